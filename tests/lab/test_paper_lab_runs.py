"""Whole runs of a bench in real time, in processes of their own: whatever ends them, the instruments are left safe and the data kept."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from paper_lab import bench_file, packaged, state

from planrunner.archive.run_reader import RunReader

PLAN = """\
planrunner: 1
title: Spinning on paper
bench: paper.yaml
sensor: {kind: paper-gyro, outputs: [rate]}
defaults: {orientation: unknown, temperature: 50 degC, motion: {rate: 20 deg/s}}
segments:
  - {label: short, dwell: 0.3 s}
  - {label: long, dwell: DWELL}
estimates: {}
report: []
"""
SPINNING = 0.349  # rad/s
PATIENCE = 240.0  # s of the wall past which something hangs, however busy the computer is
Planrunner = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def planrunner(tmp_path: Path) -> Planrunner:
    surroundings = packaged(tmp_path)
    bench_file(tmp_path)
    (tmp_path / "plan.yaml").write_text(PLAN.replace("DWELL", "60 s"), encoding="utf-8")

    def run(*arguments: str, environment: Mapping[str, str] | None = None) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "planrunner", *arguments]
        pipe = subprocess.PIPE
        here = {**surroundings, **(environment or {})}
        return subprocess.Popen(
            command, text=True, env=here, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe
        )

    return run


def started(planrunner: Planrunner, folder: Path, *more: str) -> subprocess.Popen[str]:
    """A run whose second segment records."""
    run = planrunner("run", "plan.yaml", "--quiet", "--flushed", *more)
    wait(
        lambda: (
            (folder / "table.json").exists()
            and state(folder, "table").get("rate", 0) > 0.3
            and acknowledged(folder) == 1
        ),
        run,
    )
    return run


def wait(condition: Callable[[], bool], run: subprocess.Popen[str] | None = None) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if run is not None and run.poll() is not None:
            raise AssertionError(run.communicate())
        assert time.monotonic() < deadline, "it did not come to that"
        time.sleep(0.02)


def the_run(folder: Path) -> Path:
    return next((folder / "runs").iterdir())


def acknowledged(folder: Path) -> int:
    return len(events(folder, "segment"))


def safe(folder: Path) -> bool:
    table, chamber = state(folder, "table"), state(folder, "chamber")
    return bool(table["safe"] and table["rate"] == 0 and chamber["safe"] and chamber["kelvin"] == 298.15)


def events(folder: Path, kind: str) -> list[dict[str, Any]]:
    """Those in the journal so far; a last line may be half written."""
    if not (folder / "runs").exists():
        return []
    text = (the_run(folder) / "journal.jsonl").read_text(encoding="utf-8")
    lines = text[: text.rfind("\n") + 1].splitlines()
    return [event for event in map(json.loads, lines) if event["event"] == kind]


@pytest.mark.slow
def test_a_run_of_a_real_bench_from_start_to_finish(planrunner: Planrunner, tmp_path: Path) -> None:
    (tmp_path / "plan.yaml").write_text(PLAN.replace("DWELL", "0.4 s"), encoding="utf-8")
    run = planrunner("run", "plan.yaml", "--quiet", "--flushed")
    _, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == 0, err
    assert safe(tmp_path)
    assert state(tmp_path, "table")["limited_before_moving"] and state(tmp_path, "table")["limits"] == [None, 60.0]
    assert len(RunReader.open(the_run(tmp_path)).acknowledged()) == 2
    assert state(tmp_path, "table")["connections"] == 1  # the watchdog had nothing to do
    assert not (the_run(tmp_path) / "watchdog.txt").exists()


def test_killed_the_watchdog_makes_the_bench_safe_and_the_run_goes_on(planrunner: Planrunner, tmp_path: Path) -> None:
    run = started(planrunner, tmp_path)
    assert state(tmp_path, "table")["rate"] == pytest.approx(SPINNING, rel=1e-3)
    run.send_signal(signal.SIGKILL)
    run.communicate()
    wait(lambda: (the_run(tmp_path) / "watchdog.txt").exists())
    assert safe(tmp_path)
    assert state(tmp_path, "table")["by"] != run.pid
    report = (the_run(tmp_path) / "watchdog.txt").read_text(encoding="utf-8")
    assert "planrunner ended without leaving the bench safe\n  table: safe\n  chamber: safe\n  sensor: safe\n" in report
    plan = the_run(tmp_path) / "plan.yaml"
    resumed = planrunner("resume", str(the_run(tmp_path)), "--quiet")
    wait(lambda: state(tmp_path, "table")["rate"] > 0.3, resumed)
    (event,) = events(tmp_path, "rescued")
    assert event["report"] == report and plan.exists()
    resumed.send_signal(signal.SIGTERM)
    resumed.communicate(timeout=PATIENCE)
    assert resumed.returncode == 130 and safe(tmp_path)
    assert [item.reason for item in RunReader.open(the_run(tmp_path)).rejected()] == [
        "the process ended in this segment",
        "stopped at once: SIGTERM",
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("signals", "code"), [((signal.SIGTERM,), 130), ((signal.SIGINT, signal.SIGINT), 130)])
def test_stopped_by_a_signal(
    planrunner: Planrunner, tmp_path: Path, signals: tuple[signal.Signals, ...], code: int
) -> None:
    run = started(planrunner, tmp_path)
    for number in signals:
        run.send_signal(number)
        time.sleep(0.05)
    _, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == code, err
    assert safe(tmp_path) and "The instruments are in their safe state." in err
    assert state(tmp_path, "table")["connections"] == 1


@pytest.mark.slow
def test_an_open_interlock_ends_the_run(planrunner: Planrunner, tmp_path: Path) -> None:
    run = started(planrunner, tmp_path)
    (tmp_path / "table.faults").write_text("the interlock is open", encoding="utf-8")
    _, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == 3 and "'table' cannot continue: the interlock is open" in err
    assert safe(tmp_path) and acknowledged(tmp_path) == 1


@pytest.mark.slow
def test_a_driver_that_crashes_the_process(planrunner: Planrunner, tmp_path: Path) -> None:
    run = started(planrunner, tmp_path)
    (tmp_path / "sensor.faults").write_text("exit", encoding="utf-8")
    run.communicate(timeout=PATIENCE)
    assert run.returncode == 7
    wait(lambda: (the_run(tmp_path) / "watchdog.txt").exists())
    assert safe(tmp_path)


@pytest.mark.slow
def test_an_instrument_that_cannot_be_made_safe_is_tried_again_by_the_watchdog(
    planrunner: Planrunner, tmp_path: Path
) -> None:
    """The chamber refuses for good: it is named, the exit code is 3, and the table is safe nevertheless."""
    run = started(planrunner, tmp_path)
    (tmp_path / "chamber.faults").write_text("refuse", encoding="utf-8")
    run.send_signal(signal.SIGTERM)
    _, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == 3
    assert "NOT IN THE SAFE STATE: chamber: it does not answer" in err
    assert "chamber: NOT SAFE, it does not answer" in (the_run(tmp_path) / "watchdog.txt").read_text(encoding="utf-8")
    assert state(tmp_path, "table")["safe"] and not state(tmp_path, "chamber")["safe"]


@pytest.mark.slow
def test_a_run_that_stands_still_is_taken_the_bench_from(planrunner: Planrunner, tmp_path: Path) -> None:
    """SIGSTOP: no sign of life for the five seconds that the bench allows. The run is ended, so that it can neither go on commanding nor
    keep a connection that only one can have, and goes on where it was."""
    bench_file(tmp_path, "protection: {silence: 5 s}\n")
    run = started(planrunner, tmp_path)
    run.send_signal(signal.SIGSTOP)
    wait(lambda: (the_run(tmp_path) / "watchdog.txt").exists())
    assert safe(tmp_path) and acknowledged(tmp_path) == 1
    told = (
        "planrunner gave no sign of life for 5 s and was ended; `planrunner resume` continues the run\n  table: safe\n"
    )
    assert told in (the_run(tmp_path) / "watchdog.txt").read_text(encoding="utf-8")
    _, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == -signal.SIGKILL and told in err
    resumed = planrunner("resume", str(the_run(tmp_path)), "--quiet")
    wait(lambda: state(tmp_path, "table")["rate"] > 0.3, resumed)
    resumed.send_signal(signal.SIGTERM)
    resumed.communicate(timeout=PATIENCE)
    assert resumed.returncode == 130 and safe(tmp_path) and acknowledged(tmp_path) == 1


@pytest.mark.slow
def test_a_driver_that_hangs_in_the_middle_of_a_segment_is_ended(planrunner: Planrunner, tmp_path: Path) -> None:
    """The process lives, its other threads too; only the thread that carries out the run comes to nothing."""
    bench_file(tmp_path, "protection: {silence: 5 s}\n")
    run = started(planrunner, tmp_path)
    (tmp_path / "chamber.faults").write_text("hang", encoding="utf-8")
    _, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == -signal.SIGKILL and "no sign of life for 5 s and was ended" in err
    wait(lambda: (the_run(tmp_path) / "watchdog.txt").exists())
    assert safe(tmp_path) and acknowledged(tmp_path) == 1


@pytest.mark.slow
def test_a_driver_that_hangs_while_it_is_made_safe_keeps_nobody_from_his_turn(
    planrunner: Planrunner, tmp_path: Path
) -> None:
    """The chamber comes first, and its driver never returns, here and in the watchdog: after 5 s and 30 s the table has its turn."""
    bench_file(tmp_path, "protection: {silence: 5 s}\nsafe_order: [chamber, table, sensor]\n")
    run = started(planrunner, tmp_path)
    (tmp_path / "chamber.faults").write_text("hangs when made safe", encoding="utf-8")
    wait(lambda: (the_run(tmp_path) / "watchdog.txt").exists())
    report = (the_run(tmp_path) / "watchdog.txt").read_text(encoding="utf-8")
    assert "no sign of life for 5 s" in report and "table: safe" in report
    assert "chamber: NOT SAFE, the command did not return within 30 s" in report
    assert state(tmp_path, "table")["safe"] and state(tmp_path, "table")["rate"] == 0 and acknowledged(tmp_path) == 1
    run.communicate(timeout=PATIENCE)
    (tmp_path / "chamber.faults").unlink()
    resumed = planrunner("resume", str(the_run(tmp_path)), "--quiet")
    wait(lambda: state(tmp_path, "table")["rate"] > 0.3, resumed)
    resumed.send_signal(signal.SIGTERM)
    resumed.communicate(timeout=PATIENCE)
    assert resumed.returncode == 130 and safe(tmp_path) and acknowledged(tmp_path) == 1


def test_a_run_that_is_refused_an_instrument_leaves_the_others_as_they_are(
    planrunner: Planrunner, tmp_path: Path
) -> None:
    """Somebody has the table turning and holds the sensor's port: connected to and let go, neither told to stop."""
    (tmp_path / "table.json").write_text('{"rate": 5.0, "safe": false}', encoding="utf-8")
    (tmp_path / "sensor.faults").write_text("refuses the connection", encoding="utf-8")
    run = planrunner("run", "plan.yaml", "--quiet", "--flushed")
    _, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == 3 and "sensor (paper_sensor) cannot be connected: somebody else holds its port" in err
    assert "(table, chamber: left unchanged, no command was sent)" in err
    table = state(tmp_path, "table")
    assert table["closed"] and table["rate"] == 5.0 and not table["safe"] and table["by"] == run.pid
    assert "safe" not in state(tmp_path, "chamber") and not (tmp_path / "runs").exists()


@pytest.mark.slow
def test_a_run_that_fails_before_it_moves_anything_makes_safe_what_it_commanded(
    planrunner: Planrunner, tmp_path: Path
) -> None:
    (tmp_path / "table.faults").write_text("refuses limits", encoding="utf-8")
    run = planrunner("run", "plan.yaml", "--quiet", "--flushed")
    _, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == 3 and "it keeps another limit" in err
    assert (
        "no command was sent to them: chamber, sensor." in err and "Every other instrument is in its safe state" in err
    )
    assert state(tmp_path, "table")["safe"] and "safe" not in state(tmp_path, "chamber")
    assert events(tmp_path, "safe")[0]["untouched"] == ["chamber", "sensor"]


@pytest.mark.slow
def test_a_second_resume_is_refused_before_it_connects(planrunner: Planrunner, tmp_path: Path) -> None:
    """The folder's lock comes first: also where the two see different locks of the bench."""
    run = started(planrunner, tmp_path)
    connections = state(tmp_path, "table")["connections"]
    for more in ({}, {"PLANRUNNER_LOCKS": str(tmp_path / "other-locks")}):
        second = planrunner("resume", str(the_run(tmp_path)), "--quiet", environment=more)
        _, err = second.communicate(timeout=PATIENCE)
        assert second.returncode == 2 and "error[run-in-use]" in err, err
    table = state(tmp_path, "table")
    assert table["connections"] == connections and table["rate"] > 0.3 and table["by"] == run.pid
    run.send_signal(signal.SIGTERM)
    run.communicate(timeout=PATIENCE)


@pytest.mark.slow
def test_killed_while_it_connects_nothing_is_touched(planrunner: Planrunner, tmp_path: Path) -> None:
    """The table is connected, the chamber does not return: the watchdog has nothing to answer for."""
    turning = {"rate": 5.0, "safe": False}
    (tmp_path / "table.json").write_text(json.dumps(turning), encoding="utf-8")
    (tmp_path / "chamber.faults").write_text("hangs when connected", encoding="utf-8")
    run = planrunner("run", "plan.yaml", "--quiet", "--flushed")
    wait(lambda: state(tmp_path, "table").get("by") == run.pid, run)
    run.send_signal(signal.SIGKILL)
    _, err = run.communicate(timeout=PATIENCE)  # its standard error ends with that of the watchdog
    assert err == ""
    assert state(tmp_path, "table") == {**turning, "connections": 1, "by": run.pid}


def test_two_runs_cannot_share_a_bench(planrunner: Planrunner, tmp_path: Path) -> None:
    """Not under another name either; the lock ends with its process, however that ends."""
    run = started(planrunner, tmp_path)
    other = bench_file(tmp_path).read_text(encoding="utf-8").replace("name: paper", "name: other")
    (tmp_path / "other.yaml").write_text(other, encoding="utf-8")
    for more in ((), ("--bench", "other.yaml")):
        second = planrunner("run", "plan.yaml", "--quiet", "--runs", "elsewhere", *more)
        _, err = second.communicate(timeout=PATIENCE)
        assert second.returncode == 2 and "error[bench-in-use]: this bench is in use: paper " in err
        assert f"a run, process {run.pid} of " in err
    assert not (tmp_path / "elsewhere").exists() and state(tmp_path, "table")["rate"] > 0.3
    run.send_signal(signal.SIGKILL)
    run.communicate()
    third = planrunner("run", "plan.yaml", "--quiet", "--runs", "elsewhere")  # waits for the watchdog of the first
    wait(lambda: state(tmp_path, "table")["by"] == third.pid and state(tmp_path, "table").get("rate", 0) > 0.3, third)
    third.send_signal(signal.SIGTERM)
    third.communicate(timeout=PATIENCE)
    assert safe(tmp_path)


def test_prompts_are_refused_where_nobody_is(planrunner: Planrunner, tmp_path: Path) -> None:
    text = PLAN.replace("{label: long,", "{label: long, prompt: Mount the fixture on face B,").replace("DWELL", "1 s")
    (tmp_path / "plan.yaml").write_text(text, encoding="utf-8")
    for command in (("run", "plan.yaml"), ("check", "plan.yaml", "--unattended")):
        run = planrunner(*command)
        out, err = run.communicate(timeout=PATIENCE)
        assert run.returncode == 2
        assert (
            "plan.yaml:8:27: error[run-unattended]: the operator is asked before 'long' (Mount the fixture on face B)"
            in out + err
        )
    assert not (tmp_path / "table.json").exists() and not (tmp_path / "runs").exists()
    run = planrunner("check", "plan.yaml")
    out, _ = run.communicate(timeout=PATIENCE)
    assert (
        run.returncode == 0
        and "asks the operator 1 time" in out
        and "safe state in this order: table, chamber, sensor" in out
    )


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="pseudo-terminals are POSIX")
def test_prompts_work_in_a_terminal(tmp_path: Path) -> None:
    import pty

    environment = packaged(tmp_path)
    bench_file(tmp_path)
    text = PLAN.replace("{label: long,", "{label: long, prompt: Mount the fixture on face B,").replace("DWELL", "0.3 s")
    (tmp_path / "plan.yaml").write_text(text, encoding="utf-8")
    ours, theirs = pty.openpty()
    run = subprocess.Popen(
        [sys.executable, "-m", "planrunner", "run", "plan.yaml", "--flushed"],
        env={**environment, "TERM": "dumb"},
        cwd=tmp_path,
        stdin=theirs,
        stdout=subprocess.PIPE,
        stderr=theirs,
        text=True,
    )
    os.close(theirs)
    shown = b""
    while b"Mount the fixture on face B" not in shown:
        shown += os.read(ours, 4096)
    assert safe(tmp_path) and acknowledged(tmp_path) == 1
    os.write(ours, b"\n")
    while run.poll() is None:
        try:
            os.read(ours, 4096)
        except OSError:
            break
    run.communicate(timeout=PATIENCE)
    os.close(ours)
    assert run.returncode == 0 and safe(tmp_path)
    assert [event["answer"] for event in events(tmp_path, "asked")] == ["done"]


@pytest.mark.slow
def test_prompts_are_answered_on_the_live_page(planrunner: Planrunner, tmp_path: Path) -> None:
    """Run and server are processes of their own, and nobody is at a terminal."""
    text = PLAN.replace("{label: long,", "{label: long, prompt: Mount the fixture on face B,").replace("DWELL", "0.3 s")
    (tmp_path / "plan.yaml").write_text(text, encoding="utf-8")
    run = planrunner("run", "plan.yaml", "--live-page", "--flushed")
    wait(lambda: (tmp_path / "runs").exists(), run)
    server = planrunner("serve", "runs", "--port", "0")
    assert server.stdout is not None
    address, _, token = server.stdout.readline().strip().partition("/#")

    def asked(path: str, body: Mapping[str, str] | None = None) -> Any:
        headers = {"Authorization": f"Bearer {token}", "Origin": address, "Content-Type": "application/json"}
        data = None if body is None else json.dumps(body).encode()
        with urllib.request.urlopen(urllib.request.Request(address + path, data, headers), timeout=PATIENCE) as answer:
            return json.load(answer)

    def questions() -> list[dict[str, str]]:
        running = asked("/api/activity")["running"]
        return [{"run": one["run"], **one["live"]["question"]} for one in running if one["live"]["question"]]

    wait(lambda: bool(questions()), run)
    assert safe(tmp_path) and acknowledged(tmp_path) == 1
    (question,) = questions()
    assert question["text"] == "Mount the fixture on face B"
    assert asked("/api/answer", {"run": question["run"], "question": question["id"], "by": "Li Wei"}) == {"done": True}
    _, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == 0 and "confirmed on the live page by Li Wei" in err
    assert [(event["answer"], event["by"]) for event in events(tmp_path, "asked")] == [("done", "Li Wei")]
    assert asked("/api/activity")["running"] == []
    server.send_signal(signal.SIGTERM)
    server.communicate(timeout=PATIENCE)
    assert server.returncode == 130


@pytest.mark.slow
def test_a_run_is_paused_and_goes_on(planrunner: Planrunner, tmp_path: Path) -> None:
    text = PLAN.replace("DWELL", "0.5 s").replace("estimates", "  - {label: last, dwell: 0.2 s}\nestimates")
    (tmp_path / "plan.yaml").write_text(text, encoding="utf-8")
    (tmp_path / "sensor.faults").write_text("goes on with long", encoding="utf-8")
    run = started(planrunner, tmp_path)
    paused = planrunner("pause", str(the_run(tmp_path)))
    out, _ = paused.communicate(timeout=PATIENCE)
    assert paused.returncode == 0 and "planrunner resume" in out
    (tmp_path / "sensor.faults").unlink()
    wait(lambda: bool(events(tmp_path, "paused")), run)
    assert safe(tmp_path) and acknowledged(tmp_path) == 2
    resumed = planrunner("resume", str(the_run(tmp_path)))
    out, _ = resumed.communicate(timeout=PATIENCE)
    assert resumed.returncode == 0 and out == "The run continues.\n"
    _, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == 0, err
    assert len(events(tmp_path, "continued")) == 1 and safe(tmp_path)
    late = planrunner("pause", str(the_run(tmp_path)))
    assert "error[run-not-running]" in late.communicate(timeout=PATIENCE)[1] and late.returncode == 2


@pytest.mark.slow
def test_a_recorded_segment_is_taken_again(planrunner: Planrunner, tmp_path: Path) -> None:
    """Of a finished, sealed run; its first data stay with the reason."""
    (tmp_path / "plan.yaml").write_text(PLAN.replace("DWELL", "0.2 s"), encoding="utf-8")
    planrunner("run", "plan.yaml", "--quiet", "--flushed").communicate(timeout=PATIENCE)
    folder = str(the_run(tmp_path))
    for arguments, code in (
        (("--retake", "short"), "run-retake"),
        (("--retake", "shirt", "--reason", "x"), "run-no-segment"),
    ):
        refused = planrunner("resume", folder, *arguments)
        assert f"error[{code}]" in refused.communicate(timeout=PATIENCE)[1] and refused.returncode == 2
    again = planrunner("resume", folder, "--quiet", "--retake", "short", "--reason", "the door stood open")
    _, err = again.communicate(timeout=PATIENCE)
    assert again.returncode == 0, err
    reader = RunReader.open(the_run(tmp_path))
    assert reader.sealed and [item.reason for item in reader.rejected()] == ["the door stood open"]
    assert [(item.label, item.attempt) for item in reader.acknowledged()] == [("short", 2), ("long", 1)]
    assert reader.check_digests() == 3 + 3 and reader.basis.events > 10


@pytest.mark.slow
def test_a_bench_is_kept_within_its_protection(planrunner: Planrunner, tmp_path: Path) -> None:
    bench_file(tmp_path, "protection: {rate: 10 deg/s, hottest: 45 degC, silence: 2 s}\n")
    run = planrunner("check", "plan.yaml")
    out, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == 2 and "error[meaning-range]: a silence of 2 s is out of range" in out + err
    bench_file(tmp_path, "protection: {rate: 10 deg/s, hottest: 45 degC}\n")
    run = planrunner("check", "plan.yaml")
    out, err = run.communicate(timeout=PATIENCE)
    assert run.returncode == 2
    assert (
        "50 degC is outside the chamber's range of -50 to 45 degC" in out + err and "error[physics-rate]" in out + err
    )

"""Kill −9 at random moments of whole runs, then `planrunner resume`: nothing acknowledged is lost, and the results are the same."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.in_process import planrunner

FLAGSHIP = Path(__file__).resolve().parents[2] / "plans" / "flexure_gyro_eight_position.yaml"
GIVEN = ["--set", "device_serial=1", "--set", "operator=test", "--quiet", "--json"]


def start(plan: Path, folder: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "planrunner", "run", str(plan), *GIVEN, "--runs", str(folder)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def run_in(folder: Path) -> Path | None:
    found = [path for path in folder.iterdir() if not path.name.startswith(".")] if folder.is_dir() else []
    return found[0] if found else None


def acknowledged(run: Path) -> list[str]:
    lines = (run / "journal.jsonl").read_bytes().split(b"\n")[:-1]
    events = [json.loads(line) for line in lines]
    return [event["label"] for event in events if event["event"] == "segment"]


def results(run: Path) -> bytes:
    """The results of the newest analysis. A process that was killed may leave an unfinished analysis, whose name begins with a dot."""
    finished = [path for path in (run / "analyses").iterdir() if not path.name.startswith(".")]
    newest = max(finished, key=lambda path: int(path.name))
    return (newest / "results.json").read_bytes()


def wait_for(condition: Callable[[], object], process: subprocess.Popen[bytes]) -> float:
    """Polls until the condition holds or the process ends; when that was."""
    while not condition() and process.poll() is None:
        time.sleep(0.0005)
    return time.monotonic()


def kill_and_resume(plan: Path, folder: Path, delay: float, expected: bytes) -> str:
    """One kill `delay` s after the run folder appears (before it, for a negative delay); says how far the run was."""
    process = start(plan, folder)
    if delay < 0:
        time.sleep(-delay)
    else:
        wait_for(lambda: run_in(folder), process)
        time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    process.wait()
    run = run_in(folder)
    if run is None:
        return "before the folder"
    before = acknowledged(run)
    files = {path.name: path.read_bytes() for path in (run / "segments").glob("[0-9]*.parquet")}
    done = planrunner("resume", run, "--quiet", "--json", cwd=folder)
    if "run-finished" in done.stderr:
        done = planrunner("estimate", run, "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert acknowledged(run)[: len(before)] == before
    for name, data in files.items():
        if len(before) >= int(name[:4]):
            assert (run / "segments" / name).read_bytes() == data
    assert results(run) == expected
    return f"{len(before):2} segments acknowledged"


def campaign(folder: Path, kills: int) -> None:
    """Kills spread over the whole life of a run; a tenth of them before its folder stands."""
    plan = folder / "plan.yaml"
    text = FLAGSHIP.read_text(encoding="utf-8").replace(
        "report.html, ", ""
    )  # its pictures would take longer than the run
    plan.write_text(text.replace("dwell: 2 min", "dwell: 15 min"), encoding="utf-8")
    process = start(plan, folder / "whole")
    began = wait_for(lambda: run_in(folder / "whole"), process)
    run = run_in(folder / "whole")
    assert run is not None
    ended = wait_for((run / "seal.json").exists, process)
    assert process.wait() == 0
    expected = results(run)
    draw = random.Random(20)
    seen: dict[str, int] = {}
    for number in range(kills):
        early = number % 10 == 9
        delay = -draw.uniform(0.1, 0.6) if early else draw.uniform(0, 1.2 * (ended - began))
        state = kill_and_resume(plan, folder / str(number), delay, expected)
        seen[state] = seen.get(state, 0) + 1
    print(f"{kills} kills: {dict(sorted(seen.items()))}")
    assert len(seen) >= kills / 10, seen


@pytest.mark.slow
def test_many_kills(tmp_path: Path) -> None:
    """`PLANRUNNER_KILLS=300` for a campaign."""
    campaign(tmp_path, int(os.environ.get("PLANRUNNER_KILLS", "50")))

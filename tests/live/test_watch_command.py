"""`planrunner watch`: running runs as a view, as lines of a log and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from running_run import QUESTION, STATE, RunningRun, close_all

from tests.in_process import planrunner


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    close_all()


def test_the_view_names_segment_channels_and_time_left(tmp_path: Path) -> None:
    run = RunningRun(tmp_path)
    run.show(channels=(replace(STATE.channels[0], mean=0.00123456789),))
    done = planrunner("watch", tmp_path, "--once", cwd=tmp_path)
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert lines[0] == f"drift, device FG-7 ({run.path.name})"
    assert lines[1] == "25%, segment 3 of 8 (P3), recording, about 2 min left"
    assert lines[2] == "━" * 15 + "─" * 45
    assert lines[4].split() == ["rate_x", "1000", "0.0012345679", "0.02", "-0.06", "0.07", "deg/s"]


def test_texts_do_not_control_the_terminal(tmp_path: Path) -> None:
    run = RunningRun(tmp_path)
    run.show(question=QUESTION, label="\x1b[2J[bold]x")
    for mode in ("--once", "--json"):
        out = planrunner("watch", tmp_path, mode, cwd=tmp_path).stdout
        assert "\x1b" not in out and "\u202e" not in out and "[bold]x" in out


def test_a_log_has_a_line_when_something_happens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run asks, goes on and ends while the command looks."""
    run = RunningRun(tmp_path)
    steps = iter([lambda: run.show(question=QUESTION), lambda: None, lambda: run.show(label="P4"), run.end])
    monkeypatch.setattr("planrunner.cli.watch.time.sleep", lambda seconds: next(steps)())
    done = planrunner("watch", tmp_path, "--until-idle", cwd=tmp_path)
    name = f"drift, device FG-7 ({run.path.name})"
    lines = done.stdout.splitlines()
    assert lines[0] == f"{name}: 25%, segment 3 of 8 (P3), recording, about 2 min left"
    assert lines[1].startswith(f"{name}: 25%, segment 3 of 8 (P3), waits for the operator: Mount face B")
    assert lines[2] == f"{name}: 25%, segment 3 of 8 (P4), recording, about 2 min left"
    assert lines[3:] == [f"{run.path.name}: finished"]


def test_the_activity_as_json(tmp_path: Path) -> None:
    RunningRun(tmp_path)
    found = json.loads(planrunner("watch", tmp_path, "--json", cwd=tmp_path).stdout)
    assert found["planrunner_activity"] == 1 and found["running"][0]["live"]["segment"]["label"] == "P3"


def test_an_archive_that_does_not_exist(tmp_path: Path) -> None:
    done = planrunner("watch", "nowhere", cwd=tmp_path)
    assert done.returncode == 2 and "error[archive-not-found]" in done.stderr

"""Progress while a long recording is examined, played back and searched for still spans, by a clock that the tests set."""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from planrunner.base.progress import LONG, Pace, Underway
from planrunner.cli import main
from planrunner.cli.progress import reading_progress
from planrunner.execution.progress import Advanced, ProgressEvent
from planrunner.execution.stopping import StopRequest
from planrunner.tasks.check import check_plan
from planrunner.tasks.run import start

BENCH = """planrunner_bench: 1
name: tumbled
clock: virtual
site: {latitude: 45 deg, gravity: 9.80665 m/s^2}
instruments:
  imu:
    driver: recording
    file: r.csv
    kind: imu
    time: {column: t}
    sample_rate: 100 Hz
    channels:
      accel_x: {column: x, unit: m/s^2}
      accel_y: {column: y, unit: m/s^2}
      accel_z: {column: z, unit: m/s^2}
"""
PLAN = """planrunner: 1
title: Tumble
bench: bench.yaml
sensor: {kind: imu, outputs: [accel_x, accel_y, accel_z]}
segments: [{label: tumble, orientation: unknown, dwell: recorded}]
estimates:
  a:
    estimator: accelerometer_multi_position
    reference: gravity_magnitude
    segments: {detect: still, window: 0.5 s, threshold: 0.2 m/s^2, at_least: 2 s}
report: [summary.md]
"""


class Clock:
    """Each reading is `step` seconds after the one before."""

    def __init__(self, step: float):
        self.now, self.step = 0.0, step

    def __call__(self) -> float:
        self.now += self.step
        return self.now


@pytest.fixture
def tumbled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Twelve still poses of 4 s, in batches of 500 rows."""
    noise = np.random.default_rng(5)
    directions = noise.normal(size=(12, 3))
    poses = np.repeat(9.80665 * directions / np.linalg.norm(directions, axis=1)[:, None], 400, axis=0)
    values = poses + noise.normal(0, 0.02, poses.shape)
    rows = [f"{n / 100},{x},{y},{z}" for n, (x, y, z) in enumerate(values.tolist())]
    (tmp_path / "r.csv").write_text("\n".join(["t,x,y,z", *rows]), encoding="utf-8")
    (tmp_path / "bench.yaml").write_text(BENCH, encoding="utf-8")
    (tmp_path / "plan.yaml").write_text(PLAN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("planrunner.instruments.formats.file.BATCH", 500)
    monkeypatch.setattr("planrunner.cli.progress.LINES_EVERY", 0.0)
    return tmp_path


def announced(text: str) -> list[str]:
    """What lines of progress with a time left name."""
    return list(dict.fromkeys(re.findall(r"^\d+%, (.*?), about .* left$", text, re.MULTILINE)))


@pytest.mark.parametrize(
    ("command", "named"),
    [
        ("run", ["checking r.csv", "segment 1 of 1 (tumble)", "reading the recording", "estimating 'a'"]),
        ("check", ["checking r.csv", "reading r.csv", "screening the samples", "estimating 'a'"]),
    ],
)
def test_each_long_pass_over_a_recording_is_announced(
    tumbled: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    named: list[str],
) -> None:
    def told(step: float, *more: str) -> list[str]:
        monkeypatch.setattr("planrunner.base.progress.now", Clock(step))
        assert main([command, "plan.yaml", "--data", ".", *more]) == 0
        return announced(capsys.readouterr().err)

    assert told(3.0) == named
    assert not set(told(1e-3)) & set(named[:1] + named[2:])  # short passes
    assert told(3.0, "--quiet") == []


def test_a_segment_as_long_as_its_recording_advances(tumbled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planrunner.execution.progress.EVERY", 0.0)
    events: list[ProgressEvent] = []
    _, outcome = start(
        check_plan(Path("plan.yaml")).sound(),
        info={},
        runs=Path("runs"),
        stop=StopRequest(lambda text: None),
        data_root=Path(),
        progress=events.append,
    )
    assert outcome.ok
    fractions = [event.fraction for event in events if isinstance(event, Advanced)]
    assert fractions == sorted(fractions) and len({one for one in fractions if 0 < one < 1}) > 5


def test_the_time_left_is_that_at_the_pace_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(0.0)
    monkeypatch.setattr("planrunner.base.progress.now", clock)
    seen: list[Underway] = []
    pace = Pace("reading", 100, seen.append)
    clock.now = 0.9 * LONG
    pace.reached(90)  # whole: 2 s
    clock.now = 3.0
    pace.reached(95)
    assert [(one.what, one.fraction) for one in seen] == [("reading", 0.9), ("reading", 0.95)]
    assert [one.time_left for one in seen] == pytest.approx([0.1 * LONG, 3.0 / 0.95 * 0.05])


def test_a_display_that_fails_does_not_end_the_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planrunner.base.progress.now", Clock(10.0))
    calls: list[Underway] = []

    def broken(event: Underway) -> None:
        calls.append(event)
        raise ValueError("no terminal")

    pace = Pace("reading", 3, broken)
    for row in (1, 2, 3):
        pace.reached(row)
    assert len(calls) == 1


def test_a_terminal_shows_a_bar_with_the_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    out = Terminal()
    monkeypatch.setattr(sys, "stderr", out)
    with reading_progress() as notice:
        assert notice is not None and out.getvalue() == ""
        notice(Underway("checking long.csv", 0.5, 30.0))
    assert all(text in out.getvalue() for text in ("checking long.csv", "50 %", "about 30 s left"))

"""Closing the gap of recordings that are played back: no bench can simulate them, so the simulations follow the recorded motion.

The recordings come from a generator without formulas of effects (`moved_by_hand`: accelerations are second differences of positions).
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from moved_by_hand import BY_REFERENCE, UNITS, Hand

from planrunner.cli import main
from planrunner.execution.stopping import StopRequest
from planrunner.gap.answer.diagnosis import DiagnosisOptions
from planrunner.tasks.closing import Ending, close, comparison
from planrunner.tasks.diagnose import Diagnosed, diagnose_recorded, recorded_file

ARM = (0.0, 0.05, 0.0)
PARTS, SECONDS = 6, 8.0
NOISE = {"deg/s": "noise: 0.05 deg/s", "m/s^2": "noise: 0.02 m/s^2"}
FEW = DiagnosisOptions(effects=("lever_arm", "time_latency", "accel_second_order"))


def _laid_out(folder: Path) -> tuple[Path, Path, Path]:
    """Plan, recording and segments of two units on a board that a hand twists."""
    parts = Hand(arm=ARM, fast=300.0).recording(3, BY_REFERENCE, PARTS, SECONDS)
    with (folder / "r.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["t", *UNITS])
        for part in parts:
            for block in part.blocks(tuple(UNITS)):
                rows.writerows(np.column_stack([block.time, *(block.channels[name] for name in UNITS)]).tolist())
    spans = [(f"part_{k}", one.statistics.start, one.statistics.end) for k, one in enumerate(parts, start=1)]
    table = "label,start_s,end_s\n" + "".join(f"{name},{a!r},{b + 0.005!r}\n" for name, a, b in spans)
    (folder / "s.csv").write_text(table)
    channels = "".join(
        f"      {name}: {{column: {name}, unit: '{unit}'{', ' + NOISE[unit] if unit in NOISE else ''}}}\n"
        for name, unit in UNITS.items()
    )
    (folder / "b.yaml").write_text(
        "planrunner_bench: 1\nname: board\nclock: virtual\nsite: {latitude: 45 deg, gravity: 9.81 m/s^2}\n"
        "instruments:\n  imu:\n    driver: recording\n    file: r.csv\n    kind: imu\n    time: {column: t, unit: s}\n"
        f"    sample_rate: 100 Hz\n    segments: {{table: s.csv}}\n    channels:\n{channels}"
    )
    own = ", ".join(f"two_accel_{axis}" for axis in "xyz")
    rates, forces = (", ".join(f"one_{kind}_{axis}" for axis in "xyz") for kind in ("gyro", "accel"))
    (folder / "p.yaml").write_text(
        f"planrunner: 1\ntitle: Twisted\nbench: ./b.yaml\nsensor: {{kind: imu, outputs: [{own}]}}\n"
        "defaults:\n  orientation: unknown\n  dwell: recorded\n"
        f"  motion: {{recorded: {{rates: [{rates}], forces: [{forces}]}}}}\n"
        f'segments:\n  - {{label: "part_{{repeat}}", repeat: {PARTS}}}\nreport: [summary.md]\n'
    )
    return folder / "p.yaml", folder / "r.csv", folder / "s.csv"


@pytest.fixture(scope="module")
def twisted(tmp_path_factory: pytest.TempPathFactory) -> Diagnosed:
    plan, recording, segments = _laid_out(tmp_path_factory.mktemp("twisted"))
    return diagnose_recorded(recorded_file(plan, None, recording, segments), FEW)


def test_the_lever_arm_closes_the_gap_of_a_motion_by_hand(twisted: Diagnosed) -> None:
    assert twisted.diagnosis.verdict.effects == ("lever_arm",)
    found = comparison(twisted, StopRequest())
    assert found.before_sigma > 50
    assert (
        found.after_sigma < 0.1 * found.before_sigma
    )  # the diagnosis finds the arm within 12 %, one standard uncertainty


def test_the_opposite_lever_arm_opens_it(twisted: Diagnosed) -> None:
    """The comparison is no formality."""
    found = comparison(twisted, StopRequest(), stated=[("lever_arm", {"r_y": f"{-1e3 * ARM[1]} mm"})])
    assert found.after_sigma == pytest.approx(2 * found.before_sigma, rel=0.1)


def test_close_ends_when_nothing_is_left(twisted: Diagnosed) -> None:
    closed = close(twisted.recorded, StopRequest(), options=FEW)
    assert closed.ending is Ending.NOTHING_LEFT
    assert [name for name, _ in closed.stated] == ["lever_arm"]
    assert float(dict(closed.stated)["lever_arm"]["r_y"].split()[0]) == pytest.approx(1e3 * ARM[1], rel=0.12)
    assert closed.bench == ""


def test_no_bench_is_written_and_the_reason_is_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan, recording, segments = _laid_out(tmp_path)
    asked = ["close", str(plan), "--recording", str(recording), "--segments", str(segments)]
    assert main([*asked, "--write-bench", str(tmp_path / "closed.yaml")]) == 0
    assert "No bench simulated the recording" in capsys.readouterr().out
    assert not (tmp_path / "closed.yaml").exists()

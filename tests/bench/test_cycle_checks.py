"""What `check` says of cycles of turns and stops: figures for stops and turns apart, cable limits, mean angle, resonance, whole cycles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pytest

from planrunner.base.findings import Finding
from planrunner.tasks.check import Checked, check_plan

BENCH = """\
planrunner_bench: 1
name: indexing
clock: virtual
site: {latitude: 45 deg, gravity: 9.806 m/s^2}
instruments:
  table:
    driver: virtual_table
    axes: [{name: azimuth, direction: DIRECTION, max_rate: 100 deg/s, max_acceleration: 5 deg/s^2 LIMITS}]
  gyro:
    driver: virtual_flexure_gyro
    scale_factor: {x: 0.2 (deg/h)/(pulse/s), y: 0.2 (deg/h)/(pulse/s)}
    drift_x: {F: 1 deg/h, X: 0 deg/h/g, Y: 0 deg/h/g, Z: 0 deg/h/g}
    drift_y: {F: 1 deg/h, X: 0 deg/h/g, Y: 0 deg/h/g, Z: 0 deg/h/g}
    full_scale: 1000000 pulse/s
    sample_rate: 100 Hz
"""
PLAN = """\
planrunner: 1
title: a cycle
bench: bench.yaml
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
segments:
  - label: navigate
    orientation: {x: east, y: north, z: up}
    dwell: DWELL
    motion:
      cycle: {A: 0 deg, B: 90 deg, C: 180 deg, D: 270 deg}
      turn_rate: 10 deg/s
      stop: STOP
      moves: [MOVES]
"""
NAMES = "ABCD"
PRINTED = (180, 90, -180, -90, -180, -90, 180, 90)
MIRRORED = (-180, 90, 180, -90, 180, -90, -180, 90)
EIGHT = (90, 90, -90, -90, -90, -90, 90, 90)
MOVES_LINE = 13


def moves(turns: Sequence[int]) -> str:
    angle, found = 0, []
    for turn in turns:
        start, angle = NAMES[angle // 90 % 4], angle + turn
        found.append(f"{start} {turn:+d} {NAMES[angle // 90 % 4]}")
    return ", ".join(found)


def check(
    folder: Path,
    turns: Sequence[int],
    dwell: str = "{cycles: 2}",
    stop: str = "3 min",
    direction: str = "up",
    limits: str = "",
    plan: str = PLAN,
) -> Checked:
    (folder / "bench.yaml").write_text(BENCH.replace("DIRECTION", direction).replace("LIMITS", limits))
    path = folder / "plan.yaml"
    path.write_text(plan.replace("MOVES", moves(turns)).replace("DWELL", dwell).replace("STOP", stop))
    return check_plan(path)


def only(checked: Checked) -> Finding:
    (finding,) = checked.findings
    return finding


def test_the_printed_cycle_is_warned_of_where_it_stands(tmp_path: Path) -> None:
    # −23.03 s in (8·180 + 4·20 + 4·11) s = 1564 s is 1.47 %; 0.01 deg/h of drift over the Earth's radius is 0.6 nautical miles an hour.
    checked = check(tmp_path, PRINTED)
    finding = only(checked)
    assert (finding.code, finding.severity, finding.mark.line) == ("physics-cycle-residual", "warning", MOVES_LINE)
    for words in (
        "1564.0 s",
        "effective time of 0 s from the stops",
        "-23.03 s from the turns",
        "1.5 %",
    ):
        assert words in finding.message
    assert "0.00015 deg/h" in finding.message and "0.0088 nautical miles" in finding.message
    assert "planrunner design" in finding.hint
    assert checked.ok


@pytest.mark.parametrize("turns", [(*PRINTED, *MIRRORED), EIGHT])
def test_cycles_that_leave_nothing_pass_without_a_word(turns: Sequence[int], tmp_path: Path) -> None:
    checked = check(tmp_path, turns)
    assert not list(checked.findings)
    assert checked.schedule is not None


def test_stops_that_do_not_balance_are_named(tmp_path: Path) -> None:
    found = {finding.code: finding for finding in check(tmp_path, (90, 90, -90, -90)).findings}
    assert set(found) == {"physics-cycle-residual", "physics-cycle-stops", "physics-cycle-angle"}
    # Stops at A, B, C, B: B twice, D never. 360 s across the error are left over them.
    assert "B for 360 s per cycle, the opposite side for 0 s" in found["physics-cycle-stops"].message
    assert "effective time of +360.00 s (perpendicular to it) from the stops" in found["physics-cycle-residual"].message
    # Symmetric about 90 deg, so that is the mean: 10 ppm of 90 deg are 3.24 arcsec.
    assert "is 90 deg" in found["physics-cycle-angle"].message
    assert "+3.2 arcsec" in found["physics-cycle-angle"].message


def test_periodic_reversal_is_a_cycle_without_stops(tmp_path: Path) -> None:
    plan = PLAN.replace("[MOVES]", "[A +360 A, A -360 A, A -360 A, A +360 A]")
    finding = only(check(tmp_path, EIGHT, stop="0 s", plan=plan))
    assert finding.code == "physics-cycle-residual"  # the axis is slow where it reverses
    assert "effective time of 0 s from the stops" in finding.message
    one_sided = PLAN.replace("[MOVES]", "[A +360 A, A -360 A]")
    assert "physics-cycle-angle" in [f.code for f in check(tmp_path, EIGHT, stop="0 s", plan=one_sided).findings]


def test_a_cycle_that_neither_stops_nor_turns_is_refused_at_its_move(tmp_path: Path) -> None:
    plan = PLAN.replace("[MOVES]", "[A 0 A]")
    finding = only(check(tmp_path, EIGHT, dwell="1 h", stop="0 s", plan=plan))
    assert (finding.code, finding.severity) == ("meaning-cycle", "error")
    assert "turns by 0 deg" in finding.message


def test_a_cycle_that_drives_the_schuler_oscillation(tmp_path: Path) -> None:
    finding = only(check(tmp_path, EIGHT, dwell="{cycles: 1, at_least: 24 h}", stop="10 min"))
    assert (finding.code, finding.severity, finding.mark.line) == ("physics-cycle-schuler", "warning", 12)
    assert "81.5 min" in finding.message  # (8·600 + 8·11) s
    assert "84.4 min" in finding.message
    assert "shorten the stops" in finding.hint


def test_a_part_of_a_cycle_left_over_is_noted(tmp_path: Path) -> None:
    # One cycle of 8·180 + 8·11 = 1528 s; 24 h are 56.54 of them.
    finding = only(check(tmp_path, EIGHT, dwell="24 h"))
    assert (finding.code, finding.severity) == ("physics-cycle-part", "note")
    assert "56.54 cycles of 1528.0 s" in finding.message
    assert "{cycles: 57}" in finding.hint


def test_dwell_in_whole_cycles(tmp_path: Path) -> None:
    schedule = check(tmp_path, EIGHT, dwell="{cycles: 3}").schedule
    assert schedule is not None and schedule.segments[0].dwell == pytest.approx(3 * 1528)
    schedule = check(tmp_path, EIGHT, dwell="{cycles: 1, at_least: 72 h}").schedule
    assert schedule is not None and schedule.segments[0].dwell == pytest.approx(170 * 1528)


@pytest.mark.parametrize(
    ("dwell", "motion", "words"),
    [
        ("{turns: 2}", None, "is given in turns, but the segment does not spin"),
        ("{cycles: 2}", "    rate: 10 deg/s\n", "is given in cycles, but the segment does not have a cycle"),
        ("{cycles: 2, turns: 2}", None, "both turns and cycles"),
        ("{at_least: 2 h}", None, "neither turns nor cycles"),
    ],
)
def test_dwells_in_what_the_motion_does_not_do(dwell: str, motion: str | None, words: str, tmp_path: Path) -> None:
    plan = PLAN if motion is None else PLAN[: PLAN.index("    motion:")] + motion
    finding = only(check(tmp_path, EIGHT, dwell=dwell, plan=plan))
    assert (finding.code, finding.severity, finding.mark.line) == ("meaning-turns", "error", 8)
    assert words in finding.message and finding.hint


def test_cable_range_and_where_the_cycle_begins(tmp_path: Path) -> None:
    assert not check(tmp_path, EIGHT, limits=", lowest: -180 deg, highest: 180 deg").findings.errors  # exactly
    limits = ", lowest: -200 deg, highest: 300 deg"
    assert not check(tmp_path, EIGHT, limits=limits).findings.errors
    # The printed cycle goes 270 deg to either side, 540 deg in all.
    (finding,) = check(tmp_path, PRINTED, limits=limits).findings.errors
    assert finding.code == "physics-cable-wrap" and "540 deg" in finding.message and finding.mark.line == MOVES_LINE
    # 360 deg fit between the limits, but not with the other way round about zero.
    plan = PLAN.replace("east, y: north", "south, y: east")
    (finding,) = check(tmp_path, EIGHT, limits=", lowest: -200 deg, highest: 200 deg", plan=plan).findings.errors
    assert finding.code == "physics-cable-wrap" and "from -270 to 90 deg" in finding.message


def test_the_table_stands_where_the_dwell_leaves_it(tmp_path: Path) -> None:
    # 3 min at A, 11 s of turning: after 200 s the table stands at B, and going back to A takes the 11 s again.
    plan = PLAN + "  - {label: after, orientation: {x: east, y: north, z: up}, dwell: 1 min}\n"
    schedule = check(tmp_path, EIGHT, dwell="200 s", plan=plan.replace("10 deg/s", "25 deg/s")).schedule
    assert schedule is not None
    # The next segment's way back is made at the axis's own 100 deg/s: triangular, 2·√(90/5).
    assert schedule.segments[1].transition == pytest.approx(2 * math.sqrt(90 / 5))


def test_turns_beyond_the_axis(tmp_path: Path) -> None:
    finding = only(check(tmp_path, EIGHT, plan=PLAN.replace("10 deg/s", "150 deg/s")))
    assert (finding.code, finding.severity, finding.mark.line) == ("physics-rate", "error", 11)


def test_an_axis_that_is_not_vertical(tmp_path: Path) -> None:
    finding = only(check(tmp_path, EIGHT, direction="north"))
    assert (finding.code, finding.severity) == ("physics-cycle-axis", "warning")

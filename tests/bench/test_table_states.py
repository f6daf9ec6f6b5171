"""Where a table may be after a motion, and that `check` finds no fault with exactly those plans that run from everywhere there."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planrunner.bench.table_states import TableState, spin_misses
from planrunner.physics.kinematics import TableAxis, attitude, joint_angles
from planrunner.tasks.check import check_plan
from tests.agreement.carried_out import carried_out

DEG = math.pi / 180
LIMITED = (TableAxis("azimuth", (0.0, 0.0, 1.0), 1.0, 1.0, -370 * DEG, 370 * DEG),)
PLAN = """\
planrunner: 1
title: a spin, half a turn, and a spin again
bench: virtual_imu
sensor: {{kind: imu, outputs: [gyro_z]}}
defaults: {{orientation: {{x: east, y: north, z: up}}, dwell: 1 s, settle: 0 s}}
segments:
  - {{label: A, rate: {first:g} deg/s, dwell: {dwell:.9g} s}}
  - {{label: B}}
  - {{label: C, rate: {last:g} deg/s, dwell: 6 s}}
report: [summary.md]
"""


def half_a_turn(first: float, last: float, beyond: float) -> str:
    """A first spin through 180 deg and `beyond` [deg], at 5 deg/s^2."""
    return PLAN.format(first=first, last=last, dwell=(180 + beyond) / abs(first) - abs(first) / 5)


@pytest.mark.slow
@settings(max_examples=25, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    st.floats(2, 18).map(lambda rate: float(f"{rate:.3g}")),
    st.sampled_from([-1, 1]),
    st.sampled_from([-10.0, 10.0]),
    st.one_of(st.sampled_from([0.0, 1e-9, -1e-9, 9.5, 10.0]), st.floats(-12, 12)),
)
def test_what_passes_runs_wherever_the_spin_stops(
    tmp_path: Path, rate: float, sign: int, last: float, beyond: float
) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(half_a_turn(sign * rate, last, beyond), encoding="utf-8")
    ended = carried_out(path, tmp_path / "runs")
    assert ended.agrees, ended.told
    assert ended.passed or ended.errors == ("physics-cable-wrap",)
    if abs(beyond) < 5:
        assert ended.passed  # here the table always unwinds


def test_two_ways_after_a_spin_must_both_fit(tmp_path: Path) -> None:
    # Up to 190 deg the table unwinds to 0, beyond it goes on to 360 deg; a spin through 189.5 deg may end on either side.
    # From 360 deg, spinning on by 80 deg is too far; spinning back is not.
    path = tmp_path / "plan.yaml"
    path.write_text(half_a_turn(10, 10, 9.5), encoding="utf-8")
    (finding,) = check_plan(path).findings.errors
    assert finding.code == "physics-cable-wrap" and finding.mark.line == 9
    assert "known only approximately" in finding.message and "from 360 to 440 deg" in finding.message
    path.write_text(half_a_turn(10, -10, 9.5), encoding="utf-8")
    assert check_plan(path).ok


def test_both_ways_are_kept_until_an_orientation_leads_them_together() -> None:
    start = TableState(np.zeros(1)).ended(LIMITED, 0, 190 * DEG, (-2 * DEG, 2 * DEG), 1.0)
    level, _ = start.oriented(LIMITED, attitude(LIMITED, [0.0]), 0.0)
    assert sorted(np.degrees([level.joints[0], *(other[0] for other in level.others)])) == pytest.approx([0, 360])
    assert level.roughly is None
    quarter, _ = level.oriented(LIMITED, attitude(LIMITED, [90 * DEG]), 0.0)
    assert quarter.joints[0] == pytest.approx(90 * DEG) and not quarter.others  # 450 deg is beyond the limit


@settings(max_examples=60, deadline=None)
@given(st.floats(-360, 360), st.floats(0, 40), st.floats(0, 40), st.floats(-180, 180), st.floats(0, 1))
def test_every_way_from_the_range_of_a_spin_is_foreseen(
    stop: float, below: float, above: float, target: float, share: float
) -> None:
    state = TableState(np.zeros(1)).ended(LIMITED, 0, stop * DEG, (-below * DEG, above * DEG), 0.0)
    wanted = attitude(LIMITED, [target * DEG])
    foreseen, _ = state.oriented(LIMITED, wanted, 0.0)
    found = joint_angles(LIMITED, wanted, [(stop - below + share * (below + above)) * DEG])
    assert min(abs(float(found[0] - way[0])) for way in (foreseen.joints, *foreseen.others)) < 1e-6


def test_how_far_a_spin_may_miss_its_end() -> None:
    # 0.1 s at 2 rad/s, and a thousandth of 30 rad; settling that ends up to 5 s sooner leaves 10 rad undone.
    assert spin_misses(2.0, 30.0, 0.0) == pytest.approx((-0.23, 0.23))
    assert spin_misses(2.0, 30.0, 5.0) == pytest.approx((-10.23, 0.23))
    assert spin_misses(-2.0, -30.0, 5.0) == pytest.approx((-0.23, 10.23))

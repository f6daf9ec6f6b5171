"""Table kinematics against scipy's rotations, hand-worked moves and random round trips."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planrunner.physics.kinematics import (
    TableAxis,
    Unreachable,
    attitude,
    check_geometry,
    joint_angles,
    joint_directions,
    move_time,
    spin_axis,
    spin_up_time,
    transition_time,
)

DEG = math.pi / 180
UP, EAST, NORTH = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def axis(name: str, direction: tuple[float, float, float], limit: float = math.inf, rate: float = 1.0) -> TableAxis:
    return TableAxis(name, direction, rate, 1.0, -limit, limit)


THREE = (axis("outer", UP), axis("middle", EAST), axis("inner", NORTH))
LEVEL = (axis("outer", NORTH), axis("middle", UP), axis("inner", EAST))
angle = st.floats(-math.pi, math.pi)


def by_scipy(axes: tuple[TableAxis, ...], angles: list[float], azimuth: float) -> np.ndarray:
    """Intrinsic rotations, outermost first, after a clockwise turn by the azimuth; rows are the sensor's axes."""
    total = Rotation.from_rotvec([0.0, 0.0, -azimuth])
    for item, q in zip(axes, angles, strict=True):
        total = total * Rotation.from_rotvec(q * np.array(item.direction))
    return total.as_matrix().T


def cardinal() -> list[np.ndarray]:
    """All 24 attitudes whose axes point along the site's."""
    eye = np.eye(3)
    signed = [sign * eye[i] for i in range(3) for sign in (1, -1)]
    return [np.array([x, y, np.cross(x, y)]) for x in signed for y in signed if x @ y == 0]


@given(st.lists(angle, min_size=3, max_size=3), angle)
def test_attitude_agrees_with_scipy(angles, azimuth):
    assert np.allclose(attitude(THREE, angles, azimuth), by_scipy(THREE, angles, azimuth), atol=1e-12)


def test_an_azimuth_turns_the_table_clockwise():
    # With the reference direction 90 deg east of north, the sensor's y axis (north at azimuth 0) points east, and x south.
    assert np.allclose(attitude(THREE, [0, 0, 0], 90 * DEG), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from([THREE, LEVEL]),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.lists(st.floats(-20, 20), min_size=3, max_size=3),
    angle,
)
def test_every_attitude_is_reached_by_the_shorter_way(axes, quaternion, near, azimuth):
    wanted = Rotation.from_quat(quaternion).as_matrix()
    found = joint_angles(axes, wanted, near, azimuth)
    assert np.allclose(by_scipy(axes, list(found), azimuth), wanted, atol=1e-7)
    assert np.abs(found - near).max() <= math.pi + 1e-6  # near half a turn, the positive direction is taken


@pytest.mark.parametrize("axes", [THREE, LEVEL])
def test_all_cardinal_attitudes_are_reached_from_each_other_gimbal_lock_included(axes):
    attitudes = cardinal()
    assert len(attitudes) == 24
    now = np.zeros(3)
    for wanted in attitudes + attitudes[::-5]:
        now = joint_angles(axes, wanted, now)
        assert np.allclose(attitude(axes, now), wanted, atol=1e-12)


@given(angle, angle, angle)
def test_in_gimbal_lock_the_table_does_not_move_when_it_is_already_there(outer, shift, inner):
    axes = (
        axis("outer", UP),
        axis("middle", EAST),
        axis("inner", UP),
    )  # middle at zero: outer and inner lie along each other
    near = [outer, 0.0, inner]
    wanted = by_scipy(axes, [outer + shift, 0.0, inner - shift], 0.0)
    assert np.allclose(joint_angles(axes, wanted, near), near, atol=1e-7)


def test_of_two_solutions_the_quicker_is_taken_and_limits_force_the_other():
    wanted = attitude(THREE, [10 * DEG, 30 * DEG, 20 * DEG])
    assert np.allclose(joint_angles(THREE, wanted, [0, 0, 0]) / DEG, [10, 30, 20])
    # The other solution turns outer by 180 deg, takes 180 − 30 on the middle axis, and turns inner by 180 deg.
    flipped = joint_angles(THREE, wanted, [-170 * DEG, 150 * DEG, -160 * DEG]) / DEG
    assert np.allclose(flipped, [-170, 150, -160])
    limited = (THREE[0], TableAxis("middle", EAST, 1, 1, 100 * DEG, 200 * DEG), THREE[2])
    assert np.allclose(joint_angles(limited, wanted, [0, 150 * DEG, 0])[1] / DEG, 150)


def test_a_limited_axis_unwinds_where_a_continuous_one_goes_on():
    quarter = attitude(THREE, [90 * DEG, 0, 0])
    start = [350 * DEG, 0, 0]
    assert joint_angles(THREE, quarter, start)[0] / DEG == pytest.approx(450)
    limited = (axis("outer", UP, 400 * DEG), axis("middle", EAST, 100 * DEG), THREE[2])
    assert joint_angles(limited, quarter, start)[0] / DEG == pytest.approx(90)
    # Where the middle axis may turn over, going back by 80 deg and turning both others by 180 deg is quicker than 260 deg.
    freer = (limited[0], *THREE[1:])
    assert np.abs(joint_angles(freer, quarter, start)) / DEG == pytest.approx([270, 180, 180])


@given(st.floats(-5, 5), st.sampled_from([-1, 1]))
def test_half_a_turn_away_a_limited_axis_goes_towards_zero(off, side):
    axes = (axis("outer", UP, 370 * DEG),)
    level = attitude(axes, [0.0])
    assert joint_angles(axes, level, [(side * 180 + off) * DEG])[0] == pytest.approx(0, abs=1e-9)
    assert joint_angles(axes, level, [side * 195 * DEG])[0] == pytest.approx(side * 2 * math.pi)  # 165 against 195 deg
    assert joint_angles(axes, attitude(axes, [math.pi]), [off * DEG])[0] == pytest.approx(math.pi)


@given(st.floats(-1e-7, 1e-7), st.floats(-20, 20))
def test_half_a_turn_away_a_continuous_axis_turns_in_the_positive_direction(off, here):
    target = joint_angles(THREE[:1], attitude(THREE[:1], [here + math.pi + off]), [here])
    assert target[0] - here == pytest.approx(math.pi, abs=1e-6)


def test_an_angle_at_the_very_limit_counts_as_within():
    axes = (axis("outer", UP, 90 * DEG), axis("middle", EAST, 90 * DEG), axis("inner", NORTH, 90 * DEG))
    found = joint_angles(axes, attitude(axes, [math.pi / 2, 0, 0]), [0, 0, 0])
    assert found[0] == pytest.approx(math.pi / 2, abs=1e-12)
    assert all(abs(q) <= 90 * DEG for q in found)


def test_what_limits_forbid_is_explained_with_axis_angle_and_limit():
    axes = (axis("outer", UP), axis("tilt", EAST, 45 * DEG), axis("inner", NORTH, 45 * DEG))
    with pytest.raises(
        Unreachable, match=r"'tilt' would have to be at 90 deg; the axis can turn only from -45 to 45 deg"
    ):
        joint_angles(axes, attitude(THREE, [0, 90 * DEG, 0]), [0, 0, 0])


@given(angle, angle)
def test_a_two_axis_table_reaches_what_its_axes_give(outer, inner):
    axes = THREE[:2]
    wanted = by_scipy(axes, [outer, inner], 0.3)
    found = joint_angles(axes, wanted, [0, 0], 0.3)
    assert np.allclose(by_scipy(axes, list(found), 0.3), wanted, atol=1e-7)


def test_a_two_axis_table_says_why_it_cannot():
    # Outer up, middle east: the sensor's x axis stays level, so x up is 90 deg away.
    with pytest.raises(Unreachable, match=r"only the axes 'outer' and 'middle'.*90 deg away"):
        joint_angles(THREE[:2], np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]), [0, 0])


def test_a_single_axis_table():
    assert joint_angles(THREE[:1], attitude(THREE[:1], [2.0]), [6.0])[0] == pytest.approx(2.0 + 2 * math.pi)
    with pytest.raises(Unreachable, match=r"only the axis 'outer'.*90 deg away"):
        joint_angles(THREE[:1], attitude(THREE, [1.0, math.pi / 2, 0]), [0.0])


def test_trapezoid_by_hand():
    # To 10 deg/s at 5 deg/s^2: 2 s and 10 deg each way; 90 deg leave 70 deg at 10 deg/s = 7 s: 11 s.
    assert move_time(90 * DEG, 10 * DEG, 5 * DEG) == pytest.approx(11.0)
    # 5 deg never reaches the rate: 2·√(5/5) = 2 s.
    assert move_time(-5 * DEG, 10 * DEG, 5 * DEG) == pytest.approx(2.0)
    assert move_time(0.0, 1.0, 1.0) == 0.0
    # At the boundary (20 deg) both forms give 4 s.
    assert move_time(20 * DEG, 10 * DEG, 5 * DEG) == pytest.approx(4.0)


def test_the_slowest_axis_decides():
    slow = TableAxis("slow", EAST, 10 * DEG, 5 * DEG)
    fast = TableAxis("fast", UP, 100 * DEG, 500 * DEG)
    assert transition_time((fast, slow), [0, 0], [180 * DEG, 90 * DEG]) == pytest.approx(11.0)
    assert spin_up_time(slow, -10 * DEG) == pytest.approx(2.0)


def test_which_directions_can_be_spun_about():
    assert spin_axis(THREE, [1.0, 0.5, 0.3], UP) == 0
    assert spin_axis(THREE, [0.0, 0.0, 0.0], (0.0, -1.0, 0.0)) == 2
    assert spin_axis(THREE, [0.0, 0.0, 0.0], EAST, azimuth=0.0) == 1
    assert spin_axis(THREE, [90 * DEG, 0.0, 0.0], NORTH) == 1
    # With the middle axis at 90 deg the inner axis points up as well; the outer carries it and is taken.
    assert spin_axis(THREE, [0.0, 90 * DEG, 0.0], UP) == 0
    with pytest.raises(Unreachable, match="'inner' 30 deg"):
        spin_axis(THREE, [30 * DEG, 0.0, 0.0], NORTH)


@given(st.lists(angle, min_size=3, max_size=3), angle)
def test_axes_are_carried_by_those_outside_them(angles, azimuth):
    directions = joint_directions(THREE, angles, azimuth)
    turn = Rotation.from_rotvec([0, 0, -azimuth])
    for index, item in enumerate(THREE):
        assert np.allclose(directions[index], turn.apply(item.direction), atol=1e-12)
        turn = turn * Rotation.from_rotvec(angles[index] * np.array(item.direction))


@pytest.mark.parametrize("axes", [(), (THREE[0], axis("second", UP)), (*THREE, axis("fourth", UP))])
def test_impossible_tables_are_refused(axes):
    with pytest.raises(Unreachable):
        check_geometry(axes)

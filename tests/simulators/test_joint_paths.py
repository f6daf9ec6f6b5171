"""Paths of simulated joints against hand-worked moves, and against their own derivatives."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planrunner.simulators.joint_paths import JointPaths, Path


def test_a_move_by_hand() -> None:
    """90 deg at 30 deg/s and 30 deg/s²: a second up over 15 deg, 60 deg at 30 deg/s, a second down; four seconds in all."""
    path = Path.standing(0.0).go(10.0, math.radians(90), math.radians(30), math.radians(30))
    assert path.arrival == pytest.approx(14.0)
    assert [math.degrees(path.state(time)[0]) for time in (10.0, 11.0, 12.0, 13.0, 14.0, 20.0)] == pytest.approx(
        [0, 15, 45, 75, 90, 90]
    )
    assert [math.degrees(path.state(time)[1]) for time in (10.5, 12.0, 13.5, 15.0)] == pytest.approx([15, 30, 15, 0])


def test_a_short_move_never_reaches_its_rate() -> None:
    """10 deg at 10 deg/s²: a second up over 5 deg, a second down."""
    path = Path.standing(0.0).go(0.0, math.radians(-10), math.radians(100), math.radians(10))
    assert path.arrival == pytest.approx(2.0)
    assert math.degrees(path.state(1.0)[1]) == pytest.approx(-10)


def test_a_joint_that_turns_stops_before_it_goes() -> None:
    """From 20 deg/s at 10 deg/s² it stops after 2 s and 20 deg, then comes back."""
    turning = Path.standing(0.0).turn(0.0, math.radians(20), math.radians(1e6))
    path = turning.go(10.0, 0.0, math.radians(50), math.radians(10))
    angle = math.degrees(path.state(10.0)[0])
    assert math.degrees(path.state(12.0)[0]) == pytest.approx(angle + 20)
    assert path.state(12.0)[1] == pytest.approx(0.0, abs=1e-12)
    assert path.state(path.arrival + 1)[0] == pytest.approx(0.0, abs=1e-12)


def test_what_was_before_a_command_stays_as_it_was() -> None:
    path = Path.standing(1.0).turn(5.0, 0.5, 1.0)
    times = np.linspace(0.0, 8.0, 81)
    before = path.follow(times)
    later = path.turn(8.0, 0.0, 1.0).follow(times)
    for old, new in zip(before, later, strict=True):
        np.testing.assert_allclose(new, old, atol=1e-12)


def test_rates_are_the_derivatives_of_angles() -> None:
    path = Path.standing(0.2).turn(0.0, 0.7, 2.0).go(3.0, -1.0, 0.5, 1.5)
    path = path.swing(20.0, 0.05, 0.5, 0.4, 20.0, -1.0).swing(28.0, 0.0, 0.5, 0.4, 20.0, -1.0)
    times = np.arange(0.0, 32.0, 1e-3)
    angles, rates = path.follow(times)
    numeric = np.gradient(angles, times)
    # Two steps of acceleration apart, central differences are exact to a half step of the largest acceleration.
    assert np.max(np.abs(numeric - rates)[1:-1]) < 2e-3
    assert np.max(np.abs(np.diff(angles))) < 1e-3  # no jump anywhere


def test_a_swing_reaches_its_amplitude_and_fades_out() -> None:
    path = Path.standing(1.0).swing(0.0, 0.1, 0.5, 0.0, 0.0, 1.0)
    angles, _ = path.follow(np.arange(2.0, 4.0, 1e-3))
    assert np.max(angles) == pytest.approx(1.1, abs=1e-6)
    assert np.min(angles) == pytest.approx(0.9, abs=1e-6)
    gone = path.swing(10.0, 0.0, 0.5, 0.0, 0.0, 1.0)
    assert np.ptp(gone.follow(np.arange(12.0, 14.0, 1e-2))[0]) < 1e-12


def test_stretches_break_where_the_motion_changes() -> None:
    paths = JointPaths([Path.standing(0.0).turn(2.0, 0.5, 1.0), Path.standing(1.0)])
    stretches = paths.stretches(0.0, 5.0)
    assert [(item.begin, item.end) for item in stretches] == [(0.0, 2.0), (2.0, 2.5), (2.5, 5.0)]
    assert [item.pace > 0 for item in stretches] == [False, True, True]
    assert not paths.still(3.0)
    assert JointPaths([Path.standing(0.0)]).still(0.0)

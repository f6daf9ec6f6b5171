"""The angle of a turning table from gravity or from the rate of the Earth, compared with rotations by scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planrunner.physics.earth import Site
from planrunner.physics.sampled_motion import OFFSET, AngleFrom, along_axis, angle_from, once_per_turn, start_angle
from planrunner.plan.schedule import Motion, Rest, Rock, Spin

DEG = np.pi / 180
SITE = Site(39.98 * DEG, 9.80154)
EARTH = 15.041067 * DEG / 3600 * np.array([0.0, np.cos(39.98 * DEG), np.sin(39.98 * DEG)])
GRAVITY = np.array([0.0, 0.0, 9.80154])
ATTITUDE = Rotation.from_euler("xyz", [20, -50, 110], degrees=True).as_matrix()
TILTED = (0.6, 0.0, 0.8)


def seen(motion: Spin, start: float, since: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A site vector in the axes of a sensor that the table has turned."""
    turned = Rotation.from_rotvec((start + motion.rate * since)[:, None] * np.array(motion.about))
    return turned.inv().apply(vector) @ ATTITUDE.T


@pytest.mark.parametrize("start", [-2.9, -1.0, 0.0, 2.2])
@pytest.mark.parametrize(("rate", "about"), [(40.0, (0.0, 0.0, 1.0)), (-90.0, TILTED), (7.0, (0.0, 1.0, 0.0))])
def test_the_angle_at_the_beginning_is_found(start: float, rate: float, about: tuple[float, float, float]) -> None:
    draw = np.random.default_rng(3)
    motion, since = Spin(rate * DEG, about), np.arange(6000) / 100
    inputs = np.hstack([seen(motion, start, since, EARTH), seen(motion, start, since, GRAVITY)])
    noise = draw.normal(0, 1, inputs.shape) * np.repeat([2e-5, 0.01], 3)
    expected = np.hstack(
        [once_per_turn(motion, ATTITUDE, SITE.earth_rate_enu), once_per_turn(motion, ATTITUDE, SITE.specific_force_enu)]
    )
    levels = draw.normal(0, 0.1, 6)
    found = start_angle(motion, since, inputs + noise + levels, expected, np.inf)
    assert np.angle(np.exp(1j * (found - start))) == pytest.approx(0.0, abs=0.02)


def test_an_input_that_is_too_large_for_the_earth_does_not_show_the_angle() -> None:
    motion, since = Spin(40.0 * DEG), np.arange(6000) / 100
    expected = once_per_turn(motion, ATTITUDE, SITE.earth_rate_enu)
    for ratio, angle in ((1.0, 1.3), (5.0, 0.0)):
        values = ratio * seen(motion, 1.3, since, EARTH)
        assert start_angle(motion, since, values, expected, np.inf) == pytest.approx(angle)


@pytest.mark.parametrize("rate", [0.01, 0.05, 1.0, 40.0])
def test_gravity_shows_the_angle_of_a_table_that_hardly_turns(rate: float) -> None:
    """The table turns by 0.6 to 60 deg, or many times. If it hardly turns, a constant error of `OFFSET` along each accelerometer is as
    likely as the change by the turning, and the part of gravity that changes is 0.6·g."""
    motion, since, draw = Spin(rate * DEG, TILTED), np.arange(6000) / 100, np.random.default_rng(4)
    axis = np.array(TILTED)
    expected = once_per_turn(motion, ATTITUDE, SITE.specific_force_enu)
    steady = ATTITUDE @ ((axis @ GRAVITY) * axis)
    assert along_axis(motion, ATTITUDE, SITE.specific_force_enu) == pytest.approx(steady)
    for start in (-2.0, 0.0, 0.7):
        values = seen(motion, start, since, GRAVITY) + draw.normal(0, 0.01, (6000, 3)) + 0.005 * draw.choice([-1, 1], 3)
        found = start_angle(motion, since, values - steady, expected, OFFSET)
        assert np.angle(np.exp(1j * (found - start))) == pytest.approx(0.0, abs=OFFSET / (0.6 * 9.8))


def test_one_sample_shows_no_angle() -> None:
    assert start_angle(Spin(1.0), np.zeros(1), np.ones((1, 3)), np.ones(3, dtype=complex), OFFSET) == 0.0


def test_gravity_shows_the_angle_only_if_the_axis_is_not_vertical() -> None:
    cases: list[tuple[Motion, list[int], AngleFrom]] = [
        (Rest(), [0, 1, 2], AngleFrom.PLAN),
        (Rock(0.1, 1.0, (0.0,), 10.0), [0, 1, 2], AngleFrom.PLAN),
        (Spin(1.0), [0, 1, 2], AngleFrom.NOTHING),
        (Spin(1.0, TILTED), [0, 1, 2], AngleFrom.GRAVITY),
        (Spin(1.0, TILTED), [], AngleFrom.NOTHING),
    ]
    for motion, accelerometers, source in cases:
        assert angle_from(motion, ATTITUDE, SITE, accelerometers) is source

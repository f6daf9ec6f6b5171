"""The scatter within a segment that moves is that of the noise: what a turning or rocking sensor sees of its surroundings is signal.

Samples are drawn here; the expected figures are those of the noise that was drawn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from planrunner.archive.recording import Statistics
from planrunner.archive.statistics import statistics_of
from planrunner.instruments.interfaces import Block
from planrunner.observation.flicker import scatter_within
from planrunner.plan.schedule import Motion, Rest, Rock, Spin

REPEATS = 40
RATE = 50.0  # Hz


def recorded(values: np.ndarray, motion: Motion, rows: int = 997) -> Statistics:
    """values: (k, n)."""
    time = 7.0 + np.arange(values.shape[1]) / RATE
    names = [f"c{k}" for k in range(len(values))]

    def blocks() -> Iterator[Block]:
        for low in range(0, len(time), rows):
            yield Block(time[low : low + rows], dict(zip(names, values[:, low : low + rows], strict=True)))

    return statistics_of(blocks(), names, len(time), motion=motion)


def seen_turning(rate: float, seconds: float, size: float = 30.0) -> np.ndarray:
    """What two level axes see of a fixed direction, in units of the noise, and a share of its square. The table is 50 ppm too fast."""
    angle = math.radians(rate) * (1 + 50e-6) * np.arange(round(seconds * RATE)) / RATE + 0.7
    one, other = size * np.cos(angle), size * np.sin(angle)
    return np.stack([one + 0.01 * one**2, other])


@pytest.mark.parametrize(
    ("rate", "seconds"),
    [(300.0, 36.0), (300.0, 38.4), (-60.0, 30.0), (10.0, 36.0), (1.0, 90.0), (0.1, 120.0), (200.0, 400.0)],
)
def test_standard_error_of_a_turning_sensor_is_that_of_its_noise(rate: float, seconds: float) -> None:
    """Whole turns in a batch, parts of a turn, a segment of an eighth of a turn, and one of many turns."""
    draw, course = np.random.default_rng(11), seen_turning(rate, seconds)
    made = [
        recorded(course + draw.standard_normal(course.shape), Spin(math.radians(rate)))
        for _ in range(REPEATS if course.shape[1] < 10_000 else 10)
    ]
    n = course.shape[1]
    squares = np.array([one.standard_error**2 for one in made]) * n
    degrees = made[0].freedom
    assert 24 <= degrees <= 31
    # Of χ² with REPEATS·2·degrees degrees of freedom, four standard deviations.
    assert squares.mean() == pytest.approx(1.0, abs=4 * math.sqrt(2 / (squares.size * degrees)))
    assert squares.var() == pytest.approx(2 / degrees, rel=0.7)
    covariance = np.mean([one.covariance for one in made], axis=0)
    assert covariance == pytest.approx(np.eye(2), abs=0.02 if n > 1000 else 0.05)


def test_at_rest_nothing_is_taken_from_the_scatter() -> None:
    made = recorded(seen_turning(10.0, 36.0), Rest())
    assert made.freedom == 31
    assert made.standard_error[0] > 3


def test_rocking_and_the_time_before_and_after_it() -> None:
    """What a rocking sensor sees follows the sine of a sine; the fades before and after are no noise either."""
    draw, motion = np.random.default_rng(3), Rock(math.radians(60), 0.2, (0.0,), 100.0, delay=10.0)
    time = np.arange(round(140 * RATE)) / RATE
    since = time - motion.steady
    size = np.interp(since, [-motion.period, 0, motion.duration, motion.duration + motion.period], [0, 1, 1, 0])
    angle = motion.amplitude * size * np.sin(2 * np.pi * 0.2 * since)
    course = 30 * np.stack([np.sin(angle), np.cos(angle)])
    made = [recorded(course + draw.standard_normal(course.shape), motion) for _ in range(REPEATS)]
    squares = np.array([one.standard_error**2 for one in made]) * len(time)
    assert squares.mean() == pytest.approx(1.0, abs=4 * math.sqrt(2 / (squares.size * made[0].freedom)))


def test_the_result_does_not_depend_on_blocks_and_survives_bad_samples() -> None:
    draw, motion = np.random.default_rng(5), Spin(math.radians(10.0))
    values = seen_turning(10.0, 72.0) + draw.standard_normal((2, 3600))
    one, other = recorded(values, motion), recorded(values, motion, rows=61)
    assert one.standard_error.tolist() == other.standard_error.tolist()
    values[0, 100:120] = np.nan
    less = recorded(values, motion)
    assert less.rejected == 20
    assert less.standard_error == pytest.approx(one.standard_error, rel=0.2)


def test_noise_free_samples_of_a_turn_leave_no_scatter() -> None:
    made = recorded(seen_turning(10.0, 36.0), Spin(math.radians(10.0) * (1 + 50e-6)))
    assert made.standard_error.tolist() == [0.0, 0.0]


def test_too_few_samples_for_a_course_count_as_they_are() -> None:
    made = recorded(seen_turning(10.0, 0.4), Spin(math.radians(10.0)))
    assert made.freedom == made.count - 1 == 19


@pytest.mark.parametrize("rate", [3.6, 50.0])
def test_flicker_within_a_turning_segment(rate: float) -> None:
    """One turn and fourteen: a sum of first-order processes whose densities add to 1/f."""
    draw, n, constants = np.random.default_rng(8), 5000, 2.0 ** np.arange(-8, 16)
    squares, course = [], np.zeros((0, 0))
    from scipy.signal import lfilter

    for _ in range(150):
        noise = np.zeros((1, n))
        for constant in constants:
            keep = math.exp(-1 / (constant * RATE))
            new = math.sqrt(1 - keep**2) * draw.standard_normal(n)
            noise[0] += lfilter([1.0], [1.0, -keep], new, zi=[keep * draw.standard_normal()])[0]
        made = recorded(noise * math.sqrt(math.log(2) / math.pi), Spin(math.radians(rate)))
        squares.append(float(made.standard_error[0] ** 2))
        course = made.course
    assert np.mean(squares) == pytest.approx(scatter_within(np.array([32]), (course,))[0], rel=0.1)

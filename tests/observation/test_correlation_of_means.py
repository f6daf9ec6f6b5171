"""The correlation of channels: of their samples, or of their means where samples have in common what averages out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import SensorModel
from planrunner.observation.observations import observe
from planrunner.plan.schedule import Rest, Segment

Array = NDArray[np.float64]
RATE, SECONDS = 50.0, 60.0
NAMES = ("x", "y")


def recorded(index: int, values: Array) -> RecordedSegment:
    """A segment at rest of two channels, (n, 2)."""
    time: Array = SECONDS * index + np.arange(float(len(values))) / RATE

    def blocks(channels: Sequence[str]) -> Iterator[Block]:
        yield Block(time, {name: np.ascontiguousarray(values[:, NAMES.index(name)]) for name in channels})

    segment = Segment(index, f"S{index}", np.eye(3), "as built", Rest(), SECONDS)
    statistics = statistics_of(blocks(NAMES), NAMES, len(values))
    return RecordedSegment(segment, dict.fromkeys(NAMES, "V"), statistics, blocks)


def correlation(common: Array, seed: int = 1) -> float:
    """Of white noise of size 1 in each channel, and the same course (8, n) in both in each of eight segments."""
    draw = np.random.default_rng(seed)
    rows = [one[:, None] + draw.standard_normal((len(one), 2)) for one in common]
    made = observe([recorded(index, own) for index, own in enumerate(rows)], NAMES, SensorModel("bench", (), RATE))
    return float(made.correlation[0, 1])


def test_a_vibration_in_both_channels_does_not_correlate_their_means() -> None:
    """At 20 Hz, three times the noise: it makes 4.5/5.5 of the variance of the samples, and nothing of that of means over seconds."""
    time = np.arange(RATE * SECONDS) / RATE
    found = correlation(np.tile(3 * np.sin(2 * np.pi * 20 * time), (8, 1)))
    assert abs(found) < 4 / np.sqrt(8 * 31)


def test_a_slow_common_course_correlates_them() -> None:
    """A course that is steady for a second: a twentieth of the samples' variance is half of that of their means over two seconds."""
    steps = np.random.default_rng(2).standard_normal((8, round(SECONDS)))
    found = correlation(0.2 * np.repeat(steps, round(RATE), axis=1))
    assert found == pytest.approx(2 / 3, abs=0.15)  # 0.04/(0.04 + 1/50)


def test_white_noise_in_common_is_known_from_the_samples() -> None:
    """Half of the variance: 24 000 samples give the correlation within 0.5 %, and the batch means only within 5 %."""
    found = correlation(np.random.default_rng(3).standard_normal((8, round(RATE * SECONDS))))
    assert found == pytest.approx(0.5, abs=0.02)


def test_the_covariance_of_the_means_has_their_standard_errors() -> None:
    draw = np.random.default_rng(4)
    one = recorded(0, draw.standard_normal((3000, 2)) @ np.array([[1.0, 0.5], [0.0, 2.0]])).statistics
    assert np.sqrt(one.mean_covariance.diagonal()) == pytest.approx(one.standard_error, rel=1e-12)

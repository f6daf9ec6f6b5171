"""Covariances of segment means against sums over a fine grid and against simulated processes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planrunner.gap.evidence.covariance import WalkAcross, flicker, ornstein_uhlenbeck, random_walk
from planrunner.gap.hypotheses.candidates import Weighing
from tests.gap.turntable import record

STARTS, ENDS = np.array([0.0, 7.0, 30.0]), np.array([5.0, 19.0, 34.0])


def _on_a_grid(kernel: np.ndarray, times: np.ndarray) -> np.ndarray:
    inside = np.array([(times >= a) & (times < b) for a, b in zip(STARTS, ENDS, strict=True)], dtype=float)
    weights = inside / inside.sum(1, keepdims=True)
    return weights @ kernel @ weights.T


@pytest.mark.parametrize("tau", [0.7, 12.0, 4000.0])
def test_ornstein_uhlenbeck_is_the_mean_of_its_kernel(tau: float) -> None:
    times = np.arange(0, 34, 0.02) + 0.01
    kernel = np.exp(-np.abs(times[:, None] - times[None, :]) / tau)
    assert ornstein_uhlenbeck(STARTS, ENDS, tau) == pytest.approx(_on_a_grid(kernel, times), rel=2e-3)


def test_random_walk_is_the_mean_of_its_kernel() -> None:
    times = np.arange(0, 34, 0.02) + 0.01
    kernel = np.minimum(times[:, None], times[None, :])
    assert random_walk(STARTS, ENDS) == pytest.approx(_on_a_grid(kernel, times), rel=2e-3)


def test_ornstein_uhlenbeck_against_a_simulated_process() -> None:
    draw, step, tau = np.random.default_rng(1), 0.1, 8.0
    times = np.arange(0, 34, step)
    decay = np.exp(-step / tau)
    x = np.empty((len(times), 20_000))
    x[0] = draw.standard_normal(20_000)
    for k in range(1, len(times)):
        x[k] = decay * x[k - 1] + np.sqrt(1 - decay**2) * draw.standard_normal(20_000)
    means = np.array([x[(times >= a) & (times < b)].mean(0) for a, b in zip(STARTS, ENDS, strict=True)])
    assert ornstein_uhlenbeck(STARTS, ENDS, tau) == pytest.approx(np.cov(means), abs=0.02)


def test_flicker_has_its_floor() -> None:
    """With B = 1, the Allan deviation of adjacent means, √(½·var of their difference), is 0.664 for 10 s to 1000 s, to a few per cent."""
    for seconds in (10.0, 100.0, 1000.0):
        covariance = flicker(np.array([0.0, seconds]), np.array([seconds, 2 * seconds]))
        assert np.sqrt(0.5 * np.array([1, -1]) @ covariance @ np.array([1, -1])) == pytest.approx(0.664, rel=0.06)


def test_what_a_walk_does_within_a_segment_continues_in_later_means() -> None:
    """The covariances of the means with the coefficients, written out, against their products."""
    draw = np.random.default_rng(3)
    size, own, afterwards = [3, 1, 4, 2], draw.standard_normal(10), draw.standard_normal(10)
    segment = np.repeat(np.arange(4), size)
    dense = np.where(segment == np.arange(4)[:, None], own, np.where(segment < np.arange(4)[:, None], afterwards, 0.0))
    found = WalkAcross(own, afterwards, np.array([0, 3, 4, 8]))
    columns = draw.standard_normal((10, 5))
    assert found.between(np.arange(len(found.first)), np.arange(len(found.own))) == pytest.approx(dense)
    assert found.product(columns) == pytest.approx(dense @ columns)
    assert found.squared() == pytest.approx(dense @ dense.T)


@pytest.mark.parametrize("factor", [0.5, 2.0, 4.0])
def test_segments_may_have_another_sample_rate(factor: float) -> None:
    """Every sixth segment has another sample rate than the other segments."""
    other, usual = record(seed=3, sampling=10.0 * factor), record(seed=3, sampling=10.0)
    taken = [other if index % 6 == 0 else usual for index in range(len(usual))]
    parts = [one.segments()[index] for index, one in enumerate(taken)]

    def of(name: str) -> np.ndarray:
        return np.concatenate([getattr(one, name)[part] for one, part in zip(taken, parts, strict=True)])

    mixed = replace(
        usual,
        bounds=np.concatenate([[0], np.cumsum([part.stop - part.start for part in parts])]),
        time=of("time"),
        angle=of("angle"),
        rate=of("rate"),
        acceleration=of("acceleration"),
        temperature=of("temperature"),
        temperature_rate=of("temperature_rate"),
        values=of("values"),
    )
    weights = Weighing(mixed).weights[0]
    assert any(one.walk > 0 for one in weights)
    assert all(np.isfinite(one.log_likelihood) for one in weights)

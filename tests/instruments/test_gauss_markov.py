"""The simulated Gauss–Markov bias against its covariance, from many drawn courses in parts with pauses."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.instruments.virtual.noise import GaussMarkov

SIGMA, TAU, STEP = 2.0, 5.0, 0.1


def _course(draw: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of two parts with a pause of 3 s; the second goes on from a checkpoint."""
    first = GaussMarkov(SIGMA, TAU)
    first.begin(0.0, draw)
    begun = first.advance(20, STEP, draw)
    second = GaussMarkov(SIGMA, TAU)
    second.restore(first.time, first.value)
    second.begin(5.0, draw)
    return np.r_[STEP * np.arange(20), 5.0 + STEP * np.arange(20)], np.r_[begun, second.advance(20, STEP, draw)]


def test_covariance_is_exponential() -> None:
    draw = np.random.default_rng(4)
    courses = [_course(draw) for _ in range(4000)]
    time, values = courses[0][0], np.array([own for _, own in courses])
    expected = SIGMA**2 * np.exp(-np.abs(time[:, None] - time) / TAU)
    # The standard deviation of an estimated covariance is at most σ²·√(2/n).
    assert values.T @ values / len(values) == pytest.approx(expected, abs=5 * SIGMA**2 * np.sqrt(2 / len(values)))

"""Counts found in values that a moving sensor gives."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.observation.lattice import undeclared_step


def moved(seed: int, noise: float) -> np.ndarray:
    """A rate at rest, then swinging by ±150."""
    draw = np.random.default_rng(seed)
    rest, swing = np.full(3000, 0.31), 150 * np.sin(np.arange(9000) / 31)
    return np.concatenate([rest, swing]) + draw.normal(0, noise, 12000)


@pytest.mark.parametrize("sigmas", [3.0, 8.0, 30.0])
def test_a_coarse_count_is_found_although_most_values_occur_once(sigmas: float) -> None:
    count = 0.00789
    found = undeclared_step(np.round(moved(1, count / sigmas) / count) * count)
    assert found == pytest.approx(count, rel=1e-3)


def test_values_without_a_count_have_none() -> None:
    assert undeclared_step(moved(2, 0.01)) == 0.0
    stuck = moved(3, 0.01)
    stuck[:3000] = stuck[0]  # one value in a quarter of the samples is no lattice
    assert undeclared_step(stuck) == 0.0


def test_floating_point_rounding_is_no_count() -> None:
    values = np.where(np.arange(4000) % 3, 0.1, np.nextafter(0.1, 1.0))
    assert undeclared_step(values, fewest=2) == 0.0


@pytest.mark.parametrize("spike", [1e3, 1e9, 1e15])
def test_a_spike_does_not_hide_the_count(spike: float) -> None:
    values = np.round(np.random.default_rng(4).normal(0.3, 1.5, 4000)) * 0.25
    values[1234] = spike
    assert undeclared_step(values) == pytest.approx(0.25, rel=1e-6)


def test_the_count_of_differences_of_large_sums_is_found() -> None:
    """The differences of sums of 1e6 have errors of 1e-10, far more than the rounding of the differences themselves."""
    counts = np.random.default_rng(5).integers(0, 4, 4000) * 0.1
    assert undeclared_step(np.diff(1e6 + np.cumsum(counts))) == pytest.approx(0.1, rel=1e-6)

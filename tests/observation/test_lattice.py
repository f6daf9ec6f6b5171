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

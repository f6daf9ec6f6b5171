"""The test of homogeneity: against scipy's χ² and Welch's t-test, and by draws."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, ttest_ind

from planrunner.uncertainty.homogeneity import homogeneity


def test_known_uncertainties_give_the_chi_squared_test() -> None:
    """1, 2, 4 with u = 1, 1, 2: weights 1, 1, 1/4, mean 4/2.25; Σ w (x − x̄)² worked by hand."""
    mean = 4 / 2.25
    squares = (1 - mean) ** 2 + (2 - mean) ** 2 + (4 - mean) ** 2 / 4
    found = homogeneity([1, 2, 4], [1, 1, 2], [math.inf] * 3)
    assert found is not None
    assert found.ratio == pytest.approx(math.sqrt(squares / 2))
    assert found.chance == pytest.approx(chi2.sf(squares, 2), rel=1e-6)
    assert found.farthest == pytest.approx((4 - mean) / 4)


@pytest.mark.parametrize("seed", range(5))
def test_two_values_give_the_test_of_welch(seed: int) -> None:
    draw = np.random.default_rng(seed)
    a, b = draw.normal(0, 1, 4), draw.normal(1, 3, 7)
    errors = [a.std(ddof=1) / 2, b.std(ddof=1) / math.sqrt(7)]
    found = homogeneity([a.mean(), b.mean()], errors, [3, 6])
    assert found is not None
    assert found.chance == pytest.approx(ttest_ind(a, b, equal_var=False).pvalue, rel=1e-6)


@pytest.mark.parametrize("samples", [4, 10, 100])
def test_repeats_that_agree_are_called_different_as_often_as_stated(samples: int) -> None:
    draw, seldom = np.random.default_rng(6), 0
    for _ in range(2000):
        values = draw.normal(0, [[1.0], [2.0], [5.0], [1.0], [3.0]], (5, samples))
        errors = values.std(axis=1, ddof=1) / math.sqrt(samples)
        found = homogeneity(values.mean(axis=1), errors, [samples - 1.0] * 5)
        assert found is not None
        seldom += found.chance < 0.05
    assert 0.03 < seldom / 2000 < 0.08


def test_a_circular_quantity_and_values_without_an_uncertainty() -> None:
    found = homogeneity([359.9, 0.1, 7.0, 8.0], [0.1, 0.1, math.nan, 0.0], [math.inf] * 4, 360.0)
    assert found is not None and found.repeats == 2
    assert found.ratio == pytest.approx(math.sqrt(2))
    assert homogeneity([1.0, math.nan], [1.0, 1.0], [1.0, 1.0]) is None

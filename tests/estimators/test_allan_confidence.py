"""Noise types and degrees of freedom: against the empirical formulas of NIST SP 1065, another package and simulation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import simulated_noise

from planrunner.estimators.allan.confidence import degrees_of_freedom, interval, noise_exponent
from planrunner.estimators.allan.phase import Phase
from planrunner.estimators.allan.table import deviations


def phase(values: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(values)])


@pytest.mark.parametrize("factor", [1, 2, 4, 16, 100])
def test_white_noise_as_the_empirical_formula(factor: int) -> None:
    """SP 1065, table 5, white frequency noise: [3(N−1)/(2m) − 2(N−2)/N]·4m²/(4m² + 5), good to a few per cent."""
    n, m = 4097, factor
    published = (3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5)
    assert degrees_of_freedom(0, 2, m, n) == pytest.approx(published, rel=0.04)


@pytest.mark.parametrize("factor", [8, 32, 128])
def test_random_walk_as_the_empirical_formula(factor: int) -> None:
    """The same table, random walk: (N−2)/m · [(N−1)² − 3m(N−1) + 4m²]/(N−3)²."""
    n, m = 4097, factor
    published = (n - 2) / m * ((n - 1) ** 2 - 3 * m * (n - 1) + 4 * m**2) / (n - 3) ** 2
    assert degrees_of_freedom(-2, 2, m, n) == pytest.approx(published, rel=0.1)


@pytest.mark.parametrize("factor", [1, 5, 50, 300])
def test_white_phase_as_the_empirical_formula(factor: int) -> None:
    """The same table, white phase: (N+1)(N−2m)/(2(N−m)) is coarse; the exact sum is 18/35 of the differences for m ≪ N."""
    n, m = 100_001, factor
    assert degrees_of_freedom(2, 2, m, n) == pytest.approx((n - 2 * m) * 36 / (36 + 2 * 16 + 2 * 1), rel=0.01)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("modified", [False, True])
def test_another_package_agrees(order: int, modified: bool) -> None:
    other = pytest.importorskip("allantools", reason="allantools is not installed (extra `dev`)")
    if modified and order == 3:
        pytest.skip("there is no modified Hadamard deviation here")
    compared = 0
    for alpha in range(2, 1 - 2 * order, -1):
        for points in (1001, 100_001):
            for factor in (100, 200, 1000, 30_000):
                if points <= (order + modified) * factor + 1:
                    continue
                try:
                    theirs = other.edf_greenhall(alpha, order, factor, points, overlapping=True, modified=modified)
                except (NotImplementedError, AssertionError):  # it has no table for some corners
                    continue
                assert degrees_of_freedom(alpha, order, factor, points, modified) == pytest.approx(theirs, rel=0.02)
                compared += 1
    assert compared >= 8


def test_too_short_has_none() -> None:
    assert degrees_of_freedom(0, 2, 10, 20) == 0
    assert degrees_of_freedom(0, 2, 10, 21) == 1
    assert degrees_of_freedom(-4, 2, 10, 100) == degrees_of_freedom(-2, 2, 10, 100)


@pytest.mark.parametrize(
    ("keys", "alpha"), [({"Q": 1.0}, 2), ({"N": 1.0}, 0), ({"B": 1.0}, -1), ({"K": 1.0}, -2)], ids="QNBK"
)
@pytest.mark.parametrize("factor", [1, 4, 32])
def test_noise_types(keys: dict[str, float], alpha: int, factor: int) -> None:
    values = simulated_noise.rate(np.random.default_rng(5), 2**15, 1.0, **keys)
    assert noise_exponent([phase(values)], factor) == alpha


def test_noise_type_needs_thirty_averages() -> None:
    x = phase(np.random.default_rng(0).standard_normal(300))
    assert noise_exponent([x], 10) is not None
    assert noise_exponent([x], 11) is None


def test_interval_by_tables() -> None:
    """χ² tables: 10 degrees of freedom, 2.5 % and 97.5 %: 3.247 and 20.483."""
    low, high = interval(1.0, 10, 0.95)
    assert low == pytest.approx((10 / 20.483) ** 0.5, rel=1e-4)
    assert high == pytest.approx((10 / 3.247) ** 0.5, rel=1e-4)


@pytest.mark.parametrize(("keys", "truth"), [({"N": 1.0}, lambda m: 1 / m), ({"Q": 1.0}, lambda m: 3 / m**2)], ids="NQ")
def test_intervals_cover(keys: dict[str, float], truth: Callable[[float], float]) -> None:
    """95 % intervals of 600 simulated records, noise types identified: within four standard deviations of the binomial."""
    draw = np.random.default_rng(11)
    factors = np.array([1, 4, 16, 64])
    inside, records = np.zeros(factors.size), 600
    for _ in range(records):
        x = phase(simulated_noise.rate(draw, 512, 1.0, **keys))
        rows = deviations(Phase((x,), 1.0, 1, 512, 0, 0, 0, 0), "overlapping", factors, 0.95)
        inside += [row.low**2 <= truth(row.factor) <= row.high**2 for row in rows]
    assert np.all(inside / records > 0.95 - 4 * (0.95 * 0.05 / records) ** 0.5)
    assert np.all(inside / records < 0.985)

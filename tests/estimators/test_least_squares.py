"""The kernel against numpy's solver, certified reference data, hand-worked numbers and its refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planrunner.estimators.interface import EstimationError
from planrunner.estimators.least_squares import fit, whitener

# NIST StRD, linear regression "Longley" (certified): y, GNP deflator, GNP, unemployed, armed forces, population, year.
LONGLEY_TEXT = """60323 83.0 234289 2356 1590 107608 1947
61122 88.5 259426 2325 1456 108632 1948
60171 88.2 258054 3682 1616 109773 1949
61187 89.5 284599 3351 1650 110929 1950
63221 96.2 328975 2099 3099 112075 1951
63639 98.1 346999 1932 3594 113270 1952
64989 99.0 365385 1870 3547 115094 1953
63761 100.0 363112 3578 3350 116219 1954
66019 101.2 397469 2904 3048 117388 1955
67857 104.6 419180 2822 2857 118734 1956
68169 108.4 442769 2936 2798 120445 1957
66513 110.8 444546 4681 2637 121950 1958
68655 112.6 482704 3813 2552 123366 1959
69564 114.2 502601 3931 2514 125368 1960
69331 115.7 518173 4806 2572 127852 1961
70551 116.9 554894 4007 2827 130081 1962"""
LONGLEY = np.array([[float(cell) for cell in line.split()] for line in LONGLEY_TEXT.splitlines()])
LONGLEY_CERTIFIED = (
    (-3482258.63459582, 890420.383607373),
    (15.0618722713733, 84.9149257747669),
    (-0.358191792925910e-01, 0.334910077722432e-01),
    (-2.02022980381683, 0.488399681651699),
    (-1.03322686717359, 0.214274163161675),
    (-0.511041056535807e-01, 0.226073200069370),
    (1829.15146461355, 455.478499142212),
)


def test_certified_ill_conditioned_data() -> None:
    """Collinear to 4·10⁹ in raw columns; coefficients and standard deviations as certified."""
    matrix = np.column_stack([np.ones(16), LONGLEY[:, 1:]])
    found = fit(matrix, LONGLEY[:, 0])
    spread = np.sqrt(np.diag(found.cofactor) * found.variance_factor)
    for k, (value, deviation) in enumerate(LONGLEY_CERTIFIED):
        assert found.coefficients[k] == pytest.approx(value, rel=1e-8)
        assert spread[k] == pytest.approx(deviation, rel=1e-7)
    assert math.sqrt(found.variance_factor) == pytest.approx(304.854073561965, rel=1e-9)


def test_straight_line_worked_by_hand() -> None:
    """Points (0,1), (1,3), (2,4): slope 3/2, offset 7/6, residual sum 1/6, slope variance 1/2·s²."""
    found = fit(np.array([[1, 0], [1, 1], [1, 2]], dtype=float), np.array([1.0, 3.0, 4.0]))
    assert found.coefficients == pytest.approx([7 / 6, 1.5])
    assert found.chi_squared == pytest.approx(1 / 6)
    assert found.degrees_of_freedom == 1
    assert found.cofactor == pytest.approx(np.array([[5 / 6, -0.5], [-0.5, 0.5]]))


@pytest.mark.parametrize("n", [13, 500, 511, 512, 1023, 1300, 2048, 10_000])
def test_weighted_fit_equals_numpy_for_any_length(n: int) -> None:
    rng = np.random.default_rng(n)
    matrix, sigma, size = rng.normal(size=(n, 12)), rng.uniform(0.5, 2, n), 10.0 ** rng.integers(-6, 6, 12)
    observed = matrix @ rng.normal(size=12) + rng.normal(size=n)
    found = fit(matrix * size, observed, sigma)
    expected, *_ = np.linalg.lstsq(matrix / sigma[:, None], observed / sigma, rcond=None)
    assert found.coefficients * size == pytest.approx(expected, rel=1e-9)
    residual = (observed - matrix @ expected) / sigma
    assert found.chi_squared == pytest.approx(residual @ residual, rel=1e-9)
    assert found.residuals == pytest.approx(observed - matrix @ expected, abs=1e-9)
    inverse = np.linalg.pinv(matrix / sigma[:, None])
    assert found.cofactor * np.outer(size, size) == pytest.approx(inverse @ inverse.T, rel=1e-8, abs=1e-14)


def test_what_cannot_be_determined_is_named() -> None:
    rng = np.random.default_rng(0)
    a = rng.normal(size=20)
    matrix = np.column_stack([np.ones(20), a, np.zeros(20), 1 - 2 * a])
    with pytest.raises(EstimationError) as caught:
        fit(matrix, a, names=("bias", "rate", "tilt", "both"))
    message = str(caught.value)
    assert "tilt is zero in every position" in message
    assert "bias, rate and both cannot be separated" in message


def test_refusals() -> None:
    with pytest.raises(EstimationError, match="2 observations cannot determine 3"):
        fit(np.ones((2, 3)), np.ones(2))
    with pytest.raises(EstimationError, match="not a finite number"):
        fit(np.array([[1.0, 2], [1, 3], [1, 5]]), np.array([1.0, np.nan, 2]))
    with pytest.raises(EstimationError, match="cannot be used as a weight"):
        fit(np.array([[1.0, 2], [1, 3], [1, 5]]), np.ones(3), np.array([1.0, 0.0, 1.0]))


@pytest.mark.parametrize("n", [5, 64, 65, 150])
def test_whitened_observations_are_uncorrelated_for_any_length(n: int) -> None:
    """Also for several outputs at once; longer matrices are inverted by halves."""
    mixing = np.random.default_rng(n).normal(size=(2, n, n))
    covariance = mixing @ mixing.swapaxes(1, 2) + n * np.eye(n)
    whitening = whitener(covariance)
    assert whitening @ covariance @ whitening.swapaxes(1, 2) == pytest.approx(np.array([np.eye(n)] * 2), abs=1e-12)


def test_correlated_observations_by_the_textbook_formula() -> None:
    """(AᵀV⁻¹A)⁻¹·AᵀV⁻¹·y of a random walk under white noise, by numpy's general solver."""
    n, draw = 150, np.random.default_rng(1)
    steps = np.tril(np.ones((n, n)))
    covariance = 0.01 * steps @ steps.T + np.eye(n)
    matrix = np.column_stack([np.ones(n), np.linspace(-1, 1, n)])
    observed = matrix @ [2.0, 3.0] + np.linalg.cholesky(covariance) @ draw.standard_normal(n)
    found = fit(matrix, observed, covariance=covariance)
    weighted = np.linalg.solve(covariance, matrix)
    information = matrix.T @ weighted
    assert found.coefficients == pytest.approx(np.linalg.solve(information, weighted.T @ observed), rel=1e-10)
    assert found.cofactor == pytest.approx(np.linalg.inv(information), rel=1e-10)

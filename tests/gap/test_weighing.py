"""Whitening and projection against dense Gaussian densities with a wide prior on the nominal parameters."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy.linalg import block_diag

from planrunner.error_model.effects.gyro import GyroGSensitivity, GyroScaleAsymmetry
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.bayes_factors import gaussian
from planrunner.gap.hypotheses.candidates import Weighing
from tests.gap.turntable import record


@pytest.fixture(scope="module")
def weighing() -> Weighing:
    return Weighing(record())


def dense_covariance(weighing: Weighing, channel: int, walk: float) -> np.ndarray:
    """Covariance (M, M) of a channel's coefficients: white noise, and a random walk of the density `walk`."""
    white = np.eye(len(weighing.spectrum.segment)) * weighing.white[channel] ** 2
    return white + (walked(weighing) * walk**2 if walk else 0.0)


@lru_cache(maxsize=2)
def walked(weighing: Weighing) -> np.ndarray:
    """Covariance (M, M) of the coefficients of a random walk of unit density, written from the samples: its steps between the middles of
    the samples. A sample is a mean over 0.05 s, whose variance is smaller than that in its middle by a sixth of 0.05 s."""
    observed = weighing.observed
    basis = block_diag(*[basis.vectors for basis in weighing.spectrum.bases])
    after = np.cumsum(basis[::-1], axis=0)[::-1]
    steps = np.diff(observed.time, prepend=observed.time[0] - 0.025)
    return np.asarray(after.T @ (steps[:, None] * after) - 0.05 / 6 * np.eye(basis.shape[1]))


def _log_density(covariance: np.ndarray, y: np.ndarray) -> float:
    return -0.5 * float(np.linalg.slogdet(covariance)[1] + y @ np.linalg.solve(covariance, y))


@pytest.mark.parametrize("level", [0, 5])
def test_evidence_is_that_of_dense_densities(weighing: Weighing, level: int) -> None:
    (weighed,) = weighing.weigh(GyroScaleAsymmetry().variants(weighing.observed))
    energy = np.array([50.0])
    for channel in range(3):
        weight = weighing.weights[channel][level]
        nominal = weighing.nominal[channel]
        scaled = nominal / np.linalg.norm(nominal, axis=0) * weighing.white[channel] * 1e5
        plain = dense_covariance(weighing, channel, weight.walk) + scaled @ scaled.T
        column = weighed.raw[channel][:, [channel]]
        projected = weight.project(column)[:, 0]
        size, score = float(projected @ projected), float(projected @ weight.residual)
        y = weighing.spectrum.values[:, channel]
        effect = plain + energy[0] / size * column @ column.T
        expected = _log_density(effect, y) - _log_density(plain, y)
        found = gaussian(1 + energy, energy / size * score**2 / (1 + energy))
        assert found == pytest.approx(expected, abs=0.02)


def test_the_likelihoods_of_noise_compare_as_dense_densities_do(weighing: Weighing) -> None:
    """REML of two levels of a walk differ as densities with a very wide prior on the nominal parameters."""
    nominal, y = weighing.nominal[0], weighing.spectrum.values[:, 0]
    scaled = nominal / np.linalg.norm(nominal, axis=0) * weighing.white[0] * 1e5
    both = [weighing.weights[0][0], weighing.weights[0][6]]
    dense = [_log_density(dense_covariance(weighing, 0, w.walk) + scaled @ scaled.T, y) for w in both]
    assert both[1].walk > 0
    assert both[1].log_likelihood - both[0].log_likelihood == pytest.approx(dense[1] - dense[0], abs=0.02)


def test_whitening_with_a_walk_is_the_dense_covariance(weighing: Weighing) -> None:
    weight = weighing.weights[1][6]
    covariance = weight.covariance(np.ones(len(weighing.spectrum.segment), dtype=bool))
    size = np.sqrt(np.diag(covariance))
    away = (covariance - dense_covariance(weighing, 1, weight.walk)) / np.outer(size, size)
    assert abs(away).max() < 1.1e-3  # the part by which all correlations within a segment are reduced
    columns = np.random.default_rng(1).normal(size=(len(covariance), 4))
    whitened = weight.whiten(columns)
    assert whitened.T @ whitened == pytest.approx(columns.T @ np.linalg.solve(covariance, columns), rel=1e-6)


def test_projection_is_generalised_least_squares(weighing: Weighing) -> None:
    weight, nominal = weighing.weights[0][0], weighing.nominal[0]
    covariance = weight.covariance(np.ones(len(nominal), dtype=bool))
    y = weighing.spectrum.values[:, 0]
    inverse = np.linalg.inv(covariance)
    beta = np.linalg.solve(nominal.T @ inverse @ nominal, nominal.T @ inverse @ y)
    rest = y - nominal @ beta
    assert float(weight.residual @ weight.residual) == pytest.approx(float(rest @ inverse @ rest), rel=1e-6)


def test_the_coefficients_of_a_column_are_its_inner_products(weighing: Weighing) -> None:
    observed: Observed = weighing.observed
    (weighed,) = weighing.weigh(GyroGSensitivity().variants(observed))
    basis = block_diag(*[basis.vectors for basis in weighing.spectrum.bases[:2]])
    stop = int(observed.bounds[2])
    first = weighing.spectrum.segment < 2
    expected = basis.T @ (observed.force[:stop, 0] * weighed.variant.columns[0].magnitude)
    assert weighed.raw[0][first, 0] == pytest.approx(expected)

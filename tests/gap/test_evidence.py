"""Evidence against integrals done another way."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad, quad
from scipy.stats import multivariate_normal, norm

from planrunner.gap.evidence import best_amplitudes, by_energy, log_bayes_factors, log_mean_exp, pair_log_bayes_factor


def test_one_amplitude_is_the_integral_over_it() -> None:
    x, y = np.array([0.5, 1.5, -1.0]), np.array([1.2, 2.0, 0.3])
    energies = np.array([3.0])
    s = np.sqrt(3.0 / (x @ x))

    def density(theta: float) -> float:
        return float(np.prod(norm.pdf(y - theta * x)) * norm.pdf(theta, scale=s))

    expected = np.log(quad(density, -20, 20)[0]) - norm.logpdf(y).sum()
    found = by_energy(np.array([[[x @ x]]]), np.array([[x @ y]]), None, energies)
    assert found[0, 0] == pytest.approx(expected, abs=1e-7)


def test_two_amplitudes_averaged_over_their_size() -> None:
    draw = np.random.default_rng(3)
    X, y = draw.normal(size=(5, 2)), draw.normal(size=5) * 2
    energies = np.array([2.0, 8.0])
    each = []
    for energy in energies:
        s = np.sqrt(energy / np.trace(X.T @ X))

        def density(b: float, a: float, s: float = s) -> float:
            return float(
                np.exp(norm.logpdf(y - X @ [a, b]).sum() - norm.logpdf(y).sum())
                * norm.pdf(a, scale=s)
                * norm.pdf(b, scale=s)
            )

        each.append(dblquad(density, -7 * s, 7 * s, -7 * s, 7 * s, epsabs=1e-5)[0])
    found = log_bayes_factors((X.T @ X)[None], (X.T @ y)[None], None, energies)
    assert found[0] == pytest.approx(np.log(np.mean(each)), abs=1e-4)


def test_a_pair_is_the_ratio_of_dense_gaussian_densities() -> None:
    draw = np.random.default_rng(4)
    A, B, y = draw.normal(size=(6, 2)), draw.normal(size=(6, 3)), draw.normal(size=6) * 3
    traces = (float(np.trace(A.T @ A)), float(np.trace(B.T @ B)))
    energies = np.array([4.0, 60.0])
    logs = []
    for one in energies:
        for two in energies:
            covariance = np.eye(6) + one / traces[0] * A @ A.T + two / traces[1] * B @ B.T
            logs.append(multivariate_normal(np.zeros(6), covariance).logpdf(y))
    expected = np.log(np.mean(np.exp(logs))) - multivariate_normal(np.zeros(6), np.eye(6)).logpdf(y)
    both = np.hstack([A, B])
    assert pair_log_bayes_factor(both.T @ both, both.T @ y, 2, traces, energies) == pytest.approx(expected, abs=1e-9)


def test_amplitudes_of_strong_evidence_are_least_squares() -> None:
    draw = np.random.default_rng(5)
    X = draw.normal(size=(50, 3)) * 10
    y = X @ [1.0, -2.0, 0.5] + draw.normal(size=50)
    mean, covariance = best_amplitudes(X.T @ X, X.T @ y, float(np.trace(X.T @ X)))
    assert mean == pytest.approx(np.linalg.lstsq(X, y, rcond=None)[0], rel=2e-3)
    assert np.sqrt(np.diag(covariance)) == pytest.approx(np.sqrt(np.diag(np.linalg.inv(X.T @ X))), rel=1e-2)


def test_log_mean_exp_does_not_overflow() -> None:
    assert log_mean_exp(np.array([1000.0, 1000.0]), 0) == pytest.approx(1000.0)
    assert log_mean_exp(np.array([0.0, -np.inf]), 0) == pytest.approx(-np.log(2))

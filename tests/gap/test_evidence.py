"""Evidence against integrals done another way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import hyp0f1

from planrunner.gap.answer.sets import PAIR_ENERGIES
from planrunner.gap.evidence.bayes_factors import (
    best_amplitudes,
    log_bayes_factors,
    log_mean_exp,
    pair_log_bayes_factor,
)
from planrunner.gap.evidence.noise_levels import log_densities
from tests.gap.turntable import record


@pytest.mark.parametrize(("p", "away"), [(1, 0.0), (1, 3.0), (1, 30.0), (3, 0.5), (3, 6.0), (9, 12.0)])
def test_equal_directions_are_the_integral_over_the_energy(p: int, away: float) -> None:
    """Amplitudes on a sphere, data `away` from its centre: the mean of exp(x·u) over directions u is ₀F₁(p/2; |x|²/4), and the energy is
    log-uniform from 4 to 10⁴."""

    def density(log_energy: float) -> float:
        energy = np.exp(log_energy)
        if p == 1:
            return float(
                np.exp(-energy / 2 + away * np.sqrt(energy) - away**2 / 2)
                * (1 + np.exp(-2 * away * np.sqrt(energy)))
                / 2
            )
        return float(np.exp(-energy / 2 - away**2 / 2) * hyp0f1(p / 2, energy * away**2 / 4))

    expected = np.log(quad(density, np.log(4.0), np.log(2e3), limit=200)[0] / np.log(2500)) + away**2 / 2
    size = 7.0
    score = np.zeros(p)
    score[0] = away * np.sqrt(size)
    found = log_bayes_factors(size * np.eye(p)[None], score[None])
    assert found[0] == pytest.approx(expected, abs=0.12)


def _drawn(size: np.ndarray, draw: np.random.Generator, count: int = 200_000) -> np.ndarray:
    """Amplitudes as they are foreseen: Gaussian directions, log-uniform energies."""
    directions = draw.standard_normal((count, len(size)))
    energies = np.exp(draw.uniform(np.log(4.0), np.log(1e4), count))
    return directions * np.sqrt(energies / np.einsum("ni,ij,nj->n", directions, size, directions))[:, None]


def test_unequal_directions_against_draws() -> None:
    draw = np.random.default_rng(3)
    X, y = draw.normal(size=(5, 2)) * [1.0, 4.0], draw.normal(size=5) * 2
    thetas = _drawn(X.T @ X, draw)
    each = thetas @ (X.T @ y) - 0.5 * ((thetas @ X.T) ** 2).sum(1)
    found = log_bayes_factors((X.T @ X)[None], (X.T @ y)[None])
    assert found[0] == pytest.approx(np.log(np.mean(np.exp(each))), abs=0.12)


def test_a_pair_against_draws() -> None:
    draw = np.random.default_rng(4)
    A, B, y = draw.normal(size=(6, 1)), draw.normal(size=(6, 2)), draw.normal(size=6) * 3
    thetas = np.hstack([_drawn(A.T @ A, draw), _drawn(B.T @ B, draw)])
    both = np.hstack([A, B])
    each = thetas @ (both.T @ y) - 0.5 * ((thetas @ both.T) ** 2).sum(1)
    traces = (float(np.trace(A.T @ A)), float(np.trace(B.T @ B)))
    found = pair_log_bayes_factor(both.T @ both, both.T @ y, 1, traces, PAIR_ENERGIES)
    assert found == pytest.approx(np.log(np.mean(np.exp(each))), abs=0.4)


def test_amplitudes_of_strong_evidence_are_least_squares() -> None:
    draw = np.random.default_rng(5)
    X = draw.normal(size=(50, 3)) * 10
    y = X @ [1.0, -2.0, 0.5] + draw.normal(size=50)
    mean, covariance = best_amplitudes(X.T @ X, X.T @ y)
    assert mean == pytest.approx(np.linalg.lstsq(X, y, rcond=None)[0], rel=2e-3)
    assert np.sqrt(np.diag(covariance)) == pytest.approx(np.sqrt(np.diag(np.linalg.inv(X.T @ X))), rel=1e-2)


def test_an_amplitude_that_is_fixed_at_1_leaves_the_other_ones_more_certain() -> None:
    """Two columns with the correlation 0.98; the amplitude of the first is 1. The others follow from least squares on the data minus the
    first column, and their errors are a quarter of those with a free first amplitude, or less."""
    draw = np.random.default_rng(6)
    X = draw.normal(size=(60, 3)) * 10
    X[:, 1] = 0.98 * X[:, 0] + 0.2 * X[:, 1]
    true, errors = np.array([1.0, 0.6, -0.5]), []
    for _ in range(200):
        y = X @ true + draw.normal(size=60)
        mean, covariance = best_amplitudes(X.T @ X, X.T @ y, (1, 1, 1), fixed=(0,))
        free, _ = best_amplitudes(X.T @ X, X.T @ y, (1, 1, 1))
        assert mean[0] == 1.0
        assert not covariance[0].any()
        assert mean[1:] == pytest.approx(np.linalg.lstsq(X[:, 1:], y - X[:, 0], rcond=None)[0], abs=1e-3)
        errors.append([mean[1] - true[1], free[1] - true[1], np.sqrt(covariance[1, 1])])
    fixed, left_free, stated = np.sqrt(np.mean(np.square(errors), axis=0))
    assert fixed == pytest.approx(stated, rel=0.15)
    assert fixed < 0.25 * left_free


def test_the_evidence_beside_an_amplitude_that_is_fixed_at_1() -> None:
    """The factor of the fixed column is that of a known signal; the others explain the data minus this column."""
    draw = np.random.default_rng(7)
    X = draw.normal(size=(40, 3))
    y = X @ [1.0, 3.0, -2.0] + draw.normal(size=40)
    rest, others = y - X[:, 1], X[:, [0, 2]]
    known = -0.5 * float(rest @ rest - y @ y)
    expected = known + log_bayes_factors(others.T @ others, others.T @ rest)
    assert log_bayes_factors(X.T @ X, X.T @ y, fixed=(1,)) == pytest.approx(expected, rel=1e-9)
    one = X[:, [1]]
    assert log_bayes_factors(one.T @ one, one.T @ y, fixed=(0,)) == pytest.approx(known, rel=1e-9)


def test_log_mean_exp_does_not_overflow() -> None:
    assert log_mean_exp(np.array([1000.0, 1000.0]), 0) == pytest.approx(1000.0)
    assert log_mean_exp(np.array([0.0, -np.inf]), 0) == pytest.approx(-np.log(2))


def test_each_effect_of_a_pair_has_a_size_of_its_own() -> None:
    """One effect is a thousand times stronger for the same amplitude: the other must not be shrunk by its prior."""
    draw = np.random.default_rng(4)
    strong, weak = draw.normal(size=(400, 2)) * 30, draw.normal(size=(400, 3))
    true = np.array([0.02, -0.03, 0.4, -0.5, 0.6])
    X = np.hstack([strong, weak])
    y = X @ true + draw.normal(size=400)
    mean, covariance = best_amplitudes(X.T @ X, X.T @ y, (2, 3))
    least_squares = np.linalg.lstsq(X, y, rcond=None)[0]
    assert np.all(np.abs(mean - least_squares) < 0.25 * np.sqrt(np.diag(covariance)))
    assert np.diag(covariance) == pytest.approx(np.diag(np.linalg.inv(X.T @ X)), rel=0.1)


def test_excess_noise_has_a_normalised_prior() -> None:
    """Integrated over the measured level of the gyros, the density with excess noise is that with the declared noise."""
    seen = record(1, clean=True)
    seen = replace(seen, channels=tuple(replace(one, resolution=0.0) for one in seen.channels))
    declared = np.array([one.white for one in seen.channels]) * np.sqrt(seen.sample_rate)
    totals = {"declared": 0.0, "white": 0.0}
    for excess in np.arange(-1.5, 4.5, 0.01):
        white = declared * np.exp(excess * np.array([1, 1, 1, 0, 0, 0]))
        found = log_densities(seen, white, np.full(6, 1e3), np.zeros(6))
        for level in totals:
            totals[level] += float(np.exp(found[level, "declared"]))  # type: ignore[index]
    assert totals["white"] == pytest.approx(totals["declared"], rel=2e-3)

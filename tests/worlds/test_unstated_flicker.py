"""Flicker of which a bench file says nothing: the warning, its bound, and why no test of the data could replace it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.base.said import said
from planrunner.estimators.derived import Reported, derived
from planrunner.estimators.interface import Estimate
from planrunner.estimators.open_flicker import open_flicker
from planrunner.estimators.outputs_fit import fit_outputs
from planrunner.estimators.unstated_flicker import FlickerEvidence
from planrunner.observation.flicker import mean_covariance, unstated_flicker
from planrunner.observation.observations import Observations
from planrunner.uncertainty.influences import Inputs
from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import estimated, known, recorded
from tests.worlds.faults import WORLDS
from tests.worlds.temperature_cycles import campaign, cycle_worlds

Array = NDArray[np.float64]
CAUSE = "bias_instability"
SPAN = 86_400.0


@pytest.mark.parametrize(
    "estimator",
    [
        "flexure_gyro_static",
        "scale_factor",
        "accelerometer_multi_position",
        "scale_factor_tilted",
        "scale_factor_tilted, within segments",
        "strapdown_navigation at rest",
    ],
)
@pytest.mark.parametrize(("world", "warned"), [("flicker, not declared", True), ("white noise", False)])
def test_a_bench_that_says_nothing_of_flicker_is_warned_of(estimator: str, world: str, warned: bool) -> None:
    """`white noise` states that the flicker is zero."""
    asked, sound = CAMPAIGNS[estimator], known(CAMPAIGNS[estimator], WORLDS[world])
    _, made = recorded(asked, WORLDS[world], np.random.default_rng(11))
    one = estimated(asked, sound, made)
    assert not isinstance(one, str), one
    naming = [text for text in one.warnings if CAUSE in text]
    assert len(naming) == warned
    noted = [text for text in one.notes if "No bias instability is declared" in text]
    for channel in asked.channels:
        assert not any(channel in text.partition(",")[0] for text in naming) or not any(
            channel in text for text in noted
        )


@pytest.mark.parametrize("order", ["", ", order: 1", ", uncertainty: propagated"])
def test_a_curve_over_temperature_is_warned_of(order: str) -> None:
    """The white noise of a bench that says nothing, and of one that says that there is no flicker."""
    asked, world = campaign(1, order), replace(cycle_worlds(1)["white noise"], silent=True)
    _, made = recorded(asked, world, np.random.default_rng(2))
    silent, stated = (estimated(asked, known(asked, one), made) for one in (world, replace(world, silent=False)))
    assert not isinstance(silent, str) and not isinstance(stated, str)
    assert [text for text in silent.warnings if CAUSE in text and "gyro_z_T" in text]
    assert not [text for text in stated.warnings if CAUSE in text]
    assert any("No bias instability is declared" in text for text in stated.notes)
    for one, other in zip(silent.coefficients, stated.coefficients, strict=True):
        assert (one.value, one.standard_uncertainty) == (other.value, other.standard_uncertainty)


@pytest.mark.slow
def test_averages_of_many_segments_limit_flicker_with_the_same_probability() -> None:
    """B from the half-Cauchy prior up to its quantile of 90 %: the bound is above it in 95 % of the draws, within four standard errors, and
    on average no more than a tenth above that of all contrasts. The bound of a part of the draws is computed from all contrasts, too."""
    n, draws, seconds = 300, 80, 60.0
    start: Array = np.arange(float(n)) * (seconds + 20.0)
    white = np.random.default_rng(8)
    root: Array = np.asarray(np.linalg.cholesky(mean_covariance(start, start + seconds, SPAN)), dtype=np.float64)
    columns = np.stack([np.ones(n), white.standard_normal(n)], axis=1)
    scale = 1 / np.sqrt(np.mean(np.sum((root - root.mean(axis=0)) ** 2, axis=1)))
    within: Array = np.full(n, math.log(32) / math.pi / 31)
    above, sizes = 0, []
    for draw in range(draws):
        size = scale * np.tan(np.pi / 2 * 0.9 * white.random())
        values = white.standard_normal(n) + size * (root @ white.standard_normal(n))
        seen = FlickerEvidence(columns, values, np.ones(n), 31.0 * n, root, within, np.zeros((n, 0)))
        bound = seen.bound()
        above += bound >= size
        if draw < 12:
            sizes.append(np.log(bound / exact_bound(seen)))
    assert above / draws >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / draws)
    assert abs(np.mean(sizes)) < 0.1


def exact_bound(seen: FlickerEvidence) -> float:
    """The bound by the likelihood of all observations, their coefficients integrated out, from determinants and solutions of linear
    equations for each B (Harville 1977, equation 2)."""
    values, columns = seen.values, seen.columns
    flicker = seen.flicker @ seen.flicker.T - np.diag(seen.within)
    grid = np.geomspace(1e-3, 1e2, 120)
    logs = []
    for size in grid:
        covariance = np.diag(seen.sigma**2) + size**2 * flicker
        solved = np.linalg.solve(covariance, np.column_stack([columns, values]))
        inner = columns.T @ solved[:, :-1]
        left = values @ solved[:, -1] - (values @ solved[:, :-1]) @ np.linalg.solve(inner, columns.T @ solved[:, -1])
        determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(inner)[1]
        logs.append(
            -determinants / 2 - (seen.freedom + len(values) - columns.shape[1]) / 2 * np.log1p(left / seen.freedom)
        )
    about = seen.flicker - seen.flicker.mean(axis=0)
    scale = 1 / np.sqrt(np.sum(about**2) / (len(values) - 1))
    prior = 1 / (1 + (grid / scale) ** 2) * grid  # on a logarithmic grid
    weights = np.cumsum(prior * np.exp(np.array(logs) - np.max(logs)))
    return float(np.interp(0.95 * weights[-1], weights, grid))


@pytest.mark.parametrize("quadruples", [2, 3, 6])
def test_repeated_rocking_tests_show_flicker_themselves(quadruples: int) -> None:
    """Means of the accelerometers over two windows of each run, and the drift of the element between them. Flicker gives the mean rocking
    drift a variance, and the scatter of the quadruples is expected to show it: a coverage of 95 % falls below 94 % only from a ratio of
    1.1."""
    weights, begin = np.array([-0.5, 0.5, 0.5, -0.5]), np.arange(4.0 * quadruples) * 640.0
    windows = np.sort(np.concatenate([begin + 30.0, begin + 560.0]))
    by_windows = np.kron(np.eye(quadruples), np.kron(weights, [-1.0, 1.0]))
    by_runs = np.kron(np.eye(quadruples), weights)
    accelerometers = by_windows @ mean_covariance(windows, windows + 20.0, SPAN) @ by_windows.T
    element = by_runs @ mean_covariance(begin + 30.0, begin + 560.0, SPAN) @ by_runs.T
    for covariance in (accelerometers, element):
        of_mean = covariance.sum() / quadruples**2
        shown = (np.trace(covariance) - covariance.sum() / quadruples) / (quadruples - 1) / quadruples
        assert 0.9 < of_mean / shown < 1.1


def observations(means: Array, seconds: float, gap: float, sigma: float) -> Observations:
    """Means (n,) with the standard uncertainty `sigma` of segments that follow each other."""
    n = len(means)
    start: Array = np.arange(float(n)) * (seconds + gap)
    return Observations(
        ("gyro",),
        ("deg/h",),
        tuple(f"S{k}" for k in range(n)),
        means[:, None],
        np.full((n, 1), sigma),
        np.full(n, 32),
        start,
        start + seconds,
        np.eye(1),
    )


def bound_of(seen: Observations, span: float) -> tuple[float, ...]:
    silent = unstated_flicker(seen, Inputs(without_flicker=frozenset({"gyro"})), span)
    n = len(seen.labels)
    fit = fit_outputs(np.ones((n, 1)), seen, np.ones(1), ("bias",), unstated=silent)
    named = Reported("bias", "deg/h", said("bias"))
    found = derived([named], lambda flat: flat, fit)
    basis = "within_segment"
    made = Estimate("", "", found.coefficients(basis), found.covariance(basis), unstated=found.unstated)
    return tuple(one.bound for one in open_flicker(made))


def test_plentiful_data_over_the_whole_span_need_no_declaration() -> None:
    """240 segments of 300 s fill the day over which the bias is averaged, and their scatter shows that the noise is white."""
    white = np.random.default_rng(3).standard_normal(240)
    assert not bound_of(observations(white, 300.0, 60.0, 1.0), SPAN)
    assert bound_of(observations(white[:10], 300.0, 60.0, 1.0), SPAN)


def test_more_scatter_allows_more_flicker() -> None:
    white = np.random.default_rng(4).standard_normal(12)
    (few,), (many,) = (bound_of(observations(size * white, 60.0, 20.0, 1.0), SPAN) for size in (1.0, 4.0))
    assert many > 2 * few


@pytest.mark.slow
def test_the_bound_contains_the_coefficient() -> None:
    """For flicker as large as the noise of a mean: the bound is above it in at least 95 % of the runs, within four standard errors."""
    asked, world = CAMPAIGNS["scale_factor"], WORLDS["flicker, not declared"]
    sound, above, runs = known(asked, world), 0, 60
    for run in range(runs):
        _, made = recorded(asked, world, np.random.default_rng([41, run]))
        one = estimated(asked, sound, made)
        assert not isinstance(one, str), one
        (text,) = (text for text in one.warnings if CAUSE in text)
        above += float(text.partition("is at most ")[2].split()[0]) >= asked.mean[0]
    assert above / runs >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / runs)


def kernel(start: Array, seconds: float) -> Array:
    """Covariance (n, n) of means over `seconds` of flicker with B = 1, up to constants that belong to a bias: −ln|t − t′|/π of intervals
    that are far apart, and of one interval (3/2 − ln T)/π."""
    middle = start + seconds / 2
    apart = np.abs(middle[:, None] - middle)
    far = apart > 0.5 * seconds
    return np.where(far, -np.log(np.where(far, apart, 1.0)), 1.5 - np.log(seconds)) / np.pi


def best_power(starts: Array, seconds: float, columns: Array, outputs: int, false_alarms: float) -> float:
    """Power of the most powerful test (Neyman and Pearson) of white noise against the same with flicker as large as the noise of a mean,
    for which all sizes are known, from the means of 24 parts of each segment. columns: (n, p), of the coefficients."""
    parts = 24
    start = np.concatenate([one + np.arange(parts) * seconds / parts for one in starts])
    orthonormal, _ = np.linalg.qr(np.repeat(columns, parts, axis=0), mode="complete")
    free = orthonormal[:, columns.shape[1] :]
    excess = np.linalg.eigvalsh(free.T @ kernel(start, seconds / parts) @ free) / parts
    excess = np.tile(np.maximum(excess, 0.0), outputs)
    squares = np.random.default_rng(6).standard_normal((4000, len(excess))) ** 2
    weights = excess / (1 + excess)
    limit = np.quantile(squares @ weights, 1 - false_alarms)
    return float(np.mean((squares * (1 + excess)) @ weights > limit))


def test_no_test_of_the_data_could_name_this_flicker_instead() -> None:
    """Even the best one finds it in about a third (eight positions, six coefficients, two outputs) and half (ten rates) of the runs if it
    may be wrong in a twentieth of the runs with white noise."""
    rates = np.array([300.0, -300.0, 200.0, -200.0, 100.0, -100.0, 50.0, -50.0, 20.0, -20.0])
    line = best_power(np.linspace(0.0, 414.0, 10), 36.0, np.stack([np.ones(10), rates], axis=1), 1, 0.05)
    others = np.random.default_rng(1).standard_normal((8, 5))
    eight = best_power(np.linspace(0.0, 1155.0, 8), 120.0, np.column_stack([np.ones(8), others]), 2, 0.05)
    assert 0.2 < eight < 0.5
    assert 0.4 < line < 0.65

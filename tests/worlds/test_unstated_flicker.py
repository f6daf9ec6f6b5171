"""Flicker of which a bench file says nothing: the warning, its bound, and why no test of the data could replace it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.estimators.outputs_fit import fit_outputs
from planrunner.estimators.unstated_flicker import open_flicker
from planrunner.observation.flicker import unstated_flicker
from planrunner.observation.observations import Observations
from planrunner.uncertainty.influences import Inputs
from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import estimated, known, recorded
from tests.worlds.faults import WORLDS

Array = NDArray[np.float64]
CAUSE = "bias_instability"
SPAN = 86_400.0


@pytest.mark.parametrize("estimator", ["flexure_gyro_static", "scale_factor", "accelerometer_multi_position"])
@pytest.mark.parametrize(("world", "warned"), [("flicker, not declared", True), ("white noise", False)])
def test_a_bench_that_says_nothing_of_flicker_is_warned_of(estimator: str, world: str, warned: bool) -> None:
    """`white noise` states that the flicker is zero."""
    campaign, sound = CAMPAIGNS[estimator], known(CAMPAIGNS[estimator], WORLDS[world])
    _, made = recorded(campaign, WORLDS[world], np.random.default_rng(11))
    one = estimated(campaign, sound, made)
    assert not isinstance(one, str), one
    naming = [text for text in one.warnings if CAUSE in text]
    assert len(naming) == warned
    noted = [text for text in one.notes if "No bias instability is declared" in text]
    assert not (naming and noted)


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
    return tuple(one.bound for one in open_flicker(fit, "within_segment"))


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
    campaign, world = CAMPAIGNS["scale_factor"], WORLDS["flicker, not declared"]
    sound, above, runs = known(campaign, world), 0, 60
    for run in range(runs):
        _, made = recorded(campaign, world, np.random.default_rng([41, run]))
        one = estimated(campaign, sound, made)
        assert not isinstance(one, str), one
        (text,) = (text for text in one.warnings if CAUSE in text)
        above += float(text.partition("up to ")[2].split()[0]) >= campaign.mean[0]
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

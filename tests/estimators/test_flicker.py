"""Covariance of means of flicker: against integrals over frequency, against synthesised noise, and what the fits make of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recorded import from_means, segment, sensor
from scipy.integrate import trapezoid
from simulated_flicker import flicker_series
from test_flexure_gyro_static import CHANNELS, OPTIMAL, SITE, TRUTH, attitude, pulses

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.analysis import combined
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.interface import Estimate, EstimateRequest, Setup
from planrunner.observation.flicker import flicker_errors, mean_covariance, scatter_within
from planrunner.observation.observations import Observations
from planrunner.plan.quantity import parse_quantity
from planrunner.uncertainty.influences import InputQuantity, Inputs


def over_frequency(one: tuple[float, float], other: tuple[float, float], span: tuple[float, float]) -> float:
    """∫ 1/(π·f)·Re[(H_i − H_T)·(H_j − H_T)*] df with H the Fourier transform of an average over an interval, term by term over ln f."""

    def response(f: np.ndarray, interval: tuple[float, float]) -> np.ndarray:
        low, high = interval
        return np.sinc(f * (high - low)) * np.exp(-1j * math.pi * f * (low + high))

    logarithm = np.linspace(math.log(1e-4 / (span[1] - span[0])), math.log(400 / (one[1] - one[0])), 400_001)
    f = np.exp(logarithm)
    whole = response(f, span)
    density = ((response(f, one) - whole) * np.conj(response(f, other) - whole)).real / math.pi
    return float(trapezoid(density, logarithm))


def test_covariance_of_means_is_the_integral_of_their_spectrum() -> None:
    start, end = np.array([0.0, 3.0, 20.0]), np.array([2.0, 4.0, 23.0])
    found = mean_covariance(start, end, 60.0)
    span = (11.5 - 30.0, 11.5 + 30.0)
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1)):
        expected = over_frequency((start[i], end[i]), (start[j], end[j]), span)
        assert found[i, j] == pytest.approx(expected, abs=2e-3), (i, j)


@pytest.mark.parametrize("gap", [0.0, 1e-6, 30.0])
def test_the_error_has_the_covariance_of_flicker(gap: float) -> None:
    """Also of segments without gaps that fill the whole span: their mean is the mean over the span, so that the covariance is singular."""
    n, seconds, b = 30, 60.0, 0.02
    start = np.arange(float(n)) * (seconds + gap)
    means = Observations(
        ("x",),
        ("V",),
        tuple("s" * n),
        np.zeros((n, 1)),
        np.ones((n, 1)),
        np.full(n, 32),
        start,
        start + seconds,
        np.eye(1),
    )
    stated = InputQuantity("bias instability x", 0.0, "V", b)
    (error,) = flicker_errors(means, Inputs({stated.name: stated}), n * seconds)
    expected = b**2 * mean_covariance(start, start + seconds, n * seconds)
    assert abs(np.asarray(error.covariance(0, 0)) - expected).max() < 1e-12 * expected.max()


@pytest.mark.parametrize("distance", [300.0, 500.0])
def test_short_segments_far_apart(distance: float) -> None:
    """By midpoints of the double integral, on either side of where the closed form gives way to its series."""
    grid = (np.arange(500) + 0.5) / 500
    wide = (np.arange(20_000) + 0.5) / 20_000 * 1e4 - 5e3 + (distance + 1) / 2

    def kernel(one: np.ndarray, other: np.ndarray) -> float:
        return float(-np.log(np.abs(one[:, None] - other[None, :])).mean() / math.pi)

    found = mean_covariance(np.array([0.0, distance]), np.array([1.0, distance + 1]), 1e4)
    whole = (math.log(1e4) - 1.5) / -math.pi
    expected = kernel(grid, grid + distance) - kernel(grid, wide) - kernel(grid + distance, wide) + whole
    assert found[0, 1] == pytest.approx(expected, abs=1e-4)


def test_covariance_of_synthesised_noise() -> None:
    """2000 courses: each entry within four standard errors; and the scatter within a segment."""
    draw, step, count = np.random.default_rng(3), 1.0, 1 << 13
    start = 3600.0 + np.array([0.0, 90.0, 180.0, 900.0])
    means, scatter = [], []
    for _ in range(500):
        series = flicker_series(draw, (4,), 1.0, step, count)
        middle, half = int((start[0] + start[-1] + 64) / 2), 1500
        series -= series[:, middle - half : middle + half].mean(axis=1, keepdims=True)
        cut = np.stack([series[:, int(one) : int(one) + 64] for one in start], axis=1)
        means.append(cut.mean(axis=2))
        scatter.append(cut.reshape(4, 4, 32, 2).mean(axis=3).var(axis=2, ddof=1) / 32)
    seen = np.concatenate(means)
    covariance = seen.T @ seen / len(seen)
    expected = mean_covariance(start, start + 64, 3000.0)
    own = np.diag(expected)
    error = np.sqrt((np.outer(own, own) + expected**2) / len(seen))
    assert (np.abs(covariance - expected) < 4 * error).all()
    assert np.mean(scatter) == pytest.approx(scatter_within(np.array([32]))[0], rel=0.02)


def recorded(noise: np.ndarray, error: float = 0.08, apart: float = 180.0) -> tuple[RecordedSegment, ...]:
    """noise: (2, 8), of the means."""
    made = []
    for n, (label, words) in enumerate(OPTIMAL.items()):
        means = dict(zip(CHANNELS, np.add(pulses(attitude(words), TRUTH), noise[:, n]), strict=True))
        named = replace(segment(label, attitude(words)), orientation=words)
        made.append(from_means(named, means, "pulse/s", error, start=apart * n))
    return tuple(made)


def declared(size: float, tilt: float = 0.0) -> Setup:
    stated = {
        f"bias instability {name}": InputQuantity(f"bias instability {name}", 0.0, "pulse/s", size) for name in CHANNELS
    }
    if tilt:
        stated["table position"] = InputQuantity("table position", 0.0, "rad", tilt)
    return Setup(inputs=Inputs(stated))


def fitted(segments: tuple[RecordedSegment, ...], setup: Setup, **keys: Any) -> Estimate:
    parameters = FlexureGyroStaticParameters(**keys)
    return combined(
        FlexureGyroStatic().estimate(EstimateRequest("d", segments, parameters, SITE, sensor(*CHANNELS), setup=setup))
    )


NOISE = np.random.default_rng(1).normal(scale=0.08, size=(2, 8))


def test_uncertainties_are_those_of_generalised_least_squares() -> None:
    """By the textbook formula (XᵀV⁻¹X)⁻¹ written with inverses, where all is declared and believed."""
    found = fitted(recorded(NOISE), declared(0.3), uncertainty="within_segment")
    start = 180.0 * np.arange(8, dtype=float)
    left = 0.08**2 - 0.3**2 * math.log(32) / (math.pi * 31)  # white, less what flicker makes of the scatter within
    covariance = left * np.eye(8) + 0.09 * mean_covariance(start, start + 120, 86400.0)
    earth = 15.041067 * np.array([0, math.cos(SITE.latitude), math.sin(SITE.latitude)])
    axes = np.array([attitude(words) for words in OPTIMAL.values()])
    g = SITE.gravity / 9.80665
    matrix = np.column_stack([np.ones(8), axes[:, 1] @ earth, axes[:, 0] @ earth, g * axes[:, :, 2]])
    inverse = np.linalg.inv(covariance)
    expected = np.sqrt(np.diag(np.linalg.inv(matrix.T @ inverse @ matrix)))
    assert [found[f"U{k}"].standard_uncertainty for k in range(6)] == pytest.approx(expected, rel=1e-4)


def test_flicker_is_a_line_of_the_budget_that_is_added_or_listed() -> None:
    for basis, added in (("within_segment", True), ("residual", False)):
        found = fitted(recorded(NOISE), declared(0.3), uncertainty=basis)
        budget = next(one for one in found.budgets if one.coefficient == "U0")
        (line,) = [one for one in budget.lines if one.quantity == "bias instability torquer_x"]
        assert (line.added, line.standard_uncertainty, line.unit, line.count) == (added, 0.3, "pulse/s", 8)
        if added:
            assert line.contribution > 0.25  # a constant drift is hardly told from flicker


def test_the_longer_constants_must_hold_the_less_certain_they_are() -> None:
    spans = [parse_quantity(f"{hours} h") for hours in (1, 24, 720)]
    found = [fitted(recorded(NOISE), declared(0.3), drift_span=span, uncertainty="within_segment") for span in spans]
    drifts = [one["U0"].standard_uncertainty for one in found]
    assert drifts[0] < drifts[1] < drifts[2]
    assert (drifts[2] ** 2 - drifts[1] ** 2) / 0.09 == pytest.approx(math.log(30) / math.pi, rel=0.01)
    slopes = [one["U3"].standard_uncertainty for one in found]
    assert slopes == pytest.approx([slopes[0]] * 3, rel=1e-6)


def test_nothing_changes_where_nothing_is_declared() -> None:
    found, without = fitted(recorded(NOISE), Setup()), fitted(recorded(NOISE, apart=0.0), Setup())
    assert found.covariance == pytest.approx(without.covariance, rel=1e-9, abs=1e-18)
    assert any("No bias instability is declared for torquer_x, torquer_y" in note for note in found.notes)
    said = fitted(recorded(NOISE), declared(0.3)).notes
    assert not any("No bias instability" in note for note in said)
    assert any("included in the weights of the fit: bias instability torquer_x" in note for note in said)


def test_flicker_larger_than_all_that_is_seen_within_still_gives_a_fit() -> None:
    found = fitted(recorded(NOISE, error=1e-4), declared(5.0, tilt=1e-3))
    assert np.isfinite([one.standard_uncertainty for one in found.coefficients]).all()

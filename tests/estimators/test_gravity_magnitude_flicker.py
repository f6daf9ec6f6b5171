"""Declared flicker of an accelerometer's channels in the nine parameters from |f| = g: against generalised least squares by hand."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from accelerometer_coverage import CHANNELS, SITE, spread_attitudes
from recorded import from_samples, played, segment, sensor

from planrunner.estimators.accelerometer.accelerometer_multi_position import AccelerometerMultiPosition
from planrunner.estimators.accelerometer.parameters import AccelerometerMultiPositionParameters
from planrunner.estimators.analysis import combined
from planrunner.estimators.interface import Estimate, EstimateRequest, Setup
from planrunner.observation.flicker import mean_covariance
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.selection import Detection
from planrunner.uncertainty.influences import InputQuantity, Inputs
from tests.worlds.faults import Recorded, flicker

WHITE = 1e-3  # m/s², of every mean
SIZES = (5e-4, 1e-3, 2e-3)  # m/s², bias instability of x, y, z
STARTS = 90.0 * np.arange(24)
DWELL, SAMPLES = 60.0, 320


@cache
def noise() -> np.ndarray:
    """White noise and flicker of every sample, (24, samples, 3), m/s²: flicker from the independent generator."""
    draw, rate = np.random.default_rng(4), SAMPLES / DWELL
    time = (STARTS[:, None] + np.arange(SAMPLES) / rate).ravel()
    pose, sizes = np.repeat(np.arange(24), SAMPLES), np.array(SIZES)
    white = WHITE * math.sqrt(SAMPLES) * np.ones(3)
    values = white * draw.standard_normal((len(time), 3))
    made = flicker(Recorded(time, pose, values, white, sizes, rate), draw, 1.0) + values
    return made.reshape(24, SAMPLES, 3)


def declared(sizes: tuple[float, ...]) -> Setup:
    names = [f"bias instability {one}" for one in CHANNELS]
    return Setup(inputs=Inputs({n: InputQuantity(n, 0.0, "m/s^2", b) for n, b in zip(names, sizes, strict=True) if b}))


def estimate(basis: str, sizes: tuple[float, ...] = SIZES) -> Estimate:
    """Samples of a perfect sensor with white noise and flicker."""
    made = []
    for k, attitude in enumerate(spread_attitudes()):
        means = dict(zip(CHANNELS, map(float, 9.80 * attitude[:, 2]), strict=True))
        planned = segment(f"P{k}", attitude, dwell=DWELL)
        made.append(played(planned, means, noise()[k].T, "m/s^2", STARTS[k]))
    parameters = AccelerometerMultiPositionParameters(
        reference="gravity_magnitude", uncertainty=basis, drift=("none",), drift_span=parse_quantity("24 h")
    )
    model = sensor(*CHANNELS, unit="m/s^2")
    request = EstimateRequest("a", tuple(made), parameters, SITE, model, setup=declared(sizes))
    return combined(AccelerometerMultiPosition().estimate(request))


def by_hand(
    sizes: tuple[float, ...],
    starts: np.ndarray = STARTS,
    dwell: float = DWELL,
    white: float = WHITE,
    span: float = 24 * 3600.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters less those of a perfect sensor, and their covariance; mg, 1, mrad. |f| − g answers by −d_i to a bias, by −g·d_i² to a
    scale factor and by −g·d_i·d_j to an angle, d along gravity; a reading's error reaches it by d."""
    d = np.array([attitude[:, 2] for attitude in spread_attitudes()])
    pairs = ((0, 1), (0, 2), (1, 2))
    jacobian = np.column_stack([d, 9.8 * d**2, *(9.8 * d[:, i] * d[:, j] for i, j in pairs)])
    common = mean_covariance(starts, starts + dwell, span)
    v = white**2 * np.eye(24) + sum(b**2 * np.outer(d[:, k], d[:, k]) * common for k, b in enumerate(sizes))
    cofactor = np.linalg.inv(jacobian.T @ np.linalg.solve(v, jacobian))
    values = cofactor @ jacobian.T @ np.linalg.solve(v, np.sum(d * noise().mean(axis=1), axis=1))
    units = np.array([9.80665e-3] * 3 + [1.0] * 3 + [1e-3] * 3)
    return values / units, cofactor / np.outer(units, units)


def test_values_and_uncertainties_are_those_of_generalised_least_squares() -> None:
    """The hand's directions are those of a perfect sensor, the fit's those of the fitted one, 1e-3 apart. The hand knows the white noise,
    which the fit takes from the scatter of 32 parts of each of 24 poses, that is to about 3 %."""
    found = estimate("within_segment")
    values, covariance = by_hand(SIZES)
    perfect = np.array([0.0] * 3 + [1.0] * 3 + [0.0] * 3)
    spread = np.sqrt(np.diag(covariance))
    moved = np.array([item.value for item in found.coefficients]) - perfect
    assert moved / spread == pytest.approx(values / spread, abs=0.1)
    assert [item.standard_uncertainty for item in found.coefficients] == pytest.approx(spread, rel=0.03)
    correlation = covariance / np.outer(spread, spread)
    assert found.covariance / np.outer(spread, spread) == pytest.approx(correlation, abs=0.06)


def test_the_residual_basis_has_one_factor_for_noise_and_flicker() -> None:
    found = estimate("residual")
    spreads = np.array([item.standard_uncertainty for item in found.coefficients])
    ratio = spreads / np.sqrt(np.diag(by_hand(SIZES)[1]))
    assert np.ptp(ratio) < 0.02 * ratio.mean()
    assert found["bias_x"].degrees_of_freedom == pytest.approx(24 - 9)
    assert any("bias instability accel_z" in note for note in found.notes)


def test_who_has_no_flicker_declared_is_named() -> None:
    found = estimate("within_segment", (5e-4, 0.0, 0.0))
    (note,) = [note for note in found.notes if "No bias instability" in note]
    assert "accel_y, accel_z" in note and "accel_x" not in note and "|f|" not in note


def test_flicker_reaches_spans_that_are_found_by_their_stillness() -> None:
    """24 poses in one recording, of 8 s each with 2 s of motion between them; half a window at either end is not still."""
    time = np.arange(24 * 1000) / 100
    values = np.random.default_rng(0).normal(0, 2e-3, (len(time), 3))
    for k, attitude in enumerate(spread_attitudes()):
        values[1000 * k : 1000 * (k + 1)] += 9.8 * attitude[:, 2]
        values[1000 * k + 800 : 1000 * (k + 1)] += 3 * np.sin(2 * np.pi * np.arange(200) / 100)[:, None]
    channels = {name: values[:, k] for k, name in enumerate(CHANNELS)}
    recorded = from_samples(segment("t"), time, channels, dict.fromkeys(CHANNELS, "m/s^2"))
    chosen = Detection(
        detect="still",
        channels=CHANNELS,
        window=parse_quantity("0.5 s"),
        threshold=parse_quantity("0.05 m/s^2"),
        at_least=parse_quantity("1 s"),
    )
    parameters = AccelerometerMultiPositionParameters(reference="gravity_magnitude", uncertainty="within_segment")
    model = sensor(*CHANNELS, unit="m/s^2")
    sizes = (1e-3,) * 3
    request = EstimateRequest("a", (recorded,), parameters, SITE, model, {}, chosen, declared(sizes))
    found = combined(AccelerometerMultiPosition().estimate(request))
    assert found.extra["poses"] == 24
    white = 2e-3 / math.sqrt(
        750
    )  # of the samples alone; what is left of the flicker within a span is taken off what is seen there
    _, covariance = by_hand(sizes, 10.0 * np.arange(24) + 0.25, 7.5, white, 86400.0)
    spreads = [item.standard_uncertainty for item in found.coefficients]
    assert spreads == pytest.approx(np.sqrt(np.diag(covariance)), rel=0.03)

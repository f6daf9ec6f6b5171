"""Coefficients: covariance of Allan variances against simulation, truth recovered within the stated uncertainty."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import simulated_noise
from recorded import from_samples, segment, sensor

from planrunner.estimators.allan import kernel as allan_kernel
from planrunner.estimators.allan.allan_deviation import AllanDeviation, AllanDeviationParameters
from planrunner.estimators.allan.fit import ALLAN, HADAMARD, VarianceCovariance, fit_noise, model_matrix
from planrunner.estimators.interface import Estimate, EstimateRequest
from planrunner.instruments.models import NoiseModel
from planrunner.physics.earth import Site

SITE = Site(math.radians(40.0))


def estimate(values: np.ndarray, interval: float, unit: str = "pulse/s", **keys: Any) -> Estimate:
    time = np.arange(values.size) * interval
    recorded = from_samples(segment("rest"), time, {"gyro": values}, {"gyro": unit}, rows=10_007)
    parameters = AllanDeviationParameters(outputs=("gyro",), **keys)
    return AllanDeviation().estimate(EstimateRequest("noise", (recorded,), parameters, SITE, sensor("gyro", unit=unit)))


def test_model_by_hand() -> None:
    """σ² = 3Q²/τ² + N²/τ + 0.664²B² + K²τ/3 at τ = 1 and 6."""
    assert model_matrix(np.array([1, 6])) == pytest.approx(
        np.array([[3, 1, 0.6643**2, 1 / 3], [1 / 12, 1 / 6, 0.6643**2, 2]]), rel=1e-3
    )


def test_hadamard_model_by_hand() -> None:
    """Third differences of the phase: 20/6·Q²/τ², N²/τ, (½·ln(256/27)/(2·ln 2))·0.664²·B² (NIST SP 1065, 5.2.8) and K²·τ/6."""
    flat = 0.6643**2 * 0.5 * math.log(256 / 27) / (2 * math.log(2))
    assert model_matrix(np.array([1, 6]), HADAMARD) == pytest.approx(
        np.array([[10 / 3, 1, flat, 1 / 6], [10 / 108, 1 / 6, flat, 1]]), rel=1e-3
    )


def test_noiseless_curve_gives_its_coefficients() -> None:
    factors = 2 ** np.arange(14)
    squares = np.array([2.0, 1.0, 0.01, 1e-5])
    freedom = 60_000 / factors
    fit = fit_noise(factors, model_matrix(factors) @ squares, freedom, np.array([2**16 + 1]))
    assert fit.squares == pytest.approx(squares, rel=1e-6)
    assert fit.chi_square == pytest.approx(0, abs=1e-9)
    assert fit.freedom == 10


@pytest.mark.parametrize("order", [ALLAN, HADAMARD])
def test_covariance_of_variances_against_simulation(order: int) -> None:
    draw = np.random.default_rng(1)
    n, records, factors = 1024, 3000, 2 ** np.arange(8)
    squares = np.array([4.0, 1.0, 0.0, 1e-3])
    found = np.empty((records, factors.size))
    for row in found:
        y = simulated_noise.rate(draw, n, 1.0, N=1.0, Q=2.0, K=math.sqrt(1e-3))
        x = np.concatenate([[0.0], np.cumsum(y)])
        sums = (allan_kernel.second_differences if order == ALLAN else allan_kernel.third_differences)(x, factors)
        row[:] = sums / (math.factorial(order) * factors.astype(float) ** 2 * (n + 1 - order * factors))
    assert found.mean(axis=0) == pytest.approx(model_matrix(factors, order) @ squares, rel=0.03)
    expected = VarianceCovariance(factors, np.array([n + 1]), order)(squares)
    size = np.sqrt(np.diag(expected))
    assert np.var(found, axis=0) / size**2 == pytest.approx(np.ones(factors.size), abs=0.15)
    assert np.corrcoef(found.T) == pytest.approx(expected / np.outer(size, size), abs=0.08)


def test_runs_add_their_information() -> None:
    factors, squares = 2 ** np.arange(6), np.array([0.0, 1.0, 0.0, 0.0])
    one = VarianceCovariance(factors, np.array([1000]))(squares)
    four = VarianceCovariance(factors, np.array([1000] * 4))(squares)
    assert four == pytest.approx(one / 4, rel=1e-9)


TRUTH = {"Q": 0.02, "N": 0.05, "B": 0.04, "K": 0.004}
INTERVAL = 0.1


def recover(records: int) -> dict[str, np.ndarray]:
    """(records, 2) value and standard uncertainty of each coefficient."""
    draw = np.random.default_rng(17)
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in TRUTH}
    for _ in range(records):
        values = simulated_noise.rate(draw, 2**15, INTERVAL, **TRUTH)
        result = estimate(values, INTERVAL)
        for name, pairs in found.items():
            pairs.append((result[f"{name}_gyro"].value, result[f"{name}_gyro"].standard_uncertainty))
    return {name: np.array(pairs) for name, pairs in found.items()}


def check_recovered(found: dict[str, np.ndarray], records: int) -> None:
    for name, pairs in found.items():
        error, u = pairs[:, 0] - TRUTH[name], pairs[:, 1]
        covered = np.mean(np.abs(error) <= 2 * u)
        assert covered > 0.954 - 3.5 * math.sqrt(0.954 * 0.046 / records), (name, covered)
        # Neither far too wide nor off to one side.
        assert np.std(error) > 0.4 * np.median(u), name
        assert abs(np.median(error)) < (0.35 + 4 / math.sqrt(records)) * np.median(u), name


def test_truth_is_recovered() -> None:
    check_recovered(recover(40), 40)


@pytest.mark.slow
def test_truth_is_recovered_many_times() -> None:
    check_recovered(recover(400), 400)


def test_units_of_the_field() -> None:
    """N = 0.05 (deg/s)·√s is 0.05·60 = 3 deg/√h; Q = 0.02 deg is 72 arcsec; B = 0.04 deg/s is 144 deg/h."""
    draw = np.random.default_rng(2)
    values = simulated_noise.rate(draw, 2**15, INTERVAL, **TRUTH)
    plain, rate = estimate(values, INTERVAL), estimate(values, INTERVAL, "deg/s")
    for name, factor, text in (
        ("N", 60.0, "deg/sqrt(h)"),
        ("Q", 3600.0, "arcsec"),
        ("B", 3600.0, "deg/h"),
        ("K", 216_000.0, "deg/h/sqrt(h)"),
    ):
        assert rate[f"{name}_gyro"].value == pytest.approx(factor * plain[f"{name}_gyro"].value, rel=1e-9)
        assert rate[f"{name}_gyro"].unit == text
    assert plain["N_gyro"].unit == "pulse/sqrt(s)"
    acceleration = estimate(values, INTERVAL, "m/s^2")
    assert acceleration["N_gyro"].value == pytest.approx(60 * plain["N_gyro"].value, rel=1e-9)
    assert acceleration["B_gyro"].value == pytest.approx(plain["B_gyro"].value / 9.80665e-6, rel=1e-9)
    volts = estimate(values, INTERVAL, "V")
    assert [volts[f"{name}_gyro"].unit for name in "QNBK"] == ["V*s", "V*sqrt(s)", "V", "V/sqrt(s)"]


def test_what_is_not_there_is_bounded_not_invented() -> None:
    values = simulated_noise.rate(np.random.default_rng(9), 2**14, 1.0, N=1.0)
    found = estimate(values, 1.0)
    assert found["N_gyro"].value == pytest.approx(1.0, abs=4 * found["N_gyro"].standard_uncertainty)
    assert found["K_gyro"].value <= 3 * found["K_gyro"].standard_uncertainty
    assert any("K_gyro cannot be distinguished from zero" in note for note in found.notes)


def test_a_disturbance_that_no_noise_explains_is_said() -> None:
    draw = np.random.default_rng(4)
    values = simulated_noise.rate(draw, 2**14, 1.0, N=1.0) + 2 * np.sin(2 * np.pi * np.arange(2**14) / 200)
    found = estimate(values, 1.0)
    assert any("does not describe" in warning for warning in found.warnings)


def test_counts_that_alternate_are_an_observation() -> None:
    """Two averages of 1, 2, 1, 2 … are equal: an Allan variance of 0, which must not be left out of the fit."""
    found = estimate(np.array([100.0, 200.0] * 6 + [100.0]), 0.01)
    (noise,) = found.coefficients
    assert 0 <= noise.value < 7.07  # 70.7 pulse/s at 0.01 s alone
    assert 0 < noise.standard_uncertainty < 7.07


@pytest.mark.parametrize("counted", [False, True])
@pytest.mark.parametrize(("sigma", "samples"), [(0.1, 9), (0.3, 9), (0.5, 20), (1.0, 9), (0.2, 40)])
def test_chance_of_no_change_bounds_what_happens(counted: bool, sigma: float, samples: int) -> None:
    """Records of white noise, rounded to whole counts from anywhere in a count."""
    rng = np.random.default_rng(4)
    noise = sigma * rng.standard_normal((20_000, samples))
    mean = rng.uniform(size=(20_000, 1)) if counted else np.zeros((20_000, 1))
    shown = np.diff(np.floor(mean + np.cumsum(noise, axis=1)), prepend=np.floor(mean)) if counted else np.round(noise)
    unchanged = float(np.mean(np.ptp(shown, axis=1) == 0))
    rate = 50.0
    bound = NoiseModel(sigma / math.sqrt(rate), resolution=1.0, counted=counted).chance_of_no_change(
        samples / rate, rate
    )
    assert unchanged <= bound + 3 * math.sqrt(bound / 20_000)
    assert bound <= 1.0

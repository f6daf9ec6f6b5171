"""A drift in one segment and not in the others: named, because with few segments it goes into the coefficients."""

from __future__ import annotations

import math

import numpy as np
import pytest
from recorded import from_samples, segment, sensor

from planrunner.estimators.analysis import analyse
from planrunner.estimators.drifts_within import drift_within_words
from planrunner.estimators.interface import Estimate
from planrunner.estimators.scale_factor import ScaleFactorParameters
from planrunner.physics.earth import Site
from planrunner.plan.model import EstimateSpec
from planrunner.plan.schedule import Spin

Array = np.ndarray


def estimated(
    rates: tuple[float, ...],
    drifts: Array,
    seed: int = 1,
    keys: str = "residual",
    celsius: float | None = None,
    reading: float = 1e-3,
    thermometer: str | None = None,
    walk: float = 0.0,
) -> Estimate:
    """A gyro of 200 (pulse/s)/(deg/s), 60 s at each rate with noise of 0.5 pulse/s. `drifts`: of each segment, pulse/s². `celsius`:
    rise of a recorded temperature during the test, with noise of `reading` K. `thermometer`: the channel that the plan names; it
    has a constant temperature. `walk`: random walk of the output, pulse/s/√s."""
    draw, recording, offset = np.random.default_rng(seed), [], 0.0
    for number, (rate, drift) in enumerate(zip(rates, drifts, strict=True)):
        time = 70.0 * number + np.arange(6000) / 100
        values = 200.0 * rate + 3.0 + offset + drift * (time - time[0]) + 0.5 * draw.standard_normal(6000)
        values += walk * 0.1 * np.cumsum(draw.standard_normal(6000))
        channels, units = {"gyro_z": values}, {"gyro_z": "pulse/s"}
        if celsius is not None:
            channels["heat"] = 20.0 + celsius * time / 500 + reading * draw.standard_normal(6000)
            units["heat"] = "degC"
        if thermometer is not None:
            channels[thermometer] = 25.0 + 1e-3 * draw.standard_normal(6000)
            units[thermometer] = "degC"
        planned = segment(f"R{number}", np.eye(3), Spin(math.radians(rate), (0.0, 0.0, 1.0)), 60.0)
        recording.append(from_samples(planned, time, channels, units))
    parameters = ScaleFactorParameters(outputs=("gyro_z",), uncertainty=keys, temperature_channel=thermometer)
    spec = EstimateSpec(estimator="scale_factor", parameters=parameters)
    results = analyse({"k": spec}, (), recording, Site(0.8, 9.8, earth_rate=0.0), sensor("gyro_z"))
    assert not results.failures
    return results.estimates["k"]


def named(found: Estimate) -> list[str]:
    return [text for text in found.warnings if "in a way that the other segments do not show" in text]


def test_a_drift_in_one_of_two_positions_is_named() -> None:
    """Up and down: a drift of 0.044 pulse/s² in one of them makes the scale factor 1.1 % too small, and there are no residuals."""
    rates, drift = (0.3, -0.3), 0.044
    found = estimated(rates, np.array([0.0, drift]), keys="within_segment")
    wrong = found["K_gyro_z"].value / 200 - 1
    assert wrong == pytest.approx(-drift * 30 / (200 * 0.6), abs=2e-4)  # −1.1 %
    assert abs(wrong) * 200 > 20 * found["K_gyro_z"].standard_uncertainty
    [text] = named(found)
    assert "'R1'" in text
    size = float(text.split(": by ")[1].split()[0])
    assert size == pytest.approx(60 * drift, rel=0.05)


@pytest.mark.parametrize("row", [0, 3, 7])
def test_one_of_eight_segments_is_named(row: int) -> None:
    drifts = np.zeros(8)
    drifts[row] = -0.02
    [text] = named(estimated((5.0, -5.0, 1.0, -1.0, 20.0, -20.0, 2.0, -2.0), drifts))
    assert f"'R{row}'" in text


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_a_drift_of_the_whole_test_are_not_named(seed: int) -> None:
    for rates in ((5.0, -5.0), (5.0, -5.0, 1.0, -1.0, 20.0, -20.0)):
        for drift in (0.0, 0.05):
            assert not named(estimated(rates, np.full(len(rates), drift), seed, "within_segment"))


def test_a_temperature_that_changes_is_not_named() -> None:
    """The rates then follow the temperature, which `drift: temperature` describes."""
    rates = (5.0, -5.0, 1.0, -1.0, 20.0, -20.0)
    drifts = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert named(estimated(rates, drifts, celsius=0.0))
    assert not named(estimated(rates, drifts, celsius=8.0))


@pytest.mark.parametrize("walk", [0.06, 0.3])
@pytest.mark.parametrize("rates", [(5.0, -5.0), (5.0, -5.0, 1.0), (5.0, -5.0, 1.0, -1.0)])
def test_a_random_walk_is_not_named(rates: tuple[float, ...], walk: float) -> None:
    """Over a sixteenth of a segment, the smaller walk is 4.5 times as large as the noise. If the noise was taken as white, up to 17 of 40
    estimates had a warning."""
    quiet = np.zeros(len(rates))
    found = (estimated(rates, quiet, seed, "within_segment", walk=walk) for seed in range(40))
    assert sum(bool(named(one)) for one in found) <= 1


@pytest.mark.parametrize("reading", [0.2, 0.35, 2.0])
def test_the_noise_of_a_thermometer_is_no_change(reading: float) -> None:
    drifts = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert named(estimated((5.0, -5.0, 1.0, -1.0, 20.0, -20.0), drifts, celsius=0.0, reading=reading))


def test_only_the_named_thermometer_counts() -> None:
    drifts = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert named(estimated((5.0, -5.0, 1.0, -1.0, 20.0, -20.0), drifts, celsius=8.0, thermometer="own"))


def test_a_thermometer_without_readings() -> None:
    time, values = np.arange(600) / 10, np.random.default_rng(0).normal(size=600)
    one = from_samples(segment("A", np.eye(3)), time, {"gyro_z": values}, {"gyro_z": "pulse/s", "heat": "degC"})
    assert drift_within_words([one, one], (), sensor("gyro_z")) == ()

"""A thermometer with coarse counts: the uncertainties include rounding and cut-off readings, and a warning names the counts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from recorded import from_samples, segment
from test_flexure_gyro_static import SITE

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.analysis import analyse
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.interface import Estimate
from planrunner.estimators.temperature.parameters import TemperatureModelParameters
from planrunner.estimators.thermometer_counts import thermometer_counts
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.plan.kinds import Record
from planrunner.plan.model import EstimateSpec
from planrunner.plan.quantity import parse_quantity

Array = np.ndarray
Reading = Callable[[Array], Array]
HELD = (-30.3, -9.8, 10.4, 30.2, 50.6, 70.1, 50.3, 29.6, 9.7, -10.2)  # degC
BIAS, SLOPE = 0.05, 0.002  # deg/s at 25 degC, deg/s/K


def ramps(seconds: int = 1800) -> list[Array]:
    up = np.linspace(-30.3, 70.2, seconds)
    return [up, up[::-1], up, up[::-1]]


def held(draw: np.random.Generator, seconds: int = 400) -> list[Array]:
    return [one + 0.02 * draw.standard_normal(seconds) for one in HELD]


def recording(courses: Sequence[Array], read: Reading, draw: np.random.Generator) -> list[RecordedSegment]:
    """A gyro at rest whose bias follows the temperature courses, degC, sampled at 1 Hz."""
    found = []
    for number, course in enumerate(courses):
        time = 4000.0 * number + np.arange(len(course))
        values = BIAS + SLOPE * (course - 25) + 0.002 * draw.standard_normal(len(course))
        planned = segment(f"S{number}", np.eye(3), dwell=float(len(course)))
        channels = {"gyro_z": values, "temp": read(course)}
        found.append(from_samples(planned, time, channels, {"gyro_z": "deg/s", "temp": "degC"}))
    return found


def estimated(estimator: str, parameters: Record, made: list[RecordedSegment], resolution: float = 0.0) -> Estimate:
    outputs = (OutputModel("gyro_z", "deg/s"), OutputModel("temp", "degC", noise=NoiseModel(resolution=resolution)))
    spec = EstimateSpec(estimator=estimator, segments=("S*",), parameters=parameters)
    results = analyse({"t": spec}, (), made, replace(SITE, earth_rate=0.0), SensorModel("gyro", outputs, 1.0))
    assert not results.failures
    return results.estimates["t"]


def curve(courses: Sequence[Array], read: Reading, draw: np.random.Generator, resolution: float = 0.0) -> Estimate:
    parameters = TemperatureModelParameters(
        channels=("gyro_z",), temperature_channel="temp", reference=parse_quantity("25 degC"), order=1
    )
    return estimated("temperature_model", parameters, recording(courses, read, draw), resolution)


def named(found: Estimate) -> list[str]:
    return [text for text in found.warnings if "multiples of" in text]


@pytest.mark.parametrize("along", [True, False], ids=["ramps", "held temperatures"])
def test_cut_off_readings_are_named_and_within_the_uncertainty(along: bool) -> None:
    """Readings that are cut off to 1 K are 0.5 K too low, which no residual shows."""
    draw = np.random.default_rng(1)
    found = curve(ramps() if along else held(draw), np.floor, draw)
    away = abs(found["gyro_z_T0"].value - BIAS)
    assert away > 0.3 * SLOPE  # otherwise there is nothing to find
    assert away < 2 * found["gyro_z_T0"].standard_uncertainty < 0.9 * SLOPE
    assert abs(found["gyro_z_T1"].value - SLOPE) < 3 * found["gyro_z_T1"].standard_uncertainty
    [text] = named(found)
    assert "temp: all readings are multiples of 1 K" in text and "gyro_z_T0" in text


def test_a_fine_thermometer_changes_nothing() -> None:
    draw = np.random.default_rng(1)
    exact = curve(ramps(), lambda t: t, np.random.default_rng(2))
    assert not named(exact) and exact["gyro_z_T0"].standard_uncertainty < 0.05 * SLOPE
    assert not named(curve(held(draw), lambda t: t + 0.01 * draw.standard_normal(len(t)), draw))


def test_planned_temperatures_in_place_of_readings_show_no_count() -> None:
    """−40, −20, 0 … degC are multiples of 20 K, but these are setpoints."""
    draw = np.random.default_rng(1)
    courses = [np.full(400, celsius) for celsius in (-40.0, -20.0, 0.0, 20.0, 40.0, 60.0)]
    assert not named(curve(courses, lambda t: t, draw))


def test_a_declared_resolution_means_rounded_readings() -> None:
    draw = np.random.default_rng(3)
    found = curve(held(draw), np.round, draw, resolution=1.0)
    assert not named(found)
    assert abs(found["gyro_z_T0"].value - BIAS) < 2 * found["gyro_z_T0"].standard_uncertainty < 0.5 * SLOPE
    lines = {line.quantity: line.added for line in found.budgets[0].lines}
    assert lines["counts temp"] is False  # the scatter of the residuals contains it


@pytest.mark.parametrize("basis", ["residual", "within_segment"])
def test_the_error_model_includes_the_counts(basis: str) -> None:
    """Without the counts, the bias was 22 standard uncertainties away for `within_segment`."""
    draw = np.random.default_rng(4)
    parameters = ErrorModelParameters(
        outputs={"gyro_z": ("gyro_bias", "gyro_bias_temperature")}, temperature_channel="temp", uncertainty=basis
    )
    found = estimated("error_model", parameters, recording(held(draw), np.floor, draw))
    assert abs(found["gyro_bias_z"].value - BIAS) > 0.3 * SLOPE
    for name, true in (("gyro_bias_z", BIAS), ("gyro_bias_temperature_c1_z", SLOPE)):
        assert abs(found[name].value - true) < 2.5 * found[name].standard_uncertainty
    assert found["gyro_bias_z"].standard_uncertainty < 0.6 * SLOPE
    assert len(named(found)) == 1


@pytest.mark.parametrize("offset", [0.0, 0.05], ids=["counts from 0 K", "counts from 0 degC"])
def test_the_readings_of_a_thermometer_in_kelvin_are_not_mixed_up(offset: float) -> None:
    """Readings of 0.1 K from 293.1 K to 293.6 K lie in the middle between multiples of 0.1 degC, or the reverse."""
    kelvin = [293.1 + offset + 0.1 * k for k in range(6)]
    made = [
        from_samples(segment(f"S{k}"), 400.0 * k + np.arange(300), {"temp": np.full(300, one)}, {"temp": "K"})
        for k, one in enumerate(kelvin)
    ]
    model = SensorModel("gyro", (OutputModel("temp", "K", noise=NoiseModel(resolution=0.1)),), 1.0)
    found = thermometer_counts(made, "temp", model)
    assert found is not None and found.groups.tolist() == np.eye(6).tolist()
    assert found.parts == tuple(f"{one - 273.15:.6g} degC in 'S{k}'" for k, one in enumerate(kelvin))

"""A thermometer with a wrong unit, a wrong sign or bad readings gives a warning; a warm, lagging or ovenised sensor gives none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from recorded import from_samples, segment, sensor
from test_flexure_gyro_static import SITE

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.analysis import analyse
from planrunner.estimators.declared_temperatures import thermometer_words
from planrunner.estimators.imu.imu_multi_position import ImuMultiPositionParameters
from planrunner.estimators.repeatability import RepeatabilityParameters
from planrunner.estimators.temperature.parameters import TemperatureModelParameters
from planrunner.observation.screening import screened
from planrunner.plan.kinds import Record
from planrunner.plan.model import EstimateSpec
from planrunner.plan.quantity import parse_quantity

CHAMBER = (20.0, -20.0, 60.0, 20.0)  # degC


def recording(
    read: Callable[[np.ndarray], np.ndarray], unit: str, planned: tuple[float | None, ...] = CHAMBER
) -> list[RecordedSegment]:
    """A gyro with a temperature coefficient of 0.001 deg/s/K. `read`: the number that is recorded at a temperature, degC. Where
    nothing is planned, the room has 22 degC."""
    draw, found = np.random.default_rng(4), []
    for number, plan in enumerate(planned):
        time = 100.0 * number + np.arange(200) / 10
        true = (22.0 if plan is None else plan) + 0.8 + 0.05 * draw.standard_normal(200)
        values = {"gyro_x": 0.001 * true + 0.01 * draw.standard_normal(200), "temp": read(true)}
        step = replace(
            segment(f"S{number}", np.eye(3), dwell=20.0), temperature=None if plan is None else plan + 273.15
        )
        found.append(from_samples(step, time, values, {"gyro_x": "deg/s", "temp": unit}))
    return found


def words(
    read: Callable[[np.ndarray], np.ndarray],
    unit: str,
    planned: tuple[float | None, ...] = CHAMBER,
    parameters: Record | None = None,
) -> tuple[str, ...]:
    return thermometer_words(recording(read, unit, planned), parameters or ImuMultiPositionParameters())


@pytest.mark.parametrize(
    ("read", "declared", "true"),
    [
        (lambda t: t + 273.15, "degC", "K"),
        (lambda t: 1.8 * t + 32, "degC", "degF"),
        (lambda t: t, "K", "degC"),
    ],
)
def test_a_wrong_unit_is_named(read: Callable[[np.ndarray], np.ndarray], declared: str, true: str) -> None:
    [text] = words(read, declared)
    assert f"temp is declared in {declared}, but its samples agree with {true}." in text


@pytest.mark.parametrize(
    ("read", "declared", "true"), [(lambda t: t + 273.15, "degC", "K"), (lambda t: t, "K", "degC")]
)
def test_kelvin_and_celsius_are_distinguished_without_planned_temperatures(
    read: Callable[[np.ndarray], np.ndarray], declared: str, true: str
) -> None:
    [text] = words(read, declared, (None, None, None))
    assert f"temp is declared in {declared}, but its samples agree with {true}." in text


def test_the_estimate_of_a_temperature_model_has_the_warning() -> None:
    """The fitted constant refers to 20 degC; with readings in kelvin, it is that at −253 degC."""
    parameters = TemperatureModelParameters(
        channels=("gyro_x",), temperature_channel="temp", reference=parse_quantity("20 degC"), order=1
    )
    spec = {"t": EstimateSpec(estimator="temperature_model", segments=("S*",), parameters=parameters)}
    warned = {}
    for name, read in {"right": lambda t: t, "kelvin": lambda t: t + 273.15}.items():
        results = analyse(spec, (), recording(read, "degC"), SITE, sensor("gyro_x", unit="deg/s"))
        assert not results.failures
        estimate = results.estimates["t"]
        warned[name] = [text for text in estimate.warnings if "samples agree with K" in text]
        if name == "kelvin":
            assert abs(estimate["gyro_x_T0"].value - 0.02) > 0.2
    assert not warned["right"] and len(warned["kelvin"]) == 1


def test_a_reversed_reading_contradicts_the_plan() -> None:
    [text] = words(lambda t: -t, "degC")
    assert "temp changes by -1 K for each kelvin" in text


RAMPS = ((20.0, 60.0), (60.0, -20.0), (-20.0, 20.0))  # degC


def along_ramps(
    read: Callable[[np.ndarray], np.ndarray], planned: bool, chamber: Callable[[np.ndarray], np.ndarray] | None = None
) -> list[RecordedSegment]:
    """Ramps of the chamber, which the sensor follows with a delay. `chamber`: reading of a second thermometer."""
    found, outputs = [], sensor("gyro_x", unit="deg/s")
    for number, (begin, end) in enumerate(RAMPS):
        time = 100.0 * number + np.arange(200) / 10
        air = np.linspace(begin, end, 200)
        true = np.concatenate([np.full(20, begin), air[:-20]])
        values = {"gyro_x": 0.001 * true, "temp": read(true)}
        if chamber is not None:
            values["chamber"] = chamber(air)
        step = segment(f"S{number}", np.eye(3), dwell=20.0)
        if planned:
            step = replace(step, kept_temperature=begin + 273.15, ramp_to=end + 273.15)
        found.append(
            from_samples(step, time, values, {name: "deg/s" if name == "gyro_x" else "degC" for name in values})
        )
    return list(screened(found, outputs))


def along_words(made: list[RecordedSegment]) -> tuple[str, ...]:
    return thermometer_words(made, TemperatureModelParameters(channels=("gyro_x",), temperature_channel="temp"))


def test_a_reversed_reading_contradicts_planned_ramps() -> None:
    """The mean temperatures of ramps hardly differ, but their ends do."""
    assert along_words(along_ramps(lambda t: t, True)) == ()
    [text] = along_words(along_ramps(lambda t: 40 - t, True))
    assert "temp changes by -" in text and "its sign" in text


def test_a_reversed_reading_contradicts_another_thermometer() -> None:
    """Nothing is planned; the chamber records its own temperature."""
    assert along_words(along_ramps(lambda t: t, False, lambda t: t)) == ()
    assert along_words(along_ramps(lambda t: 70 + 0.01 * t, False, lambda t: t)) == ()  # an oven
    [text] = along_words(along_ramps(lambda t: 40 - t, False, lambda t: t))
    assert "temp and chamber change in opposite directions" in text


def test_counts_and_failed_samples_are_no_temperatures() -> None:
    def failing(true: np.ndarray) -> np.ndarray:
        out = true.copy()
        if true.mean() > 50:
            out[40:60] = -273.0
        return out

    for read, label in ((lambda t: 16 * (t - 25), "S1"), (failing, "S2")):
        [text] = words(read, "degC")
        assert f"degC in '{label}'. No sensor has such a temperature" in text


def test_a_reading_far_from_the_plan_at_one_temperature_is_named() -> None:
    [text] = words(lambda t: t + 200, "degC", (20.0, 20.0))
    assert "temp differs from the planned temperatures by 201 K" in text


@pytest.mark.parametrize(
    ("read", "declared", "planned"),
    [
        (lambda t: t, "degC", CHAMBER),
        (lambda t: t + 273.15, "K", CHAMBER),
        (lambda t: 1.8 * t + 32, "degF", CHAMBER),
        (lambda t: t + 55, "degC", CHAMBER),  # heated by its own electronics
        (lambda t: 25 + 0.4 * (t - 25), "degC", CHAMBER),  # not yet soaked
        (lambda t: 70 + 0.01 * (t - 20), "degC", CHAMBER),  # an oven
        (lambda t: 48 + 0 * t, "degC", (20.0, 20.0)),
        (lambda t: 68 + 0 * t, "degC", (20.0, 20.0)),  # 68 could be degF, but also an oven
        (lambda t: t, "degC", (None, None)),
        (lambda t: 0 * t - 196, "degC", (None, -196.0)),  # liquid nitrogen
    ],
)
def test_what_a_sound_sensor_reads_gives_no_warning(
    read: Callable[[np.ndarray], np.ndarray], declared: str, planned: tuple[float | None, ...]
) -> None:
    assert words(read, declared, planned) == ()


def test_an_estimator_without_a_thermometer_gives_no_warning() -> None:
    assert words(lambda t: t + 273.15, "degC", parameters=RepeatabilityParameters()) == ()

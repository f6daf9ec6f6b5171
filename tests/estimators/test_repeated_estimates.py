"""Estimates of one plan that repeat each other: a warning if they scatter more than their uncertainties allow."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from recorded import from_samples, segment, sensor

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.estimators.analysis import analyse
from planrunner.estimators.interface import Estimate
from planrunner.estimators.repeatability import RepeatabilityParameters
from planrunner.estimators.repeated_estimates import with_scatter_words
from planrunner.estimators.scale_factor import ScaleFactorParameters
from planrunner.physics.earth import Site
from planrunner.plan.kinds import Record
from planrunner.plan.model import EstimateSpec
from planrunner.plan.schedule import Spin

SITE = Site(math.radians(47.0), 9.807, earth_rate=0.0)
RATES = (-60.0, -30.0, -10.0, 10.0, 30.0, 60.0)


def recorded(seed: int, scales: tuple[float, ...], degrees: tuple[float, ...] = ()) -> list[RecordedSegment]:
    """A rate table once per scale factor, each time at another temperature if `degrees` [°C] are given."""
    draw, found = np.random.default_rng(seed), []
    for turn, scale in enumerate(scales):
        for number, rate in enumerate(RATES):
            time = 1000.0 * turn + 20.0 * number + np.arange(1000) / 100
            values = scale * rate + 0.01 + 0.05 * draw.standard_normal(1000)
            planned = segment(f"T{turn}-{number}", np.eye(3), Spin(math.radians(rate), (0.0, 0.0, 1.0)), 10.0)
            if degrees:
                planned = replace(planned, temperature=273.15 + degrees[turn])
            found.append(from_samples(planned, time, {"gyro_z": values}, {"gyro_z": "deg/s"}))
    return found


def made(recording: list[RecordedSegment], turns: int, compared: bool = False) -> dict[str, Estimate]:
    own = ScaleFactorParameters(outputs=("gyro_z",))
    specs = {
        f"turn_{k}": EstimateSpec(estimator="scale_factor", segments=(f"T{k}-*",), parameters=own) for k in range(turns)
    }
    if compared:
        specs["scatter"] = EstimateSpec(
            estimator="repeatability",
            uses=tuple(specs),
            parameters=RepeatabilityParameters(coefficients=("K_gyro_z",)),
        )
    results = analyse(specs, (), recording, SITE, sensor("gyro_z", unit="deg/s"))
    assert not results.failures
    return dict(results.estimates)


def warned(one: Estimate) -> list[str]:
    return [text for text in one.warnings if "repeat each other" in text]


def test_repeats_that_scatter_more_than_their_uncertainties_are_named_with_the_ratio() -> None:
    found = made(recorded(1, (1.0, 1.01, 0.99)), 3)
    values = [one["K_gyro_z"] for one in found.values()]
    weights = np.array([1 / one.standard_uncertainty**2 for one in values])
    x = np.array([one.value for one in values])
    ratio = math.sqrt(float(weights @ (x - np.average(x, weights=weights)) ** 2) / 2)
    assert ratio > 10
    for one in found.values():
        [text] = warned(one)
        assert "turn_0, turn_1, turn_2" in text and f"K_gyro_z {ratio:.2g}" in text


def test_repeats_that_agree_give_no_warning() -> None:
    """At a significance level of 1 %, 2 of 200 plans are expected to have a warning; more than 8 have a probability of 0.0002."""
    assert sum(bool(warned(made(recorded(seed, (1.0,) * 4), 4)["turn_0"])) for seed in range(200)) <= 8


@pytest.mark.parametrize("degrees", [(20.0, 60.0), (20.0, 20.0)])
def test_estimates_at_other_temperatures_are_no_repeats(degrees: tuple[float, float]) -> None:
    found = made(recorded(2, (1.0, 1.02), degrees), 2)
    assert bool(warned(found["turn_0"])) == (degrees[0] == degrees[1])


@pytest.mark.parametrize("kelvin", [(293.15, 333.15), (293.15, 293.15)])
def test_a_temperature_that_the_chamber_keeps_counts_as_stated(kelvin: tuple[float, float]) -> None:
    recording = [
        replace(one, segment=replace(one.segment, kept_temperature=kelvin[number // len(RATES)]))
        for number, one in enumerate(recorded(2, (1.0, 1.02)))
    ]
    assert bool(warned(made(recording, 2)["turn_0"])) == (kelvin[0] == kelvin[1])


class Weighted(Record):
    """Parameters of an estimator from elsewhere: an array cannot be compared as a whole."""

    weights: Array


def test_parameters_that_cannot_be_compared_do_not_prevent_the_analysis() -> None:
    recording = recorded(3, (1.0, 1.01))
    estimates = made(recording, 2)
    specs = {
        name: EstimateSpec(estimator="own", segments=(f"T{k}-*",), parameters=Weighted(weights=np.ones(3)))
        for k, name in enumerate(estimates)
    }
    with pytest.raises(ValueError, match="ambiguous"):
        _ = specs["turn_0"].parameters == specs["turn_1"].parameters
    assert with_scatter_words(estimates, specs, recording) == estimates


def test_estimates_that_a_plan_compares_itself_are_left_to_it() -> None:
    found = made(recorded(3, (1.0, 1.01, 0.99)), 3, compared=True)
    assert not any(warned(one) for one in found.values())
    assert any("times as much as their standard uncertainties" in text for text in found["scatter"].warnings)


def test_estimates_of_overlapping_segments_are_no_repeats() -> None:
    own = ScaleFactorParameters(outputs=("gyro_z",))
    specs = {
        name: EstimateSpec(estimator="scale_factor", segments=labels, parameters=own)
        for name, labels in (("first", ("T0-*", "T1-*")), ("second", ("T1-*", "T2-*")))
    }
    results = analyse(specs, (), recorded(4, (1.0, 1.0, 1.01)), SITE, sensor("gyro_z", unit="deg/s"))
    assert not any(warned(one) for one in results.estimates.values())

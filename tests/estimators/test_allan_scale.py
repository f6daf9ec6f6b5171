"""Noise of an output in pulses, seen through its scale factor: by hand, by a coefficient of another estimate, and what cannot be meant."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import simulated_noise
from recorded import from_samples, segment, sensor

from planrunner.estimators.allan.allan_deviation import AllanDeviation, AllanDeviationParameters
from planrunner.estimators.interface import (
    Coefficient,
    Design,
    DesignRequest,
    Estimate,
    EstimateRequest,
    EstimationError,
    Foresight,
)
from planrunner.estimators.method import designed
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.quantity import parse_quantity

SITE = Site(math.radians(40.0))
VALUES = simulated_noise.rate(np.random.default_rng(2), 2**13, 0.1, N=1.0, B=0.1)
DRIFT = Estimate("drift", "other", (Coefficient("SF_Y", 0.2, "(deg/h)/(pulse/s)", 0.001, 7.0),), np.array([[1e-6]]))


def estimate(scale: object, uses: dict[str, Estimate] | None = None, unit: str = "pulse/s") -> Estimate:
    time = np.arange(VALUES.size) * 0.1
    recorded = from_samples(segment("rest"), time, {"gyro": VALUES}, {"gyro": unit})
    scales: dict[str, Any] = {} if scale is None else {"gyro": scale}
    parameters = AllanDeviationParameters(outputs=("gyro",), scale_factors=scales)
    return AllanDeviation().estimate(
        EstimateRequest("noise", (recorded,), parameters, SITE, sensor("gyro", unit=unit), uses=uses or {})
    )


@pytest.mark.parametrize(
    ("scale", "uses"),
    [
        (parse_quantity("0.2 (deg/h)/(pulse/s) ± 0.001 (deg/h)/(pulse/s)"), {}),
        (parse_quantity("5 (pulse/s)/(deg/h) ± 0.025 (pulse/s)/(deg/h)"), {}),
        ("drift.SF_Y", {"drift": DRIFT}),
    ],
    ids=["sensed per output", "output per sensed", "of an estimate"],
)
def test_pulses_become_a_rate(scale: object, uses: dict[str, Estimate]) -> None:
    """N in (pulse/s)·√s times 0.2 (deg/h)/(pulse/s) is (deg/h)·√s, and 1 (deg/h)·√s is 1/60 deg/√h; B in pulse/s times 0.2 is deg/h."""
    plain, found = estimate(None), estimate(scale, uses)
    assert found["N_gyro"].unit == "deg/sqrt(h)" and found["B_gyro"].unit == "deg/h"
    assert found["N_gyro"].value == pytest.approx(0.2 / 60 * plain["N_gyro"].value, rel=1e-9)
    assert found["B_gyro"].value == pytest.approx(0.2 * plain["B_gyro"].value, rel=1e-9)
    assert found["N_gyro"].standard_uncertainty == pytest.approx(0.2 / 60 * plain["N_gyro"].standard_uncertainty)
    (influence,) = found.influences
    index = [item.name for item in found.coefficients].index("N_gyro")
    own = influence.quantity.standard_uncertainty * abs(influence.sensitivities[index, 0])
    assert own == pytest.approx(0.005 * found["N_gyro"].value, rel=1e-9)
    assert influence.quantity.degrees_of_freedom == (7.0 if uses else math.inf)


def test_volts_become_an_acceleration() -> None:
    plain, found = estimate(None, unit="V"), estimate(parse_quantity("2 V/g"), unit="V")
    assert found["B_gyro"].unit == "ug"
    assert found["B_gyro"].value == pytest.approx(plain["B_gyro"].value / 2 * 1e6, rel=1e-9)
    assert not found.influences


@pytest.mark.parametrize(
    ("scale", "uses", "words"),
    [
        (parse_quantity("3 K"), {}, "to a rate or an acceleration"),
        (parse_quantity("0 (deg/h)/(pulse/s)"), {}, "cannot be a scale factor"),
        ("drift.SF_Y", {}, "uses: drift"),
        ("drift.SF_Z", {"drift": DRIFT}, "did you mean 'SF_Y'"),
    ],
)
def test_what_cannot_be_meant(scale: object, uses: dict[str, Estimate], words: str) -> None:
    with pytest.raises(EstimationError, match=words):
        estimate(scale, uses)


def test_an_output_that_is_not_analysed() -> None:
    parameters = AllanDeviationParameters(outputs=("gyro",), scale_factors={"gyr": parse_quantity("2 V/g")})
    recorded = from_samples(segment("rest"), np.arange(VALUES.size) * 0.1, {"gyro": VALUES}, {"gyro": "V"})
    with pytest.raises(EstimationError, match="did you mean 'gyro'"):
        AllanDeviation().estimate(EstimateRequest("noise", (recorded,), parameters, SITE, sensor("gyro", unit="V")))


def test_what_is_expected_is_in_the_same_unit() -> None:
    model = SensorModel("gyro", (OutputModel("gyro", "pulse/s", noise=NoiseModel(white=0.9)),), 10.0)
    parameters = AllanDeviationParameters(outputs=("gyro",), scale_factors={"gyro": "drift.SF_Y"})
    design = designed(
        AllanDeviation(),
        DesignRequest(
            "noise",
            (segment("rest", dwell=3600.0),),
            parameters,
            SITE,
            model,
            uses={"drift": Design((), foresight=lambda: Foresight(DRIFT.coefficients))},
        ),
    )
    assert design is not None
    (expected,) = design.predicted
    assert (expected.name, expected.unit) == ("N_gyro", "deg/sqrt(h)")
    assert expected.value == pytest.approx(0.9 * 0.2 / 60)

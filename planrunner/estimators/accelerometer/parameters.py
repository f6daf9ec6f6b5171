"""Declares the plan keys of the estimator `accelerometer_multi_position`."""

from __future__ import annotations

from planrunner.estimators.outputs_fit import uncertainty_basis
from planrunner.observation.drift import drift, thermometer
from planrunner.observation.flicker import drift_span
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, Record, key
from planrunner.plan.quantity import Quantity

TERMS = ("bias", "accel_x", "accel_y", "accel_z")


class AccelerometerMultiPositionParameters(Record):
    """Declares the plan keys of the estimator `accelerometer_multi_position`."""

    outputs: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=3),
        "The three accelerometer channels, for x, y and z.",
        ["accel_x", "accel_y", "accel_z"],
        default=("accel_x", "accel_y", "accel_z"),
    )
    reference: str = key(
        Choice(("orientation", "gravity_magnitude")),
        "Reference for the readings: gravity in known attitudes, or only its magnitude.",
        "gravity_magnitude",
        default="orientation",
    )
    terms: tuple[str, ...] = key(
        ListOf(Choice(TERMS), minimum=1),
        "Terms of each axis for the reference 'orientation'; leave out terms that the attitudes cannot determine.",
        ["bias", "accel_x", "accel_z"],
        default=TERMS,
    )
    uncertainty: str = uncertainty_basis("positions about the model", "positions")
    drift_span: Quantity = drift_span()
    drift: tuple[str, ...] = drift()
    temperature_channel: str | None = thermometer()

"""Describes the specification of a sensor: the limits of its constant errors. The limits are declared, or are the usual limits of
the sensor's grade.

A diagnosis compares its results with these limits. This comparison is necessary because the simulation fits biases and scale
factors. Therefore, even a very large bias or scale-factor error causes no gap between simulation and measurement. If the bench file
declares no limits, the usual limits of the sensor's grade apply.

Sources. navigation, tactical: P. D. Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems*, 2nd ed.,
2013, table 4.1 (biases; the range of a grade extends to the beginning of the next grade) and section 4.4.2 (scale factors and
cross-coupling of 100 to 1000 ppm, laser gyros below 100 ppm). consumer: data sheet PS-MPU-6000A-00, rev. 3.4, 2013, sections 6.1
and 6.2 (tolerances of zero-rate and zero-g output, sensitivity and cross-axis sensitivity). industrial: our judgement, between
tactical and consumer, for factory-calibrated MEMS units. Noise: Groves, table 4.2, and data sheets of quiet units (ADIS16475: 0.15
deg/√h; MPU-6000: 0.005 deg/s/√Hz, 400 µg/√Hz).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from planrunner.plan.kinds import Choice, Record, optional
from planrunner.plan.model import SymmetricKind
from planrunner.plan.quantity import Quantity, parse_symmetric


class Sense(Enum):
    """States the quantity that a sensor measures. The applicable limits depend on this quantity."""

    RATE = "angular rate"
    FORCE = "specific force"


SENSES: Mapping[str, Sense] = MappingProxyType(
    {
        "gyro_bias": Sense.RATE,
        "gyro_scale_factor": Sense.RATE,
        "gyro_misalignment": Sense.RATE,
        "accel_bias": Sense.FORCE,
        "accel_scale_factor": Sense.FORCE,
        "accel_misalignment": Sense.FORCE,
    }
)
"""Terms of the nominal model for which a specification has limits."""


@dataclass(frozen=True)
class Grade:
    """States the usual limits of one grade of sensors. `quietest`: smallest usual white noise. For a gyro, it is the angle random
    walk in deg/√h; for an accelerometer, it is the one-sided density in µg/√Hz. `usual`: the usual limits of the terms in `SENSES`,
    in the same order."""

    name: str
    quietest: Mapping[Sense, float]
    usual: tuple[str, ...]

    def limits(self) -> Mapping[str, Quantity]:
        """Maps each term of the nominal model to its upper limit."""
        read = {name: parse_symmetric(text) for name, text in zip(SENSES, self.usual, strict=True)}
        return {name: limit for name, limit in read.items() if limit is not None}


def _grade(name: str, walk: float, density: float, *usual: str) -> Grade:
    return Grade(name, MappingProxyType({Sense.RATE: walk, Sense.FORCE: density}), usual)


GRADES = (
    _grade("navigation", 0.0, 0.0, "±0.1 deg/h", "±0.01 %", "±0.06 deg", "±1 mg", "±0.1 %", "±0.06 deg"),
    _grade("tactical", 0.005, 5.0, "±100 deg/h", "±0.1 %", "±0.06 deg", "±10 mg", "±0.1 %", "±0.06 deg"),
    _grade("industrial", 0.05, 15.0, "±0.5 deg/s", "±1 %", "±0.5 deg", "±30 mg", "±1 %", "±0.5 deg"),
    _grade("consumer", 0.15, 60.0, "±20 deg/s", "±3 %", "±1.15 deg", "±80 mg", "±3 %", "±1.15 deg"),
)
"""The grades, from the tightest to the loosest limits."""
GRADE_NAMES = tuple(grade.name for grade in GRADES)


def grade_of(sense: Sense, noise: float) -> Grade:
    """Returns the lowest grade whose sensors usually have noise as low as `noise`. `noise`: the white noise in the unit of
    `Grade.quietest`."""
    return next(grade for grade in reversed(GRADES) if grade.quietest[sense] <= noise)


class Specification(Record):
    """Contains the limits of the constant errors of every axis, as the data sheet states them."""

    grade: str | None = optional(
        Choice(GRADE_NAMES),
        "Grade of the sensor; its usual limits apply to errors without a limit of their own. By default it follows from the noise.",
        "tactical",
    )
    gyro_bias: str | None = optional(SymmetricKind("angular rate"), "Limits of the bias of a gyro.", "±0.5 deg/s")
    gyro_scale_factor: str | None = optional(
        SymmetricKind("ratio"), "Limits of the scale-factor error of a gyro.", "±1 %"
    )
    gyro_misalignment: str | None = optional(
        SymmetricKind("angle"), "Limits of the misalignment of a gyro's input axis.", "±0.2 deg"
    )
    accel_bias: str | None = optional(
        SymmetricKind("acceleration"), "Limits of the bias of an accelerometer.", "±50 mg"
    )
    accel_scale_factor: str | None = optional(
        SymmetricKind("ratio"), "Limits of the scale-factor error of an accelerometer.", "±0.5 %"
    )
    accel_misalignment: str | None = optional(
        SymmetricKind("angle"), "Limits of the misalignment of an accelerometer's input axis.", "±0.2 deg"
    )

    def limits(self) -> Mapping[str, Quantity]:
        """Maps each term of the nominal model to its upper limit, which the key of the term states. Without this key, the usual
        limit of the grade applies."""
        usual = {name: limit for grade in GRADES if grade.name == self.grade for name, limit in grade.limits().items()}
        stated = {
            "gyro_bias": self.gyro_bias,
            "gyro_scale_factor": self.gyro_scale_factor,
            "gyro_misalignment": self.gyro_misalignment,
            "accel_bias": self.accel_bias,
            "accel_scale_factor": self.accel_scale_factor,
            "accel_misalignment": self.accel_misalignment,
        }
        read = {name: parse_symmetric(text) for name, text in stated.items() if text is not None}
        return usual | {name: limit for name, limit in read.items() if limit is not None}

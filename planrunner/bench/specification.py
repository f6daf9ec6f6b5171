"""The specification of a sensor: limits of its constant errors. A diagnosis compares its results with these limits."""

from __future__ import annotations

from collections.abc import Mapping

from planrunner.bench.grades import GRADE_NAMES, GRADES
from planrunner.plan.kinds import Choice, Record, optional
from planrunner.plan.model import SymmetricKind
from planrunner.plan.quantity import Quantity, parse_symmetric


class Specification(Record):
    """Limits of the constant errors of every axis, as the data sheet states them."""

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
        """Maps each term of the nominal model to its upper limit. This is the limit that the key of the term states; without it,
        the usual limit of the grade."""
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

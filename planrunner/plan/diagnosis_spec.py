"""What a plan says of its diagnosis: what the simulation fits, and which segments are held against it."""

from __future__ import annotations

from planrunner.plan.kinds import CHANNEL, Choice, ListOf, Record, key
from planrunner.plan.selection import Detection, SelectionKind

NOMINAL_TERMS = (
    "gyro_bias",
    "gyro_scale_factor",
    "gyro_misalignment",
    "earth_rate",
    "accel_bias",
    "accel_scale_factor",
    "accel_misalignment",
)
"""What a simulation can fit: a bias and a 3 by 3 matrix a triad, and the Earth rate that it knows."""


class DiagnosisSpec(Record):
    """How a recording of the plan is diagnosed."""

    nominal: tuple[str, ...] = key(
        ListOf(Choice(NOMINAL_TERMS)),
        "Terms that the simulation fits to the recording; a term that is left out is a candidate like any other effect.",
        ["accel_bias"],
        default=NOMINAL_TERMS,
    )
    outputs: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=1),
        "Outputs to analyse, such as those of one of two sensors in a recording; by default those of `sensor`.",
        ["bno_accel_x", "bno_accel_y", "bno_accel_z"],
        default_factory=tuple,
    )
    segments: tuple[str, ...] | Detection = key(
        SelectionKind(),
        "Labels of the segments to diagnose, with * and ?; or {detect: still} for a sensor tumbled by hand, whose orientation is unknown.",
        "P*",
        default=("*",),
    )

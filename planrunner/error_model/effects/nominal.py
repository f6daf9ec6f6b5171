"""Offers the terms bias, scale factor, misalignment and Earth rate as candidate effects, for nominal models that lack one of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import About, Actor, Column, Variant, on_stimulus, per_axis, single, whole
from planrunner.error_model.observed import Observed
from planrunner.plan.units import STANDARD_GRAVITY as G

DEG = 3.141592653589793 / 180


def felt(observed: Observed, kind: str) -> Array:
    """Returns the quantity that a triad measures, angular rate or specific force, shape (N, 3)."""
    return observed.omega if kind == "gyro" else observed.force


def bias(observed: Observed, kind: str) -> list[Column]:
    """Returns the columns of a constant bias, one column for each axis."""
    unit, factor = ("deg/s", DEG) if kind == "gyro" else ("mg", 1e-3 * G)
    one = observed.time * 0 + 1
    return per_axis(observed, kind, "bias", unit, factor, factor, one)


def scale_factor(observed: Observed, kind: str) -> list[Column]:
    """Returns the columns of the scale factor errors, one column for each axis. The output of an axis changes by k times its input."""
    columns = per_axis(observed, kind, "k", "ppm", 1e-6, 1e-3, felt(observed, kind))
    return [replace(column, along=column.axis) for column in columns]


def misalignment(observed: Observed, kind: str) -> list[Column]:
    """Returns the columns of the misalignments. The output of an axis changes by m times the input of another sensor axis. A triad
    has six amplitudes m. In unknown orientations, a triad has only three amplitudes, because only the sums of opposite
    misalignments can be determined."""
    return towards_others(observed, kind, "arcsec", 1e-3, inputs=True)


def towards_others(
    observed: Observed, kind: str, unit: str, magnitude: float, factor: Array | float = 1.0, inputs: bool = False
) -> list[Column]:
    """Returns columns that describe the response of each axis to the inputs of the other axes. Each column is such an input,
    multiplied by `factor`. `unit`: the unit of the amplitudes, which is arcsec or arcsec per SI unit of the factor. `inputs`: True
    if the columns are the unchanged inputs of the sensor (`Column.along`). `magnitude`: prior scale of the amplitudes, SI."""
    columns = []
    largest = 1.0 if isinstance(factor, float) else np.inf  # a component of the input axis, which is a unit vector
    for other in range(3):
        signature = felt(observed, kind)[:, other] * factor
        for column in per_axis(observed, kind, f"towards_{'xyz'[other]}", unit, DEG / 3600, magnitude, signature):
            own = column.axis
            if own is None or own == other:
                continue
            if observed.along is None:
                columns.append(replace(column, along=other if inputs else None, smallest=-largest, largest=largest))
            elif own < other:
                name = f"gamma_{'xyz'[own]}{'xyz'[other]}"  # the cosine of the angle between the two input axes
                columns.append(replace(column, name=name, axis=None, smallest=-largest, largest=largest))
    return columns


PARTS = {"bias": bias, "scale_factor": scale_factor, "misalignment": misalignment}
_SHOWN_BY = {
    "bias": "any segments",
    "scale_factor": "opposite inputs along the axis: turns in both directions, or the axis up and down",
    "misalignment": "inputs along the other axes: a turn about each of them, or each of them up and down",
}


def _about(kind: str, part: str) -> About:
    named, word = _ABOUT[part], _NAMES[kind]
    return replace(
        named, name=named.name.format(word), physics=named.physics.format(word), remedy=named.remedy.format()
    )


_NAMES = {"gyro": "gyro", "accel": "accelerometer"}
_ABOUT = {
    "bias": About(
        "{} bias",
        "The output of each {} contains a constant that is not among the fitted terms of the simulation.",
        Actor.SENSOR,
        "Correct the bias, or add it to `nominal` under `diagnosis` in the plan: {{found}}.",
    ),
    "scale_factor": About(
        "{} scale factor is wrong",
        "The output of each {} differs from its input by a constant factor that is not among the fitted terms of the simulation.",
        Actor.SENSOR,
        "Correct the scale factor, or add it to `nominal` under `diagnosis` in the plan: {{found}}.",
    ),
    "misalignment": About(
        "{} axes deviate from their declared directions",
        "Each {} responds to inputs along the other axes, because its input axis is tilted.",
        Actor.SENSOR,
        "Correct the misalignment, or add it to `nominal` under `diagnosis` in the plan: {{found}}.",
    ),
}


class _OfTriad:
    """One term of the nominal model (bias, scale factor or misalignment) of one triad."""

    stage = "sensor"

    def __init__(self, kind: str, part: str):
        self.id, self.kind, self.part = f"{kind}_{part}", kind, part
        self.shown_by = _SHOWN_BY[part]
        self.about = _about(kind, part)

    def variants(self, observed: Observed) -> list[Variant]:
        return single(PARTS[self.part](observed, self.kind))


class EarthRate:
    """Adds the Earth's rotation, if the nominal simulation omits it."""

    id, stage, in_every_world = "earth_rate", "stimulus", True
    shown_by = "orientations that differ in the angle between the axis and the Earth's axis"
    about = About(
        "simulation omits the rotation of the Earth",
        "The gyros measure the rotation of the Earth, which the simulation does not contain.",
        Actor.BOOKKEEPING,
        "Add `earth_rate` to `nominal` under `diagnosis` in the plan: {found}.",
    )

    def variants(self, observed: Observed) -> list[Variant]:
        parts = on_stimulus(observed, observed.earth_rate, None)
        return single([whole(parts)] if parts else [])


def gyro_bias() -> _OfTriad:
    return _OfTriad("gyro", "bias")


def gyro_scale_factor() -> _OfTriad:
    return _OfTriad("gyro", "scale_factor")


def gyro_misalignment() -> _OfTriad:
    return _OfTriad("gyro", "misalignment")


def accel_bias() -> _OfTriad:
    return _OfTriad("accel", "bias")


def accel_scale_factor() -> _OfTriad:
    return _OfTriad("accel", "scale_factor")


def accel_misalignment() -> _OfTriad:
    return _OfTriad("accel", "misalignment")

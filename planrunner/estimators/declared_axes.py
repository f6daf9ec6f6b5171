"""Checks whether outputs respond as declared: detects reversed and exchanged axes, left-handed triads, and wrong units.

An output is calibrated in its own unit against the true rate or specific force. The result is a row of ratios, which should be
close to one along the output's own axis, and close to zero along the other axes. A fit accepts any row. This module therefore
compares each row with the declaration.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.plan.units import DIMENSIONS, Unit, unit

LARGEST_DEVIATION = 0.2
"""A scale factor contradicts its declaration if it deviates from one by more than this value. Data sheets of uncalibrated MEMS
sensors state tolerances of the sensitivity of up to 10 or 20 %."""
_UNIT_MATCH = 0.1  # largest relative difference between a scale factor and the ratio of two units
_UNITS = {
    "angular rate": ("rad/s", "mrad/s", "deg/s", "deg/min", "deg/h", "rev/s", "rev/min"),
    "acceleration": ("m/s^2", "g", "mg", "ug"),
}
_AXES = "xyz"


@dataclass(frozen=True, slots=True)
class AxisResponse:
    """Contains the response of one output along each axis.

    `axis`: the declared axis (0, 1, 2). `unit`: the unit in which the output is recorded. `ratios`: for each axis along which the
    output was excited, the response in `unit` divided by the true value.
    """

    channel: str
    axis: int
    unit: Unit
    ratios: Mapping[int, float]

    @property
    def own(self) -> float:
        return self.ratios.get(self.axis, 0.0)

    @property
    def largest(self) -> int:
        """Returns the axis along which the response has the largest magnitude."""
        return max(self.ratios, key=lambda axis: abs(self.ratios[axis]))


def contradictions(rows: Sequence[AxisResponse]) -> list[Said]:
    """Returns warnings about outputs of one triad that contradict their declaration. Only outputs that were excited along their own
    axes are compared."""
    excited = [row for row in rows if row.axis in row.ratios and any(row.ratios.values())]
    reversed_ = [row for row in excited if row.largest == row.axis and row.own < 0]
    found = _all_reversed(reversed_[0].unit) if len(reversed_) == 3 else [_reversed(row) for row in reversed_]
    exchanged = [row for row in excited if row.largest != row.axis]
    found += [_exchanged(row) for row in exchanged]
    if len(reversed_) < 3 and (reversed_ or exchanged) and _left_handed(excited):
        found.append(
            said("The three input axes form a left-handed triad: one axis is reversed, or two channels are exchanged.")
        )
    return found + [text for row in excited if (text := _size(row))]


def against_nominal(factors: Iterable[tuple[str, float, float]]) -> list[Said]:
    """Returns a warning for each scale factor whose sign or size differs from the nominal value. Each factor is given as a tuple of
    its name, the value found, and the nominal value in the bench file. The nominal value must not be zero."""
    found = []
    for name, value, nominal in factors:
        ratio = value / nominal
        if ratio < 0:
            found.append(
                said(
                    "{name} has the opposite sign to its nominal value in the bench file: the output is reversed, or "
                    "the senses or labels of opposite states are exchanged.",
                    name=name,
                )
            )
        elif abs(ratio - 1) > LARGEST_DEVIATION:
            found.append(
                said(
                    "{name} is {ratio:.4g} times its nominal value in the bench file: check the nominal value, the "
                    "unit of the output and the planned states.",
                    name=name,
                    ratio=ratio,
                )
            )
    return found


def _all_reversed(own: Unit) -> list[Said]:
    if own.dimension == DIMENSIONS["acceleration"]:
        return [
            said(
                "All three accelerometers respond with the opposite sign: either the recording contains gravity "
                "instead of specific force (which points up at rest), or the labels of opposite positions are "
                "exchanged."
            )
        ]
    return [
        said(
            "All three gyros respond with the opposite sign: either the senses of the planned rotations are "
            "exchanged, or the sensor counts clockwise rates as positive."
        )
    ]


def _reversed(row: AxisResponse) -> Said:
    return said(
        "{output} responds along {axis} with the opposite sign (scale factor {factor:.5g}): its axis is reversed. Check its "
        "sign in the bench file, its mounting and the labels of opposite positions.",
        output=row.channel,
        axis=_AXES[row.axis],
        factor=row.own,
    )


def _exchanged(row: AxisResponse) -> Said:
    most = row.largest
    return said(
        "{output} responds mostly along {axis} ({response:.5g}; along {own} {factor:.5g}): channels, axes or positions are "
        "exchanged. Check the channels in the bench file and the orientations of the segments.",
        output=row.channel,
        axis=_AXES[most],
        response=row.ratios[most],
        own=_AXES[row.axis],
        factor=row.own,
    )


def _left_handed(rows: Sequence[AxisResponse]) -> bool:
    if len(rows) != 3 or any(len(row.ratios) < 3 for row in rows):
        return False
    placed = sorted(rows, key=lambda row: row.axis)
    return bool(np.linalg.det([[row.ratios[axis] for axis in range(3)] for row in placed]) < 0)


def _size(row: AxisResponse) -> Said | None:
    """Returns a warning if a scale factor is far from one; otherwise None."""
    size = math.hypot(*row.ratios.values())
    if abs(size - 1) <= LARGEST_DEVIATION:
        return None
    for dimension, texts in _UNITS.items():
        for other in (unit(text) for text in texts if row.unit.dimension == DIMENSIONS[dimension]):
            if other.factor != row.unit.factor and abs(size * other.factor / row.unit.factor - 1) <= _UNIT_MATCH:
                return said(
                    "{output} has a scale factor of {factor:.4g}: its samples agree with {other}, but the recording declares "
                    "{unit}. Correct its unit in the bench file.",
                    output=row.channel,
                    factor=size,
                    other=other.text,
                    unit=row.unit.text,
                )
    return said(
        "{output} has a scale factor of {factor:.4g}, far from 1: check its unit and its sensitivity in the bench file, and "
        "the planned states.",
        output=row.channel,
        factor=size,
    )

"""Declares the entries of a bench file that every real table has: the number and the sense of each axis in the controller, and the
tolerances within which a state counts as reached."""

from __future__ import annotations

import math
from dataclasses import dataclass

from planrunner.instruments.table_keys import AxesKind, AxisSpec, TableKeys
from planrunner.plan.kinds import Choice, Number, QuantityOf, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity


class WiredAxisSpec(AxisSpec):
    """Declares the bench-file keys of one axis of a real table."""

    number: int | None = optional(
        Number(1, 16, integer=True), "Number of the axis at the controller; by default its position in the list.", 1
    )
    zero: Quantity = key(
        QuantityOf("angle"),
        "Reading of the controller when the joint is at zero.",
        "12.5 deg",
        default=parse_quantity("0 deg"),
    )
    sense: str = key(
        Choice(("counterclockwise", "clockwise")),
        "Positive sense of the controller's angle, seen by an observer whom the axis points to.",
        "clockwise",
        default="counterclockwise",
    )


class WiredTableKeys(TableKeys):
    """Declares the bench-file keys of a real table, without the keys of the link to its controller."""

    axes: tuple[WiredAxisSpec, ...] = key(
        AxesKind(WiredAxisSpec),
        "The axes, outermost first, one to three.",
        [{"name": "table", "direction": "up", "max_rate": "400 deg/s", "max_acceleration": "200 deg/s^2"}],
    )
    position_tolerance: Quantity = key(
        QuantityOf("angle", "positive"),
        "An axis has reached its target if it is no farther away than this.",
        "10 arcsec",
        default=parse_quantity("0.01 deg"),
    )
    rate_tolerance: Quantity = key(
        QuantityOf("angular rate", "positive"),
        "A rate is reached if it differs from its target by no more than this.",
        "0.01 deg/s",
        default=parse_quantity("0.02 deg/s"),
    )
    tracking_error: Quantity = key(
        QuantityOf("angle", "positive"),
        "Following error at which the controller stops an axis, if it supports this.",
        "0.5 deg",
        default=parse_quantity("1 deg"),
    )


@dataclass(frozen=True, slots=True)
class CountedAxis:
    """An axis as its controller counts it.

    `number`: number that the controller gives to the axis. `zero`: reading [deg] of the controller at the joint angle zero.
    `sense`: 1 if the readings of the controller increase with the joint angle, −1 if they decrease.
    """

    number: int
    zero: float
    sense: int

    def reading(self, joint: float) -> float:
        """Converts a joint angle [rad] to a reading of the controller [deg]."""
        return self.zero + self.sense * math.degrees(joint)

    def joint(self, reading: float) -> float:
        return self.sense * math.radians(reading - self.zero)


def counted(keys: WiredTableKeys) -> tuple[CountedAxis, ...]:
    """Returns the axes as their controller counts them, the outermost first."""
    return tuple(
        CountedAxis(spec.number or place, math.degrees(spec.zero.value), -1 if spec.sense == "clockwise" else 1)
        for place, spec in enumerate(keys.axes, start=1)
    )

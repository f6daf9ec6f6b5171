"""Describes the protection of a bench: limits that its instruments enforce themselves, and that plans must not exceed.

Instruments that support limits receive them before the first move. planrunner also compares its own readings with these limits.
"""

from __future__ import annotations

import math
from dataclasses import replace

from planrunner.base.findings import Findings
from planrunner.instruments.interfaces import OwnLimits
from planrunner.instruments.models import ChamberModel, TableModel
from planrunner.plan.kinds import QuantityOf, Record, RecordOf, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity

SHORTEST_SILENCE, LONGEST_SILENCE = 5.0, 3600.0


class Protection(Record):
    """Limits of the bench. A limit that is not stated here comes from the keys of the instrument."""

    rate: Quantity | None = optional(
        QuantityOf("angular rate", "positive"), "Largest rate of any axis of the table.", "320 deg/s"
    )
    acceleration: Quantity | None = optional(
        QuantityOf("angular acceleration", "positive"), "Largest acceleration of any axis of the table.", "200 deg/s^2"
    )
    position_error: Quantity | None = optional(
        QuantityOf("angle", "positive"),
        "Following error at which the table and all its instruments are stopped.",
        "2 deg",
    )
    coldest: Quantity | None = optional(
        QuantityOf("temperature"), "Lowest permitted temperature of anything on the bench.", "-50 degC"
    )
    hottest: Quantity | None = optional(
        QuantityOf("temperature"), "Highest permitted temperature of anything on the bench.", "75 degC"
    )
    silence: Quantity = key(
        QuantityOf("time", "positive"),
        "Time without a sign of life from planrunner, from 5 s to 1 h. After this time the watchdog makes the "
        "bench safe; instruments that have a watchdog stop by themselves too.",
        "60 s",
        default=parse_quantity("60 s"),
    )


def _check(protection: Protection, log: Findings) -> None:
    if not SHORTEST_SILENCE <= protection.silence.value <= LONGEST_SILENCE:
        message = f"a silence of {protection.silence} is out of range"
        log.error("meaning-range", protection.at("silence"), message, "from 5 s to 1 h")
    coldest, hottest = protection.coldest, protection.hottest
    if coldest is not None and hottest is not None and coldest.value >= hottest.value:
        message = "the coldest temperature is not below the hottest"
        log.error("meaning-range", protection.at("coldest"), message, "exchange them")


PROTECTION = RecordOf(Protection, _check)


def kept_table(table: TableModel, protection: Protection) -> TableModel:
    """Returns the table with the limits that plans must observe. Each limit is the lower of two limits: the limit of the table and
    the limit of the protection."""
    rate = math.inf if protection.rate is None else protection.rate.value
    acceleration = math.inf if protection.acceleration is None else protection.acceleration.value
    axes = tuple(
        replace(
            axis,
            max_rate=min(axis.max_rate, rate),
            max_acceleration=min(axis.max_acceleration, acceleration),
        )
        for axis in table.axes
    )
    return replace(table, axes=axes)


def kept_chamber(chamber: ChamberModel, protection: Protection) -> ChamberModel:
    """Returns the chamber with the temperature range that plans must observe: its own range, narrowed to the range that the
    protection permits."""
    coldest, hottest = protection.coldest, protection.hottest
    return replace(
        chamber,
        lowest=chamber.lowest if coldest is None else max(chamber.lowest, coldest.value),
        highest=chamber.highest if hottest is None else min(chamber.highest, hottest.value),
    )


def own_limits(protection: Protection) -> OwnLimits:
    """Returns the limits of the protection that the instruments themselves must enforce."""

    def si(quantity: Quantity | None) -> float | None:
        return None if quantity is None else quantity.value

    return OwnLimits(
        si(protection.rate),
        si(protection.acceleration),
        si(protection.position_error),
        si(protection.coldest),
        si(protection.hottest),
        si(protection.silence),
    )

"""What a plan says of holding a state: readings that settle before a segment records, and that stay within limits while it does.

The readings are measured by the instruments themselves; `planrunner.plan.schedule` has the same in SI units.
"""

from __future__ import annotations

from planrunner.base.findings import Findings
from planrunner.plan.kinds import Choice, Number, QuantityOf, Record, RecordOf, key
from planrunner.plan.quantity import Quantity

READINGS = ("position_error", "rate_error", "temperature_error", "temperature_drift")


class Tolerated(Record):
    """Largest values of what the instruments read, on either side of zero."""

    position_error: Quantity | None = key(
        QuantityOf("angle", "positive"), "Following error of the table, on every axis.", "5 arcsec", default=None
    )
    rate_error: Quantity | None = key(
        QuantityOf("angular rate", "positive"),
        "Measured minus commanded rate, on every axis.",
        "0.002 deg/s",
        default=None,
    )
    temperature_error: Quantity | None = key(
        QuantityOf("temperature", "positive"),
        "Measured minus commanded temperature of the chamber.",
        "0.5 K",
        default=None,
    )
    temperature_drift: Quantity | None = key(
        QuantityOf("temperature rate", "positive"),
        "Rate at which the temperatures of the chamber and of the sensor change.",
        "0.1 K/min",
        default=None,
    )

    def stated(self) -> dict[str, Quantity]:
        """Reading → largest value, of those that are given."""
        return {name: getattr(self, name) for name in READINGS if getattr(self, name) is not None}


class Stability(Tolerated):
    """Waiting until readings have settled: each within its limit, for a while at a stretch."""

    for_: Quantity = key(
        QuantityOf("time", "positive"), "Time for which the readings must stay within their limits.", "30 s", name="for"
    )
    within: Quantity = key(
        QuantityOf("time", "positive"), "The run stops when they have not settled after this time.", "10 min"
    )


class Watch(Tolerated):
    """Limits on the readings while the segment records, and what happens when a limit is exceeded."""

    lost_frames: Quantity | None = key(
        QuantityOf("ratio", "not negative"), "Share of the sensor's frames that may be missing.", "0.1 %", default=None
    )
    corrupt_frames: Quantity | None = key(
        QuantityOf("ratio", "not negative"),
        "Share of the sensor's frames that may have a wrong checksum.",
        "0 %",
        default=None,
    )
    doubts: str = key(
        Choice(("limit", "note")),
        "How samples that the instrument marks as doubtful (status bits) are treated: as an exceeded limit, or noted only.",
        "note",
        default="limit",
    )
    retakes: int = key(
        Number(0, 10, integer=True),
        "How often a segment that exceeds a limit is recorded again before the run stops; its data are kept, with the "
        "reason.",
        2,
        default=0,
    )


def _check_difference(record: Tolerated, log: Findings) -> None:
    stated = record.temperature_error
    if stated is not None and stated.unit.offset:
        hint = f"write {stated.unit.from_si(stated.value):g} K"
        log.error("meaning-range", record.at("temperature_error"), f"{stated} is a temperature, not a difference", hint)


def _check_stability(stability: Stability, log: Findings) -> None:
    _check_difference(stability, log)
    if not stability.stated():
        hint = "add for example `temperature_drift: 0.1 K/min`, or write a time alone"
        log.error("meaning-stability", stability.origin.mark, "no reading is named that must settle", hint)
    if stability.within.value < stability.for_.value:
        message = f"{stability.within} is shorter than the {stability.for_} for which the readings must stay"
        log.error("meaning-stability", stability.at("within"), message, "make `within` longer")


STABILITY = RecordOf(Stability, _check_stability)
WATCH = RecordOf(Watch, _check_difference)

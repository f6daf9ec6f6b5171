"""Declares the check standard of a bench: a device that stays in the laboratory and is measured repeatedly. Its values show whether
the measurement process is in control (NIST/SEMATECH e-Handbook of Statistical Methods, 2.2; NIST SOP 17, NISTIR 7383)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from planrunner.base.findings import Findings
from planrunner.bench.calibration import LINE, parsed_day
from planrunner.plan.kinds import Choice, ListOf, MapOf, Number, QuantityOf, Record, RecordOf, Text, key, optional
from planrunner.plan.model import PERSON
from planrunner.plan.quantity import Quantity
from planrunner.plan.run_information import device_of
from planrunner.plan.segments import NAME

COEFFICIENT = rf"{NAME}\.[^ \x00-\x1f]{{1,60}}"
_PART = r"[A-Za-z0-9_.-]{1,80}"


class CheckedCoefficient(Record):
    """States how a coefficient of the check standard is compared. Without `reference`, the coefficient is compared with the mean of
    its own earlier values."""

    reference: Quantity | None = optional(
        QuantityOf(None, uncertain=True),
        "Reference value with its standard uncertainty, from a calibration of the check standard elsewhere.",
        "0.30 deg/h ± 0.02 deg/h",
    )
    repeatability: Quantity | None = optional(
        QuantityOf(None),
        "Standard deviation of repeated runs that the stated uncertainties do not include; without it, it is estimated from the earlier "
        "values.",
        "0.01 deg/h",
    )


class CheckStandardRule(Record):
    """The check standard of a bench. While the check standard is not in control, other plans do not run on the bench."""

    device: str = key(
        Text(LINE, "a serial number"), "Serial number of the check standard (`device_serial`).", "CS-01", fallback=""
    )
    plan: str = key(
        Text(rf"(\.\./){{0,4}}{_PART}(/{_PART}){{0,8}}", "a plan file relative to the bench file"),
        "The plan that measures the check standard, relative to the bench file. The name of this file "
        "identifies the runs of the check standard.",
        "check_standard.yaml",
        fallback="",
    )
    coefficients: dict[str, CheckedCoefficient] = key(
        MapOf(RecordOf(CheckedCoefficient), pattern=COEFFICIENT),
        "The coefficients that must be in control, each with its reference value or its repeatability, if stated.",
        {"drift.D_X_F": {"reference": "0.30 deg/h ± 0.02 deg/h"}},
        fallback={},
    )
    max_age: Quantity = key(
        QuantityOf("time", "positive"), "Largest permitted age of the newest run of the check standard.", "24 h"
    )
    values: int = key(
        Number(3, 1000, integer=True),
        "Number of values, from the first one on, that give the mean and the repeatability of the control chart.",
        20,
        default=10,
    )
    since: str | None = optional(
        Text(r"[0-9]{4}-[0-9]{2}-[0-9]{2}", "a date", 'write the date in quotes, for example "2026-03-01"'),
        "First day of the control chart, such as that of an accepted change of the bench.",
        "2026-03-01",
    )
    action: str = key(
        Choice(("refuse", "warn")),
        "What happens to other plans while the check standard is not in control.",
        "warn",
        default="refuse",
    )
    unreadable: str = key(
        Choice(("refuse", "warn")),
        "What happens if a folder in the archive is so damaged that its bench cannot be determined: `refuse` "
        "counts it as a possible run "
        "of this check standard, `warn` names it and does not use it.",
        "warn",
        default="refuse",
    )
    may_override: tuple[str, ...] = key(
        ListOf(Text(PERSON, "a person's name"), minimum=1),
        "Persons who may let a single run begin nevertheless; the run records who and why. Without this key, nobody may.",
        ["anna"],
        default_factory=tuple,
    )

    @property
    def plan_name(self) -> str:
        """Returns the name under which the archive lists the check standard's plan."""
        return Path(self.plan).stem

    def measured_by(self, plan_name: str, info: Mapping[str, object]) -> bool:
        """Returns True if a run with this plan and this run information measures the check standard itself."""
        return plan_name == self.plan_name and device_of(info) == self.device


def _check(rule: CheckStandardRule, log: Findings) -> None:
    if not rule.coefficients and "coefficients" not in rule.origin.broken and rule.origin.parts("coefficients"):
        hint = "add for example `drift.D_X_F: {}`"
        log.error("meaning-check-standard", rule.at("coefficients"), "the check standard has no coefficient", hint)
    if rule.since is not None and parsed_day(rule.since) is None:
        message = f"'{rule.since}' is not a calendar date"
        log.error("meaning-date", rule.at("since"), message, "write year-month-day, such as 2026-03-01")
    for one in rule.coefficients.values():
        spread, centre = one.repeatability, one.reference
        if spread is not None and spread.unit.offset:
            message = f"a repeatability is a difference between values, so it cannot be given in {spread.unit.text}"
            log.error("meaning-range", one.at("repeatability"), message, "write it in K")
        elif spread is not None and spread.value < 0:
            log.error(
                "meaning-range", one.at("repeatability"), "a repeatability cannot be negative", "write zero or more"
            )
        if spread is not None and centre is not None and spread.unit.dimension != centre.unit.dimension:
            message = f"the repeatability in {spread.unit.text} does not belong to a reference in {centre.unit.text}"
            log.error("meaning-dimension", one.at("repeatability"), message, f"write it in {centre.unit.text}")


CHECK_STANDARD = RecordOf(CheckStandardRule, _check)

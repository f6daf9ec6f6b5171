"""Describes the calibrations of the parts of a bench, checks their dates, and checks that they are valid on the day of a run. Also
describes the laboratory of the bench as calibration certificates name it (ISO/IEC 17025:2017, 7.8).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from datetime import date, timedelta

from planrunner.base.findings import Findings
from planrunner.plan.kinds import ListOf, Record, Text, key, optional

LINE = r"[^\x00-\x1f]{1,200}"
_DATE = r"[0-9]{4}-[0-9]{2}-[0-9]{2}"
SOON = timedelta(days=30)  # time before the due date from which `check` gives a reminder


class Calibration(Record):
    """States the calibration or survey from which uncertainties come, and the last day on which it is valid."""

    certificate: str = key(
        Text(LINE, "a certificate"), "Certificate or report that gives the values.", "RT-0042 / 2026-117"
    )
    date: str = key(
        Text(_DATE, "a date", "write for example 2026-03-01"), "Day of the calibration or survey.", "2026-03-01"
    )
    due: str | None = optional(
        Text(_DATE, "a date", "write for example 2027-03-01"),
        "Last day on which the calibration is valid.",
        "2027-03-01",
    )
    laboratory: str | None = optional(Text(LINE, "a laboratory"), "Who calibrated.", "accredited laboratory")

    @property
    def words(self) -> str:
        """Returns a text that names the certificate and the laboratory. Budgets show this text as the source of a stated
        uncertainty."""
        return self.certificate + (f" ({self.laboratory})" if self.laboratory else "")


def check_dates(calibration: Calibration, log: Findings) -> None:
    """Adds errors for dates that do not exist, and for a due date that precedes the calibration."""
    made, due = parsed_day(calibration.date), parsed_day(calibration.due)
    for name, stated, day in (("date", calibration.date, made), ("due", calibration.due, due)):
        if day is None and stated is not None:
            message = f"'{stated}' is not a calendar date"
            log.error("meaning-date", calibration.at(name), message, "write year-month-day, such as 2026-03-01")
    if made is not None and due is not None and due < made:
        message = f"the due date of the calibration, {due}, is before its date, {made}"
        log.error("meaning-date", calibration.at("due"), message, "compare both dates with the certificate")


def check_validity(calibrations: Iterable[tuple[str, Calibration]], today: date, seconds: float, log: Findings) -> None:
    """Adds findings for calibrations that are invalid on the day of a run or expire soon.

    `calibrations`: pairs of the name of an object and the object's calibration. `seconds`: planned duration of the run. Invalid
    dates are skipped; `check_dates` reports them.
    """
    lasts = math.ceil(seconds / 86400)  # days; added to today they may be beyond the calendar
    for what, calibration in calibrations:
        made, due = parsed_day(calibration.date), parsed_day(calibration.due)
        if made is not None and made > today:
            message = f"the calibration of {what} is dated {made}, which is after {today}"
            log.error(
                "bench-calibration-future",
                calibration.at("date"),
                message,
                "correct the date, or run on or after that date",
            )
        if due is None:
            continue
        if due < today:
            message = f"the calibration of {what} ({calibration.certificate}) expired on {due}; it is {today}"
            log.error(
                "bench-calibration-expired", calibration.at("due"), message, "have it calibrated before measuring"
            )
        elif (left := due - today) <= SOON or left.days < lasts:
            when = "expires during this run" if left.days < lasts else "expires soon"
            message = f"the calibration of {what} ({calibration.certificate}) {when}, on {due}"
            log.warning("bench-calibration-due", calibration.at("due"), message, "plan a recalibration")


def parsed_day(text: str | None) -> date | None:
    """Returns the calendar date that a text states; None if the text is not a date."""
    try:
        return date.fromisoformat(text) if text else None
    except ValueError:
        return None


class Laboratory(Record):
    """States the laboratory that is responsible for measurements on this bench; certificates need this record."""

    name: str = key(Text(LINE, "a name"), "Name of the laboratory.", "Inertial calibration laboratory")
    address: str = key(Text(LINE, "an address"), "Its address.", "1 Example Street, 00000 Example Town")
    location: str | None = optional(
        Text(LINE, "a place"),
        "Location of the bench if it differs from that address: another site, a customer's site, a mobile facility.",
        "Building 7, basement",
    )
    contact: str | None = optional(
        Text(LINE, "a contact"), "Telephone, e-mail or website of the laboratory.", "calibration@example.org"
    )
    accreditation: str | None = optional(
        Text(LINE, "an accreditation"), "Accreditation body, number and scope.", "accreditation body, no. 0000"
    )
    traceability: str | None = optional(
        Text(r"[^\x00-\x1f]{1,1000}", "a statement"),
        "Statement on the traceability of results to the SI; certificates show it in addition to the calibrations of instruments and site.",
        "Angles and rates through the table's calibration; Earth rate from the conventional value (WGS 84).",
    )
    authorised: tuple[str, ...] = key(
        ListOf(Text(LINE, "a name or role"), single=True),
        "Persons who may authorise certificates; by default any person that `issued_by` names.",
        ["head of laboratory", "deputy head of laboratory"],
        default_factory=tuple,
    )

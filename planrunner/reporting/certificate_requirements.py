"""Checks plan, bench and run information against the requirements of ISO/IEC 17025:2017 for calibration certificates.

`ASKED` lists, by name, the run information that certificates use. docs/certificates.md shows where each item appears on the page.

The module also lists the references to which the results of a bench are traceable: its instruments and its site, with their
calibrations.
"""

from __future__ import annotations

from collections.abc import Collection

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings
from planrunner.bench.calibration import Calibration
from planrunner.bench.model import Bench, driver_of
from planrunner.plan.model import Plan
from planrunner.plan.schedule import Schedule


@dataclass(frozen=True, slots=True)
class Reference:
    """Describes a reference to which the results on a certificate are traceable: an instrument of the bench, or the site of the
    bench. `calibration`: calibration of the instrument, or survey of the site; None if it is not stated."""

    name: str
    role: str
    asset: str = ""
    calibration: Calibration | None = None


def references(bench: Bench) -> tuple[Reference, ...]:
    """Returns the site and the instruments in the order of the bench file. The sensor is left out, because it is the device under
    test."""
    instruments = [
        Reference(name, driver_of(entry).role, entry.asset or "", entry.calibration)
        for name, entry in bench.instruments.items()
        if driver_of(entry).role != "sensor"
    ]
    return (Reference("site", "site", "", bench.site.survey), *instruments)


STANDARD = "ISO/IEC 17025:2017"


@dataclass(frozen=True, slots=True)
class CertificateItem:
    """An item of run information that a certificate shows. `required`: True if no certificate is written without it. `instead`:
    name of another item of run information that is accepted in place of this one."""

    name: str
    clause: str
    about: str
    required: bool = False
    instead: str = ""


ASKED = (
    CertificateItem("certificate_number", "7.8.2.1 d", "unique identification of the certificate", True),
    CertificateItem("customer", "7.8.2.1 e", "name of the customer", True),
    CertificateItem("customer_contact", "7.8.2.1 e", "contact information of the customer", True),
    CertificateItem("item_description", "7.8.2.1 g", "description of the item: kind, manufacturer, type", True),
    CertificateItem(
        "device_serial", "7.8.2.1 g", "unambiguous identification of the item", True, "item_identification"
    ),
    CertificateItem("date_received", "7.8.2.1 h", "date of receipt of the item", True),
    CertificateItem("issued_by", "7.8.2.1 o", "name of the person who authorises the certificate", True),
    CertificateItem(
        "item_identification", "7.8.2.1 g", "an identification instead of, or in addition to, `device_serial`"
    ),
    CertificateItem("item_condition", "7.8.2.1 g", "condition of the item as received"),
    CertificateItem("location", "7.8.2.1 c", "place of the calibration, if it differs from the bench file"),
    CertificateItem("method", "7.8.2.1 f", "a method reference in addition to the plan"),
    CertificateItem("date_issued", "7.8.2.1 j", "date of issue, if not today"),
    CertificateItem("sampling", "7.8.2.1 k", "sampling plan and method, if the laboratory took samples"),
    CertificateItem("deviations", "7.8.2.1 n", "additions to, deviations or exclusions from the method"),
    CertificateItem(
        "certified_estimates",
        "7.8.2.1 m",
        "names (in the plan) of the estimates that the certificate shows, if not all",
    ),
    CertificateItem("external_provider", "7.8.2.1 p", "provider of results that were not obtained by the laboratory"),
    CertificateItem("external_estimates", "7.8.2.1 p", "names (in the plan) of the estimates with these results"),
    CertificateItem("customer_information", "7.8.2.2", "information from the customer that can affect the results"),
    CertificateItem("adjustment", "7.8.4.1 d", "adjustment or repair that was made"),
    CertificateItem("agreed_interval", "7.8.4.3", "interval to the next calibration, only if agreed with the customer"),
    CertificateItem("specification", "7.8.6.2 b", "the specification that is the source of the plan's limits"),
    CertificateItem("opinions", "7.8.7", "opinions and interpretations"),
    CertificateItem("amends", "7.8.8", "number of the certificate that this one replaces"),
    CertificateItem("amendment_reason", "7.8.8.1", "what was changed, and why"),
)
DATES = ("date_received", "date_issued")


@dataclass(frozen=True, slots=True)
class Lack:
    """Missing information that a certificate requires. `remedy`: what to add, and where."""

    clause: str
    what: str
    remedy: str

    def __str__(self) -> str:
        return f"a certificate needs {self.what} ({STANDARD}, {self.clause})"


def is_certificate(report: str) -> bool:
    """Returns True if a report is a certificate in any language."""
    return report.partition(".")[0] == "certificate"


def room_condition(information: str) -> str | None:
    """Returns the condition of the room that an item of run information states, such as `pressure` for `ambient_pressure`; None if
    the item states no condition."""
    head, _, condition = information.partition("_")
    return condition if head == "ambient" and condition else None


def lacks_of_bench(bench: Bench, known: Collection[str], holds_temperature: bool) -> list[Lack]:
    """Returns the required information that the bench file lacks. `known`: names of the run information that is given, or that the
    plan requests. `holds_temperature`: True if the plan holds a temperature."""
    found = []
    if bench.laboratory is None:
        remedy = "add laboratory: {name: …, address: …} to the bench file"
        found.append(Lack("7.8.2.1 b", "name and address of the laboratory", remedy))
    if bench.ambient is None and not holds_temperature and not any(map(room_condition, known)):
        remedy = "add ambient: {temperature: …} to the bench file, or record ambient_temperature"
        found.append(Lack("7.8.4.1 b", "the conditions of the calibration", remedy))
    untraced = [item.name for item in references(bench) if item.calibration is None]
    if untraced and (bench.laboratory is None or bench.laboratory.traceability is None):
        remedy = "add calibration: to each instrument and survey: to site in the bench file, or laboratory: {traceability: …}"
        found.append(Lack("7.8.4.1 c", f"how {_list(untraced)} traceable", remedy))
    return found


def lacks_of_information(known: Collection[str], remedy: str) -> list[Lack]:
    """Returns the required run information that is not among the `known` names. `remedy`: a text in which {name} is replaced by the
    name of the missing item."""
    return [
        Lack(item.clause, f"'{item.name}': {item.about}", remedy.format(name=item.name))
        for item in ASKED
        if item.required and item.name not in known and item.instead not in known
    ]


def _list(names: list[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names)
    return f"{shown} {'is' if len(names) == 1 else 'are'}"


def check_certificate(
    plan: Plan, bench: Bench, schedule: Schedule | None, known: Collection[str], log: Findings
) -> None:
    """Adds an error for each piece of information that a certificate requires but could not show. The errors are placed at the first
    certificate in the plan's `report`. `known`: names of existing reports; unknown names are reported elsewhere."""
    places = [index for index, name in enumerate(plan.report) if is_certificate(name) and name in known]
    if not places:
        return
    required = {name for name, item in plan.record.items() if item.required}
    held = schedule is None or any(segment.temperature is not None for segment in schedule.segments)
    lacks = lacks_of_information(required, "add {name}: required under record: in the plan")
    for lack in [*lacks_of_bench(bench, set(plan.record), held), *lacks]:
        log.error("report-certificate-missing", plan.at(f"report[{places[0]}]"), str(lack), lack.remedy)

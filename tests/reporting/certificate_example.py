"""A made-up certificate on which everything is stated, for tests."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import reporting_example as example

from planrunner.reporting.certificate_names import CHAMBER_TEMPERATURE, of_reference, of_room
from planrunner.reporting.context import CertificateFacts, ReportContext, Traced

TOLD = {
    "certificate_number": "2026-0117",
    "customer": "The customer",
    "customer_contact": "2 Example Street",
    "item_description": "Flexure gyro, example type",
    "device_serial": "FG-0007",
    "item_identification": "asset 31",
    "item_condition": "No visible damage",
    "date_received": "2026-02-27",
    "location": "Hall 3 of the customer",
    "method": "Procedure 12, issue 4",
    "sampling": "One of a lot of ten, procedure 3",
    "deviations": "P8 was held for 3 min",
    "external_provider": "Another laboratory",
    "external_estimates": "traditional",
    "customer_information": "Nominal scale factor of the data sheet",
    "adjustment": "Torquer gain trimmed",
    "agreed_interval": "12 months",
    "specification": "Data sheet 7, issue 2",
    "opinions": "The drift is typical of the type",
    "amends": "2026-0099",
    "amendment_reason": "The customer's name was wrong",
    "issued_by": "N. N., head of laboratory",
}
FACTS = CertificateFacts(
    run="20260302T081109Z-eight-1a2b",
    laboratory={
        "name": "Example laboratory",
        "address": "1 Example Street, Example Town",
        "location": "Building 7",
        "contact": "calibration@example.org",
        "accreditation": "Accreditation body, no. 0000",
        "traceability": "Earth rate from the conventional value",
    },
    told=TOLD,
    corrected={"customer": "The costumer"},
    references=(
        Traced(of_reference("site", "site"), "", "survey 2026-1", "2026-02-10"),
        Traced(
            of_reference("table", "table"),
            "Maker, RT-3, RT-0042",
            "RT-0042 / 2026-117",
            "2026-03-01",
            "2027-03-01",
            "Accredited laboratory",
        ),
        Traced(of_reference("chamber", "chamber"), "Maker, TC-1"),
    ),
    conditions=((of_room("temperature"), "23 degC"), (CHAMBER_TEMPERATURE, "25 °C")),
    events=(
        ("truncated", "P3", "cut short"),
        ("rejected", "P5", "vibration"),
        ("fault", "", "the table did not answer"),
    ),
    performed=("2026-03-01", "2026-03-02"),
    issued="2026-03-05",
    plan_digest="9f2c4e" * 10 + "aabb",
    before={"drift": example.estimate(scale=2.0)},
    before_run="20260228T100000Z-eight-9f9f",
)


def context(**changes: Any) -> ReportContext:
    """The report's example with everything that a certificate states; changes: of the facts."""
    met, failed = example.context().limits
    met = replace(met, probability=0.9996, false_decision=0.0004, consumer_risk=0.012, producer_risk=0.034)
    failed = replace(failed, probability=0.42, false_decision=0.42)
    limits = tuple(
        replace(one, lower=-5.0, upper=5.0, guard_band=one.expanded_uncertainty, guard_factor=1.0)
        for one in (met, failed)
    )
    return example.context(limits=limits, certificate=replace(FACTS, **changes))

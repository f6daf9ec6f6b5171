"""The laboratory that a bench belongs to: what a calibration certificate says of who calibrates (ISO/IEC 17025:2017, 7.8)."""

from __future__ import annotations

from planrunner.plan.kinds import ListOf, Record, Text, key

LINE = r"[^\x00-\x1f]{1,200}"


class Laboratory(Record):
    """Who answers for what is measured on this bench; needed for certificates."""

    name: str = key(Text(LINE, "a name"), "Name of the laboratory.", "Inertial calibration laboratory")
    address: str = key(Text(LINE, "an address"), "Its address.", "1 Example Street, 00000 Example Town")
    location: str | None = key(
        Text(LINE, "a place"),
        "Location of the bench if it differs from that address: another site, a customer's site, a mobile facility.",
        "Building 7, basement",
        default=None,
    )
    contact: str | None = key(
        Text(LINE, "a contact"),
        "Telephone, e-mail or website of the laboratory.",
        "calibration@example.org",
        default=None,
    )
    accreditation: str | None = key(
        Text(LINE, "an accreditation"),
        "Accreditation body, number and scope.",
        "accreditation body, no. 0000",
        default=None,
    )
    traceability: str | None = key(
        Text(r"[^\x00-\x1f]{1,1000}", "a statement"),
        "How results are traceable to the SI, in addition to the calibrations of instruments and site.",
        "Angles and rates through the table's calibration; Earth rate from the conventional value (WGS 84).",
        default=None,
    )
    authorised: tuple[str, ...] = key(
        ListOf(Text(LINE, "a name or role"), single=True),
        "Persons who may authorise certificates; by default any person that `issued_by` names.",
        ["head of laboratory", "deputy head of laboratory"],
        default_factory=tuple,
    )

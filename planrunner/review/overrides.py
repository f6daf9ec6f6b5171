"""Makes and checks overrides of a check standard. An override is a signed statement by which a person permits runs to begin on a
bench although its check standard is not in control.

An override is a DSSE envelope with an in-toto Statement v1 and a predicate of planrunner's own. The statement names the bench by
the SHA-256 digest of its canonical meaning. The approvals that the bench requires are not part of this digest. If anything else in
the meaning of the bench changes, the override is no longer valid.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime, timedelta

from planrunner import __version__
from planrunner.archive.formats import to_bytes
from planrunner.archive.verifying import CLOCKS_DIFFER
from planrunner.base.documents import JsonObject
from planrunner.signing.envelope import (
    PAYLOAD,
    STATEMENT,
    Envelope,
    EnvelopeError,
    parse_envelope,
    payload_of,
    printable_line,
    read_statement,
    seal_envelope,
)
from planrunner.signing.key_ring import KeyRing
from planrunner.signing.keys import Signer

OVERRIDE = "urn:planrunner:check-standard-override:v1"


@dataclass(frozen=True, slots=True)
class Overridden:
    """The bench, the check standard and the reason that an override covers.

    `bench`: digest of the meaning of the bench. `device`: the check standard. `why`: the reason for the override. `until`: last day
    on which the override is valid.
    """

    bench: str
    device: str
    why: str
    until: date


@dataclass(frozen=True, slots=True)
class StatedOverride:
    """An override as a file states it. All values are claims of the signer until `objection` has checked them. `signed`: time of
    signing, UTC."""

    envelope: Envelope
    what: Overridden
    signed: datetime


def override_envelope(what: Overridden, signer: Signer, signed: datetime) -> Envelope:
    """Signs an override. `signed`: time of signing, UTC."""
    predicate = {
        "device": what.device,
        "why": what.why,
        "until": what.until.isoformat(),
        "signed": signed.isoformat(timespec="seconds"),
        "planrunner": __version__,
    }
    subject = [{"name": "bench", "digest": {"sha256": what.bench}}]
    made = {"_type": STATEMENT, "subject": subject, "predicateType": OVERRIDE, "predicate": predicate}
    return seal_envelope(PAYLOAD, payload_of(made), signer)


def read_override(data: bytes) -> StatedOverride | None:
    """Reads the override in a file; returns None if the file does not have the form of an override of planrunner. The signature is
    not checked here."""
    try:
        envelope = parse_envelope(data, PAYLOAD)
        statement = read_statement(envelope.payload, OVERRIDE)
        (subject,) = statement["subject"]
        told: JsonObject = statement["predicate"]
        signed = datetime.fromisoformat(told["signed"])
        if not all(printable_line(told[name]) for name in ("device", "why")) or signed.utcoffset() != timedelta(0):
            return None
        until = date.fromisoformat(told["until"])
        what = Overridden(subject["digest"]["sha256"], told["device"], told["why"], until)
        return StatedOverride(envelope, what, signed)
    except (EnvelopeError, ValueError, KeyError, TypeError, AttributeError):
        return None


def objection(
    one: StatedOverride, ring: KeyRing, by: str, what: Overridden, moment: datetime, day: date | None = None
) -> str:
    """Returns the reason why an override does not count; empty if it counts.

    `by`: the person who should have given the override, named as in the key ring. `what`: the present bench, check standard and
    reason, with which the override must agree; its `until` is ignored. `moment`: time for which the override is checked, with a
    time zone. `day`: date in the time zone of the bench; by default, the date of `moment`.
    """
    known, day = ring.find(one.envelope.key), day or moment.date()
    if known is None:
        return f"its key {one.envelope.key} is not in the key ring"
    if not one.envelope.signed_by(known.public):
        return "the signature does not match its content"
    if refused := known.objection(one.signed.date()) or known.objection(day):
        return refused
    if by not in (known.name, known.person):
        return f"it was signed by {known.person}, not by {by}"
    if one.signed > moment + CLOCKS_DIFFER:
        return f"it is dated {one.signed:%Y-%m-%d %H:%M} UTC, which is in the future"
    if day > one.what.until:
        return f"it was given until {one.what.until}"
    if one.what.bench != what.bench:
        return "it is for another bench, or for this bench before a change"
    if one.what.device != what.device:
        return f"it is for the check standard {one.what.device}"
    return "" if one.what.why == what.why else f"it states a different reason: {one.what.why}"


def kept_objection(
    given: JsonObject, ring: KeyRing, bench: str | None, device: str, moment: datetime, day: date
) -> str:
    """Does the same as `objection`, for an override that a run folder keeps with its signature. `bench`: digest of the meaning of
    the bench when the override was used; None to omit this comparison. `moment`, `day`: time and date at which the override was
    used."""
    stated = read_override(to_bytes(given["signature"]))
    if stated is None:
        return "it is damaged"
    what = Overridden(stated.what.bench if bench is None else bench, device, str(given["why"]), date.max)
    return objection(stated, ring, str(given["by"]), what, moment, day)

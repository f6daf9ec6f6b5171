"""Makes and checks approvals of plans. An approval is a signed statement that connects a reviewer's key with the meaning of a plan
and of the benches on which it may run.

An approval is a DSSE envelope with an in-toto Statement v1 and a predicate of planrunner's own. The subject of the statement is the
SHA-256 digest of the canonical meaning of the plan without its bench (`procedure_of`). The predicate names each bench by the digest
of the bench's meaning without the required approvals (`equipment_of`). A withdrawal is a statement of the same form that names
earlier approvals.

For every approval, `judged` determines whether the approval counts under the rule of a bench. If it does not count, `judged` states
the reason. The function reads no files and needs no private key.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import Literal

from planrunner import __version__
from planrunner.archive.formats import from_bytes
from planrunner.archive.verifying import CLOCKS_DIFFER
from planrunner.base.documents import Json, JsonObject
from planrunner.bench.signatures import ApprovalRule
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
from planrunner.signing.key_ring import KeyRing, KnownKey
from planrunner.signing.keys import Signer

APPROVAL = "urn:planrunner:approval:v1"
WITHDRAWAL = "urn:planrunner:approval-withdrawal:v1"
DECLARED = "I have reviewed this plan. It may run on the benches that are named here."
"""Default statement of an approval."""
_HEX = frozenset("0123456789abcdef")

ApprovalStanding = Literal[
    "counts",
    "damaged",
    "unknown key",
    "revoked",
    "key dates",
    "withdrawn",
    "future",
    "expired",
    "another plan",
    "another bench",
    "another author",
    "not named",
    "role",
    "author",
    "same person",
]
"""Standing of an approval: "counts", or the first reason why the approval does not count."""


@dataclass(frozen=True, slots=True)
class ApprovedBench:
    """Describes a bench for which an approval is valid: its name, and the digest of its meaning without the approvals that it
    requires."""

    name: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Approved:
    """The plan and the benches that an approval covers.

    `plan`: digest of the meaning of the plan without its bench. `title`, `author`: as the plan states them. `until`: last day on
    which the approval is valid; None if its validity is not limited.
    """

    plan: str
    title: str
    author: tuple[str, ...]
    benches: tuple[ApprovedBench, ...]
    until: date | None = None


@dataclass(frozen=True, slots=True)
class StatedApproval:
    """An approval as a file states it. `digest`: SHA-256 of the payload of its envelope. All values are claims of the signer until
    `judged` has checked them.

    `name`: name of the reviewer. `signed`: time of signing, UTC. `version`: version of planrunner that made the approval.
    """

    file: str
    digest: str
    envelope: Envelope
    what: Approved
    name: str
    statement: str
    signed: datetime
    version: str


@dataclass(frozen=True, slots=True)
class StatedWithdrawal:
    """Contains a withdrawal of approvals as a file states it. `withdrawn`: digests of the payloads of the approvals that it
    withdraws."""

    file: str
    envelope: Envelope
    withdrawn: frozenset[str]
    name: str
    statement: str
    signed: datetime


@dataclass(frozen=True, slots=True)
class DamagedApproval:
    """A file that is not in the format in which planrunner writes approvals."""

    file: str
    why: str


ApprovalRecord = StatedApproval | StatedWithdrawal | DamagedApproval


def approval_envelope(what: Approved, name: str, statement: str, signer: Signer, signed: str) -> Envelope:
    """Signs an approval. `signed`: time of signing, UTC in ISO 8601."""
    predicate = {
        "title": what.title,
        "author": list(what.author),
        "benches": [{"name": one.name, "sha256": one.sha256} for one in what.benches],
        "until": None if what.until is None else what.until.isoformat(),
        **_told(name, statement, signed),
    }
    return _signed(APPROVAL, {"plan": what.plan}, predicate, signer)


def withdrawal_envelope(withdrawn: Mapping[str, str], name: str, why: str, signer: Signer, signed: str) -> Envelope:
    """Signs the withdrawal of approvals. `withdrawn`: maps the file of each approval to the digest of the approval's payload."""
    return _signed(WITHDRAWAL, withdrawn, _told(name, why, signed), signer)


def _told(name: str, statement: str, signed: str) -> JsonObject:
    return {"name": name, "statement": statement, "signed": signed, "planrunner": __version__}


def _signed(kind: str, subjects: Mapping[str, str], predicate: JsonObject, signer: Signer) -> Envelope:
    subject = [{"name": name, "digest": {"sha256": value}} for name, value in subjects.items()]
    made = {"_type": STATEMENT, "subject": subject, "predicateType": kind, "predicate": predicate}
    return seal_envelope(PAYLOAD, payload_of(made), signer)


# -- reading ---------------------------------------------------------------------------------------------------------


def read_stated(file: str, data: bytes) -> ApprovalRecord:
    """Reads the approval or withdrawal in a file. The signature is not checked here."""
    try:
        envelope = parse_envelope(data, PAYLOAD)
    except EnvelopeError as error:
        return DamagedApproval(file, str(error))
    try:
        value = from_bytes(envelope.payload)
        kind = value["predicateType"] if isinstance(value, dict) else ""
        statement = read_statement(envelope.payload, WITHDRAWAL if kind == WITHDRAWAL else APPROVAL)
        return _withdrawal(file, envelope, statement) if kind == WITHDRAWAL else _approval(file, envelope, statement)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
        return DamagedApproval(file, "its content is not an approval of a plan")


def _approval(file: str, envelope: Envelope, statement: JsonObject) -> StatedApproval:
    told = statement["predicate"]
    _require_keys(told, "title", "author", "benches", "until", "name", "statement", "signed", "planrunner")
    (plan,) = _subjects(statement).items()
    if plan[0] != "plan":
        raise ValueError
    benches = tuple(ApprovedBench(_line(one["name"]), _digest(one["sha256"])) for one in told["benches"])
    if not benches or any(set(one) != {"name", "sha256"} for one in told["benches"]):
        raise ValueError
    until = None if told["until"] is None else _day(told["until"])
    what = Approved(plan[1], _line(told["title"]), tuple(map(_line, _list(told["author"]))), benches, until)
    return StatedApproval(
        file,
        payload_digest(envelope),
        envelope,
        what,
        _line(told["name"]),
        _line(told["statement"]),
        _moment(told["signed"]),
        _line(told["planrunner"]),
    )


def _withdrawal(file: str, envelope: Envelope, statement: JsonObject) -> StatedWithdrawal:
    told = statement["predicate"]
    _require_keys(told, "name", "statement", "signed", "planrunner")
    withdrawn = frozenset(_subjects(statement).values())
    if not withdrawn:
        raise ValueError
    return StatedWithdrawal(
        file, envelope, withdrawn, _line(told["name"]), _line(told["statement"]), _moment(told["signed"])
    )


def payload_digest(envelope: Envelope) -> str:
    """Returns the SHA-256 of the signed content of an approval. The digest identifies the approval independently of the approval's
    file."""
    return hashlib.sha256(envelope.payload).hexdigest()


def _require_keys(value: Json, *names: str) -> None:
    if not isinstance(value, dict) or set(value) != set(names):
        raise ValueError


def _subjects(statement: JsonObject) -> dict[str, str]:
    _require_keys(statement, "_type", "subject", "predicateType", "predicate")
    found: dict[str, str] = {}
    for one in statement["subject"]:
        _require_keys(one, "name", "digest")
        _require_keys(one["digest"], "sha256")
        if found.setdefault(_line(one["name"]), _digest(one["digest"]["sha256"])) != one["digest"]["sha256"]:
            raise ValueError
    return found


def _line(value: Json) -> str:
    if not isinstance(value, str) or not printable_line(value):
        raise ValueError
    return value


def _digest(value: Json) -> str:
    if not isinstance(value, str) or len(value) != 64 or not _HEX.issuperset(value):
        raise ValueError
    return value


def _list(value: Json) -> list[Json]:
    if not isinstance(value, list):
        raise ValueError
    return value


def _day(value: Json) -> date:
    found = date.fromisoformat(_line(value))
    if found.isoformat() != value:
        raise ValueError
    return found


def _moment(value: Json) -> datetime:
    found = datetime.fromisoformat(_line(value))
    if found.utcoffset() != timedelta(0):
        raise ValueError
    return found


# -- judging ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class JudgedApproval:
    """Contains an approval with the result of its check. `why`: the reason why the approval does not count, in words; empty if it
    counts. `key`: the signing key as the key ring lists it; None if the ring does not contain it."""

    stated: StatedApproval | DamagedApproval
    standing: ApprovalStanding
    why: str = ""
    key: KnownKey | None = None

    @property
    def person(self) -> str:
        return "" if self.key is None else self.key.person

    def to_json(self) -> JsonObject:
        """Returns JSON data according to schemas/approval.schema.json."""
        known = {
            "file": self.stated.file,
            "standing": self.standing,
            "why": self.why,
            "owner": "" if self.key is None else self.key.name,
            "person": self.person,
        }
        if isinstance(self.stated, DamagedApproval):
            return known
        one, what = self.stated, self.stated.what
        return known | {
            "digest": one.digest,
            "key": one.envelope.key,
            "name": one.name,
            "signed": one.signed.isoformat(),
            "until": None if what.until is None else what.until.isoformat(),
            "statement": one.statement,
            "plan": what.plan,
            "title": what.title,
            "author": list(what.author),
            "benches": [{"name": bench.name, "sha256": bench.sha256} for bench in what.benches],
            "planrunner": one.version,
        }


@dataclass(frozen=True, slots=True)
class ApprovalRequest:
    """States the plan, the bench and the time for which approvals are checked. `plan`, `bench`: digests of the meanings from
    `procedure_of` and `equipment_of`. `author`: the authors that the plan states.

    `moment`: time at which the plan is to run, with a time zone. `day`: the date at that time in the time zone of the bench.
    """

    plan: str
    bench: str
    author: tuple[str, ...]
    moment: datetime
    day: date


def judged(
    stated: Iterable[ApprovalRecord], rule: ApprovalRule, ring: KeyRing, asked: ApprovalRequest
) -> tuple[tuple[JudgedApproval, ...], bool]:
    """Checks every approval in the order of signing. Returns the results, and True if the rule of the bench is met.

    The rule is satisfied if the required number of persons have approved. If the rule excludes approvals by the author, the plan
    must state every author, and every author must be in the key ring.
    """
    files = list(stated)
    gone = set(rule.withdrawn) | _withdrawn(files, ring)
    found: list[JudgedApproval] = [
        JudgedApproval(one, "damaged", one.why) for one in files if isinstance(one, DamagedApproval)
    ]
    counted: set[str] = set()
    for one in sorted(
        (one for one in files if isinstance(one, StatedApproval)), key=lambda one: (one.signed, one.digest)
    ):
        known = ring.find(one.envelope.key)
        standing, why = _standing(one, known, rule, ring, asked, gone)
        if standing == "counts" and known is not None:
            if known.person in counted:
                standing, why = "same person", f"another approval of {known.person} counts already"
            counted.add(known.person)
        found.append(JudgedApproval(one, standing, why, known))
    independent = rule.author_may_approve or not unknown_authors(asked.author, ring)
    return tuple(found), independent and len(counted) >= rule.required


def unknown_authors(author: Sequence[str], ring: KeyRing) -> tuple[str, ...]:
    """Returns the authors that are not in the key ring. For these authors, it cannot be determined whether they approved the plan
    themselves. If the plan states no author, the result is one empty name."""
    return tuple(name for name in author if ring.person(name) is None) if author else ("",)


def _withdrawn(stated: Iterable[ApprovalRecord], ring: KeyRing) -> set[str]:
    """Returns the digests of the approvals that were withdrawn with the key that signed them."""
    files = list(stated)
    given = {one.digest: one.envelope.key for one in files if isinstance(one, StatedApproval)}
    found = set()
    for one in files:
        known = ring.find(one.envelope.key) if isinstance(one, StatedWithdrawal) else None
        if isinstance(one, StatedWithdrawal) and known is not None and one.envelope.signed_by(known.public):
            found |= {digest for digest in one.withdrawn if given.get(digest) == one.envelope.key}
    return found


def _standing(
    one: StatedApproval,
    known: KnownKey | None,
    rule: ApprovalRule,
    ring: KeyRing,
    asked: ApprovalRequest,
    gone: set[str],
) -> tuple[ApprovalStanding, str]:
    """Determines whether an approval counts and, if it does not, states the reason. The key and the signature are checked first,
    because without a valid signature, all other values are only claims."""
    what, day = one.what, asked.day
    if known is None:
        return "unknown key", f"its key {one.envelope.key} is not in the key ring"
    if not one.envelope.signed_by(known.public):
        return "damaged", "the signature does not match its content"
    if known.revoked is not None:
        return "revoked", known.objection(day)
    if objection := known.objection(one.signed.date()) or known.objection(day):
        return "key dates", objection
    if one.digest in gone:
        return "withdrawn", "it was withdrawn"
    if one.signed > asked.moment + CLOCKS_DIFFER:
        return "future", f"it is dated {one.signed:%Y-%m-%d %H:%M} UTC, which is in the future"
    if what.until is not None and day > what.until:
        return "expired", f"it was given until {what.until}"
    if what.plan != asked.plan:
        return "another plan", "it is for a plan with another meaning"
    if all(bench.sha256 != asked.bench for bench in what.benches):
        names = " and ".join(f"'{bench.name}' ({bench.sha256[:12]})" for bench in what.benches)
        return "another bench", f"it is for {names}, but this bench has the digest {asked.bench[:12]}"
    if what.author != asked.author:
        stated = [", ".join(names) or "nobody" for names in (what.author, asked.author)]
        return "another author", f"it is for a plan by {stated[0]}, but the plan names {stated[1]} as author"
    if rule.by and not {known.name, known.person} & set(rule.by):
        return "not named", f"the bench does not name {known.person} in `by`"
    if rule.roles and not set(known.roles) & set(rule.roles):
        has = f"has {', '.join(known.roles)}" if known.roles else "has no role"
        return "role", f"the key needs one of the roles {', '.join(rule.roles)}, but {has}"
    if not rule.author_may_approve and known.person in {ring.person(name) for name in asked.author}:
        return "author", f"{known.person} is an author of the plan"
    return "counts", ""

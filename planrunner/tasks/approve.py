"""Approves a plan for benches, withdraws approvals, and lists them.

prepared = prepare(plan, benches, until)
prepared.what            what would be signed; the reviewer must see it first
prepared.last            the newest approval of another version, and how that version differs from the plan
approve(prepared, signer, name, statement)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

from planrunner.archive.journal import utc_now
from planrunner.archive.storage import Storage
from planrunner.base.findings import COMMAND_LINE, InputError, Mark
from planrunner.bench.signatures import ApprovalRule
from planrunner.plan import source
from planrunner.plan.model import parse_plan
from planrunner.review.approval_files import approvals_folder, approved_text, read_approvals, write_envelope
from planrunner.review.approvals import (
    DECLARED,
    ApprovalRequest,
    Approved,
    ApprovedBench,
    JudgedApproval,
    StatedApproval,
    StatedWithdrawal,
    approval_envelope,
    judged,
    withdrawal_envelope,
)
from planrunner.review.compared import Compared
from planrunner.review.meaning import equipment_of, procedure_of
from planrunner.signing.envelope import require_line
from planrunner.signing.key_ring import KeyRing
from planrunner.signing.keys import Signer
from planrunner.tasks.approvals import ring_of
from planrunner.tasks.check import Document, Sound, check_plan
from planrunner.tasks.diff import compare_plans

_ANYBODY = ApprovalRule(keys="", author_may_approve=True)
"""Rule for benches that require no approvals."""


@dataclass(frozen=True, slots=True)
class PreparedApproval:
    """Contains what an approval states before it is signed. `sound`: the checked plan on each bench. `last`: the newest approval of
    a plan with another meaning, with the difference between that plan and the present one; None if there is no such approval or its
    text is not available."""

    plan: Path
    what: Approved
    sound: tuple[Sound, ...]
    last: tuple[StatedApproval, Compared] | None = None


@dataclass(frozen=True, slots=True)
class BenchApprovals:
    """Contains the approvals of a plan on one bench. `rule`: the bench's rule for approvals; None if the bench requires none.
    `met`: True if the approvals fulfil the rule."""

    bench: str
    rule: ApprovalRule | None
    approvals: tuple[JudgedApproval, ...]
    met: bool


def prepare(
    plan: Path, benches: Sequence[str] = (), until: date | None = None, *, foresee: bool = True
) -> PreparedApproval:
    """Prepares an approval of a plan. `benches`: names of shipped benches or bench files; by default, the bench that the plan
    names. `until`: last day on which the approval is valid.

    `foresee`: True to also determine the consequences of the difference between the plan and the last approved version. Raises
    `InputError` for a plan that does not pass its checks on every bench, and for a day in the past.
    """
    document = Document(source.read_bytes(plan), str(plan))
    sound = tuple(check_plan(document, bench).sound() for bench in benches or (None,))
    if until is not None and until < date.today():
        raise InputError.at(
            COMMAND_LINE, "approval-until", f"{until} is in the past", "give a later day, or leave it out"
        )
    named = [ApprovedBench(one.bench.name, equipment_of(one.bench).digest()) for one in sound]
    first = sound[0].plan
    what = Approved(procedure_of(first).digest(), first.title, first.author, tuple(dict.fromkeys(named)), until)
    return PreparedApproval(plan, what, sound, _last(plan, document, what, benches, foresee=foresee))


def _last(
    plan: Path, document: Document, what: Approved, benches: Sequence[str], *, foresee: bool
) -> tuple[StatedApproval, Compared] | None:
    folder = approvals_folder(plan)
    given = [one for one in read_approvals(folder) if isinstance(one, StatedApproval)]
    for one in sorted(given, key=lambda one: one.signed, reverse=True):
        text = approved_text(folder, one)
        if one.what.plan == what.plan or text is None:
            continue
        shown = str(folder / one.file)
        before, log = parse_plan(source.decode(text, shown), shown)
        if before is None or log.errors or procedure_of(before).digest() != one.what.plan:
            continue
        # Its bench is sought where that of the present plan is.
        beside = Document(text, str(plan.with_name(f"{plan.stem}, approved {one.signed:%Y-%m-%d}{plan.suffix}")))
        return one, compare_plans(beside, document, benches[0] if benches else None, foresee=foresee)
    return None


def approve(
    prepared: PreparedApproval, signer: Signer, name: str, statement: str = "", storage: Storage | None = None
) -> str:
    """Signs the prepared approval; returns the name of the new file. Raises `InputError` if the approval cannot be written."""
    require_line(str(prepared.plan), "name", name, 1)
    require_line(str(prepared.plan), "statement", statement)
    signed = utc_now()
    envelope = approval_envelope(prepared.what, name.strip(), statement.strip() or DECLARED, signer, signed)
    return write_envelope(prepared.plan, envelope, signed, prepared.sound[0].plan_bytes, storage)


def withdraw(plan: Path, signer: Signer, name: str, why: str, storage: Storage | None = None) -> tuple[str, int]:
    """Withdraws all approvals of a plan that were signed with this key; returns the name of the new file and the number of
    approvals withdrawn. Raises `InputError` if there is no such approval."""
    require_line(str(plan), "name", name, 1)
    require_line(str(plan), "statement", why, 1)
    stated = read_approvals(approvals_folder(plan))
    key, gone = signer.public, set[str]()
    for withdrawal in stated:
        if isinstance(withdrawal, StatedWithdrawal) and withdrawal.envelope.signed_by(key):
            gone |= withdrawal.withdrawn
    given = [one for one in stated if isinstance(one, StatedApproval) and one.envelope.signed_by(key)]
    ours = {one.file: one.digest for one in given if one.digest not in gone}
    if not ours:
        message = "there is no approval of this plan by this key, or all of them are withdrawn already"
        raise InputError.at(Mark(str(plan)), "approval-none", message, "`planrunner approve PLAN --list` lists them")
    signed = utc_now()
    envelope = withdrawal_envelope(ours, name.strip(), why.strip(), signer, signed)
    return write_envelope(plan, envelope, signed, storage=storage), len(ours)


def approvals_on(plan: Path, sound: Sound, ring: KeyRing | None = None) -> BenchApprovals:
    """Returns the approvals of a plan on a bench that are valid now. `ring`: the key ring to use instead of the ring that the bench
    names. Raises `InputError` if the approvals or the key ring cannot be read."""
    rule = sound.bench.approvals
    if ring is None:
        ring = KeyRing({}) if rule is None else ring_of(rule, Path(sound.bench.origin.mark.file)).ring
    now = datetime.now(UTC)
    digests = procedure_of(sound.plan).digest(), equipment_of(sound.bench).digest()
    asked = ApprovalRequest(*digests, sound.plan.author, now, now.astimezone().date())
    found, met = judged(read_approvals(approvals_folder(plan)), rule or _ANYBODY, ring, asked)
    return BenchApprovals(sound.bench.name, rule, found, met)

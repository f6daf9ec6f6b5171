"""Checks whether a plan has the approvals that a bench requires: before the plan runs, when a run is resumed, and after the run.
If a bench requires approvals, `planrunner.tasks.run` executes a plan only if enough approvals count.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from planrunner import __version__
from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal import NAME as JOURNAL
from planrunner.archive.journal_state import JournalState
from planrunner.archive.run_reader import RunReader
from planrunner.archive.verifying import APPROVALS, BENCH, PLAN, RUN, Examined
from planrunner.base.documents import JsonObject
from planrunner.base.findings import Findings, InputError, Mark, closest
from planrunner.bench.model import Bench, bench_of
from planrunner.bench.signatures import ApprovalRule
from planrunner.plan import source
from planrunner.plan.model import Plan, parse_plan
from planrunner.reporting.difference_tables import headline
from planrunner.review.approval_files import (
    KeptApprovals,
    approvals_folder,
    approved_text,
    entries_of,
    entry_of,
    keep,
    kept_approvals,
    read_approvals,
)
from planrunner.review.approvals import (
    ApprovalRecord,
    ApprovalRequest,
    ApprovalStanding,
    DamagedApproval,
    JudgedApproval,
    StatedApproval,
    StatedWithdrawal,
    judged,
    unknown_authors,
)
from planrunner.review.compared import Compared
from planrunner.review.difference import difference
from planrunner.review.meaning import equipment_of, meaning_of_plan, procedure_of
from planrunner.review.overrides import kept_objection
from planrunner.signing.key_ring import KeyRing, parse_ring


@dataclass(frozen=True, slots=True)
class RingFile:
    """Contains a key ring and the text of its file."""

    path: Path
    text: str
    ring: KeyRing


def ring_of(rule: ApprovalRule, bench_file: Path) -> RingFile:
    """Returns the key ring that a bench names. Raises `InputError` if the ring cannot be read, or if it lacks a person whom the
    rule names under `by`."""
    return _ring(rule, bench_file.parent / rule.keys)


def ring_of_run(rule: ApprovalRule, kept: KeptApprovals, bench_file: Path | None) -> RingFile:
    """Returns the key ring that verifies approvals when a run is continued. The ring is read from the file that the bench names,
    not from the run folder. `bench_file`: the bench file that replaces the bench file in the run folder; None if it is not
    replaced. Raises `InputError` like `ring_of`."""
    return _ring(rule, Path(kept.keys) if bench_file is None else bench_file.parent / rule.keys)


def _ring(rule: ApprovalRule, path: Path) -> RingFile:
    try:
        text = source.read_text(path)
        ring = parse_ring(text, str(path))
    except InputError as error:
        log = Findings(error.findings)
        message = f"the key ring {path} cannot be read, so no approval can be verified"
        log.error("approval-ring", rule.at("keys"), message, "correct `keys` or the key ring")
        raise InputError(log) from None
    log = Findings()
    names = [one.name for one in ring.keys.values()]
    for index, name in enumerate(rule.by):
        if ring.person(name) is None:
            message = f"'{name}' is not a name in the key ring"
            log.error("approval-person", rule.at(f"by[{index}]"), message, closest(name, names))
    if log.errors:
        raise InputError(log)
    return RingFile(path, text, ring)


@dataclass(frozen=True, slots=True)
class _Reason:
    """Describes the reason why an approval does not count, in the form in which a finding states it.

    `code`: code of the finding. `hint`: what to do. `key`: the violated key in the bench's rule for approvals; empty if the reason
    does not refer to the rule.
    """

    code: str
    hint: str
    key: str = ""


_AGAIN = "approve the plan again"
_REASONS: dict[ApprovalStanding, _Reason] = {
    "damaged": _Reason("approval-damaged", "restore the file from a backup, or approve the plan again"),
    "unknown key": _Reason("approval-unknown-key", "ask the keeper of the key ring to add the key", "keys"),
    "revoked": _Reason("approval-key-revoked", "approve with another key", "keys"),
    "key dates": _Reason("approval-key-dates", "approve with a key that is valid", "keys"),
    "withdrawn": _Reason("approval-withdrawn", "find out why it was withdrawn, then approve the plan again"),
    "future": _Reason(
        "approval-future", "check the clock of this computer, and that of the computer on which the plan was approved"
    ),
    "expired": _Reason("approval-expired", _AGAIN),
    "another plan": _Reason("approval-other-plan", _AGAIN),
    "another bench": _Reason("approval-other-bench", "approve the plan for this bench"),
    "another author": _Reason("approval-other-author", _AGAIN),
    "not named": _Reason("approval-not-named", "ask a person whom the bench names to approve the plan", "by"),
    "role": _Reason("approval-role", "ask a person with this role to approve the plan", "roles"),
    "author": _Reason("approval-by-author", "ask another person to approve the plan", "author_may_approve"),
    "same person": _Reason("approval-same-person", "ask another person to approve the plan", "required"),
}


def required_approvals(
    plan_file: Path, plan_bytes: bytes, plan: Plan, bench: Bench, moment: datetime, log: Findings
) -> KeptApprovals | None:
    """Returns the approval data that the run folder must keep. Returns None if the bench requires no approvals, or if approvals are
    missing; in the second case, findings give the reasons.

    The approvals are read from the folder of the plan file, and the key ring from the file that the bench file names. `moment`:
    time at which the plan is to run, with a time zone.
    """
    rule = bench.approvals
    if rule is None:
        return None
    folder = approvals_folder(plan_file)
    try:
        ring = ring_of(rule, Path(bench.origin.mark.file))
        procedure, equipment = procedure_of(plan), equipment_of(bench)
        stated = read_approvals(folder)
    except InputError as error:
        log.extend(error.findings)
        return None
    day = moment.astimezone().date()
    asked = ApprovalRequest(procedure.digest(), equipment.digest(), plan.author, moment, day)
    found, met = judged(stated, rule, ring.ring, asked)
    _require_authors(rule, plan, ring.ring, log)
    if not met:
        _tell(found, bench, rule, str(plan_file), log, _Differences(folder, plan, plan_bytes))
        return None
    counted = [one.stated for one in found if one.standing == "counts" and isinstance(one.stated, StatedApproval)]
    return keep(procedure, equipment, ring.text, day, counted, ring.path, folder)


def _require_authors(rule: ApprovalRule, plan: Plan, ring: KeyRing, log: Findings) -> None:
    unknown = () if rule.author_may_approve else unknown_authors(plan.author, ring)
    for name in unknown:
        what = f"the author '{name}' is not a name in the key ring" if name else "the plan does not state its author"
        message = f"{what}, so it cannot be determined whether other persons approved it, as this bench requires"
        hint = "write for example `author: carla` in the plan, with a name in the key ring"
        log.error("approval-author-unknown", plan.at("author"), message, hint)


@dataclass(frozen=True, slots=True)
class _Differences:
    """Describes how approved plans differ from the plan that is to run."""

    folder: Path
    plan: Plan
    data: bytes

    def words(self, approval: StatedApproval) -> str:
        """Describes how the approved plan differs from the present plan. The difference can be described only if the text of the
        approved plan is available and still has the approved meaning."""
        data = approved_text(self.folder, approval)
        if data is None:
            return ""
        try:
            other, _ = parse_plan(source.decode(data, approval.file), approval.file)
            if other is None or procedure_of(other).digest() != approval.what.plan:
                made = f"made with planrunner {approval.version}" if approval.version != __version__ else ""
                return f"the meaning of the approved plan cannot be restored{', ' if made else ''}{made}"
            meanings = meaning_of_plan(other), meaning_of_plan(self.plan)
        except InputError:
            return ""
        found = difference(*meanings)
        return headline(Compared("plan", (approval.file, ""), meanings, found)).rstrip(".")


def _tell(
    found: Sequence[JudgedApproval],
    bench: Bench,
    rule: ApprovalRule,
    plan: str,
    log: Findings,
    differences: _Differences | None = None,
    remedy: str = "",
) -> None:
    """Adds one error about missing approvals. Adds a further error for each signing key whose newest approval does not count,
    with the reason. `remedy`: text of the hint; by default, the advice to approve the plan."""
    persons = sorted({one.person for one in found if one.standing == "counts"})
    counted = (
        f"only the approval by {persons[0]} counts"
        if len(persons) == 1
        else f"only the approvals by {', '.join(persons)} count"
    )
    have = "there is none" if not found else "none of the existing approvals counts" if not persons else counted
    who = "one person" if rule.required == 1 else f"{rule.required} persons"
    message = f"the bench '{bench.name}' requires an approval of the plan by {who}; {have}"
    hint = remedy or f"approve the plan with `planrunner approve {plan}`; with --list, this command lists all approvals"
    log.error("approval-missing", bench.at("approvals"), message, hint)
    newest: dict[str, JudgedApproval] = {}
    for one in found:
        stated = one.stated
        newest[stated.envelope.key if isinstance(stated, StatedApproval) else stated.file] = one
    for one in newest.values():
        if one.standing == "counts":
            continue
        reason, name, why = _REASONS[one.standing], one.stated.file, one.why
        if isinstance(one.stated, StatedApproval):
            name = f"{one.stated.name}, {one.stated.signed:%Y-%m-%d}"
            told = differences.words(one.stated) if differences and one.standing == "another plan" else ""
            why = f"{why} ({told})" if told else why
        mark = rule.at(reason.key) if reason.key in rule.origin.keys else bench.at("approvals")
        log.error(reason.code, mark, f"the approval by {name} does not count: {why}", reason.hint)


# -- resuming ----------------------------------------------------------------------------------------------------------


def still_approved(
    reader: RunReader, plan: Plan, bench: Bench, bench_file: Path | None, further: Path | None = None
) -> tuple[JsonObject, ...]:
    """Returns the approvals that were added since the run began or was last continued, as entries for the journal of the run.
    Raises `InputError` if too few approvals count today.

    `bench_file`: the bench file that replaces the bench file in the run folder; None if it is not replaced. `further`: plan file;
    approvals that were given after the run began are read from the folder of this file. Without `further`, only the approvals
    that the run has already used can count. An approval does not count if it has expired or been withdrawn in the meantime, or if
    its key has been revoked.
    """
    rule = bench.approvals
    if rule is None:
        return ()
    if reader.approvals is None:
        message = f"the bench '{bench.name}' requires approvals, but this run began without any"
        raise InputError.at(bench.at("approvals"), "approval-missing", message, "approve the plan, then run it again")
    kept, damaged = kept_approvals(reader.approvals, reader.path)
    ring, own = ring_of_run(rule, kept, bench_file).ring, bench_of(reader.bench_bytes, str(reader.path / BENCH))
    withdrawals = [one for one in read_approvals(Path(kept.folder)) if isinstance(one, StatedWithdrawal)]
    before = [*kept.approvals, *(one for _, given in _renewals(reader.state) for one in given[0])]
    known = {one.digest for one in before}
    given = () if further is None else read_approvals(approvals_folder(further))
    withdrawals += [one for one in given if isinstance(one, StatedWithdrawal)]
    new = [one for one in given if isinstance(one, StatedApproval) and one.digest not in known]
    moment = datetime.now(UTC)
    day = moment.astimezone().date()
    asked = ApprovalRequest(procedure_of(plan).digest(), equipment_of(own).digest(), plan.author, moment, day)
    found, met = judged([*before, *new, *damaged, *withdrawals], rule, ring, asked)
    log = Findings()
    _require_authors(rule, plan, ring, log)
    if not met:
        _tell(
            found,
            bench,
            rule,
            "PLAN",
            log,
            remedy="ask reviewers to approve the plan again, then add `--approvals PLAN`",
        )
    if log.errors:
        raise InputError(log)
    counted = {
        one.stated.digest for one in found if one.standing == "counts" and isinstance(one.stated, StatedApproval)
    }
    return tuple(entry_of(one) for one in new if one.digest in counted)


def _renewals(
    state: JournalState,
) -> list[tuple[datetime, tuple[tuple[StatedApproval, ...], tuple[DamagedApproval, ...]]]]:
    """Returns one tuple for each time at which a run was continued with further approvals. Each tuple contains the time, these
    approvals, and the journal entries that cannot be read as approvals."""
    return [(datetime.fromisoformat(at), entries_of(given)) for at, given in state.renewals]


# -- afterwards --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RunApproval:
    """Describes an approval under which a plan ran. `verified`: True if the approval was verified with a key ring that the user
    gave. Otherwise, it was checked with the ring in the run folder, which proves nothing about the owner of the key."""

    judged: JudgedApproval
    verified: bool

    def words(self) -> str:
        """States in words who approved the plan, when, until when, and with which key."""
        stated = self.judged.stated
        if not isinstance(stated, StatedApproval):
            return stated.file
        until = "" if stated.what.until is None else f", until {stated.what.until}"
        return f"{stated.name}, {stated.signed.isoformat(timespec='seconds')}{until} ({stated.envelope.key})"


def run_approvals(found: Examined, ring: KeyRing | None) -> tuple[RunApproval, ...]:
    """Returns the approvals of a run, checked for the time at which the run began. Faults become findings. `ring`: the user's key
    ring; None to use the ring in the run folder."""
    path = found.folder.path
    if not {PLAN, BENCH} <= found.given.keys() or not found.run:
        return ()
    data = found.given.get(APPROVALS)
    try:
        bench = bench_of(found.given[BENCH], str(path / BENCH))
    except InputError as error:
        if data is not None:
            _unverified(found, f"the bench of this run cannot be read: {error.findings[0].message}")
        return ()
    rule = bench.approvals
    if data is None or rule is None:
        if rule is not None:
            message = f"{path / BENCH}: this bench requires approvals, but the run has none ({APPROVALS})"
            found.error("run-approval", message, hint="")
        elif "signature" in found.run.get("check_standard", {}).get("override", {}):
            message = (
                f"{path / RUN}: the run has a signed override, but its bench file names no key ring, so the signature cannot be "
                "verified"
            )
            found.error("run-approval", message, hint="")
        return ()
    try:
        kept, damaged = kept_approvals(data, path)
        known = parse_ring(kept.ring, f"{path / APPROVALS}: ring") if ring is None else ring
    except IntegrityError as error:
        found.error("run-approval", str(error), hint="")
        return ()
    except InputError as error:
        found.error("run-approval", f"{path / APPROVALS}: its key ring cannot be read: {error.findings[0].message}")
        return ()
    created = datetime.fromisoformat(str(found.run["created"]))
    if abs(kept.day - created.astimezone(UTC).date()) > timedelta(days=1):
        found.error("run-approval", f"{path / APPROVALS}: its day, {kept.day}, is not that of the run", hint="")
    _check_override(found, kept, known)
    author = _author(found, kept, bench)
    asked = ApprovalRequest(kept.plan_digest, kept.bench_digest, author, created, kept.day)
    stated: list[ApprovalRecord] = [*kept.approvals, *damaged]
    seen, met = judged(stated, rule, known, asked)
    renewals = [] if found.state is None else _renewals(found.state)
    outdated: tuple[ApprovalStanding, ...] = ("revoked",) if renewals else ()
    _tell_invalid(found, path / APPROVALS, seen, outdated, met=met or bool(renewals))
    for number, (at, (good, bad)) in enumerate(renewals, 1):
        stated += [*good, *bad]
        asked = replace(asked, moment=at, day=at.astimezone().date())
        again, met = judged(stated, rule, known, asked)
        last = number == len(renewals)
        outdated = ("expired", "key dates", "revoked", "same person")
        of_these = [one for one in again if one.stated in (*good, *bad)]
        _tell_invalid(found, path / JOURNAL, of_these, () if last else outdated, met=met or not last)
        seen = (*seen, *of_these)
    return tuple(RunApproval(one, ring is not None) for one in seen)


def _check_override(found: Examined, kept: KeptApprovals, ring: KeyRing) -> None:
    """Checks whether each signed override of the check standard was valid when it was used to begin or to continue the run."""
    begun = found.run.get("check_standard", {})
    created = datetime.fromisoformat(str(found.run["created"]))
    judged_then = [(RUN, created, kept.day, begun)]
    for at, standard in () if found.state is None else found.state.standards:
        if standard.get("override") != begun.get("override"):
            moment = datetime.fromisoformat(at)
            judged_then.append((JOURNAL, moment, moment.astimezone().date(), standard))
    for name, moment, day, standard in judged_then:
        if "signature" not in standard.get("override", {}):
            continue
        bench = kept.bench_digest if name == RUN else None  # it may have been continued on another connection
        refused = kept_objection(standard["override"], ring, bench, str(standard["device"]), moment, day)
        if refused:
            message = f"{found.folder.path / name}: the signed override of the check standard does not count: {refused}"
            found.error("run-approval", message, hint="")


def _tell_invalid(
    found: Examined, where: Path, seen: Sequence[JudgedApproval], outdated: Sequence[ApprovalStanding], *, met: bool
) -> None:
    """Reports approvals that do not count, except those that later approvals have replaced. `met`: True if enough approvals count."""
    why = "; ".join(f"{_name(one)}: {one.why}" for one in seen if one.standing not in ("counts", *outdated))
    if not met or why:
        lacking = "the approvals that the bench requires are not all valid"
        found.error("run-approval", f"{where}: {lacking}{': ' if why else ''}{why}", hint="")


def _author(found: Examined, kept: KeptApprovals, bench: Bench) -> tuple[str, ...]:
    """Returns the authors that the plan in the run folder states. Also checks that this plan and the bench have the meanings that
    were approved."""
    path = found.folder.path
    plan, _ = parse_plan(source.decode(found.given[PLAN], str(path / PLAN)), str(path / PLAN))
    if plan is None:
        _unverified(found, "the plan of this run cannot be read")
        return ()
    try:
        same = {
            PLAN: procedure_of(plan).digest() == kept.plan_digest,
            BENCH: equipment_of(bench).digest() == kept.bench_digest,
        }
    except InputError as error:
        _unverified(found, f"the meaning of the plan cannot be computed: {error.findings[0].message}")
        return plan.author
    other = [name for name, equal in same.items() if not equal]
    made = str(found.run["versions"]["planrunner"])
    if other and made != __version__:
        _unverified(
            found,
            f"{' and '.join(other)} ran with planrunner {made}, which writes canonical meanings in a different form",
        )
    elif other:
        message = f"{path / APPROVALS}: the approved meaning is not that of {' and '.join(other)}"
        found.error("run-approval", message, hint="")
    return plan.author


def _unverified(found: Examined, why: str) -> None:
    message = f"it was not verified that the plan of the run is the approved plan: {why}"
    hint = "verify with the version of planrunner, and the plug-ins, that made the run"
    found.findings.warning("run-approval-unverified", Mark(str(found.folder.path)), message, hint)


def _name(one: JudgedApproval) -> str:
    return one.stated.name if isinstance(one.stated, StatedApproval) else one.stated.file


def approved_by(reader: RunReader) -> Iterator[tuple[str, str]]:
    """Yields two texts for each approval in the run folder: the name of the person, and the description of the approval that
    reports print. The approvals were verified when the run began or was continued with further approvals."""
    if reader.approvals is None:
        return
    kept, _ = kept_approvals(reader.approvals, reader.path)
    ring = parse_ring(kept.ring, str(reader.path / APPROVALS))
    for one in [*kept.approvals, *(one for _, given in _renewals(reader.state) for one in given[0])]:
        judgement = JudgedApproval(one, "counts", key=ring.find(one.envelope.key))
        yield one.name, RunApproval(judgement, False).words()

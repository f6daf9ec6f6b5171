"""Checks the check standard of a bench before a run: determines its state from the archive, and whether the run may begin in this
state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

from planrunner.archive.formats import from_bytes
from planrunner.archive.run_reader import RunReader
from planrunner.archive.storage import Storage
from planrunner.archive.verifying import RUN
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import Finding, Findings, InputError, Mark, closest
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.base.progress import Announce
from planrunner.bench.check_standard import CheckStandardRule
from planrunner.bench.model import Bench, bench_of
from planrunner.night.history.check_standard import ControlStanding, ControlState, judge, state_in
from planrunner.night.history.rows import FaultRow
from planrunner.plan import source
from planrunner.review.approval_files import kept_approvals
from planrunner.review.meaning import equipment_of
from planrunner.review.overrides import (
    Overridden,
    StatedOverride,
    kept_objection,
    objection,
    override_envelope,
    read_override,
)
from planrunner.signing.envelope import require_line
from planrunner.signing.keys import Signer
from planrunner.tasks.approvals import ring_of, ring_of_run
from planrunner.tasks.history import Freshness, opened

CODE = "bench-check-standard"


@dataclass(frozen=True, slots=True)
class Override:
    """Records a person's decision that a run may begin although the check standard is not in control, and the reason for this
    decision."""

    by: str
    why: str


def override_file(bench_file: Path) -> Path:
    """Returns the path of the signed override for a bench, next to the bench file."""
    return bench_file.with_name(f"{bench_file.stem}.override.json")


def sign_override(bench: Bench, override: Override, until: date, signer: Signer) -> Path:
    """Signs an override of the check standard of a bench and writes it next to the bench file. The new override replaces an earlier
    one. Raises `InputError` if the override is not valid for runs now."""
    rule = bench.check_standard
    if rule is None or bench.approvals is None:
        message = f"bench '{bench.name}' needs `check_standard`, and `approvals` with a key ring, for a signed override"
        raise InputError.at(Mark(bench.origin.mark.file), "bench-check-override", message, "add them to the bench file")
    _require_named(bench, rule, override)
    require_line(rule.device, "reason", override.why, least=1)
    what = Overridden(equipment_of(bench).digest(), rule.device, override.why, until)
    now = datetime.now(UTC).replace(microsecond=0)
    envelope = override_envelope(what, signer, now)
    place = override_file(Path(bench.origin.mark.file))
    ring = ring_of(bench.approvals, place).ring
    if refused := objection(StatedOverride(envelope, what, now), ring, override.by, what, datetime.now().astimezone()):
        message = f"the override would not count: {refused}"
        raise InputError.at(
            Mark(str(place)), "bench-check-override", message, "sign with a key of this person, and choose a later day"
        )
    try:
        Storage().write_whole(GuardedFolder.open(place.parent), place.name, envelope.to_bytes())
    except OSError as error:
        message = f"the override cannot be written: {error.strerror or error}"
        raise InputError.at(Mark(str(place)), "file-system", message, "change the permissions of the folder") from None
    return place


def signature_of(bench: Bench, override: Override) -> JsonObject | None:
    """Reads the signed statement of an override. Returns None if the bench has no key ring, because a signature cannot then be
    attributed to a person. Raises `InputError` if the bench has a key ring but there is no valid signed override next to the bench
    file."""
    rule = bench.check_standard
    if rule is None or bench.approvals is None:
        return None
    place = override_file(Path(bench.origin.mark.file))
    ring = ring_of(bench.approvals, place).ring
    try:
        data = source.read_bytes(place)
    except InputError:
        refused = "there is none"
    else:
        stated = read_override(data)
        what = Overridden(equipment_of(bench).digest(), rule.device, override.why, date.max)
        now = datetime.now().astimezone()
        refused = "it is damaged" if stated is None else objection(stated, ring, override.by, what, now)
    if refused:
        message = f"the bench has a key ring, so an override must be signed by {override.by}, in {place}: {refused}"
        hint = "sign it with `planrunner bench override`"
        raise InputError.at(rule.at("may_override"), "bench-check-override", message, hint)
    signed: JsonObject = from_bytes(data)
    return signed


def _require_named(bench: Bench, rule: CheckStandardRule, override: Override) -> None:
    if override.by not in rule.may_override:
        message = f"'{override.by}' may not override the check standard of bench '{bench.name}'"
        hint = closest(override.by, rule.may_override) or "`may_override` in the bench file names who may"
        raise InputError.at(rule.at("may_override"), "bench-check-override", message, hint)


def shown_name(override: JsonObject) -> str:
    """Returns the name of the person who gave an override, as run.json states it. A remark is added to a name that is not
    authenticated."""
    name = str(override["by"])
    return name if "signature" in override else f"{name} (name not authenticated)"


@dataclass(frozen=True, slots=True)
class Admission:
    """Describes the permission for a run to begin. `record`: data about the check standard that are stored in run.json. `findings`:
    warnings for the user."""

    record: JsonObject | None = None
    findings: tuple[Finding, ...] = ()


def control_state(
    bench: Bench,
    archive: Path,
    *,
    index: str | None = None,
    now: datetime | None = None,
    fresh: Freshness = Freshness(),  # noqa: B008 - frozen
) -> ControlState | None:
    """Determines the state of a bench's check standard from the runs in an archive; returns None if the bench has no check
    standard. `now`: time for which the state is determined; by default, the current time. Raises `InputError` if the index cannot
    be used."""
    rule = bench.check_standard
    if rule is None:
        return None
    now = now or datetime.now(UTC)
    if not archive.is_dir():
        return judge(rule, bench.name, (), {}, now)
    with opened(archive, index, fresh) as found:
        return state_in(found, bench, now)


def check_in_control(bench: Bench, state: ControlState, log: Findings) -> None:
    """Adds a finding at the rule in the bench file if the check standard is not in control, and a warning about folders that cannot
    be read."""
    rule = bench.check_standard
    if rule is None:
        return
    if state.left_out:
        names = ", ".join(fault.folder for fault in state.left_out)
        message = f"the state of the check standard {rule.device} does not include folders that cannot be read: {names}"
        log.warning(CODE, rule.at("unreadable"), message, _restore(state.left_out))
    if state.in_control:
        return
    allowed = (
        f"{' or '.join(rule.may_override)} may override this for a run (--override-check-standard)"
        if rule.may_override
        else "nobody may override this on this bench"
    )
    measure = f"run {rule.plan} with device_serial={rule.device} on this bench; if it fails again, find the cause"
    unknown = any(fault.recorded is None for fault in state.damaged)
    leave = ", or write `unreadable: warn` in the rule" if unknown else ""
    lost = state.standing is ControlStanding.NOT_DETERMINED
    hint = f"{_restore(state.damaged) + leave if lost else measure}; {allowed}"
    add = log.error if rule.action == "refuse" else log.warning
    add(CODE, bench.at("check_standard"), state.words(), hint)


def _restore(damaged: Sequence[FaultRow]) -> str:
    named = " ".join(fault.folder for fault in damaged[:3])
    return f"restore {named} from a backup (`planrunner verify` shows what was changed), or move it out of the archive if it is not a run"


def check_before_run(bench: Bench, plan_name: str, archive: Path, log: Findings) -> None:
    """Checks the check standard as part of the check of a plan. The plan that measures the check standard is always allowed to run."""
    rule = bench.check_standard
    if rule is None or plan_name == rule.plan_name:
        return
    state = control_state(bench, archive)
    if state is not None:
        check_in_control(bench, state, log)


def admit(
    bench: Bench,
    plan_name: str,
    info: Mapping[str, Json],
    archive: Path,
    override: Override | None = None,
    notice: Announce | None = None,
    signature: JsonObject | None = None,
) -> Admission:
    """Checks whether a run may begin on a bench. Raises `InputError` if the check standard of the bench is not in control and no
    authorised person has given an override, or if an override is given but cannot be used. `signature`: the signed statement of the
    override, if the caller has already verified that it was valid at the time when the run began."""
    rule = bench.check_standard
    if rule is None:
        if override is not None:
            raise InputError.of_usage(f"bench '{bench.name}' has no check standard", "leave the override out")
        return Admission()
    if override is not None:
        _require_named(bench, rule, override)
        if signature is None:
            signature = signature_of(bench, override)
    if rule.measured_by(plan_name, info):
        return Admission()
    state = control_state(bench, archive, fresh=Freshness(notice=notice))
    assert state is not None  # the bench has a rule
    log = Findings()
    check_in_control(bench, state, log)
    if log.errors and override is None:
        raise InputError(log)
    record: JsonObject = {
        "device": state.device,
        "run": None if state.run is None else state.run.folder,
        "standing": state.standing.value,
        "reasons": list(state.reasons),
    }
    if override is not None and not state.in_control:
        given: JsonObject = {"by": override.by, "why": override.why}
        record["override"] = given if signature is None else {**given, "signature": signature}
        log = Findings()
        message = f"{state.words()}; {shown_name(record['override'])} let this run begin: {override.why}"
        log.warning(CODE, bench.at("check_standard"), message)
    return Admission(record, tuple(log))


def admit_again(
    bench: Bench,
    run: RunReader,
    override: Override | None = None,
    bench_file: Path | None = None,
) -> Admission:
    """Checks whether a run may be continued. The state of the check standard is determined again, from the archive that contains
    the run. An override with which the run began stays valid for the whole run. `bench`: the bench on which the run is continued.
    `bench_file`: the file of this bench, if it replaces the file in the run folder. Raises `InputError` like `admit`."""
    signature: JsonObject | None = None
    rule, began = bench.check_standard, run.run.get("check_standard", {}).get("override")
    own = None if began is None else Override(str(began["by"]), str(began["why"]))
    if own is not None and rule is not None and own.by in rule.may_override and override in (None, own):
        signature = _signature_kept(bench, run, began, bench_file)
        override = own if signature is not None or bench.approvals is None else override
    if override is not None and signature is None and bench_file is None and rule is not None and bench.approvals:
        _require_named(bench, rule, override)
        message = "the signed override for this bench is next to the bench file, not in the run folder"
        hint = "name the file of the bench with --bench"
        raise InputError.at(rule.at("may_override"), "bench-check-override", message, hint)
    return admit(
        bench, str(run.run["plan"]), run.run["info"], run.path.absolute().parent, override, signature=signature
    )


def _signature_kept(bench: Bench, run: RunReader, began: JsonObject, bench_file: Path | None) -> JsonObject | None:
    """Returns the signature of the override with which a run began. Raises `InputError` if the signature was not valid when the run
    began. Returns None if the bench has no key ring or the override has no signature."""
    if bench.approvals is None or run.approvals is None or "signature" not in began:
        return None
    kept, created = kept_approvals(run.approvals, run.path)[0], datetime.fromisoformat(str(run.run["created"]))
    ring = ring_of_run(bench.approvals, kept, bench_file).ring
    device = str(run.run["check_standard"]["device"])
    refused = kept_objection(began, ring, kept.bench_digest, device, created, kept.day)
    if refused:
        message = f"the signed override of the check standard with which the run began does not count: {refused}"
        raise InputError.at(Mark(str(run.path / RUN)), "bench-check-override", message, "run the plan again")
    signed: JsonObject = began["signature"]
    return signed


def state_after(run: Path) -> ControlState | None:
    """Determines the state of the check standard after a run that measured it, from the archive that contains the run. Returns None
    for any other run."""
    reader = RunReader.open(run)
    bench = bench_of(reader.bench_bytes, str(reader.path / "bench.yaml"))
    rule = bench.check_standard
    if rule is None or not rule.measured_by(str(reader.run["plan"]), reader.run["info"]):
        return None
    return control_state(bench, run.absolute().parent)

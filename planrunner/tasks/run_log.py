"""Compares the log of an archive with the runs in the archive. The comparison shows which runs were removed, replaced, or added
without an entry in the log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from planrunner.archive.formats import IntegrityError, to_bytes
from planrunner.archive.merkle import (
    ProofError,
    consistency_proof,
    inclusion_path,
    leaf_hash,
    require_consistency,
    require_inclusion,
)
from planrunner.archive.run_log import (
    FOLDER,
    LogContent,
    LogEntry,
    RunLog,
    TreeHead,
    head_faults,
    require_growth,
    unwritable,
)
from planrunner.archive.verifying import CHANGES, MENDED, Change, Examined, examine, open_run
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import Finding, Findings, InputError, Mark
from planrunner.signing.key_ring import KeyRing
from planrunner.signing.tree_heads import RememberedHead, signed_head

FORMAT = 1
PROOF_FORMAT = 1


@dataclass
class LogVerification:
    """Contains the result of the verification of a log.

    `content`: entries of the log; None if the log cannot be read. `signed`: the signed tree head in the log, if any. `findings`: an
    error reports a change to the log or to a run; all other findings are remarks.
    """

    path: Path
    content: LogContent | None = None
    signed: RememberedHead | None = None
    findings: Findings = field(default_factory=Findings)

    @property
    def changes(self) -> tuple[tuple[Change, Finding], ...]:
        return tuple((CHANGES.get(one.code, "altered"), one) for one in self.findings.errors)

    @property
    def remarks(self) -> tuple[Finding, ...]:
        return tuple(one for one in self.findings if one.severity != "error")

    def to_json(self) -> JsonObject:
        """Returns JSON data according to schemas/log-verification.schema.json."""
        content, signed = self.content, self.signed
        return {
            "log": str(self.path),
            "planrunner_log_verification": FORMAT,
            "changes": [{"change": change, **finding.to_json()} for change, finding in self.changes],
            "remarks": [finding.to_json() for finding in self.remarks],
            "entries": None if content is None else len(content.entries),
            "root": None if content is None else content.root(len(content.entries)),
            "signed_head": None
            if signed is None
            else {"size": signed.head.size, "at": signed.head.at, "key": signed.key, "owner": signed.owner},
        }

    def error(self, code: str, message: str, hint: str = "") -> None:
        self.findings.error(code, Mark(str(self.path)), message, hint)

    def warning(self, code: str, message: str, hint: str = "") -> None:
        self.findings.warning(code, Mark(str(self.path)), message, hint)


def log_of(archive: Path) -> RunLog | None:
    """Returns the log of an archive; None if the archive has no log. Raises `InputError` if the log cannot be opened."""
    try:
        return RunLog.of(archive)
    except OSError as error:
        message = f"the log of this archive cannot be read: {error.strerror or error}"
        raise InputError.at(Mark(str(archive / FOLDER)), "log-unreadable", message, "check its permissions") from None


def require_log(archive: Path) -> RunLog:
    """Raises `InputError` if the archive has no log; otherwise returns the log."""
    log = log_of(archive)
    if log is None:
        hint = f"begin one with `planrunner log new {archive}`"
        raise InputError.at(Mark(str(archive)), "log-missing", "this folder has no log of its runs", hint)
    return log


def missing_log(
    archive: Path, runs: Sequence[LoggedRun], remembered: Mapping[str, RememberedHead]
) -> LogVerification | None:
    """Returns the verification of an archive without a log; None if nothing shows that the archive ever had a log. `remembered`:
    as for `verify_log`."""
    found = LogVerification(archive / FOLDER)
    if remembered:
        message = f"the archive has no log, but {next(iter(remembered))} is a tree head of its log"
        found.error("log-cut", message, "restore the log from a backup")
        return found
    made = sum(run.told is not None for run in runs)
    if not made:
        return None
    entered = f"{made} of its runs {'was' if made == 1 else 'were'} entered in a log"
    message = f"this archive has no log, but {entered}: without this log, removed runs cannot be detected"
    found.warning("log-elsewhere", message, "verify the archive in which they were made")
    return found


def verify_log(
    log: RunLog,
    runs: Sequence[LoggedRun] | None = None,
    ring: KeyRing | None = None,
    remembered: Mapping[str, RememberedHead] | None = None,
) -> LogVerification:
    """Verifies a log against its own tree head. Also compares the log with the runs of the archive and with tree heads that were
    noted earlier, if these are given. `remembered`: maps the name of a file to the tree head that was noted in it."""
    found = LogVerification(log.path)
    try:
        content = found.content = log.read()
        require_growth(content, log.path)
        found.signed = signed_head(log, ring)
    except IntegrityError as error:
        found.error(error.code if error.code in CHANGES else "log-changed", str(error))
    except OSError as error:
        found.error("log-changed", f"{log.path}: {error.strerror or error}")
    if found.content is None:
        return found
    if found.content.torn:
        size = found.content.torn
        found.warning("log-torn", f"the log ends with {size} bytes of an entry that was never completed", "no action")
    heads = dict(remembered or {})
    if found.signed is not None:
        heads["its signed tree head"] = found.signed
    for name, one in heads.items():
        _check_head(found, found.content, name, one)
    if runs is not None:
        _compare(found, found.content, runs)
    return found


def _check_head(found: LogVerification, content: LogContent, name: str, one: RememberedHead) -> None:
    if one.why:
        found.error("log-signature", f"{name}: {one.why}", "use a head with a valid signature")
    elif one.key and not one.owner:
        hint = "give the key ring with --keys"
        found.warning("log-key-unknown", f"{name}: NOT VERIFIED: the key {one.key} is not in a key ring", hint)
    for code, fault in head_faults(content, one.head, name):
        found.error(code, fault, "restore the log from a backup")


# -- runs ------------------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _History:
    """Contains the entries of the log about one run.

    `begun`: True if the run was made in this archive. `journals`: for each state of the journal that the entries record, maps the
    number of events to the digest of the last of these events. `seals`: SHA-256 of each seal of the run.
    """

    begun: bool = False
    journals: dict[int, str] = field(default_factory=dict)
    seals: list[str] = field(default_factory=list)
    retired: LogEntry | None = None


def _histories(entries: Iterable[LogEntry]) -> dict[str, _History]:
    found: dict[str, _History] = {}
    for entry in entries:
        if entry.event == "created":
            continue
        history = found.setdefault(entry.run, _History())
        history.begun = history.begun or entry.event == "begun"
        if entry.events:
            history.journals[entry.events] = entry.head
        if entry.seal:
            history.seals.append(entry.seal)
        history.retired = entry if entry.event == "retired" else None
    return found


@dataclass(frozen=True, slots=True)
class LoggedRun:
    """Contains the data of a run that are compared with the log of its archive.

    `name`: name of the run from its journal. If the journal cannot be read, the name is read from run.json; if this is
    impossible, it is the name of the folder. `told`: the tree head of the log, as run.json contains it. `events`: number of
    events in the journal; None if the journal cannot be read. `heads`: maps numbers of events to the digest of the last of these
    events.
    """

    name: str
    path: Path
    told: JsonObject | None
    seal_digest: str | None
    events: int | None
    heads: Mapping[int, str]
    empty: bool


def logged_run(run: Examined) -> LoggedRun:
    """Returns the data of an examined run that are compared with the log of its archive."""
    path, scan = run.folder.path, run.scan
    name = run.state.created["run"] if run.state is not None else run.run.get("run", path.name)
    heads = {} if scan is None else {**scan.heads, scan.count: scan.head}
    events = None if scan is None else scan.count
    empty = events == 1 and run.seal is None and not run.files
    return LoggedRun(str(name), path, run.run.get("log"), run.seal_digest, events, heads, empty)


def _compare(found: LogVerification, content: LogContent, runs: Sequence[LoggedRun]) -> None:
    histories = _histories(content.entries)
    present: dict[str, LoggedRun] = {}
    for run in runs:
        name = run.name
        if name in present:
            message = f"{run.path}: this run is in the archive twice, also as {present[name].path}"
            found.error("log-run-added", message, "keep the original, and move the copy elsewhere")
            continue
        present[name] = run
        history = histories.get(name)
        if history is None:
            _unlogged(found, run)
            continue
        fault = _contradiction(history, run)
        _check_memory(found, content, run, history)
        if fault:
            hint = "restore the run from a backup"
            found.error("log-run-replaced", f"{run.path}: this is not the run in the log: {fault}", hint)
        elif run.seal_digest is not None and run.seal_digest not in history.seals:
            hint = (
                f"if it was sealed where the log could not be reached, add it with `planrunner log append {run.path}`"
            )
            found.error("log-run-added", f"{run.path}: it was sealed outside the log", hint)
    for name, history in histories.items():
        if name in present:
            continue
        if history.retired is not None:
            entry = history.retired
            found.warning("log-run-retired", f"{name}: taken out of the archive on {entry.at}: {entry.why}")
        else:
            what = "sealed" if history.seals else "begun"
            message = f"{name}: this run was {what} according to the log, but it is not in the archive"
            hint = "restore the run from a backup; if it was moved on purpose, record this with `planrunner log retire`"
            found.error("log-run-removed", message, hint)


def _check_memory(found: LogVerification, content: LogContent, run: LoggedRun, history: _History) -> None:
    """Checks the log against the tree head in run.json: the log must still contain the entries that this tree head covers."""
    if run.told is None:
        return
    told, path = run.told, run.path
    if told["origin"] == content.origin:
        for code, fault in head_faults(content, TreeHead.from_json({**told, "at": ""}), f"the tree head in {path}"):
            found.error(code, fault, "restore the log from a backup")
    elif history.begun:
        message = f"{path}: the entries of this log name it as begun, but it was begun with another log"
        found.error("log-changed", message, "restore the log from a backup")
    else:
        message = f"{path}: it was made with another log, of {told['size']} entries, and was added to this log later"
        found.warning("log-elsewhere", message, "verify the archive in which it was made")


def _unlogged(found: LogVerification, run: LoggedRun) -> None:
    """Adds a finding about a run that the log does not name. A run without any data may be left over from an interrupted start."""
    message = f"{run.path}: this run is not in the log"
    if run.empty:
        found.warning("log-run-empty", f"{message}; it has no data: planrunner ended before the run began", "remove it")
    else:
        hint = "it was made elsewhere, or before the log; `planrunner log append` adds it with the present date"
        found.error("log-run-added", message, hint)


def _contradiction(history: _History, run: LoggedRun) -> str:
    """Returns a description of the contradiction between a run and the log; empty if there is none. For each entry in the log, the
    journal of the run must begin with the events that it had when the entry was made."""
    if run.events is None:
        return "its journal cannot be read"
    for events, head in history.journals.items():
        if events > run.events:
            return f"the log counts {events} events, its journal has {run.events}"
        if run.heads.get(events) != head:
            return f"its first {events} events differ from those in the log"
    return ""


# -- adding ----------------------------------------------------------------------------------------------------------------


def begin_log(archive: Path, runs: Sequence[Path]) -> TreeHead:
    """Makes a new log for the runs in the archive. Sealed runs are entered with their seals. All other runs are entered as runs
    that have begun. Raises `InputError` if the log cannot be made, and `IntegrityError` for a run that was changed."""
    present = [_examined(run, *MENDED) for run in runs]
    log = RunLog.create(archive)
    try:
        for run in present:
            if run.seal_digest is not None:
                _enter(log, run)
            elif run.scan is not None and "log" not in run.run:
                log.append("begun", logged_run(run).name, events=1, head=run.scan.heads[1])
        return log.read().head()
    except OSError as error:
        raise unwritable(archive, error) from None


def append_run(log: RunLog, run: Path) -> TreeHead | None:
    """Adds the present seal of a run to the log; returns the new tree head, or None if the log already contains this seal. Raises
    `InputError` if the log cannot be written, and `IntegrityError` if the log or the run was changed."""
    found = _examined(run)
    if found.seal_digest is None:
        message = "only a finished, sealed run can be added to the log"
        raise InputError.at(Mark(str(run)), "sign-not-sealed", message, "finish the run with `planrunner resume`")
    known = logged_run(found)
    history = _histories(log.read().entries).get(known.name, _History())
    if found.seal_digest in history.seals and history.retired is None:
        return None
    fault = _contradiction(history, known)
    if fault:
        raise IntegrityError(f"{run}: this is not the run in the log: {fault}", "log-run-replaced")
    try:
        return _enter(log, found)
    except OSError as error:
        raise unwritable(log.path.parent, error) from None


def _enter(log: RunLog, run: Examined) -> TreeHead:
    assert run.seal is not None and run.seal_digest is not None
    sealed = run.seal["journal"]
    return log.append(
        "sealed", logged_run(run).name, events=sealed["events"], head=sealed["head"], seal=run.seal_digest
    )


def retire_run(log: RunLog, run: str, why: str) -> TreeHead:
    """Records in the log that a run is removed from the archive. `run`: name of the run. Raises `InputError` if the removal cannot
    be recorded, and `IntegrityError` for a changed log."""
    if not why.strip() or not why.isprintable() or len(why) > 1000:
        message = "the reason must be one line of printable text with at most 1000 characters"
        raise InputError.at(Mark(str(log.path)), "log-why", message, "say who has the run now, and why")
    if run not in _histories(log.read().entries):
        message = f"the log does not name a run '{run}'"
        raise InputError.at(Mark(str(log.path)), "log-no-run", message, "give the name of the run folder")
    try:
        return log.append("retired", run, why=why)
    except OSError as error:
        raise unwritable(log.path.parent, error) from None


def _examined(run: Path, *but: str) -> Examined:
    """Examines a run. Raises `IntegrityError` if the run was changed. `but`: codes of faults that are accepted."""
    found = examine(open_run(run), samples="digests")
    found.require_whole(*but)
    return found


# -- proofs ----------------------------------------------------------------------------------------------------------------


def inclusion_proof(log: RunLog, run: str) -> JsonObject:
    """Makes a proof that the log contains the newest seal of a run; see schemas/log-proof.schema.json. Raises `InputError` if the
    run or the log is missing, and `IntegrityError` if one of them was changed."""
    content = _whole(log)
    entry = next((one for one in reversed(content.entries) if one.run == run and one.event == "sealed"), None)
    if entry is None:
        message = f"the log has no seal of a run '{run}'"
        raise InputError.at(Mark(str(log.path)), "log-no-run", message, "give the name of the folder of a sealed run")
    path = inclusion_path(entry.seq - 1, content.leaves)
    return {
        "planrunner_log_proof": PROOF_FORMAT,
        "kind": "inclusion",
        "entry": entry.to_json(),
        "leaf": leaf_hash(entry.line).hex(),
        "path": [one.hex() for one in path],
        "head": content.head().to_json(),
    }


def growth_proof(log: RunLog, first: TreeHead) -> JsonObject:
    """Makes a proof that the log begins with the entries that an earlier tree head covers. Raises `IntegrityError` if the log does
    not begin with these entries."""
    content = _whole(log)
    for code, fault in head_faults(content, first, "the remembered tree head"):
        raise IntegrityError(f"{log.path}: {fault}", code)
    return {
        "planrunner_log_proof": PROOF_FORMAT,
        "kind": "consistency",
        "first": first.to_json(),
        "path": [one.hex() for one in consistency_proof(first.size, content.leaves)],
        "head": content.head().to_json(),
    }


def _whole(log: RunLog) -> LogContent:
    content = log.read()
    require_growth(content, log.path)
    return content


def check_proof(proof: Json, path: Path, head: TreeHead | None, seal: str | None = None) -> str:
    """Verifies a proof without the log; returns a description of what it proves.

    `proof`: data that match the schema of proofs. `head`: the tree head that the verifier trusts; by default, the tree head in the
    proof. `seal`: SHA-256 of the seal that the proof must concern. Raises `IntegrityError` if the proof is not valid.
    """
    stated = TreeHead.from_json(proof["head"])
    if head is not None and (head.size, head.root) != (stated.size, stated.root):
        message = (
            f"the proof is for a tree of size {stated.size} with a different root from that of the given tree head"
        )
        raise IntegrityError(f"{path}: {message}", "log-proof")
    hashes = [bytes.fromhex(one) for one in proof["path"]]
    root = bytes.fromhex(stated.root)
    try:
        if ("first" in proof) != (proof["kind"] == "consistency") or ("entry" in proof) == ("first" in proof):
            raise ProofError(f"it lacks what a proof of the kind {proof['kind']} contains")
        if proof["kind"] == "consistency":
            first = TreeHead.from_json(proof["first"])
            require_consistency(first.size, stated.size, bytes.fromhex(first.root), root, hashes)
            return f"the log of {stated.size} entries begins with the {first.size} entries of the first head"
        entry = LogEntry.from_json(proof["entry"])
        if entry is None:
            raise ProofError("its entry is not an entry of a log")
        require_inclusion(leaf_hash(entry.line), entry.seq - 1, stated.size, hashes, root)
    except ProofError as error:
        raise IntegrityError(f"{path}: the proof does not hold: {error}", "log-proof") from None
    if seal is not None and seal != entry.seal:
        raise IntegrityError(f"{path}: the proof is about a seal other than that of the run", "log-proof")
    return f"entry {entry.seq} of the log of {stated.size} entries: {entry.run} {entry.event} {entry.at}, seal {entry.seal}"


def proof_bytes(proof: JsonObject) -> bytes:
    """Returns the proof as the contents of a file."""
    return to_bytes(proof)

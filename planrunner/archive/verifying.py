"""Verifies a run folder: checks its contents against all its digests, schemas and chains.

All commands use `examine`, which returns the verified contents together with findings about faults. An error means that the folder
differs from what was written. A warning means that less can be verified, because the run is not sealed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from planrunner.archive import analyses as stored
from planrunner.archive import formats, live, pausing
from planrunner.archive import seal as seals
from planrunner.archive.analyses import Basis, StoredAnalysis, exchanged, stored_analysis
from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal import FIRST, JournalScan
from planrunner.archive.journal import NAME as JOURNAL
from planrunner.archive.journal_state import JournalState, name_parts, read_state
from planrunner.archive.lock import NAME as LOCK
from planrunner.archive.origin import NAME as ORIGIN
from planrunner.archive.segment_file import FOLDER as SEGMENTS
from planrunner.archive.segment_file import MOST_BYTES, Part, check_part
from planrunner.archive.stamp_files import FOLDER as STAMPS
from planrunner.archive.stamp_files import stamp_names
from planrunner.archive.storage import ASIDE, digest, digest_of
from planrunner.base.documents import JsonObject
from planrunner.base.findings import Finding, Findings, InputError, Mark
from planrunner.base.guarded_folder import Entry, GuardedFolder, NotOrdinaryError
from planrunner.bench.watchdog_report import NAME as WATCHDOG

RUN, PLAN, BENCH, APPROVALS = "run.json", "plan.yaml", "bench.yaml", "approvals.json"
MOST_GIVEN = 2**20
"""Maximum size in bytes of run.json, the plan and the bench."""
MOST_OF_APPROVALS = 2**26
"""Maximum size in bytes of approvals.json, which contains the meaning of every segment of the plan."""
FILES = {
    RUN,
    PLAN,
    BENCH,
    APPROVALS,
    JOURNAL,
    seals.NAME,
    LOCK,
    pausing.NAME,
    live.NAME,
    live.ANSWER,
    ORIGIN,
    WATCHDOG,
}
SIGNATURES = "signatures"
"""Folder of the electronic signatures; `planrunner.signing.run_signatures` verifies its contents."""
FILE_MANAGERS = {".DS_Store", "Thumbs.db", "desktop.ini"}  # files that they create in every folder that is opened
SIGNS = (JOURNAL, RUN, seals.NAME)
"""Files that identify a run folder: a folder that contains one of them is a run folder."""
MENDED = ("run-seal-missing", "run-journal-torn")
"""Codes of errors that are repaired when the run is opened again. They occur if planrunner ended before it wrote the seal, or while
it wrote the first event after the seal."""

MOST_SHOWN = 20
"""Maximum number of errors in one message."""

RecordedEntries = dict[str, Entry]

SampleCheck = Literal["sizes", "digests", "contents"]
"""Depth of the check of sample files. `sizes`: each file exists and has the right size. `digests`: in addition, its digest is
right. `contents`: in addition, its rows and columns are right."""

CLOCKS_DIFFER = timedelta(hours=1)
"""Largest expected difference between the clocks of two computers: the computer that reads a run and the computer that wrote it."""

Change = Literal["altered", "removed", "added", "reordered", "re-sealed", "cut", "back-dated", "replaced"]
"""Kind of a later change to a run folder, or to the runs of an archive."""
CHANGES: Mapping[str, Change] = MappingProxyType(
    {
        "run-changed": "altered",
        "run-analysis-chain": "altered",
        "run-analysis-format": "altered",
        "run-file-missing": "removed",
        "run-seal-missing": "removed",
        "run-seal-removed": "removed",
        "run-unknown-file": "added",
        "run-journal-torn": "added",
        "run-reordered": "reordered",
        "run-resealed": "re-sealed",
        "run-cut-short": "cut",
        "run-back-dated": "back-dated",
        "run-signature": "altered",
        "run-stamp": "altered",
        "run-stamp-missing": "removed",
        "log-changed": "altered",
        "log-cut": "cut",
        "log-signature": "altered",
        "log-run-removed": "removed",
        "log-run-added": "added",
        "log-run-replaced": "replaced",
        "run-approval": "altered",
        "run-bench-unsigned": "removed",
        "run-analysis-unsigned": "added",
    }
)
"""Code of a finding → the change that it reports."""

CLOCK_STEP = timedelta(seconds=1)
"""Largest step backwards that a clock may make when it is synchronised. Times that go back further count as back-dated."""


@dataclass
class Examined:
    """The verified part of a run folder. `findings`: errors, warnings and notes.

    `seal_digest`: SHA-256 of seal.json. `sealed_before`: True if the contents show that the run was sealed at some earlier time.
    `state`, `scan`: state and scan of the journal; None if the journal cannot be read. If they are None, nothing is verified.
    `unknown`: entries of the folder that planrunner did not write.
    """

    folder: GuardedFolder
    findings: Findings = field(default_factory=Findings)
    state: JournalState | None = None
    scan: JournalScan | None = None
    given: dict[str, bytes] = field(default_factory=dict)
    run: JsonObject = field(default_factory=dict)
    seal: JsonObject | None = None
    seal_digest: str | None = None
    analyses: tuple[StoredAnalysis, ...] = ()
    sealed_before: bool = False
    unknown: list[tuple[Path, Entry]] = field(default_factory=list)

    @property
    def basis(self) -> Basis:
        """Returns the state of the journal and the seal, on which a new analysis is based."""
        assert self.scan is not None
        return Basis(self.scan.count, self.scan.head, self.seal_digest)

    @property
    def files(self) -> dict[str, Part]:
        """Maps the name of every file of samples in the journal to the file's record."""
        return {} if self.state is None else {part.file: part for part in self.state.files()}

    def error(self, code: str, message: str, hint: str = formats.FROM_BACKUP) -> None:
        self.findings.error(code, Mark(str(self.folder.path)), message, hint)

    def require_whole(self, *but: str) -> None:
        """Raises one `IntegrityError` with all errors whose codes are not in `but`."""
        found = [
            f"{item.message}; {item.hint}" if item.hint else item.message
            for item in self.findings.errors
            if item.code not in but
        ]
        if found:
            more = [f"and {len(found) - MOST_SHOWN} more"] if len(found) > MOST_SHOWN else []
            raise IntegrityError("\n".join([*found[:MOST_SHOWN], *more]))


def verify(run: Path, *, samples: SampleCheck = "contents") -> list[Finding]:
    """Verifies a run folder. Returns all errors, warnings and notes; empty for a sealed folder without changes.

    `samples`: how to check the files of samples. Raises `InputError` if there is no run folder.
    """
    return list(examine(open_run(run), samples=samples).findings)


def open_run(path: Path) -> GuardedFolder:
    """Opens the folder of a run that the user named. Raises `InputError` if the folder is not a run folder."""
    try:
        folder = GuardedFolder.open(path)
        known = any(folder.entry(name) is not None for name in SIGNS)
    except (OSError, ValueError):
        known = False
    if not known:
        raise InputError.at(
            Mark(str(path)), "run-not-found", "this is not a run folder", "give a run folder, such as one in runs/"
        )
    return folder


def examine(folder: GuardedFolder, *, samples: SampleCheck = "sizes") -> Examined:
    """Examines a run folder. `samples`: how to check the files of samples.

    A run that is being written can be examined as well. The files are listed before the journal is read. The journal may therefore
    name files that are not in the list, but it names every file in the list.
    """
    found = Examined(folder)
    standing = _entries(found)
    if standing is None:
        return found
    recorded = _recorded(found, standing)
    _read_seal(found, standing)
    _read_analyses(found, standing)
    if not _read_journal(found):
        return found
    _check_given(found, standing)
    _check_seal(found, standing)
    _check_chain(found)
    _check_times(found)
    _check_samples(found, recorded, samples)
    _check_names(found, standing)
    for path, entry in found.unknown:
        _tell_unknown(found, path, entry)
    return found


def _entries(found: Examined) -> RecordedEntries | None:
    try:
        return found.folder.entries()
    except OSError as error:
        found.error("run-changed", f"{found.folder.path}: {error.strerror}")
        return None


def _recorded(found: Examined, standing: RecordedEntries) -> RecordedEntries:
    """Lists the entries in the folder of samples. The function is called before the journal is read. Therefore, if the event of a
    listed file existed at the time of the listing, the journal contains this event."""
    if SEGMENTS not in standing:
        found.error("run-file-missing", f"{found.folder.path / SEGMENTS}: the folder of the samples is missing")
        return {}
    try:
        return found.folder.folder(SEGMENTS).entries()
    except OSError as error:
        found.error("run-changed", f"{found.folder.path / SEGMENTS}: {error.strerror}")
        return {}


def _read_seal(found: Examined, standing: RecordedEntries) -> None:
    if seals.NAME not in standing:
        return
    data = _read(found, seals.NAME, seals.MOST_BYTES)
    found.sealed_before = True
    if data is not None:
        found.seal_digest = digest(data)
        with _collecting(found):
            found.seal = seals.parse_seal(data, found.folder.path / seals.NAME)


def _read_analyses(found: Examined, standing: RecordedEntries) -> None:
    """Reads the existing analyses, and adds the faults of their files to the findings."""
    if stored.FOLDER not in standing:
        return
    path = found.folder.path / stored.FOLDER
    try:
        entries = found.folder.folder(stored.FOLDER).entries()
        numbers = stored.numbers(found.folder)
    except OSError as error:
        found.error("run-changed", f"{path}: {error.strerror}")
        return
    read = []
    for number in numbers:
        with _collecting(found):
            analysis = stored_analysis(found.folder, number)
            read.append(analysis)
            for fault in analysis.check():
                found.error(fault.code, str(fault), hint="")
    found.analyses = tuple(read)
    known = set(map(str, numbers))
    for number in (number for number in range(1, len(numbers) + 1) if str(number) not in known):
        found.error("run-file-missing", f"{path / str(number)}: this analysis is missing, but later ones exist")
    for name, entry in entries.items():
        if name.isdecimal() and entry.kind != "folder":
            found.error("run-changed", f"{path / name}: it is {entry.what}, but a folder is expected here")
        elif name not in known and not _aside(name, entry, "folder"):
            found.unknown.append((path / name, entry))


def _read_journal(found: Examined) -> bool:
    marks = {1} | {analysis.basis.events for analysis in found.analyses}
    if found.seal is not None:
        marks.add(found.seal["journal"]["events"])
    with _collecting(found):
        marks |= {one.events for one in stamp_names(found.folder) if one.events is not None}
    with _collecting(found):
        found.state, found.scan = read_state(found.folder, marks)
    if found.state is None:
        return False
    found.sealed_before = found.sealed_before or bool(found.state.earlier_seals)
    return True


def _check_given(found: Examined, standing: RecordedEntries) -> None:
    """Checks plan, bench, run.json and approvals against the first event of the journal."""
    assert found.state is not None
    for name, expected in found.state.created["files"].items():
        if name not in (RUN, PLAN, BENCH, APPROVALS):
            found.error(
                "run-changed",
                f"{found.folder.path / JOURNAL}:1: it names a file that is not part of the start of a run, {name[:60]!r}",
            )
            continue
        data = _read(found, name, MOST_OF_APPROVALS if name == APPROVALS else MOST_GIVEN)
        if data is None:
            continue
        own = digest(data)
        if own != expected:
            path = found.folder.path / name
            other = next((other for other, value in found.state.created["files"].items() if value == own), None)
            if other is None:
                found.error("run-changed", f"{path}: differs from what was recorded (SHA-256)")
            else:
                fault = exchanged(path, other)
                found.error(fault.code, str(fault), hint="")
            continue
        found.given[name] = data
    if APPROVALS not in found.state.created["files"] and APPROVALS in standing:
        found.error("run-unknown-file", f"{found.folder.path / APPROVALS}: this run began without approvals")
    if RUN in found.given:
        path = found.folder.path / RUN
        with _collecting(found):
            found.run = formats.parse_json(found.given[RUN], path, "run", "planrunner_run", formats.RUN_FORMAT)
        if found.run and found.run["run"] != found.state.created["run"]:
            found.error("run-changed", f"{path}: it gives another name of the run than the journal")


def _check_seal(found: Examined, standing: RecordedEntries) -> None:
    assert found.state is not None and found.scan is not None
    path = found.folder.path
    if found.seal is not None:
        for code, fault in seals.seal_faults(path / seals.NAME, found.seal, found.scan, found.state):
            found.error(code, fault)
    found.sealed_before = found.sealed_before or any(one.basis.seal is not None for one in found.analyses)
    torn = found.scan.torn and f"; the last line is incomplete: {found.scan.torn} bytes that were never acknowledged"
    if seals.NAME not in standing and found.sealed_before:
        found.error("run-seal-removed", f"{path / seals.NAME}: the run was sealed, but its seal is missing")
    elif seals.NAME not in standing and found.state.finished and not is_being_written(found):
        message = f"{path / seals.NAME}: the run is finished, but its seal is missing: the seal was never written, or it was removed"
        found.error(
            "run-seal-missing",
            message,
            "if planrunner was stopped just before it wrote the seal, seal the run with `planrunner resume`; "
            "otherwise, restore the run folder from a backup",
        )
    elif found.seal is None or not found.state.finished:
        again = found.seal is not None and "it was opened again after it was sealed, and is not finished: "
        message = (
            f"{again or ''}not sealed: more data may follow, and data removed at its end cannot be detected{torn or ''}"
        )
        found.findings.warning("run-not-sealed", Mark(str(path)), message, "finish it with `planrunner resume`")
    elif found.scan.torn:
        message = (
            f"{path / JOURNAL}: after the sealed events there are {found.scan.torn} bytes that do not form an event"
        )
        found.error(
            "run-journal-torn", message, "record a segment again with `planrunner resume --retake`, which removes them"
        )


def is_being_written(found: Examined) -> bool:
    """Returns True if a process is writing to the run folder at present, so that a seal or signature may still be added."""
    try:
        return pausing.is_written(found.folder)
    except OSError:
        return False


def _check_chain(found: Examined) -> None:
    """Checks each analysis against the previous one, the journal and the seal."""
    assert found.scan is not None
    before: StoredAnalysis | None = None
    for analysis in found.analyses:
        basis, path = analysis.basis, analysis.path / stored.DIGESTS
        follows = before is None or before.number == analysis.number - 1
        if follows and analysis.digests["previous"] != (FIRST if before is None else before.digest):
            found.error(
                "run-analysis-chain",
                f"{path}: it does not contain the digest of the analysis before it: one of the two was changed or replaced",
            )
        if found.scan.heads.get(basis.events) != basis.head:
            message = (
                f"{path}: the analysis was made from another journal, or the journal was shortened: the analysis counted "
                f"{basis.events} events, the journal has {found.scan.count}"
            )
            found.error("run-cut-short" if basis.events > found.scan.count else "run-analysis-chain", message)
        elif _follows_seal(found, basis) and basis.seal != found.seal_digest:
            found.error("run-resealed", f"{path}: the analysis was made under a seal other than {seals.NAME}")
        before = analysis


def _follows_seal(found: Examined, basis: Basis) -> bool:
    """Returns True if the analysis was made after the present seal. An analysis of a reopened run may belong to an earlier seal
    instead."""
    return found.seal is not None and basis.events >= int(found.seal["journal"]["events"])


def _check_times(found: Examined) -> None:
    """Checks that no time is earlier than the times of the preceding data, and that no time is in the future.

    A clock that was set back causes the same findings as an altered time. Therefore only `verify` treats these findings as a
    change; other commands warn, because the data themselves are unchanged.
    """
    assert found.state is not None and found.scan is not None
    path = found.folder.path
    dated = [(str(found.run["created"]), path / RUN)] if found.run else []
    dated += [(at, path / f"{JOURNAL}:{number}") for number, at in found.state.turning_times]
    if found.seal is not None and found.seal["journal"]["events"] == found.scan.count:
        dated.append((str(found.seal["sealed"]), path / seals.NAME))
    dated += [(str(one.digests["made"]), one.path / stored.DIGESTS) for one in _of_the_whole(found)]
    now = datetime.now(UTC)
    latest: tuple[datetime, Path] | None = None
    for text, place in dated:
        try:
            moment = datetime.fromisoformat(text).astimezone(UTC)
        except ValueError:
            found.error("run-changed", f"{place}: '{text[:40]}' is not a time")
            continue
        if latest is not None and moment < latest[0] - CLOCK_STEP:
            _tell_clock(
                found,
                f"{place}: dated {text}, although it was written after {latest[1]}, which is dated {latest[0].isoformat()}",
            )
        if moment > now + CLOCKS_DIFFER:
            _tell_clock(found, f"{place}: dated {text}, which is in the future")
        if latest is None or moment > latest[0]:
            latest = moment, place


def _of_the_whole(found: Examined) -> list[StoredAnalysis]:
    """Returns the analyses that were made from the whole journal as it is now."""
    assert found.scan is not None
    return [one for one in found.analyses if one.basis.events == found.scan.count]


def _tell_clock(found: Examined, message: str) -> None:
    hint = "a time was altered, or the clock of the computer was wrong: compare with the records of the laboratory"
    found.findings.warning("run-back-dated", Mark(str(found.folder.path)), message, hint)


def _check_samples(found: Examined, recorded: RecordedEntries, samples: SampleCheck) -> None:
    """Checks that every file of samples in the journal exists and has the recorded size. On request, also checks the digest and the
    contents of the file."""
    assert found.state is not None
    known: dict[str, Part] = {}
    for part in found.state.files():
        if known.setdefault(part.file, part) != part:
            found.error(
                "run-changed", f"{found.folder.path / JOURNAL}: it contains two different digests of {part.file}"
            )
    try:
        folder = found.folder.folder(SEGMENTS)
    except OSError:
        return  # already reported
    for name, part in known.items():
        path = found.folder.path / name
        own = name.removeprefix(f"{SEGMENTS}/")
        entry = recorded.get(own)
        with _collecting(found):
            entry = entry or folder.entry(own)
        if entry is None:
            found.error("run-file-missing", f"{path}: the samples cannot be read: No such file or directory")
        elif entry.kind != "file":
            found.error(
                "run-changed", f"{path}: it is {entry.what}, but a regular file with only one name is expected here"
            )
        elif samples == "contents" and entry.size == part.bytes:
            with _collecting(found):
                check_part(found.folder, part)
        elif entry.size != part.bytes or samples == "digests":
            _check_digest(found, folder, own, part, entry.size, read=samples == "digests")
    for name, entry in recorded.items():
        path = folder.path / name
        if f"{SEGMENTS}/{name}" in known or _aside(name, entry, "file"):
            continue
        if name_parts(name) is not None and entry.kind == "file" and not found.state.finished:
            message = f"{path}: these samples are not in the journal yet, and are not used"
            found.findings.warning(
                "run-not-sealed", Mark(str(found.folder.path)), message, "`planrunner resume` resolves this"
            )
        else:
            found.unknown.append((path, entry))


def _check_digest(found: Examined, folder: GuardedFolder, own: str, part: Part, size: int, *, read: bool) -> None:
    """Checks the digest of a file of samples, or reports its wrong size. `read`: True if the file may be read to compute its
    digest."""
    path = folder.path / own
    value = ""
    if read:
        try:
            with folder.open_file(own, MOST_BYTES) as file:
                value = digest_of(file)
        except OSError as error:
            found.error("run-changed", f"{path}: the samples: {error.strerror}")
            return
        if value == part.sha256 and size == part.bytes:
            return
        other = next((name for name, one in found.files.items() if one.sha256 == value), None)
        if other is not None and other != part.file:
            fault = exchanged(path, other)
            found.error(fault.code, str(fault), hint="")
            return
    sizes = f": {size} bytes, not {part.bytes}" if size != part.bytes else " (SHA-256)"
    found.error("run-changed", f"{path}: the samples differ from what was recorded{sizes}")


def _check_names(found: Examined, standing: RecordedEntries) -> None:
    """Reports entries that do not belong in a run folder, and entries of the wrong kind."""
    for name, entry in standing.items():
        path = found.folder.path / name
        if name in FILES:
            if entry.kind != "file" and name in (LOCK, pausing.NAME, live.NAME, live.ANSWER, ORIGIN, WATCHDOG):
                found.error(
                    "run-changed", f"{path}: it is {entry.what}, but a regular file with only one name is expected here"
                )
        elif name in (SIGNATURES, STAMPS) and entry.kind == "folder":
            continue
        elif name not in (SEGMENTS, stored.FOLDER) and not _aside(name, entry, "file"):
            found.unknown.append((path, entry))


def _tell_unknown(found: Examined, path: Path, entry: Entry) -> None:
    """Reports an entry that planrunner did not write. The finding is an error if the folder was sealed, or if the entry is not a
    plain file or folder. Otherwise, it is a warning."""
    if entry.kind == "file" and path.name in FILE_MANAGERS:
        return
    message = f"{path}: {entry.what} that planrunner did not write"
    hint = "move it elsewhere: a run folder must contain only the run"
    sealed = found.sealed_before or (found.state is not None and found.state.finished)
    add = found.findings.error if sealed or entry.kind == "other" else found.findings.warning
    add("run-unknown-file", Mark(str(found.folder.path)), message, hint)


def _aside(name: str, entry: Entry, kind: str) -> bool:
    """Returns True if an entry remains from an interrupted write. Such entries are ignored."""
    return name.endswith(ASIDE) and entry.kind == kind


def _read(found: Examined, name: str, limit: int) -> bytes | None:
    path = found.folder.path / name
    try:
        return found.folder.read(name, limit)
    except NotOrdinaryError as error:
        found.error("run-changed", f"{path}: {error.strerror}")
    except OSError as error:
        code = "run-file-missing" if isinstance(error, FileNotFoundError) else "run-changed"
        found.error(code, f"{path}: cannot be read: {error.strerror}; is this a run folder?")
    return None


@contextmanager
def _collecting(found: Examined) -> Iterator[None]:
    """Turns `IntegrityError` and `OSError` that the enclosed code raises into findings."""
    try:
        yield
    except IntegrityError as error:  # its message says what to do
        found.error(error.code, str(error), hint="")
    except OSError as error:
        found.error("run-changed", f"{error.filename or found.folder.path}: {error.strerror or error}")

"""Verifying a run folder: what stands in it, held against every digest, schema and chain that it carries.

One look for all commands: `examine` gives what was verified, and what is wrong with it as findings. An error means that the folder is not
as it was written; a warning, that it is not sealed, so that less can be said of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planrunner.archive import analyses as stored
from planrunner.archive import formats, pausing
from planrunner.archive import seal as seals
from planrunner.archive.analyses import Basis, StoredAnalysis, stored_analysis
from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal import FIRST, JournalScan
from planrunner.archive.journal import NAME as JOURNAL
from planrunner.archive.journal_state import JournalState, name_parts, read_state
from planrunner.archive.lock import NAME as LOCK
from planrunner.archive.origin import NAME as ORIGIN
from planrunner.archive.segment_file import FOLDER as SEGMENTS
from planrunner.archive.segment_file import Part, check_part
from planrunner.archive.storage import ASIDE, digest
from planrunner.base.findings import Finding, Findings, InputError, Mark
from planrunner.base.guarded_folder import Entry, GuardedFolder, NotOrdinaryError
from planrunner.bench.watchdog_report import NAME as WATCHDOG

RUN, PLAN, BENCH = "run.json", "plan.yaml", "bench.yaml"
MOST_GIVEN = 2**20
"""Bytes that run.json, the plan and the bench have at most."""
FILES = {RUN, PLAN, BENCH, JOURNAL, seals.NAME, LOCK, pausing.NAME, ORIGIN, WATCHDOG}
FILE_MANAGERS = {".DS_Store", "Thumbs.db", "desktop.ini"}  # what they leave in every folder that is looked at
MENDED = ("run-seal-missing", "run-journal-torn")
"""Codes of errors that are mended when a run is opened again to go on: planrunner was ended before the seal was written, or in the
middle of the first event after it."""

MOST_SHOWN = 20
"""Errors that one message names at most."""

Recorded = dict[str, Entry]


@dataclass
class Examined:
    """A run folder as far as it is as it was written. findings: what is wrong, and what is to be known.

    seal_digest: SHA-256 of seal.json. sealed_before: whether it was sealed once, by what stands in it. state, scan: None where the journal
    cannot be read; then nothing is verified. unknown: what planrunner did not put there.
    """

    folder: GuardedFolder
    findings: Findings = field(default_factory=Findings)
    state: JournalState | None = None
    scan: JournalScan | None = None
    given: dict[str, bytes] = field(default_factory=dict)
    run: dict[str, Any] = field(default_factory=dict)
    seal: dict[str, Any] | None = None
    seal_digest: str | None = None
    analyses: tuple[StoredAnalysis, ...] = ()
    sealed_before: bool = False
    unknown: list[tuple[Path, Entry]] = field(default_factory=list)

    @property
    def basis(self) -> Basis:
        """What an analysis that is made now is made from."""
        assert self.scan is not None
        return Basis(self.scan.count, self.scan.head, self.seal_digest)

    def error(self, code: str, message: str, hint: str = formats.FROM_BACKUP) -> None:
        self.findings.error(code, Mark(str(self.folder.path)), message, hint)

    def require_whole(self, *but: str) -> None:
        """Raises `IntegrityError` with all errors, except those of these codes."""
        found = [
            f"{item.message}; {item.hint}" if item.hint else item.message
            for item in self.findings.errors
            if item.code not in but
        ]
        if found:
            more = [f"and {len(found) - MOST_SHOWN} more"] if len(found) > MOST_SHOWN else []
            raise IntegrityError("\n".join([*found[:MOST_SHOWN], *more]))


def verify(run: Path, *, samples: bool = True) -> list[Finding]:
    """Everything that is wrong with a run folder or must be known of it; an empty list for one that is sealed and as it was written.

    samples: hold the samples of every segment against their digests too, which takes the time to read them. Raises `InputError` when
    there is no run folder.
    """
    return list(examine(open_run(run), samples=samples).findings)


def open_run(path: Path) -> GuardedFolder:
    """The folder of a run, as a user named it. Raises `InputError` when it is none."""
    try:
        folder = GuardedFolder.open(path)
        known = folder.entry(JOURNAL) is not None or folder.entry(RUN) is not None
    except (OSError, ValueError):
        known = False
    if not known:
        raise InputError.at(
            Mark(str(path)), "run-not-found", "this is not a run folder", "give a run folder, such as one in runs/"
        )
    return folder


def examine(folder: GuardedFolder, *, samples: bool = False) -> Examined:
    """Look a run folder over. samples: those of every segment too; else only that their files are there and as long as they were.

    A run that is being written may be looked over too: what is listed first may only have become more since.
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
    _check_given(found)
    _check_seal(found, standing)
    _check_chain(found)
    _check_samples(found, recorded, samples)
    _check_names(found, standing)
    for path, entry in found.unknown:
        _tell_unknown(found, path, entry)
    return found


def _entries(found: Examined) -> Recorded | None:
    try:
        return found.folder.entries()
    except OSError as error:
        found.error("run-changed", f"{found.folder.path}: {error.strerror}")
        return None


def _recorded(found: Examined, standing: Recorded) -> Recorded:
    """What stands in the folder of samples, before the journal is read: a file that is there has its event then, or none."""
    if SEGMENTS not in standing:
        found.error("run-changed", f"{found.folder.path / SEGMENTS}: the folder of the samples is missing")
        return {}
    try:
        return found.folder.folder(SEGMENTS).entries()
    except OSError as error:
        found.error("run-changed", f"{found.folder.path / SEGMENTS}: {error.strerror}")
        return {}


def _read_seal(found: Examined, standing: Recorded) -> None:
    if seals.NAME not in standing:
        return
    data = _read(found, seals.NAME, seals.MOST_BYTES)
    found.sealed_before = True
    if data is not None:
        found.seal_digest = digest(data)
        with _collecting(found):
            found.seal = seals.parse_seal(data, found.folder.path / seals.NAME)


def _read_analyses(found: Examined, standing: Recorded) -> None:
    """The analyses that are there, each with what is wrong with its files."""
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
                found.error("run-changed", str(fault), hint="")
    found.analyses = tuple(read)
    known = set(map(str, numbers))
    for number in (number for number in range(1, len(numbers) + 1) if str(number) not in known):
        found.error("run-analysis-chain", f"{path / str(number)}: this analysis is missing, but later ones exist")
    for name, entry in entries.items():
        if name.isdecimal() and entry.kind != "folder":
            found.error("run-changed", f"{path / name}: it is {entry.what}, but a folder is expected here")
        elif name not in known and not _aside(name, entry, "folder"):
            found.unknown.append((path / name, entry))


def _read_journal(found: Examined) -> bool:
    marks = {1} | {analysis.basis.events for analysis in found.analyses if analysis.basis is not None}
    if found.seal is not None:
        marks.add(found.seal["journal"]["events"])
    with _collecting(found):
        found.state, found.scan = read_state(found.folder, marks)
    if found.state is None:
        return False
    found.sealed_before = found.sealed_before or found.state.sealed_before
    return True


def _check_given(found: Examined) -> None:
    """What the run was made from, against the journal's first event."""
    assert found.state is not None
    for name, expected in found.state.created["files"].items():
        if name not in (RUN, PLAN, BENCH):
            found.error(
                "run-changed",
                f"{found.folder.path / JOURNAL}:1: it names a file that does not belong to the start of a run, {name[:60]!r}",
            )
            continue
        data = _read(found, name, MOST_GIVEN)
        if data is None:
            continue
        if digest(data) != expected:
            found.error("run-changed", f"{found.folder.path / name}: differs from what was recorded (SHA-256)")
            continue
        found.given[name] = data
    if RUN in found.given:
        path = found.folder.path / RUN
        with _collecting(found):
            found.run = formats.parse_json(found.given[RUN], path, "run", "planrunner_run", formats.RUN_FORMAT)
        if found.run and found.run["run"] != found.state.created["run"]:
            found.error("run-changed", f"{path}: its name of the run differs from the one in the journal")


def _check_seal(found: Examined, standing: Recorded) -> None:
    assert found.state is not None and found.scan is not None
    path = found.folder.path
    if found.seal is not None:
        for fault in seals.seal_faults(path / seals.NAME, found.seal, found.scan, found.state):
            found.error("run-changed", fault)
    found.sealed_before = found.sealed_before or any(
        analysis.basis is not None and analysis.basis.seal is not None for analysis in found.analyses
    )
    torn = found.scan.torn and f"; the last line is not whole: {found.scan.torn} bytes were not acknowledged"
    if seals.NAME not in standing and found.sealed_before:
        found.error("run-seal-removed", f"{path / seals.NAME}: the run was sealed, but its seal is missing")
    elif seals.NAME not in standing and found.state.finished and not _written(found):
        message = f"{path / seals.NAME}: the run is finished, but its seal is missing: the seal was never written, or it was removed"
        found.error(
            "run-seal-missing",
            message,
            "if planrunner ended before it wrote the seal, `planrunner resume` seals the run",
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


def _written(found: Examined) -> bool:
    """Whether a process writes the run now, so that its seal may be on its way."""
    try:
        return pausing.is_written(found.folder)
    except OSError:
        return False


def _check_chain(found: Examined) -> None:
    """Each analysis against the one before it, the journal and the seal."""
    assert found.scan is not None
    before: StoredAnalysis | None = None
    for analysis in found.analyses:
        basis, path = analysis.basis, analysis.path / stored.DIGESTS
        if basis is None:
            if before is not None and before.basis is not None:
                found.error(
                    "run-analysis-chain",
                    f"{path}: made by an older version of planrunner, without the digest of the analysis before it",
                )
        else:
            follows = before is None or before.number == analysis.number - 1
            if follows and analysis.digests["previous"] != (FIRST if before is None else before.digest):
                found.error(
                    "run-analysis-chain",
                    f"{path}: it does not contain the digest of the analysis before it: one of the two was changed or "
                    "replaced",
                )
            if found.scan.heads.get(basis.events) != basis.head:
                message = (
                    f"{path}: the analysis was made from another journal, or the journal was shortened: the analysis counted "
                    f"{basis.events} events, the journal has {found.scan.count}"
                )
                found.error("run-analysis-chain", message)
            elif _follows_seal(found, basis) and basis.seal != found.seal_digest:
                found.error("run-analysis-chain", f"{path}: the analysis was made under another seal than {seals.NAME}")
        before = analysis


def _follows_seal(found: Examined, basis: Basis) -> bool:
    """Whether the present seal stood when the analysis was made; an earlier one may have, in a run that was opened again."""
    return found.seal is not None and basis.events >= int(found.seal["journal"]["events"])


def _check_samples(found: Examined, recorded: Recorded, samples: bool) -> None:
    """Every file of samples that the journal knows: there, as long as it was and, if asked for, with its digest."""
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
            found.error("run-changed", f"{path}: the samples cannot be read: No such file or directory")
        elif entry.kind != "file":
            found.error("run-changed", f"{path}: it is {entry.what}, but a file with a single name is expected here")
        elif entry.size != part.bytes:
            found.error(
                "run-changed",
                f"{path}: the samples differ from what was recorded: {entry.size} bytes, not {part.bytes}",
            )
        elif samples:
            with _collecting(found):
                check_part(found.folder, part)
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


def _check_names(found: Examined, standing: Recorded) -> None:
    """What belongs into no run folder, and what stands where something else belongs."""
    for name, entry in standing.items():
        path = found.folder.path / name
        if name in FILES:
            if entry.kind != "file" and name in (LOCK, pausing.NAME, ORIGIN, WATCHDOG):
                found.error(
                    "run-changed", f"{path}: it is {entry.what}, but a file with a single name is expected here"
                )
        elif name not in (SEGMENTS, stored.FOLDER) and not _aside(name, entry, "file"):
            found.unknown.append((path, entry))


def _tell_unknown(found: Examined, path: Path, entry: Entry) -> None:
    """Something that planrunner did not write: an error once the folder was sealed, and where it is no plain file or folder."""
    if entry.kind == "file" and path.name in FILE_MANAGERS:
        return
    message = f"{path}: {entry.what} that planrunner did not write"
    hint = "move it elsewhere: a run folder must contain only the run"
    sealed = found.sealed_before or (found.state is not None and found.state.finished)
    add = found.findings.error if sealed or entry.kind == "other" else found.findings.warning
    add("run-unknown-file", Mark(str(found.folder.path)), message, hint)


def _aside(name: str, entry: Entry, kind: str) -> bool:
    """Whether it is what a write that was cut short left: it counts for nothing."""
    return name.endswith(ASIDE) and entry.kind == kind


def _read(found: Examined, name: str, limit: int) -> bytes | None:
    path = found.folder.path / name
    try:
        return found.folder.read(name, limit)
    except NotOrdinaryError as error:
        found.error("run-changed", f"{path}: {error.strerror}")
    except OSError as error:
        found.error("run-changed", f"{path}: cannot be read: {error.strerror}; is this a run folder?")
    return None


@contextmanager
def _collecting(found: Examined) -> Iterator[None]:
    """What raises `IntegrityError` or `OSError` within becomes a finding."""
    try:
        yield
    except IntegrityError as error:  # which says what to do
        found.error("run-changed", str(error), hint="")
    except OSError as error:
        found.error("run-changed", f"{error.filename or found.folder.path}: {error.strerror or error}")

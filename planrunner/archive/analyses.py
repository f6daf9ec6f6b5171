"""Stores the analyses of a run. Each analysis is in a numbered folder, which is written atomically together with a list of digests,
and is never changed afterwards.

Each list contains the digest of the previous list, the head of the journal at the time of the analysis, and the digest of the seal
if there was one. Like the events of the journal, the analyses therefore form a chain: if a later analysis exists, a changed or
removed analysis is detected.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from planrunner.archive import formats
from planrunner.archive.formats import FormatError, IntegrityError
from planrunner.archive.journal import FIRST, utc_now
from planrunner.archive.storage import ASIDE, Storage, digest, digest_of
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder, NotOrdinaryError

FOLDER = "analyses"
DIGESTS = "digests.json"
MOST_BYTES = 2**28
"""Maximum size in bytes of a file of an analysis."""
MOST_DIGESTS = 2**20
MOST_RESULTS = 2**27
"""Maximum sizes in bytes: of a list of digests, and of results that are read again."""


@dataclass(frozen=True, slots=True)
class Basis:
    """Describes the state of a run from which an analysis is made. `events`: number of events in the journal. `head`: digest of the
    last of these events. `seal`: digest of the seal; None if the run had no seal."""

    events: int
    head: str
    seal: str | None


@dataclass(frozen=True)
class StoredAnalysis:
    """Describes a stored analysis: its number, its folder, its list of digests, and the digest of this list."""

    run: GuardedFolder
    number: int
    digests: Mapping[str, Json]
    digest: str

    @property
    def path(self) -> Path:
        return self.run.path / FOLDER / str(self.number)

    @property
    def files(self) -> tuple[str, ...]:
        return tuple(self.digests["files"])

    @property
    def basis(self) -> Basis:
        """Returns the data from which the analysis was made."""
        return Basis(self.digests["journal"]["events"], self.digests["journal"]["head"], self.digests["seal"])

    def read(self, name: str) -> bytes:
        """Reads a file of the analysis and checks its digest. Raises `IntegrityError` if the file is missing or was changed."""
        try:
            data = self._folder().read(name, MOST_RESULTS)
        except OSError as error:
            raise _unreadable(self.path / name, error) from None
        if digest(data) != self.digests["files"].get(name):
            raise _changed(self.path / name)
        return data

    def read_json(self, name: str, schema: str, version_key: str, known: int) -> JsonObject:
        """Reads a JSON file of the analysis and checks its digest and its schema. Raises `IntegrityError` if the file is missing,
        was changed, or does not match its schema."""
        return formats.parse_json(self.read(name), self.path / name, schema, version_key, known)

    def check(self) -> Iterator[IntegrityError]:
        """Reports missing, changed and added files, one entry for each file."""
        folder, listed = self._folder(), self.digests["files"]
        standing = set(folder.entries()) - {DIGESTS}
        for name in sorted(standing | set(listed)):
            if name not in standing:
                yield IntegrityError(
                    f"{self.path / name}: missing from the analysis; restore the run folder from a backup, or estimate again",
                    "run-file-missing",
                )
            elif name not in listed:
                yield IntegrityError(
                    f"{self.path / name}: added after the analysis was made; remove it", "run-unknown-file"
                )
            else:
                try:
                    with folder.open_file(name, MOST_BYTES) as file:
                        found = digest_of(file)
                except OSError as error:
                    yield _unreadable(self.path / name, error)
                    continue
                if found != listed[name]:
                    other = next((other for other, value in listed.items() if value == found), None)
                    yield _changed(self.path / name) if other is None else exchanged(self.path / name, other)

    def _folder(self) -> GuardedFolder:
        return self.run.folder(FOLDER).folder(str(self.number))


def exchanged(path: Path, other: str) -> IntegrityError:
    """Returns the error for a file that has the content of another file of the run."""
    return IntegrityError(
        f"{path}: it has the content of {other}: files were exchanged; {formats.FROM_BACKUP}", "run-reordered"
    )


def _changed(path: Path) -> IntegrityError:
    return IntegrityError(
        f"{path}: changed after the analysis was made; restore the run folder from a backup, or estimate again"
    )


def _unreadable(path: Path, error: OSError) -> IntegrityError:
    how = "" if isinstance(error, NotOrdinaryError) else "cannot be read: "
    code = "run-file-missing" if isinstance(error, FileNotFoundError) else "run-changed"
    return IntegrityError(f"{path}: {how}{error.strerror}; restore the run folder from a backup", code)


def _other_format(run: GuardedFolder, path: Path, error: FormatError) -> IntegrityError:
    """Returns the error for an analysis whose list of digests has a format that is not read. The samples do not depend on it."""
    age = "an older" if error.version < error.known else "a newer"
    return IntegrityError(
        f"{path}: this analysis is in {age} format ({error.version}; this version of planrunner reads format {error.known}), so it "
        f"cannot be verified; move the folder {path.parent} out of the run folder, and analyse the samples again with `planrunner "
        f"estimate {run.path}`",
        "run-analysis-format",
    )


def numbers(run: GuardedFolder) -> tuple[int, ...]:
    """Returns the numbers of a run's analyses, in order. Raises `OSError` if the folder of the analyses cannot be read."""
    if run.entry(FOLDER) is None:
        return ()
    found = [
        int(name) for name, entry in run.folder(FOLDER).entries().items() if _is_number(name) and entry.kind == "folder"
    ]
    return tuple(sorted(found))


def _is_number(name: str) -> bool:
    return name.isascii() and name.isdecimal() and len(name) <= 9 and name[0] != "0"


def stored_analysis(run: GuardedFolder, number: int) -> StoredAnalysis:
    """Reads an analysis with its list of digests. The list is checked against its schema and its own digest; the files are not
    checked. Raises `IntegrityError` if the list is missing, was changed, does not match its schema, or has another format."""
    path = run.path / FOLDER / str(number) / DIGESTS
    try:
        data = run.folder(FOLDER).folder(str(number)).read(DIGESTS, MOST_DIGESTS)
    except OSError as error:
        raise _unreadable(path, error) from None
    try:
        digests = formats.parse_json(data, path, "digests", "planrunner_digests", formats.DIGESTS_FORMAT)
    except FormatError as error:
        raise _other_format(run, path, error) from None
    formats.require_own_digest(data, digests, path)
    return StoredAnalysis(run, number, digests, digest(data))


def chosen_analysis(run: Path, analyses: Iterable[StoredAnalysis], number: int | None = None) -> StoredAnalysis:
    """Returns the analysis with the given number or, by default, the newest analysis of a run. Raises `InputError` if the run has
    no such analysis."""
    known = {one.number: one for one in analyses}
    number = max(known, default=0) if number is None else number
    if number not in known:
        message = f"this run has no analysis {number}" if known else "this run has no analysis yet"
        hint = f"known here: {', '.join(map(str, known))}" if known else "make an analysis with `planrunner estimate`"
        raise InputError.at(Mark(str(run)), "analysis-missing", message, hint)
    return known[number]


def add_analysis(run: GuardedFolder, files: Mapping[str, bytes], basis: Basis) -> StoredAnalysis:
    """Adds an analysis in `analyses/<n>` and returns it. `files`: maps each file name to the content of the file.

    The analysis is written under a temporary name and then renamed, so it exists completely or not at all. Two simultaneous
    analyses get different numbers. Raises `InputError` if the analysis cannot be written, and `ValueError` for a file name that is
    not allowed.
    """
    storage = Storage()
    for name in files:
        if name == DIGESTS or Path(name).name != name or name in ("", ".", ".."):
            raise ValueError(f"not a file name for an analysis: {name!r}")
    aside = f".{os.getpid()}-{os.urandom(4).hex()}{ASIDE}"
    try:
        if run.entry(FOLDER) is None:
            with contextlib.suppress(FileExistsError):  # another process was first
                storage.make_folder(run, FOLDER)
            storage.sync_folder(run)
        folder = run.folder(FOLDER)
        try:
            beside = storage.make_folder(folder, aside)
            for name, data in files.items():
                storage.write_whole(beside, name, data)
            number = _take_number(run, folder, aside, files, basis, storage)
        except OSError:
            folder.remove_folder(aside)
            raise
        return stored_analysis(run, number)
    except OSError as error:
        message = f"the analysis cannot be written: {error.strerror or error}"
        raise InputError.at(
            Mark(str(run.path / FOLDER)),
            "analysis-unwritable",
            message,
            "free disk space or change permissions, then estimate again",
        ) from None


def _take_number(
    run: GuardedFolder,
    folder: GuardedFolder,
    aside: str,
    files: Mapping[str, bytes],
    basis: Basis,
    storage: Storage,
) -> int:
    """Chooses the number of the new analysis, and writes it and the digest of the previous analysis into the list of digests.
    Returns the number."""
    while True:
        standing = numbers(run)
        last = stored_analysis(run, standing[-1]) if standing else None
        number = 1 if last is None else last.number + 1
        digests = {
            "planrunner_digests": formats.DIGESTS_FORMAT,
            "made": utc_now(),
            "previous": FIRST if last is None else last.digest,
            "journal": {"events": basis.events, "head": basis.head},
            "seal": basis.seal,
            "files": {name: digest(data) for name, data in sorted(files.items())},
        }
        storage.write_whole(folder.folder(aside), DIGESTS, formats.digested(digests))
        try:
            storage.rename(folder, aside, str(number))  # refused when another process took the number
        except OSError:
            if number not in numbers(run):
                raise
            continue
        storage.sync_folder(folder)
        return number

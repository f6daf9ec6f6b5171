"""Writes the seal when a run is finished: digests of everything that was recorded, and the head of the journal's chain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from planrunner.archive import formats
from planrunner.archive.journal import MOST_BYTES as MOST_OF_JOURNAL
from planrunner.archive.journal import NAME as JOURNAL
from planrunner.archive.journal import JournalScan, utc_now
from planrunner.archive.journal_state import JournalState
from planrunner.archive.storage import digest_of
from planrunner.base.documents import Json, JsonObject
from planrunner.base.guarded_folder import GuardedFolder

NAME = "seal.json"
MOST_BYTES = 2**25


def seal_of(folder: GuardedFolder, run: str, files: Mapping[str, str], head: str, events: int) -> bytes:
    """Returns the text of the seal for a run whose journal ends with the digest `head` after `events` events.

    `run`: name of the run. `files`: maps the name of each other recorded file to its SHA-256, as computed while the file was
    written. Raises `OSError` if the journal cannot be read.
    """
    with folder.open_file(JOURNAL, MOST_OF_JOURNAL) as journal:
        digests = {**files, JOURNAL: digest_of(journal)}
    seal = {
        "planrunner_seal": formats.SEAL_FORMAT,
        "run": run,
        "sealed": utc_now(),
        "journal": {"events": events, "head": head},
        "files": dict(sorted(digests.items())),
    }
    return formats.digested(seal)


def parse_seal(data: bytes, path: Path) -> JsonObject:
    """Returns the content of a seal. Raises `IntegrityError` if the seal does not match its schema or its own digest."""
    seal = formats.parse_json(data, path, "seal", "planrunner_seal", formats.SEAL_FORMAT)
    formats.require_own_digest(data, seal, path)
    return seal


def seal_faults(
    path: Path, seal: Mapping[str, Json], scan: JournalScan, state: JournalState
) -> Iterator[tuple[str, str]]:
    """Yields the differences between a seal and the journal, each as a code and a message. `scan`: a scan of the journal. The scan
    must have stored the head and the digest after the number of events that the seal states.

    If a finished run was reopened to repeat a segment, its journal continues after the seal. In this case, only the sealed part of
    the journal is checked.
    """
    sealed = seal["journal"]
    if sealed["events"] > scan.count:
        yield (
            "run-cut-short",
            f"{path}: the seal counts {sealed['events']} events, but the journal has {scan.count} complete events",
        )
        return
    if scan.heads.get(sealed["events"]) != sealed["head"]:
        yield "run-changed", f"{path}: this is not the journal that was sealed"
        return
    if scan.digests.get(sealed["events"]) != seal["files"][JOURNAL]:
        yield "run-changed", f"{path}: the digest of {JOURNAL} is not that of the journal"
    if seal["run"] != state.created["run"]:
        yield "run-changed", f"{path}: it gives another name of the run than the journal"
    known = {part.file: part.sha256 for part in state.files()} | state.created["files"]
    for name, value in seal["files"].items():
        if name != JOURNAL and known.get(name) != value:
            yield "run-changed", f"{path}: the digest of {name} is not the one in the journal"
    if sealed["events"] == scan.count:
        for name in sorted(set(known) - set(seal["files"])):
            yield "run-changed", f"{path}: it does not list {name}, which is in the journal"

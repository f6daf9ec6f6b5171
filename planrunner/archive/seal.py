"""The seal: digests of everything that was recorded and the head of the journal's chain, written when a run is
finished."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from planrunner.archive import formats
from planrunner.archive.integrity import IntegrityError
from planrunner.archive.journal import NAME as JOURNAL
from planrunner.archive.journal import JournalScan, utc_now
from planrunner.archive.journal_state import JournalState
from planrunner.archive.storage import Storage, digest_file

NAME = "seal.json"


def write_seal(folder: Path, storage: Storage, files: Mapping[str, str], head: str, events: int) -> None:
    """Seal a run whose journal ends with `head` after `events` events; a seal that already stands is replaced.

    files: name → SHA-256 of everything else that was recorded, as computed while it was written.
    """
    seal = {
        "planrunner_seal": formats.SEAL_FORMAT,
        "run": folder.name,
        "sealed": utc_now(),
        "journal": {"events": events, "head": head},
        "files": dict(sorted({**files, JOURNAL: digest_file(folder / JOURNAL)}.items())),
    }
    storage.write_whole(folder / NAME, formats.to_bytes(seal))


def read_seal(folder: Path) -> dict[str, Any] | None:
    """The seal, or None while a run is not finished. Raises `IntegrityError` for one that is not as its schema says."""
    path = folder / NAME
    return formats.read_json(path, "seal", "planrunner_seal", formats.SEAL_FORMAT) if path.exists() else None


def check_seal(folder: Path, seal: dict[str, Any], scan: JournalScan, state: JournalState) -> None:
    """Hold a seal against the journal as read. Raises `IntegrityError`.

    A finished run that was opened again, to take a segment another time, has a journal that goes on after its seal;
    then the sealed beginning is checked instead.
    """
    sealed, path = seal["journal"], folder / NAME
    if sealed["events"] > scan.count:
        message = f"the seal counts {sealed['events']} events, the journal has {scan.count} that are whole"
        raise IntegrityError(f"{path}: {message}; take the run folder from a backup")
    head = scan.head if sealed["events"] == scan.count else _head_after(folder / JOURNAL, sealed["events"])
    if head != sealed["head"]:
        raise IntegrityError(f"{path}: the journal is not the one that was sealed; take the run folder from a backup")
    known = {part.file: part.sha256 for part in state.files()} | state.created["files"]
    for name, value in seal["files"].items():
        if name != JOURNAL and known.get(name) != value:
            raise IntegrityError(
                f"{path}: the digest of {name} is not the one in the journal; take the run folder from a backup"
            )


def _head_after(path: Path, events: int) -> str:
    scan = JournalScan(path)
    for _ in scan:
        if scan.count == events:
            break
    return scan.head

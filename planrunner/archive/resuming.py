"""Determines where an interrupted run continues, and handles the segment during which it was interrupted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal import Journal
from planrunner.archive.journal_state import Acknowledged, JournalState, name_parts
from planrunner.archive.segment_file import FOLDER, MOST_BYTES, Part, check_part, rows_of
from planrunner.archive.storage import ASIDE, Storage, digest
from planrunner.base.documents import Json
from planrunner.base.guarded_folder import GuardedFolder

REASON = "the process ended in this segment"


@dataclass(slots=True)
class ResumePoint:
    """The state from which an interrupted run continues. `states`: states of the executor and of the instruments that can be
    resumed, as stored with the last acknowledged segment. `clock`: time at which these states were stored, s.

    `instruments`: descriptions that the instruments gave of themselves before the interruption. `files`: maps the name of every
    file recorded so far to its SHA-256, for the seal. `attempts`: how often each segment has been begun.
    """

    clock: float = 0.0
    states: Mapping[str, Json] = field(default_factory=dict)
    acknowledged: dict[int, Acknowledged] = field(default_factory=dict)
    attempts: dict[int, int] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    instruments: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    resumed: bool = False

    @property
    def next_segment(self) -> int:
        """Returns the index of the first segment that is not acknowledged."""
        index = 0
        while index in self.acknowledged:
            index += 1
        return index


def settle_break(folder: GuardedFolder, storage: Storage, journal: Journal, state: JournalState) -> ResumePoint:
    """Makes the journal of an interrupted run agree with its files. Returns the point from which the run continues.

    Temporary files are removed. The segment in progress keeps its finished parts. If the plan says `on_break: keep`, these parts
    count and are marked as truncated. Otherwise these parts are rejected and the segment is repeated.
    """
    found = _unknown_files(folder, storage, state)
    begun = state.open
    if begun is not None:
        parts = [*begun.parts, *found.pop((begun.index, begun.attempt), [])]
        event = {
            "segment": begun.index,
            "label": begun.label,
            "attempt": begun.attempt,
            "parts": [part.to_json() for part in parts],
        }
        if begun.on_break == "keep" and any(part.rows for part in parts):
            kept = {
                "clock": max(begun.clock, state.clock),
                "readings": {},
                "states": state.states,
                "truncated": True,
                "reason": REASON,
            }
            _append(journal, state, "segment", {**event, **kept})
        else:
            _append(journal, state, "rejected", {**event, "reason": REASON})
    for (index, attempt), parts in found.items():
        label = name_parts(Path(parts[0].file).name)
        event = {
            "segment": index,
            "label": label[1] if label else "",
            "attempt": attempt,
            "parts": [part.to_json() for part in parts],
        }
        _append(journal, state, "rejected", {**event, "reason": REASON})
    files = dict(state.created["files"]) | {part.file: part.sha256 for part in state.files()}
    return ResumePoint(
        state.clock, state.states, state.acknowledged, state.attempts, files, state.instruments, resumed=True
    )


def _append(journal: Journal, state: JournalState, kind: str, data: Mapping[str, Json]) -> None:
    journal.append(kind, data)
    state.take({"event": kind, **data})


def _unknown_files(run: GuardedFolder, storage: Storage, state: JournalState) -> dict[tuple[int, int], list[Part]]:
    """Returns the complete files of samples that the journal does not list because their event was not written. The files are
    grouped by segment and attempt."""
    known = {part.file for part in state.files()}
    found: dict[tuple[int, int], list[Part]] = {}
    folder = run.folder(FOLDER)
    for file, entry in folder.entries().items():
        if file.endswith(ASIDE) and entry.kind == "file":
            storage.remove(folder, file)
            continue
        name = f"{FOLDER}/{file}"
        place = name_parts(file)
        if place is not None and name not in known:
            part = _part(run, folder, file)
            found.setdefault((place[0], place[2]), []).append(part)
    return found


def _part(run: GuardedFolder, folder: GuardedFolder, file: str) -> Part:
    try:
        data = folder.read(file, MOST_BYTES)
        part = Part(f"{FOLDER}/{file}", digest(data), rows_of(data), len(data))
        check_part(run, part)
    except (IntegrityError, OSError, ValueError):
        raise IntegrityError(
            f"{folder.path / file}: not samples of this run: move it elsewhere, then resume again"
        ) from None
    return part

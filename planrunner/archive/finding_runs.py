"""Finds the run folders in an archive, which is a folder that contains run folders at any depth. Links are not followed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from planrunner.archive.storage import ASIDE
from planrunner.archive.verifying import SIGNS
from planrunner.base.guarded_folder import Entry, GuardedFolder

DEEPEST = 32
"""Number of levels below the archive that are searched."""


@dataclass(frozen=True, slots=True)
class FoundFolder:
    """Describes a run folder in an archive, or a folder that cannot be searched.

    `place`: path relative to the archive, with slashes. `entries`: entries of the run folder by name. `fault`: the reason why the
    folder cannot be searched; empty if it can.
    """

    place: str
    path: Path
    entries: Mapping[str, Entry] = field(default_factory=dict)
    fault: str = ""


def find_runs(archive: Path) -> Iterator[FoundFolder]:
    """Yields the run folders in an archive, in the order of their names, and the folders that cannot be searched. Raises `OSError`
    if the archive cannot be read."""
    yield from _search(GuardedFolder.open(archive), "")


def _search(folder: GuardedFolder, place: str) -> Iterator[FoundFolder]:
    entries = folder.entries()
    if not entries.keys().isdisjoint(SIGNS):
        yield FoundFolder(place or ".", folder.path, entries)
        return
    for name, entry in entries.items():
        if entry.kind != "folder" or name.endswith(ASIDE):  # a run or a log whose creation was interrupted
            continue
        inner = f"{place}/{name}" if place else name
        if inner.count("/") >= DEEPEST:
            yield FoundFolder(inner, folder.path / name, fault=f"more than {DEEPEST} folders inside one another")
            continue
        try:
            yield from _search(folder.folder(name), inner)
        except FileNotFoundError:  # removed meanwhile
            continue
        except OSError as error:
            yield FoundFolder(inner, folder.path / name, fault=f"it cannot be read: {error.strerror or error}")

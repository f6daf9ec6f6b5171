"""Manages the log of an archive. The log is an append-only Merkle tree (RFC 9162) over the runs in a folder, and reveals a removed
or replaced run.

    runs/.log/entries.jsonl   one entry per line, only ever appended: a run was begun, sealed, or taken out
    runs/.log/head.json       the tree head: number of entries and root; replaced after each entry

A leaf of the tree is a line without its line feed. An entry counts when its line is complete. If a process is killed directly after
it has written an entry, the head lacks this entry; the next entry brings the head up to date. A seal is entered into the log before
the seal is written to the run folder, so that every seal in the archive is in the log. If planrunner ends between these two steps,
the run is sealed again when it is resumed; both entries then name the same journal. In addition, run.json contains the tree head
from the time before the run. The runs therefore reveal a log that was removed or rewritten.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

from planrunner.archive import formats
from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal import utc_now
from planrunner.archive.merkle import complete_nodes, leaf_hash, root_of
from planrunner.archive.storage import ASIDE, Storage
from planrunner.base.documents import Json, JsonObject
from planrunner.base.exclusive import ExclusiveFile, HeldError
from planrunner.base.findings import InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder

FOLDER = ".log"
ENTRIES, HEAD, LOCK = "entries.jsonl", "head.json", ".lock"
MOST_BYTES = 2**28
MOST_LINE = 4096
"""Maximum size in bytes of all entries, and of one line."""
MOST_HEAD = 2**14
PATIENCE = 60.0
"""Seconds to wait for another process that is writing an entry."""

LogEvent = Literal["created", "begun", "sealed", "retired"]
"""What an entry records. `created`: the log was created (the first entry). `begun`: a run began. `sealed`: a run was sealed,
possibly again. `retired`: a run was removed from the archive for a stated reason."""


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One entry of the log.

    `seq`: number of the entry, counted from 1. `at`: time of the entry in UTC. `events`: number of events in the journal at that
    time. `head`: SHA-256 of the last of these events. `seal`: SHA-256 of seal.json, for a sealed run. `why`: reason for removing
    the run from the archive.
    """

    seq: int
    at: str
    event: LogEvent
    run: str
    events: int = 0
    head: str = ""
    seal: str = ""
    why: str = ""

    def to_json(self) -> JsonObject:
        """Returns the entry as JSON data; values that are absent are left out."""
        value = {name: getattr(self, name) for name in self.__slots__}
        return {name: item for name, item in value.items() if item not in (0, "")}

    @property
    def line(self) -> bytes:
        """Returns the leaf of the tree for this entry, which is the line in the file without the line feed."""
        return json.dumps(self.to_json(), separators=(",", ":"), ensure_ascii=False).encode("utf-8", "backslashreplace")

    @classmethod
    def from_json(cls, value: Json) -> LogEntry | None:
        """Reads an entry from JSON data; returns None if the data are not an entry."""
        if not isinstance(value, dict) or not set(value) <= set(cls.__slots__):
            return None
        numbers, texts = ("seq", "events"), ("at", "event", "run", "head", "seal", "why")
        right = all(type(value.get(name, 0)) is int for name in numbers)
        if not right or not all(isinstance(value.get(name, ""), str) for name in texts):
            return None
        try:
            entry = cls(**value)
            datetime.fromisoformat(entry.at)
        except (TypeError, ValueError):
            return None
        return entry if entry.event in get_args(LogEvent) and entry.run else None


@dataclass(frozen=True, slots=True)
class TreeHead:
    """Contains a tree head: the number of entries, the root as 64 hexadecimal digits, and the time at which the head was made, UTC."""

    size: int
    root: str
    at: str

    def to_json(self) -> JsonObject:
        return {"planrunner_tree_head": formats.HEAD_FORMAT, "size": self.size, "root": self.root, "at": self.at}

    def to_bytes(self) -> bytes:
        return formats.digested(self.to_json())

    @classmethod
    def from_json(cls, value: Mapping[str, Json]) -> TreeHead:
        return cls(value["size"], value["root"], value["at"])


def parse_head(data: bytes, path: Path) -> TreeHead:
    """Reads the tree head in a file. Raises `IntegrityError` if the file does not contain a tree head."""
    value = formats.parse_json(data, path, "tree-head", "planrunner_tree_head", formats.HEAD_FORMAT)
    formats.require_own_digest(data, value, path)
    return TreeHead.from_json(value)


@dataclass(frozen=True)
class LogContent:
    """The whole content of a log. `torn`: number of bytes in an incomplete last line. `stored`: the tree head in `head.json`; None
    if the file does not exist."""

    entries: tuple[LogEntry, ...]
    size: int
    torn: int
    stored: TreeHead | None

    @cached_property
    def leaves(self) -> tuple[bytes, ...]:
        """Returns the hashes of the entries, which are the leaves of the tree."""
        return tuple(leaf_hash(entry.line) for entry in self.entries)

    @cached_property
    def _levels(self) -> list[list[bytes]]:
        return complete_nodes(self.leaves)

    def root(self, size: int) -> str:
        """Returns the root of the tree that consists of the first `size` entries."""
        return root_of(self._levels, size).hex()

    @property
    def origin(self) -> str:
        """Returns the hash of the first entry, which identifies the log; empty if there is no entry."""
        return self.leaves[0].hex() if self.leaves else ""

    def head(self) -> TreeHead:
        """Returns the head of the tree of all entries; its time is the present time."""
        return TreeHead(len(self.entries), self.root(len(self.entries)), utc_now())


class RunLog:
    """The log of an archive. Several processes may append entries; each waits until the others have finished."""

    def __init__(self, folder: GuardedFolder, storage: Storage | None = None):
        self.folder = folder
        self._storage = storage or Storage()

    @classmethod
    def of(cls, archive: Path, storage: Storage | None = None) -> RunLog | None:
        """Returns the log of a folder that contains runs; None if the folder has no log. Raises `OSError` if the folder cannot be
        read."""
        try:
            above = GuardedFolder.open(archive)
        except FileNotFoundError:
            return None
        entry = above.entry(FOLDER)
        return None if entry is None else cls(above.folder(FOLDER), storage)

    @classmethod
    def create(cls, archive: Path, storage: Storage | None = None) -> RunLog:
        """Makes a new log. Its first entry has a random name, so that no other log begins with the same entry.

        Raises `InputError` if the folder already has a log, or if it cannot be written.
        """
        storage = storage or Storage()
        try:
            archive.mkdir(parents=True, exist_ok=True)
            above, aside = GuardedFolder.open(archive), FOLDER + ASIDE
            if above.entry(FOLDER) is not None:
                message, hint = (
                    "this archive has a log already",
                    "the existing log is kept; a log cannot be replaced by a new one",
                )
                raise InputError.at(Mark(str(archive / FOLDER)), "log-exists", message, hint)
            above.remove_folder(aside)
            made = cls(storage.make_folder(above, aside), storage)
            storage.write_whole(made.folder, ENTRIES, b"")
            storage.write_whole(made.folder, HEAD, made.read().head().to_bytes())
            made.append("created", f"log-{os.urandom(8).hex()}")
            storage.rename(above, aside, FOLDER)
            storage.sync_folder(above)
            return cls(above.folder(FOLDER), storage)
        except OSError as error:
            raise unwritable(archive, error) from None

    @property
    def path(self) -> Path:
        return self.folder.path

    def read(self) -> LogContent:
        """Reads all entries and the stored head. Raises `IntegrityError` if entries or head were changed, and `OSError` if they
        cannot be read."""
        try:  # the head first: entries can then only be more than it counts
            stored = parse_head(self.folder.read(HEAD, MOST_HEAD), self.path / HEAD)
        except FileNotFoundError:
            stored = None
        try:
            data = self.folder.read(ENTRIES, MOST_BYTES)
        except FileNotFoundError:
            message = f"{self.path / ENTRIES}: the entries of the log are missing; {formats.FROM_BACKUP}"
            raise IntegrityError(message, "log-cut") from None
        entries: list[LogEntry] = []
        size = 0
        while (end := data.find(b"\n", size)) >= 0:
            line = data[size:end]
            entry = _parsed(line)
            if entry is None or entry.line != line or entry.seq != len(entries) + 1:
                message = f"{self.path / ENTRIES}:{len(entries) + 1}: this line was changed, moved or removed after it was written"
                raise IntegrityError(f"{message}; {formats.FROM_BACKUP}", "log-changed")
            entries.append(entry)
            size = end + 1
        return LogContent(tuple(entries), size, len(data) - size, stored)

    def append(
        self, event: LogEvent, run: str, *, events: int = 0, head: str = "", seal: str = "", why: str = ""
    ) -> TreeHead:
        """Adds an entry and replaces the tree head. Raises `IntegrityError` for a log that was changed, and `OSError` if the log
        cannot be written."""
        with self.locked():
            content = self.read()
            require_growth(content, self.path)
            entry = LogEntry(len(content.entries) + 1, utc_now(), event, run, events, head, seal, why)
            line = entry.line + b"\n"
            if len(line) > MOST_LINE or content.size + len(line) > MOST_BYTES:
                raise OSError(f"{self.path}: the log is limited to {MOST_BYTES} bytes, and a line to {MOST_LINE} bytes")
            with self._storage.open_existing(self.folder, ENTRIES) as file:
                if content.torn:
                    self._storage.truncate(file, content.size)
                self._storage.write(file, line)
                self._storage.sync(file)
            grown = LogContent((*content.entries, entry), 0, 0, None).head()
            self._storage.write_whole(self.folder, HEAD, grown.to_bytes())
            return grown

    def write_beside(self, name: str, data: bytes) -> None:
        """Writes a file into the folder of the log, such as a signed head. The caller must hold the lock. Raises `OSError` if the
        file cannot be written."""
        self._storage.write_whole(self.folder, name, data)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Excludes other writers while the enclosed code runs. Raises `OSError` if another writer does not finish."""
        until = time.monotonic() + PATIENCE
        while True:
            try:
                lock = ExclusiveFile(self.path / LOCK, opened=self.folder.open_or_make(LOCK))
                break
            except HeldError:
                if time.monotonic() > until:
                    raise OSError(f"{self.path / LOCK}: other processes are still writing the log") from None
                time.sleep(0.01)
        try:
            yield
        finally:
            lock.release()


def require_growth(content: LogContent, path: Path) -> None:
    """Checks that the entries continue the tree of the stored head. Raises `IntegrityError` if the entries do not continue this
    tree."""
    head = content.stored
    if head is None:
        message = f"{path / HEAD}: the tree head of the log is missing; {formats.FROM_BACKUP}"
        raise IntegrityError(message, "log-cut")
    for code, fault in head_faults(content, head, "its own tree head"):
        raise IntegrityError(f"{path}: {fault}; {formats.FROM_BACKUP}", code)


def head_faults(content: LogContent, head: TreeHead, named: str) -> Iterator[tuple[str, str]]:
    """Yields the contradictions between the log and a tree head that was noted earlier, each as a code and a message. `named`: the
    words with which messages refer to this tree head."""
    if head.size > len(content.entries):
        yield (
            "log-cut",
            f"the log was cut: {named} records {head.size} entries, but the log has only {len(content.entries)}",
        )
    elif content.root(head.size) != head.root:
        yield "log-changed", f"the log was rewritten: its first {head.size} entries are not those of {named}"


def unwritable(archive: Path, error: OSError) -> InputError:
    """Returns the error for a log that cannot be written."""
    message = f"the log of the archive cannot be written: {error.strerror or error}"
    return InputError.at(
        Mark(str(archive / FOLDER)), "log-unwritable", message, "free disk space, or change its permissions"
    )


def _parsed(line: bytes) -> LogEntry | None:
    """Reads the entry in a line of the log; returns None if the line is not an entry."""
    try:
        value: Json = formats.from_bytes(line)
    except ValueError:
        return None
    return LogEntry.from_json(value)

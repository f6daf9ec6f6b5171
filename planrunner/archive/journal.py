"""Writes and reads the journal of a run. The journal has one event per line, and each line contains the SHA-256 of the previous
line.

A line is acknowledged when `Journal.append` returns. In durable mode, the line is then on the disk. A process that is killed during
a write leaves an incomplete last line, which was never acknowledged. This line is removed when the run is resumed. If the chain is
broken anywhere else, the file was changed, and the journal is refused. A journal is also refused if a line, the file or the number
of events exceeds the limits that planrunner observes when it writes.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Collection, Iterator, Mapping
from datetime import UTC, datetime
from functools import lru_cache
from io import BufferedReader, FileIO

from planrunner.archive.formats import IntegrityError, from_bytes
from planrunner.archive.storage import Storage
from planrunner.base.documents import Json, JsonObject
from planrunner.base.guarded_folder import GuardedFolder

NAME = "journal.jsonl"
MOST_LINE = 4 * 2**20
MOST_BYTES = 2**28
MOST_EVENTS = 2_000_000
"""Maximum size in bytes of a line and of a journal, and maximum number of events. Ten thousand segments take about ten megabytes."""
FIRST = "0" * 64
"""Placeholder for the digest in the first line."""


def utc_now() -> str:
    """Returns the current time in UTC, ISO 8601 with microseconds."""
    now = time.time_ns() // 1000
    return f"{_whole_second(now // 1_000_000)}.{now % 1_000_000:06d}+00:00"


@lru_cache(maxsize=1)
def _whole_second(seconds: int) -> str:
    """Converts a number of whole seconds since 1970-01-01 UTC to a date and time, ISO 8601, without the offset from UTC."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%S")


def _plain(value: Json) -> Json:
    """Converts numpy scalars and arrays to JSON data."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} is not JSON data")


_encode = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False, default=_plain).encode


def finite(readings: Mapping[str, float]) -> dict[str, float | None]:
    """Returns the readings in a form that JSON can represent: NaN and infinities become null."""
    return {name: value if math.isfinite(value) else None for name, value in readings.items()}


class Journal:
    """Writes a journal event by event. If `append` raises, the event does not count and its line is removed."""

    def __init__(self, storage: Storage, file: FileIO, *, head: str = FIRST, count: int = 0, size: int = 0):
        self._storage = storage
        self._file = file
        self._state = (head, count, size)
        self._broken = False
        self.last = b""
        """The line that was added last, without its line feed; its SHA-256 is the head."""

    @property
    def head(self) -> str:
        """Returns the SHA-256 of the last line of the journal."""
        return self._state[0]

    @property
    def count(self) -> int:
        return self._state[1]

    def append(self, event: str, data: Mapping[str, Json], *, acknowledge: bool = True) -> str:
        """Adds one event; returns the digest of its line.

        `acknowledge`: True to wait, in durable mode, until the event is on the disk. Use False for an event that only announces
        something; such an event reaches the disk together with the next acknowledged event. Raises `OSError`, and ValueError for
        data that JSON cannot represent.
        """
        if self._broken:
            raise OSError("the journal could not be repaired after a failed write; resume the run to repair it")
        before = self._state
        head, count, size = before
        text = _encode({"seq": count + 1, "at": utc_now(), "event": event, **data, "previous": head})
        line = text.encode("utf-8", "backslashreplace")  # a lone surrogate becomes its JSON escape
        if len(line) >= MOST_LINE or size + len(line) >= MOST_BYTES or count >= MOST_EVENTS:
            raise OSError(
                f"the journal is limited to {MOST_LINE} bytes per line, {MOST_BYTES} bytes and {MOST_EVENTS} events: "
                "record the rest in another run"
            )
        try:
            self._storage.write(self._file, line + b"\n")
            if acknowledge:
                self._storage.sync(self._file)
            self._state = (hashlib.sha256(line).hexdigest(), count + 1, size + len(line) + 1)
            self.last = line
        except BaseException:
            self._take_back(before)
            raise
        return self._state[0]

    def _take_back(self, state: tuple[str, int, int]) -> None:
        self._state = state
        try:
            self._storage.truncate(self._file, state[2])
        except BaseException:
            self._broken = True
            raise

    def close(self) -> None:
        self._file.close()


class JournalScan:
    """Reads a journal and checks the chain of its lines.

    Iterate once over the events; after that, `head`, `count`, `size`, `torn`, `heads` and `digests` are known. `size`: number of
    bytes in complete lines. `torn`: number of bytes in an incomplete last line. `marks`: numbers of events after which the state of
    the chain is stored. `heads`: maps each number in `marks` to the head of the chain after this number of events. `digests`: maps
    the same numbers to the SHA-256 of the file after this number of events. Head and SHA-256 are also stored before each event
    `reopened`. `times`: maps each number in `marks` to the time of the event with this number. `name`: name of the file, for
    messages. Raises `IntegrityError` if the chain is broken, and `OSError` if the file cannot be read.
    """

    def __init__(self, folder: GuardedFolder, marks: Collection[int] = (), name: str = NAME):
        self.folder = folder
        self.name = name
        self.path = folder.path / name
        self.head = FIRST
        self.count = 0
        self.size = 0
        self.torn = 0
        self.heads: dict[int, str] = {0: FIRST}
        self.digests: dict[int, str] = {}
        self.times: dict[int, str] = {}
        self._whole = hashlib.sha256()
        self._marks = frozenset(marks)

    def __iter__(self) -> Iterator[JsonObject]:
        with self.folder.open_file(self.name, MOST_BYTES) as file:
            while line := file.readline(MOST_LINE + 1):
                if len(line) > MOST_LINE:
                    raise self._error(f"is longer than the {MOST_LINE} bytes that a line can have")
                if not line.endswith(b"\n") or b"\0" in line:  # a power failure may leave zeros in place of a line
                    self.torn = len(line)
                    if file.read(1) or _two_lines(line):
                        raise self._error("is damaged")
                    return
                if self.count >= MOST_EVENTS:
                    raise self._error(f"is beyond the {MOST_EVENTS} events that a journal can have")
                event = self._event(line)
                if event.get("seq") != self.count + 1:
                    raise self._misplaced(event.get("seq"), file)
                if event.get("previous") != self.head:
                    raise self._error("does not contain the digest of the preceding line")
                if event.get("event") == "reopened":
                    self.heads[self.count] = self.head
                    self.digests[self.count] = self._whole.hexdigest()
                self.head = hashlib.sha256(line[:-1]).hexdigest()
                self.count += 1
                self.size += len(line)
                self._whole.update(line)
                if self.count in self._marks:
                    self.heads[self.count] = self.head
                    self.digests[self.count] = self._whole.hexdigest()
                    self.times[self.count] = str(event.get("at", ""))  # not yet checked against the schema
                yield event

    def _event(self, line: bytes) -> JsonObject:
        try:
            event = from_bytes(line)
        except ValueError:
            event = None
        if not isinstance(event, dict):
            raise self._error("is not a JSON object")
        return event

    def _misplaced(self, number: Json, rest: BufferedReader) -> IntegrityError:
        """Returns the error for a line whose number does not match its position. Such a line shows that lines were removed,
        inserted or exchanged."""
        expected = self.count + 1
        what = f"has the number {str(number)[:20]}, but {expected} is expected here"
        if type(number) is not int:
            return self._error(what)
        if number <= self.count:
            return self._error(f"{what}: a line was inserted or moved", "run-reordered")
        wanted = b'"seq":%d,' % expected  # as a journal is written
        later = any(wanted in line[:40] for line in iter(lambda: rest.readline(MOST_LINE + 1), b""))
        if later:
            return self._error(f"{what}, which is further down: lines were exchanged", "run-reordered")
        return self._error(f"{what}: lines are missing", "run-cut-short")

    def _error(self, what: str, code: str = "run-changed") -> IntegrityError:
        return IntegrityError(
            f"{self.path}:{self.count + 1}: this line {what}: the journal was changed after it was written; "
            "restore the run folder from a backup",
            code,
        )


def _two_lines(line: bytes) -> bool:
    """Returns True if there are zero bytes between a complete line and a line end. The complete line was then acknowledged, so the
    zero bytes are not the trace of an interrupted write."""
    first, zeros, _ = line.partition(b"\0")
    if not zeros or not line.endswith(b"\n"):
        return False
    try:
        from_bytes(first)
    except ValueError:
        return False
    return True

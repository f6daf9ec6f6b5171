"""Determines the state that a journal describes: the acknowledged segments, their files, and the point at which the run was
interrupted."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field

from planrunner.archive import formats
from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal import JournalScan
from planrunner.archive.segment_file import Part
from planrunner.base.documents import Json, JsonObject
from planrunner.base.guarded_folder import GuardedFolder, NotOrdinaryError

MOST_TURNS = 1000
"""Maximum number of stored places at which the time goes back."""


@dataclass(frozen=True, slots=True)
class Acknowledged:
    """Describes a segment that counts: its files and its readings. If the segment is shorter than planned, also gives the
    reason."""

    index: int
    label: str
    attempt: int
    parts: tuple[Part, ...]
    readings: Mapping[str, float | None]
    truncated: bool = False
    reason: str = ""


@dataclass(slots=True)
class Begun:
    """A segment that was begun but neither acknowledged nor rejected, because the process ended during it."""

    index: int
    label: str
    attempt: int
    on_break: str
    parts: list[Part] = field(default_factory=list)
    clock: float = 0.0


@dataclass(frozen=True, slots=True)
class Rejected:
    """Describes data of a segment that are stored but do not count, with the reason."""

    index: int
    label: str
    attempt: int
    parts: tuple[Part, ...]
    reason: str


@dataclass(slots=True)
class JournalState:
    """Contains the state of a run as its journal describes it. Resuming and verifying a run begin from this state.

    `clock`, `states`: time and states that were stored with the last acknowledged segment; the run can be resumed from them.
    `open`: the segment during which the process ended; None if the process ended between segments. `earlier_seals`: maps the
    SHA-256 of each seal that the run had before it was reopened to the number of events at the reopening. `turning_times`: number
    and time of certain events: the first, the last, and the two events before and after each step back in time. `planned`: number
    of segments in the schedule; 0 if the run never started. `stamped`, `unstamped`: the events about time stamps that were
    obtained, and the events about time stamps that could not be obtained. `unstamped_ends`: numbers of certain events `finished`.
    At such an event, a part of the journal had no time stamp, and no event explained why. `renewals`: the time of each event that
    reopened the run with further approvals, and the entries of these approvals. `standards`: for each event that reopened the run
    on a bench with a check standard, the time of the event and the state of the check standard at that time.
    """

    created: JsonObject = field(default_factory=dict)
    acknowledged: dict[int, Acknowledged] = field(default_factory=dict)
    rejected: list[Rejected] = field(default_factory=list)
    attempts: dict[int, int] = field(default_factory=dict)
    instruments: dict[str, dict[str, str]] = field(default_factory=dict)
    open: Begun | None = None
    clock: float = 0.0
    states: Mapping[str, Json] = field(default_factory=dict)
    finished: bool = False
    earlier_seals: dict[str, int] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    turning_times: list[tuple[int, str]] = field(default_factory=list)
    planned: int = 0
    stamped: list[JsonObject] = field(default_factory=list)
    unstamped: list[JsonObject] = field(default_factory=list)
    unstamped_ends: list[int] = field(default_factory=list)
    renewals: list[tuple[str, list[JsonObject]]] = field(default_factory=list)
    standards: list[tuple[str, JsonObject]] = field(default_factory=list)
    _covered: int = 0
    _end_of_others: int = 0

    def files(self) -> Iterator[Part]:
        """Yields every file of samples that the journal lists, including those that do not count."""
        for item in self.acknowledged.values():
            yield from item.parts
        for rejected in self.rejected:
            yield from rejected.parts
        if self.open is not None:
            yield from self.open.parts

    def take(self, event: Mapping[str, Json]) -> None:
        """Updates the state according to one event of the journal."""
        kind = event["event"]
        handler = getattr(self, f"_{kind}", None)
        if handler is not None:
            handler(event)
        if kind not in ("stamped", "unstamped"):
            self._end_of_others = event.get("seq", self._end_of_others)

    def take_time(self, number: int, at: str) -> None:
        """Updates `turning_times` according to one event of the journal. All events state the time in the same form, so that the
        alphabetical order of the texts is the order of the times."""
        kept = self.turning_times
        rising = len(kept) > 1 and kept[-2][1] <= kept[-1][1] <= at
        if rising or len(kept) > MOST_TURNS:
            kept[-1] = (number, at)
        else:
            kept.append((number, at))

    def _created(self, event: Mapping[str, Json]) -> None:
        self.created = dict(event)

    def _instruments(self, event: Mapping[str, Json]) -> None:
        self.instruments = {name: dict(identity) for name, identity in event["instruments"].items()}

    def _started(self, event: Mapping[str, Json]) -> None:
        self.planned = event["segments"]

    def _begun(self, event: Mapping[str, Json]) -> None:
        index = event["segment"]
        self.attempts[index] = max(self.attempts.get(index, 0), event["attempt"])
        self.open = Begun(index, event["label"], event["attempt"], event["on_break"], clock=event["clock"])
        self.finished = False

    def _part(self, event: Mapping[str, Json]) -> None:
        if self.open is not None and self.open.index == event["segment"]:
            self.open.parts.append(Part.from_json(event["part"]))
            self.open.clock = event["clock"]

    def _segment(self, event: Mapping[str, Json]) -> None:
        index = event["segment"]
        parts = tuple(Part.from_json(part) for part in event["parts"])
        self.acknowledged[index] = Acknowledged(
            index,
            event["label"],
            event["attempt"],
            parts,
            event["readings"],
            event["truncated"],
            event.get("reason", ""),
        )
        self.clock, self.states, self.open = event["clock"], event["states"], None

    def _rejected(self, event: Mapping[str, Json]) -> None:
        index = event["segment"]
        parts = tuple(Part.from_json(part) for part in event["parts"])
        self.attempts[index] = max(self.attempts.get(index, 0), event["attempt"])
        self.rejected.append(Rejected(index, event["label"], event["attempt"], parts, event["reason"]))
        counted = self.acknowledged.get(index)
        if counted is not None and (counted.attempt, counted.parts) == (event["attempt"], parts):
            del self.acknowledged[index]
        if self.open is not None and self.open.index == index:
            self.open = None

    def _failed(self, event: Mapping[str, Json]) -> None:
        self.failures.append(f"{event['where']}: {event['message']}")

    def _finished(self, event: Mapping[str, Json]) -> None:
        self.finished = True
        if self._covered < self._end_of_others:
            self.unstamped_ends.append(event["seq"])

    def _stamped(self, event: Mapping[str, Json]) -> None:
        self.stamped.append(dict(event))
        self._covered = max(self._covered, event["events"])

    def _unstamped(self, event: Mapping[str, Json]) -> None:
        self.unstamped.append(dict(event))
        self._covered = max(self._covered, event["events"])

    def _reopened(self, event: Mapping[str, Json]) -> None:
        self.finished = False
        if "seal" in event:
            self.earlier_seals[event["seal"]] = event["seq"] - 1
        if "approvals" in event:
            self.renewals.append((event["at"], [dict(one) for one in event["approvals"]]))
        if "check_standard" in event:
            self.standards.append((event["at"], dict(event["check_standard"])))


def read_state(folder: GuardedFolder, marks: Collection[int] = ()) -> tuple[JournalState, JournalScan]:
    """Reads a journal; returns the state that it describes, and the scan, which has the journal's head and size. `marks`: numbers
    of events after which the scan stores the head of the chain. Raises `IntegrityError` if the journal was changed."""
    scan = JournalScan(folder, marks)
    state, path = JournalState(), scan.path
    try:
        for event in scan:
            fault = formats.event_fault(event)
            if fault is None and (scan.count == 1) != (event["event"] == "created"):
                fault = "is in the wrong place: the first event, and no other, describes the creation of the run"
            if fault is not None:
                raise IntegrityError(
                    f"{path}:{scan.count}: this event {fault}; was it written by a newer version of planrunner?"
                )
            state.take_time(event["seq"], event["at"])
            state.take(event)
    except NotOrdinaryError as error:
        raise IntegrityError(f"{path}: {error.strerror}; {formats.FROM_BACKUP}") from None
    except OSError as error:
        code = "run-file-missing" if isinstance(error, FileNotFoundError) else "run-changed"
        raise IntegrityError(f"{path}: cannot be read: {error.strerror}; is this a run folder?", code) from None
    if not state.created:
        raise IntegrityError(f"{path}: the journal is empty: the run never began; start it again")
    return state, scan


_FILE = re.compile(r"(?P<number>\d{4,})-(?P<label>.+?)(?:\.try(?P<attempt>\d+))?(?:\.part\d+)?\.parquet")


def name_parts(name: str) -> tuple[int, str, int] | None:
    """Splits the name of a file of samples into (index, label, attempt); returns None for any other file."""
    match = _FILE.fullmatch(name)
    return (int(match["number"]) - 1, match["label"], int(match["attempt"] or 1)) if match else None

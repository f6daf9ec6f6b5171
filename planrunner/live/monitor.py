"""Finds the runs of an archive that are in progress, and carries out a person's requests: to pause a run, to continue a run, or to
confirm a prompt.

Runs are executed by other processes. A run with a live state counts as running if the live state changes, or if the run folder is
locked. The lock is tested as rarely as possible, because each test holds the lock for a moment.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Literal

from planrunner.archive import formats, pausing
from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal import NAME as JOURNAL
from planrunner.archive.journal_state import read_state
from planrunner.archive.live import LONGEST_NAME, NAME, Answer, LiveState, read_live, write_answer
from planrunner.archive.verifying import MOST_GIVEN, RUN
from planrunner.base.documents import JsonObject
from planrunner.base.findings import InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder

SILENT = 5.0
"""If no new state appears for this time, s, the monitor checks whether the run is still locked."""
RECENT = 20
"""Maximum number of listed runs that are not in progress."""

RunOutcome = Literal["finished", "not finished", "unreadable"]


@dataclass(frozen=True, slots=True)
class RunHeader:
    """Data of a run from its run.json. All texts are empty if the file cannot be read.

    `started`: time at which the run began, UTC, ISO 8601."""

    run: str
    plan: str = ""
    device: str = ""
    operator: str = ""
    started: str = ""

    def to_json(self) -> JsonObject:
        return {
            "run": self.run,
            "plan": self.plan,
            "device": self.device,
            "operator": self.operator,
            "started": self.started,
        }


@dataclass(frozen=True, slots=True)
class RunningRun:
    """A run that is in progress. `asked_to_pause`: True if a pause is requested, even if the pause has not begun."""

    header: RunHeader
    state: LiveState
    asked_to_pause: bool

    def to_json(self) -> JsonObject:
        return {**self.header.to_json(), "asked_to_pause": self.asked_to_pause, "live": self.state.to_json()}


@dataclass(frozen=True, slots=True)
class RecentRun:
    """A recent run that is not in progress. `segments`: number of recorded segments. `reason`: the last failure in the journal;
    empty if there is none."""

    header: RunHeader
    outcome: RunOutcome
    segments: int
    reason: str

    def to_json(self) -> JsonObject:
        return {**self.header.to_json(), "outcome": self.outcome, "segments": self.segments, "reason": self.reason}


@dataclass(frozen=True, slots=True)
class Activity:
    """The runs of an archive at one moment, the newest first."""

    running: tuple[RunningRun, ...]
    recent: tuple[RecentRun, ...]

    def to_json(self) -> JsonObject:
        return {
            "planrunner_activity": 1,
            "running": [one.to_json() for one in self.running],
            "recent": [one.to_json() for one in self.recent],
        }


@dataclass(slots=True)
class _Pulse:
    """The last live state of a run.

    `at`: time stamp of this live state. `seen`: time at which this live state was first read, s. `alive`: True if the folder of the
    run was locked; None if this has not been tested for this live state.
    """

    at: str
    seen: float
    alive: bool | None = None


class Monitor:
    """Observes an archive. Raises `InputError` if the archive is not a folder. A monitor may be used from several threads."""

    def __init__(self, archive: Path):
        try:
            self._archive = GuardedFolder.open(archive)
        except OSError as error:
            raise InputError.at(
                Mark(str(archive)),
                "archive-not-found",
                f"this folder cannot be opened: {error.strerror or error}",
                "give the folder that contains the run folders, such as runs",
            ) from None
        self.path = archive
        self._lock = threading.Lock()
        self._pulses: dict[str, _Pulse] = {}
        self._headers: dict[str, RunHeader] = {}
        self._recent: dict[str, tuple[int, RecentRun]] = {}

    # -- looking -----------------------------------------------------------------------------------------------------

    def look(self) -> Activity:
        """Returns the runs at present, in progress and recent. A folder that cannot be read is omitted."""
        with self._lock:
            names = self._names()
            running = [one for name in names if self._has_live(name) and (one := self._running(name)) is not None]
            kept = {one.header.run for one in running}
            self._pulses = {name: pulse for name, pulse in self._pulses.items() if self._has_live(name)}
            recent = (ended for name in names if name not in kept and (ended := self._ended(name)) is not None)
            return Activity(tuple(running), tuple(islice(recent, RECENT)))

    def _names(self) -> list[str]:
        """Returns the names of the run folders, the newest run first. The names sort by time, because each begins with the time of
        its run."""
        try:
            with os.scandir(self.path) as listed:
                names = [item.name for item in listed if not item.name.startswith(".") and item.is_dir()]
        except OSError:
            return []
        return sorted(names, reverse=True)

    def _has_live(self, name: str) -> bool:
        """Returns True if a folder seems to have a live state. The check is quick; the file itself is opened later, with all
        precautions."""
        return os.path.lexists(self.path / name / NAME)

    def _running(self, name: str) -> RunningRun | None:
        try:
            folder = self._archive.folder(name)
            state = read_live(folder)
            if state is None or not self._alive(name, folder, state.at):
                return None
            return RunningRun(self._header(name, folder), state, pausing.asked_to_pause(folder))
        except OSError:
            return None

    def _alive(self, name: str, folder: GuardedFolder, at: str) -> bool:
        now = time.monotonic()
        pulse = self._pulses.get(name)
        if pulse is None or pulse.at != at:
            first = pulse is None
            pulse = self._pulses[name] = _Pulse(at, now)
            if not first:
                return True
        elif pulse.alive is False:
            return False
        elif now - pulse.seen < SILENT:
            return True
        pulse.alive = pausing.is_written(folder)
        return pulse.alive

    def _header(self, name: str, folder: GuardedFolder) -> RunHeader:
        if name not in self._headers:
            self._headers[name] = _read_header(name, folder)
        return self._headers[name]

    def _ended(self, name: str) -> RecentRun | None:
        """Describes a recent run that is not in progress. The journal of such a run is read again only if it has grown."""
        try:
            folder = self._archive.folder(name)
            journal = folder.entry(JOURNAL)
            if journal is None:
                return None
            known = self._recent.get(name)
            if known is not None and known[0] == journal.size:
                return known[1]
            ended = _outcome(self._header(name, folder), folder)
            self._recent[name] = journal.size, ended
            return ended
        except OSError:
            return None

    # -- acting ------------------------------------------------------------------------------------------------------

    def pause(self, run: str) -> None:
        """Asks a running run to pause. Raises `InputError` if the run is not in progress."""
        folder = self._written(run)
        try:
            pausing.ask_to_pause(folder)
        except OSError as error:
            raise self._refused(run, f"the run folder cannot be written: {error.strerror or error}") from None

    def go_on(self, run: str) -> None:
        """Continues a paused run, or withdraws the request for a pause. Raises `InputError` if the run is not in progress."""
        folder = self._written(run)
        try:
            pausing.take_back(folder)
        except OSError as error:
            raise self._refused(run, f"the run folder cannot be written: {error.strerror or error}") from None

    def answer(self, run: str, question: str, by: str) -> None:
        """Confirms the prompt that a run shows. `by`: name of the person. Raises `InputError` if the run shows no such prompt."""
        folder = self._written(run)
        name = " ".join(by.split())
        if not name or len(name) > LONGEST_NAME or not name.isprintable():
            raise self._refused(run, f"give a name of 1 to {LONGEST_NAME} printable characters with the answer")
        state = read_live(folder)
        if state is None or state.question is None or state.question.id != question:
            raise self._refused(run, "this prompt is no longer open")
        try:
            write_answer(folder, Answer(question, name))
        except OSError as error:
            raise self._refused(run, f"the run folder cannot be written: {error.strerror or error}") from None

    def _written(self, run: str) -> GuardedFolder:
        """Opens the folder of a run that a process is writing."""
        try:
            folder = self._archive.folder(run)
            if read_live(folder) is not None and pausing.is_written(folder):
                return folder
        except (OSError, ValueError):  # no folder, or not a name
            pass
        raise self._refused(run, "no process is writing this run")

    def _refused(self, run: str, message: str) -> InputError:
        return InputError.at(Mark(str(self.path)), "run-not-running", f"run {run[:200]!r}: {message}")


def _read_header(name: str, folder: GuardedFolder) -> RunHeader:
    try:
        run = formats.parse_json(
            folder.read(RUN, MOST_GIVEN), folder.path / RUN, "run", "planrunner_run", formats.RUN_FORMAT
        )
    except (OSError, IntegrityError):
        return RunHeader(name)
    info: Mapping[str, object] = run["info"]
    device, operator = info.get("device_serial", ""), info.get("operator", "")
    return RunHeader(name, str(run["plan"]), str(device), str(operator), str(run["created"]))


def _outcome(header: RunHeader, folder: GuardedFolder) -> RecentRun:
    try:
        state, _ = read_state(folder)
    except IntegrityError as error:
        return RecentRun(header, "unreadable", 0, str(error)[:300])
    reason = "" if state.finished or not state.failures else state.failures[-1]
    return RecentRun(header, "finished" if state.finished else "not finished", len(state.acknowledged), reason)

"""Runs the tests of a suite at night, unattended. Each test runs in a separate process. A night that was interrupted can be
continued where it stopped.

The rules that decide when each test runs are in `planrunner.night.timetable`. The night continues after an event only when the
event has been written to the night's journal. After a kill or a power failure, the journal and the run folders show where the
night stopped. The id of a run folder is written to the journal before the process of the run starts, so that no run folder is
lost.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import platform
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path

from planrunner import __version__
from planrunner.archive.formats import IntegrityError, from_bytes, to_bytes
from planrunner.archive.journal import Journal, JournalScan
from planrunner.archive.seal import NAME as SEAL
from planrunner.archive.segment_file import safe_name
from planrunner.archive.space import shortage
from planrunner.archive.storage import Storage
from planrunner.base.documents import Json, JsonObject
from planrunner.base.exclusive import ExclusiveFile, HeldError
from planrunner.base.findings import InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.base.processes import ProcessEndedError
from planrunner.bench.model import read_bench
from planrunner.execution.stopping import StopRequest
from planrunner.night.civil_time import Opening, civil, shown_time
from planrunner.night.expansion import PlannedTest, known_failure
from planrunner.night.junit import to_junit
from planrunner.night.notify import NotificationError, receiver, send, wanted
from planrunner.night.record import FAULT, FOLDER, INTERRUPTED, RECORD, NightRecord, StateOfTest
from planrunner.night.suite import Notification
from planrunner.night.summary import headline, summary
from planrunner.night.timetable import Begin, BenchHours, EndOfTest, NightCourse, NightHours
from planrunner.tasks.check_standard import control_state
from planrunner.tasks.check_suite import SoundSuite, bench_file
from planrunner.tasks.diagnose_night import diagnose_night

JOURNAL = "night.jsonl"
RESERVE = "reserve"
DIAGNOSIS_LOG = "diagnosis.txt"
"""File in the folder `logs` that contains the traceback of a diagnosis with an internal error."""
RESERVE_BYTES = 2**20
"""Disk space in bytes that is reserved for the record of a night. The space is released if the disk becomes full."""
MOST_RECORD = 2**26
CLOCK_TOLERANCE = 5.0
"""Largest adjustment of the computer's clock that is not reported, s."""
OVERDUE_FACTOR, OVERDUE_PAUSE = 1.5, 1800.0
"""Time limit of a test on a real bench: the planned duration multiplied by `OVERDUE_FACTOR`, plus `OVERDUE_PAUSE` [s]."""
CONTINUED_WITHIN = 24 * 3600.0
"""An unfinished night can be continued within this time after its last event, s."""


class NightClock:
    """Gives the time of a night. This time never goes back.

    Simulated time advances only when `advance` is called. Real time is measured from the start of this process with the
    computer's monotonic clock. If someone sets the computer's clock forward, the time of the night advances by the same amount;
    if someone sets it back, the time of the night does not change. `jump`: called with the number of seconds by which the
    computer's clock was set.
    """

    def __init__(
        self,
        start: float,
        *,
        virtual: bool,
        jump: Callable[[float], None],
        wall: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
    ):
        self.virtual = virtual
        self._now = start
        self._jump, self._wall, self._monotonic = jump, wall, monotonic
        self._wall_before, self._before = wall(), monotonic()

    def now(self) -> float:
        if not self.virtual:
            wall, monotonic = self._wall(), self._monotonic()
            passed = monotonic - self._before
            step = wall - self._wall_before - passed
            self._wall_before, self._before = wall, monotonic
            if abs(step) > CLOCK_TOLERANCE:
                self._jump(step)
            self._now += passed + (step if step > CLOCK_TOLERANCE else 0.0)
        return self._now

    def advance(self, instant: float) -> None:
        if self.virtual:
            self._now = max(self._now, instant)


@dataclass(frozen=True, slots=True)
class NightOptions:
    """Contains the options of a night.

    `runs`: folder of the archive. `tell`: called with each line of progress. `program`: the command that starts planrunner.
    """

    runs: Path
    data: Path | None = None
    flushed: bool = False
    new: bool = False
    tell: Callable[[str], None] = print
    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)
    program: tuple[str, ...] = (sys.executable, "-m", "planrunner")


@dataclass(frozen=True, slots=True)
class NightResult:
    """Contains the result of a night. `folder`: folder with the records of the night. `trouble`: the reason why the record could
    not be written; empty if it was written."""

    folder: Path
    record: JsonObject
    exit_code: int
    trouble: str = ""


_RESULTS: dict[EndOfTest, StateOfTest] = {
    EndOfTest.PASSED: "passed",
    EndOfTest.LIMIT: "failed",
    EndOfTest.FAULT: "fault",
    EndOfTest.REFUSED: "refused",
}


@dataclass(slots=True)
class _Child:
    process: subprocess.Popen[bytes]
    output: FileIO
    identity: str
    kind: str
    begins: float
    ends: float
    """Planned end of the night."""
    overdue: bool = False


def run_night(sound: SoundSuite, options: NightOptions, stop: StopRequest) -> NightResult:
    """Runs the tests of a suite, or continues an unfinished night of this suite. Raises `InputError` if the night cannot begin."""
    folder, storage = _archive(options), Storage("flushed" if options.flushed else "durable")
    digest = hashlib.sha256(sound.data).hexdigest()
    with _Lock(folder, f".{digest[:24]}.lock", sound.file):
        night = None if options.new else _unfinished(folder, digest, sound, options, storage)
        night = night or _created(folder, digest, sound, options, storage)
        try:
            return night.run(stop)
        finally:
            night.close()


def _archive(options: NightOptions) -> GuardedFolder:
    try:
        (options.runs / FOLDER).mkdir(parents=True, exist_ok=True)
        return GuardedFolder.open(options.runs / FOLDER)
    except OSError as error:
        message = f"the folder for nights cannot be written: {error.strerror or error}"
        hint = "choose another folder with --runs, or change its permissions"
        raise InputError.at(Mark(str(options.runs / FOLDER)), "night-unwritable", message, hint) from None


class _Lock:
    """Locks an archive, so that only one night of a suite runs in it at a time. Different suites may run at the same time."""

    def __init__(self, folder: GuardedFolder, name: str, shown: str):
        note = f"process {os.getpid()}, since {datetime.now().astimezone().isoformat(timespec='seconds')}"
        try:
            self._file = ExclusiveFile(folder.path / name, note, opened=folder.open_or_make(name))
        except HeldError as error:
            message = f"this suite is already running in this archive: {error or 'another process'}"
            hint = "wait until it ends, or use another archive with --runs"
            raise InputError.at(Mark(shown), "night-in-use", message, hint) from None
        except OSError as error:
            message = f"the night cannot be locked: {error.strerror or error}"
            raise InputError.at(
                Mark(shown), "night-unwritable", message, "change the permissions of the archive"
            ) from None

    def __enter__(self) -> _Lock:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.release()


def _created(nights: GuardedFolder, digest: str, sound: SoundSuite, options: NightOptions, storage: Storage) -> _Night:
    hours, now = sound.forecast.hours, datetime.now(UTC)
    name = f"{now:%Y%m%dT%H%M%SZ}-{safe_name(Path(sound.file).stem)}-{os.urandom(3).hex()}"
    foreseen, slots = dict(sound.forecast.left_out), sound.forecast.slots_of_tests
    tests: list[Json] = []
    for test, seconds in zip(sound.tests, sound.durations, strict=True):
        slot = slots.get(test.index)
        times = (
            None
            if slot is None
            else [civil(at, sound.zone).isoformat(timespec="seconds") for at in (slot.begins, slot.ends)]
        )
        tests.append(
            {
                "test": test.name,
                "entry": test.entry,
                "plan": str(test.file),
                "device": test.device,
                "bench": test.bench,
                "parameters": test.values,
                "seconds": seconds,
                "foreseen": times,
                "foreseen_obstacle": foreseen.get(test.index, ""),
            }
        )
    created = {
        "night": name,
        "suite": sound.file,
        "title": sound.suite.title,
        "digest": digest,
        "clock": "virtual" if sound.virtual else "wall",
        "host": platform.node(),
        "planrunner": __version__,
        "begins": hours.begins,
        "closes": hours.closes if math.isfinite(hours.closes) else None,
        "benches": {
            bench: None if about.openings is None else [[one.opens, one.closes] for one in about.openings]
            for bench, about in hours.benches.items()
        },
        "foreseen_end": sound.forecast.ends,
        "tests": tests,
        "now": hours.begins if sound.virtual else time.time(),
    }
    try:
        folder = storage.make_folder(nights, name)
        storage.make_folder(folder, "logs")
        storage.write_whole(folder, "suite.yaml", sound.data)
        storage.write_whole(folder, RESERVE, bytes(RESERVE_BYTES))
        journal = Journal(storage, storage.open_new(folder, JOURNAL))
        journal.append("created", created)
        storage.sync_folder(folder)
        storage.sync_folder(nights)
    except OSError as error:
        message = f"the night cannot be written: {error.strerror or error}"
        raise InputError.at(
            Mark(str(nights.path / name)),
            "night-unwritable",
            message,
            "free disk space, or choose another folder with --runs",
        ) from None
    record = NightRecord(sound.zone)
    record.take({"event": "created", **created})
    return _Night(sound, options, storage, folder, journal, record, hours)


def _unfinished(
    nights: GuardedFolder, digest: str, sound: SoundSuite, options: NightOptions, storage: Storage
) -> _Night | None:
    """Returns the newest night of this suite that has not ended according to its journal; None if no such night can be continued.
    Other unfinished nights are closed."""
    found: _Night | None = None
    for name, entry in reversed(nights.entries().items()):
        if entry.kind != "folder":
            continue
        try:
            night = _reopened(nights.folder(name), digest, sound, options, storage)
        except (OSError, IntegrityError, KeyError, ValueError) as error:
            options.tell(f"{nights.path / name}: this night cannot be read and is left as it is: {error}")
            continue
        if night is None:
            continue
        if found is None and night.can_go_on():
            found = night
        else:
            night.give_up()
            night.close()
    return found


def _reopened(
    folder: GuardedFolder, digest: str, sound: SoundSuite, options: NightOptions, storage: Storage
) -> _Night | None:
    """Opens the night in a folder; returns None if the night belongs to another suite or has ended."""
    record = NightRecord(sound.zone)
    scan = JournalScan(folder, name=JOURNAL)
    for event in scan:
        record.take(event)
        if scan.count == 1 and record.created.get("digest") != digest:
            return None
    if record.state in ("finished", "abandoned") or not record.created:
        return None
    created = record.created
    hours = NightHours(
        created["begins"],
        math.inf if created["closes"] is None else created["closes"],
        {
            bench: BenchHours(
                None if given is None else tuple(Opening(*one) for one in given), about.warm_up, about.stays_warm
            )
            for bench, about in sound.forecast.hours.benches.items()
            for given in [created["benches"][bench]]
        },
    )
    file = storage.open_existing(folder, JOURNAL)
    storage.truncate(file, scan.size)  # an event that was not written completely never counted
    journal = Journal(storage, file, head=scan.head, count=scan.count, size=scan.size)
    return _Night(sound, options, storage, folder, journal, record, hours, continued=True)


class _Night:
    """Represents a night while it is running."""

    def __init__(
        self,
        sound: SoundSuite,
        options: NightOptions,
        storage: Storage,
        folder: GuardedFolder,
        journal: Journal,
        record: NightRecord,
        hours: NightHours,
        *,
        continued: bool = False,
    ):
        self._sound, self._options, self._storage = sound, options, storage
        self._folder, self._journal, self._record = folder, journal, record
        self._logs = folder.folder("logs")
        self._continued = continued
        self._course = NightCourse(sound.tests, sound.durations, hours, sound.zone)
        self._children: dict[int, _Child] = {}
        self._ended: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._gone: set[int] = set()
        self._begun_before: dict[int, str] = {}
        """For each test, the id of the run that must be continued."""
        self._waited: set[int] = set()
        self._trouble = ""
        self._told_to_stop = 0
        start = max(record.now, hours.begins) if sound.virtual else max(record.now, time.time())
        if not sound.virtual and time.time() < record.now - CLOCK_TOLERANCE:
            self._behind = record.now - time.time()
        else:
            self._behind = 0.0
        self._clock = NightClock(start, virtual=sound.virtual, jump=self._jumped)

    # -- the whole night -------------------------------------------------------------------------------------------------

    def can_go_on(self) -> bool:
        """Returns True if an interrupted night can still be continued: its closing time has not been reached and, on real
        benches, its last event is recent enough."""
        now = self._clock.now()
        return now < self._course.hours.closes and (self._sound.virtual or now - self._record.now < CONTINUED_WITHIN)

    def give_up(self) -> None:
        """Closes a night that has not been continued."""
        for index, test in enumerate(self._record.tests):
            if test.state in ("waiting", "running"):
                self._log("not_run", {"test": index, "reason": "the night was interrupted and not continued"})
        self._finish("abandoned", FAULT)

    def run(self, stop: StopRequest) -> NightResult:
        self._begin()
        try:
            self._loop(stop)
        finally:
            self._end_children()
        if stop.after_segment and any(test.state in ("waiting", "running") for test in self._record.tests):
            self._log("interrupted", {"reason": stop.reason})
            self._write_reports()
            return NightResult(self._folder.path, self._record.to_json(), INTERRUPTED, self._trouble)
        self._diagnose()
        code = FAULT if self._trouble else self._record.verdict()
        self._finish("finished", code)
        return NightResult(self._folder.path, self._record.to_json(), code, self._trouble)

    def _diagnose(self) -> None:
        """Diagnoses the runs of the night together with recent runs. The diagnosis is not a test: the results of the night remain
        valid even if the diagnosis fails."""
        asked = self._sound.suite.diagnosis
        if asked is None or self._trouble or self._record.fleet:
            return
        self._options.tell("diagnosing the runs")
        runs = [attempt.run for test in self._record.tests for attempt in test.attempts if attempt.run is not None]
        try:
            for found, remark in diagnose_night(self._options.runs, runs, asked):
                if found is not None:
                    self._log("fleet", found)
                if remark:
                    self._remark(f"diagnosis of {remark}")
        except (InputError, IntegrityError, ProcessEndedError, OSError) as error:
            self._remark(f"the runs could not be diagnosed: {error}")
        except Exception as error:
            with contextlib.suppress(OSError):
                trace = "".join(traceback.format_exception(error)).encode("utf-8", "backslashreplace")
                self._storage.write_whole(self._logs, DIAGNOSIS_LOG, trace)
            what = f"internal error: {type(error).__name__}: {error}; see logs/{DIAGNOSIS_LOG}"
            self._remark(f"the runs could not be diagnosed: {what}")

    def _tell_overrides(self) -> None:
        """Records, for the wall display and the report, who permits tests although a check standard is not in control."""
        for name, about in self._sound.suite.benches.items():
            given = about.override_check_standard
            if given is None:
                continue
            bench = read_bench(bench_file(self._sound.suite, self._sound.file, name), Path())[0]
            known = "" if bench.approvals is not None else " (name not authenticated)"
            self._remark(f"bench {name}: {given.by}{known} overrides the check standard: {given.why}")

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._journal.close()

    def _begin(self) -> None:
        if self._continued:
            self._replay()
            self._options.tell(f"continuing the night {self._folder.path}")
        else:
            self._tell_overrides()
        self._log("session", {"process": os.getpid()})
        if self._continued:
            self._remark("the night was interrupted and continued; every bench warms up again")
        missing = "" if self._continued else shortage(self._options.runs, self._sound.size)
        if missing:
            self._remark(f"the night {missing}: later tests may not run")
        if self._behind:
            self._jumped(-self._behind)
        self._write_reports()
        if not self._sound.virtual and self._clock.now() < self._course.hours.begins:
            self._options.tell(f"waiting until {shown_time(self._course.hours.begins, self._sound.zone)}")

    def _replay(self) -> None:
        """Applies the events in the journal to the state of the timetable."""
        for index, test in enumerate(self._record.tests):
            for attempt in test.attempts:
                self._course.begun(index, attempt.begins)
                if attempt.ends is None:
                    self._course.interrupted(index)
                else:
                    self._course.ended(index, attempt.ends, EndOfTest(attempt.ending))
            last = test.attempts[-1] if test.attempts else None
            if last is not None and (
                test.state == "running" or (test.state == "waiting" and last.ending == "fault" and last.run is not None)
            ):
                self._begun_before[index] = last.identity
        for index in self._course.waiting:
            if self._record.tests[index].state not in ("waiting", "running"):
                self._course.abandon(index)
        self._course.cooled()

    def _loop(self, stop: StopRequest) -> None:
        course = self._course
        while True:
            now = self._clock.now()
            if not stop.after_segment and not self._trouble:
                while lost := tuple(course.out_of_reach(now)):
                    for index, reason in lost:
                        self._abandon(index, now, reason)
                while (step := course.next(now)) is not None and not self._trouble:
                    if isinstance(step, Begin):
                        course.begun(step.test, now)
                        self._start(step.test, now)
                    else:
                        course.warming(step.bench, step.until)
                        self._log("warm_up", {"bench": step.bench, "until": step.until})
                        self._say(
                            now, f"warm-up      bench {step.bench}, until {shown_time(step.until, self._sound.zone)}"
                        )
            moment = math.inf if stop.after_segment or self._trouble else course.wakes(now)
            if not self._children and not math.isfinite(moment):
                break
            self._wait(moment, stop)
        if not stop.after_segment:
            reason = self._trouble or "nothing that it waits for can run"
            for index in course.waiting:
                self._abandon(index, self._clock.now(), reason)

    def _abandon(self, index: int, now: float, reason: str) -> None:
        """Records that a waiting test will not run. If the test was waiting for a repetition, its last attempt gives its result."""
        name, ending = self._sound.tests[index].name, self._course.abandon(index)
        if ending is None:
            self._log("not_run", {"test": index, "reason": reason})
            self._say(now, f"did not run  {name}: {reason}")
            return
        last = self._record.tests[index].attempts[-1].reason
        state, reason = self._result(index, now, ending, f"{last}; not repeated: {reason}")
        self._log("not_repeated", {"test": index, "state": state, "reason": reason})
        self._say(now, f"{state:<12} {name}: {reason}")
        self._write_reports()

    def _result(self, index: int, now: float, ending: EndOfTest, reason: str) -> tuple[StateOfTest, str]:
        """Returns the final state of a test, and the reason for it."""
        name, failures = self._sound.tests[index].name, self._sound.suite.known_failures
        known = known_failure(name, failures, ending.value, civil(now, self._sound.zone).date())
        if known is not None:
            return "known_failure", f"known until {known.until}: {known.reason}; {reason}"
        return _RESULTS[ending], reason

    def _wait(self, moment: float, stop: StopRequest) -> None:
        """Waits until a test ends, or until a given instant. In simulated time, tests end in the order of their planned ends."""
        first = min(self._children, key=lambda index: self._children[index].ends, default=None)
        if self._sound.virtual:
            if first is None or self._children[first].ends > moment:
                self._clock.advance(moment)
                return
            while first not in self._gone:
                self._pass_on(stop)
                self._listen(0.2)
            self._clock.advance(self._children[first].ends)
            self._end(first)
            return
        while self._clock.now() < moment:
            self._pass_on(stop)
            self._stop_overdue()
            self._listen(min(0.5, max(0.0, moment - self._clock.now())))
            if self._gone:
                for index in sorted(self._gone):
                    self._end(index)
                return
            if stop.after_segment and not self._children:
                return

    def _listen(self, patience: float) -> None:
        with contextlib.suppress(queue.Empty):
            self._gone.add(self._ended.get(timeout=patience))

    # -- one test --------------------------------------------------------------------------------------------------------

    def _start(self, index: int, now: float) -> None:
        test = self._sound.tests[index]
        number = len(self._record.tests[index].attempts) + 1
        before = self._begun_before.pop(index, None)
        identity, kind, words = self._command(test, before)
        log = f"{index + 1:04d}-{number}"
        self._log("begun", {"test": index, "id": identity, "kind": kind, "log": f"logs/{log}.txt"})
        if self._trouble:  # not in the journal: it must not begin
            self._course.ended(index, now, EndOfTest.FAULT)
            return
        self._say(now, f"{'begins' if kind == 'run' else kind + 's':<12} {test.name}")
        seconds = self._sound.durations[index] or 0.0
        try:
            output, errors = self._logs.open_new(f"{log}.json"), self._logs.open_new(f"{log}.txt")
            with errors:
                process = subprocess.Popen(
                    [*self._options.program, *words],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=errors,
                    start_new_session=True,
                    creationflags=_GROUP,
                )
        except OSError as error:
            self._conclude(
                index, now, EndOfTest.FAULT, None, f"the process cannot be started: {error.strerror or error}", None, {}
            )
            return
        self._children[index] = _Child(process, output, identity, kind, now, now + seconds)
        threading.Thread(target=self._watch, args=(index, process), daemon=True).start()

    def _watch(self, index: int, process: subprocess.Popen[bytes]) -> None:
        process.wait()
        self._ended.put(index)

    def _command(self, test: PlannedTest, before: str | None) -> tuple[str, str, list[str]]:
        """Returns the id of the run, the kind of process, and the arguments of the command for a test. `before`: id of the run to
        continue; None to begin a new run."""
        common = ["--json", "--quiet"]
        data = [] if self._options.data is None else ["--data", str(self._options.data)]
        override = self._sound.suite.benches[test.bench].override_check_standard
        overriding: list[str] = []
        if override is not None and not test.standard:
            overriding = ["--override-check-standard", override.why, "--override-by", override.by]
        run = None if before is None else self._run_folder(before)
        if before is not None and run is not None:
            if (run / SEAL).exists():
                return before, "estimate", ["estimate", str(run), "--json"]
            if test.plan.interrupted == "resume":
                return before, "resume", ["resume", str(run), *common, "--unattended", *data, *overriding]
        identity = os.urandom(8).hex()
        asks = self._sound.asks[test.index]
        given = [
            word for name, value in test.information.items() if name in asks for word in ("--set", f"{name}={value}")
        ]
        given += overriding
        given += [word for name, value in test.parameter_values.items() for word in ("--parameter", f"{name}={value}")]
        seed = [] if test.seed is None else ["--seed", str(test.seed)]
        flushed = ["--flushed"] if self._options.flushed else []
        words = ["run", str(test.file), "--bench", self._sound.bench_of(test), "--runs", str(self._options.runs)]
        return identity, "run", [*words, "--id", identity, "--unattended", *common, *flushed, *given, *seed, *data]

    def _run_folder(self, identity: str) -> Path | None:
        return next(self._options.runs.glob(f"*-{identity}"), None)

    def _end(self, index: int) -> None:
        """Handles the end of a process that has run a test."""
        child = self._children.pop(index)
        self._gone.discard(index)
        child.output.close()
        code = child.process.returncode
        now = self._clock.now()
        document = self._answer(index)
        ending, reason = judged(code, document, asked=bool(self._told_to_stop), overdue=child.overdue)
        if document.get("unsigned"):
            self._remark(f"{self._sound.tests[index].name} is not signed: {'; '.join(document['unsigned'])}")
        if ending is None:  # stopped on request: it is continued with the night
            self._course.interrupted(index)
            return
        if child.kind == "resume" and ending is EndOfTest.REFUSED:
            self._remark(
                f"{self._sound.tests[index].name}: the incomplete run cannot be continued ({reason}); "
                f"the test runs again"
            )
            ending, child.identity = EndOfTest.BUSY, ""
            self._waited.add(index)
        self._conclude(index, now, ending, code, reason, child.identity, document)

    def _answer(self, index: int) -> JsonObject:
        """Reads the JSON data that a process has printed."""
        name = Path(self._record.tests[index].attempts[-1].log).stem + ".json"
        try:
            found = from_bytes(self._logs.read(name, MOST_RECORD))
        except (OSError, ValueError):
            return {}
        if isinstance(found, list):
            single = len(found) == 1 and isinstance(found[0], dict) and "exit_code" in found[0]
            found = found[0] if single else {"findings": found}
        return found if isinstance(found, dict) else {}

    def _conclude(
        self,
        index: int,
        now: float,
        ending: EndOfTest,
        code: int | None,
        reason: str,
        identity: str | None,
        document: JsonObject,
    ) -> None:
        test = self._sound.tests[index]
        if test.standard and ending in (EndOfTest.PASSED, EndOfTest.LIMIT):
            ending, reason = self._judge_standard(test, ending, reason)
        final = self._course.ended(index, now, ending)
        run = self._run_folder(identity) if identity else None
        analysis = document.get("analysis")
        state: StateOfTest = "waiting"
        if final:
            state, reason = self._result(index, now, ending, reason)
        elif ending is EndOfTest.FAULT and run is not None:
            self._begun_before[index] = run.name.rpartition("-")[2]
        limits = [_limit(item) for item in document.get("limits", ())]
        self._log(
            "ended",
            {
                "test": index,
                "ending": ending.value,
                "exit_code": code,
                "state": state,
                "reason": reason,
                "run": None if run is None else run.name,
                "analysis": None if analysis is None else Path(analysis).name,
                "limits": limits,
            },
        )
        if ending is EndOfTest.BUSY:
            if reason and index not in self._waited:
                self._waited.add(index)
                self._remark(f"{test.name} waited: {reason}")
            if self._sound.virtual:
                time.sleep(1.0)  # simulated time does not wait for the other process
        again = "" if final else "; it is repeated"
        self._say(now, f"{state if final else ending.value:<12} {test.name}{': ' + reason if reason else ''}{again}")
        self._write_reports()

    def _judge_standard(self, test: PlannedTest, ending: EndOfTest, reason: str) -> tuple[EndOfTest, str]:
        """Returns the outcome of a test that measures a check standard. The test has passed if the check standard is in control
        now."""
        try:
            state = control_state(read_bench(self._sound.bench_of(test), Path())[0], self._options.runs)
        except InputError as error:
            return EndOfTest.FAULT, f"the state of the check standard cannot be determined: {error}"
        if state is None:
            return ending, reason
        self._log("check_standard", {"bench": test.bench, "state": state.to_json()})
        return (ending, reason) if state.in_control else (EndOfTest.LIMIT, state.words())

    # -- stopping --------------------------------------------------------------------------------------------------------

    def _pass_on(self, stop: StopRequest) -> None:
        """Forwards the operator's requests to stop to the processes of all tests. After the first request, each test ends after its
        segment; after the second, it ends at once."""
        wanted_ = 2 if stop.at_once else 1 if stop.after_segment else 0
        if wanted_ > self._told_to_stop:
            self._told_to_stop = wanted_
            for child in self._children.values():
                _tell(child.process, at_once=wanted_ == 2)

    def _stop_overdue(self) -> None:
        for index, child in self._children.items():
            planned = child.ends - child.begins
            limit = child.begins + planned * OVERDUE_FACTOR + OVERDUE_PAUSE
            if planned and not child.overdue and self._clock.now() > limit:
                child.overdue = True
                self._remark(f"{self._sound.tests[index].name} takes much longer than planned and was stopped")
                _tell(child.process, at_once=True)

    def _end_children(self) -> None:
        """Ends all processes after an unexpected error, so that none of them continues unsupervised."""
        for child in self._children.values():
            _tell(child.process, at_once=True)
        for child in self._children.values():
            child.process.wait()
            child.output.close()

    # -- the record ------------------------------------------------------------------------------------------------------

    def _say(self, now: float, text: str) -> None:
        self._options.tell(f"{civil(now, self._sound.zone):%H:%M}  {text}")

    def _remark(self, text: str) -> None:
        self._log("remark", {"text": text})
        self._options.tell(f"note: {text}")

    def _jumped(self, seconds: float) -> None:
        way = "forward" if seconds > 0 else "back"
        follows = "the night follows it" if seconds > 0 else "the night goes on with its own time"
        self._remark(f"the clock of the computer was set {way} by {abs(seconds):.0f} s; {follows}")

    def _log(self, event: str, data: JsonObject) -> None:
        """Writes an event to the journal and to the record. If the disk is full, no further test begins."""
        given = {"now": self._clock.now() if event != "remark" else self._record.now, **data}
        self._record.take({"event": event, **given})
        for attempt in range(2):
            try:
                self._journal.append(event, given)
                return
            except OSError as error:
                if attempt == 0:
                    with contextlib.suppress(OSError):
                        self._folder.remove(RESERVE)
                trouble = f"the record of the night cannot be written: {error.strerror or error}"
        if not self._trouble:
            self._trouble = trouble
            self._options.tell(f"error: {trouble}; no further test begins")
        elif event == "ended":
            self._options.tell(f"error: {trouble}")

    def _write_reports(self) -> None:
        try:
            self._storage.write_whole(self._folder, RECORD, to_bytes(self._record.to_json()))
        except OSError as error:
            if not self._trouble:
                with contextlib.suppress(OSError):
                    self._folder.remove(RESERVE)
                self._trouble = f"the record of the night cannot be written: {error.strerror or error}"
                self._options.tell(f"error: {self._trouble}; no further test begins")

    def _finish(self, state: str, code: int) -> None:
        """Writes the end of the night, sends the notifications, and writes the reports."""
        if self._trouble:
            self._record.remarks.append(self._trouble)
        self._log("finished", {"state": state, "exit_code": code})
        if state == "finished":
            document = self._record.to_json()
            for entry in self._sound.suite.notify:
                if wanted(entry, code):
                    self._notify(entry, document)
        document = self._record.to_json()
        with contextlib.suppress(OSError):
            self._folder.remove(RESERVE)
        for name, data in (
            (RECORD, to_bytes(document)),
            ("junit.xml", to_junit(document)),
            ("summary.md", summary(document).encode("utf-8", "backslashreplace")),
        ):
            try:
                self._storage.write_whole(self._folder, name, data)
            except OSError as error:
                self._trouble = self._trouble or f"{name} cannot be written: {error.strerror or error}"

    def _notify(self, entry: Notification, document: JsonObject) -> None:
        reason = ""
        for attempt in range(3):
            try:
                send(entry, document, self._options.environment)
                reason = ""
                break
            except NotificationError as error:
                reason = str(error)
                time.sleep(0.2 * attempt)
        if reason:
            self._options.tell(f"warning: the notification of {receiver(entry)} was not sent: {reason}")
        self._log("notified", {"to": receiver(entry), "sent": not reason, "reason": reason})


def judged(code: int, document: JsonObject, *, asked: bool, overdue: bool = False) -> tuple[EndOfTest | None, str]:
    """Judges the outcome of a test from the exit code and the JSON output of its process. Returns the outcome, and the reason in
    words. The outcome is None if the test was stopped on request.

    `asked`: True if the processes were asked to stop. `overdue`: True if this process was stopped because it took too long.
    """
    if overdue:
        return EndOfTest.FAULT, "it took much longer than planned and was stopped"
    findings = document.get("findings", ())
    said = "; ".join(str(item["message"]) for item in findings if item.get("severity") == "error")
    codes = {item.get("code") for item in findings}
    if code == 0:
        return EndOfTest.PASSED, ""
    if code == 1:
        failed = [
            f"{item['quantity']}: {_words(item)}" for item in document.get("limits", ()) if item["verdict"] != "pass"
        ]
        failed += [f"{name}: {text}" for name, text in document.get("failures", {}).items()]
        return EndOfTest.LIMIT, "; ".join(failed) or "a limit failed"
    if code == 2:
        if codes & _BUSY:
            return EndOfTest.BUSY, said
        if codes & _ENVIRONMENT:
            return EndOfTest.FAULT, said
        failures = document.get("failures", {})
        if isinstance(failures, dict) and failures:
            said = "; ".join(f"{name}: {text}" for name, text in failures.items())
        return EndOfTest.REFUSED, said or "the input is wrong; see the log"
    if code == INTERRUPTED and asked:
        return None, "stopped"
    if code == INTERRUPTED:
        return EndOfTest.FAULT, "its process was ended by a signal"
    if code < 0:
        return EndOfTest.FAULT, f"its process was killed by {_signal_name(-code)}"
    if document.get("unsigned"):  # the run is complete, and can be signed later
        return EndOfTest.PASSED, "; ".join(str(item) for item in document["unsigned"])
    failures = document.get("failures", [])
    told = [str(item) for item in (failures if isinstance(failures, list) else [])]
    told += [f"NOT IN THE SAFE STATE: {item}" for item in document.get("unsafe", [])]
    return EndOfTest.FAULT, "; ".join(told) or said or f"exit code {code}; see the log"


_BUSY = {"bench-in-use", "run-in-use"}
_ENVIRONMENT = {"disk-space", "run-unwritable", "file-system", "bench-lock"}


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _words(limit: Mapping[str, Json]) -> str:
    return (
        f"{limit['value']:.6g} {limit['unit']}, required {limit['requirement']}"
        if isinstance(limit["value"], float | int)
        else str(limit["reason"])
    )


def _limit(limit: Mapping[str, Json]) -> JsonObject:
    return {
        "quantity": limit["quantity"],
        "verdict": limit["verdict"],
        "value": limit["value"],
        "unit": limit["unit"],
        "words": _words(limit),
    }


def _tell(process: subprocess.Popen[bytes], *, at_once: bool) -> None:
    if sys.platform == "win32":
        process.send_signal(signal.CTRL_BREAK_EVENT)
    else:
        process.send_signal(signal.SIGTERM if at_once else signal.SIGINT)


if sys.platform == "win32":
    _GROUP = subprocess.CREATE_NEW_PROCESS_GROUP
else:
    _GROUP = 0
"""Ctrl-C in the terminal reaches the night alone, which passes it on."""


def lines_of(result: NightResult) -> Iterator[str]:
    """Yields the lines of text that state the result of the night."""
    yield headline(result.record)
    if result.trouble:
        yield f"error: {result.trouble}"
    yield str(result.folder / "summary.md")

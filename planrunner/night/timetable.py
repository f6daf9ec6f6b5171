"""Computes the timetable of a night: which test begins when, on which bench, and which tests do not fit.

`NightCourse` contains the state of a night and the rules by which the night continues. `NightCourse` does not use processes or a
clock: the caller states the time, and the tests that have ended. `planrunner check` simulates the night with the planned durations
(`foresee`). `planrunner night` updates the state with real events. Both commands therefore follow the same rules. Times are
instants, seconds since 1970 UTC.

The next test on a bench is the first test, in the order of the suite, that satisfies three conditions: the tests for which it waits
have ended, its device is free, and it can end in time with its planned duration.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import field
from datetime import tzinfo
from enum import Enum
from heapq import heappop, heappush
from itertools import islice
from typing import Literal

from planrunner.base.dataclass import dataclass
from planrunner.night.civil_time import Opening, openings, shown_time
from planrunner.night.expansion import PlannedTest
from planrunner.night.suite import Suite
from planrunner.night.words import spell_out

BUSY_PAUSE = 30.0
"""If another process uses the bench of a test, the test is tried again after this time [s]."""
_ALWAYS = Opening(-math.inf, math.inf)
_OPENINGS = 60
"""Maximum number of openings of a bench's time window that are considered in one night."""


class EndOfTest(Enum):
    """Lists the ways in which a test can end."""

    PASSED = "passed"
    LIMIT = "limit"
    """A limit failed, or an estimate could not be made from the data."""
    FAULT = "fault"
    """A fault of the bench or of the computer during execution."""
    REFUSED = "refused"
    """The plan, or a file that it needs, was wrong; the test moved nothing."""
    BUSY = "busy"
    """Another process uses the bench; the test is tried again."""


@dataclass(frozen=True, slots=True)
class BenchHours:
    """States the hours in which a bench may work, and the warm-up that it needs. `openings`: the openings of the bench's window;
    None if the bench may work at any time. `warm_up`: duration of the warm-up, s. `stays_warm`: time for which the bench stays warm
    after a warm-up or a test, s; inf if it never cools down.
    """

    openings: tuple[Opening, ...] | None = None
    warm_up: float = 0.0
    stays_warm: float = math.inf


@dataclass(frozen=True, slots=True)
class NightHours:
    """States the hours of a night, as instants. `begins`, `closes`: instants at which the night begins and ends; `closes` is inf if
    there is neither a window nor a budget."""

    begins: float
    closes: float
    benches: Mapping[str, BenchHours]


@dataclass(frozen=True, slots=True)
class Begin:
    """The action that a test begins now."""

    test: int
    at: float


@dataclass(frozen=True, slots=True)
class WarmUp:
    """The action that a bench begins to warm up now."""

    bench: str
    at: float
    until: float


@dataclass(slots=True)
class _Test:
    """The state of a test in a night.

    `since`: the earliest instant at which the test may begin. `pending`: number of tests that must end before this test begins.
    `failed`: for a test that waits for a repetition, how its last attempt ended.
    """

    state: Literal["waiting", "running", "ended", "not run"] = "waiting"
    ending: EndOfTest | None = None
    since: float = -math.inf
    attempts: int = 0
    pending: int = 0
    failed: EndOfTest | None = None


@dataclass(slots=True)
class _Bench:
    """The state of a bench during a night.

    `warm_at`: instant at which the last warm-up of the bench ended. `last_used`: instant at which the last test on the bench ended.
    `stopped`: the reason why no further test begins on the bench; empty if there is none. `ready`: for each device, the tests that
    now wait only for the bench, the device and the hours, in the order of the suite. `first`: a heap that contains, for each
    device, the first of these tests. `longest`: two heaps of the waiting tests, one of tests that need a warm-up and one of tests
    that need none. An entry is the pair (−planned seconds, test). An entry that is no longer valid stays in the heap until it
    reaches the top, and is then removed.
    """

    running: int | None = None
    warm_at: float | None = None
    last_used: float = -math.inf
    stopped: str = ""
    ready: dict[str | None, list[int]] = field(default_factory=dict)
    first: list[int] = field(default_factory=list)
    longest: dict[bool, list[tuple[float, int]]] = field(default_factory=lambda: {True: [], False: []})


@dataclass(slots=True)
class NightCourse:
    """Contains the state of a night, and the rules by which the night continues. `durations`: planned time of each test, s; None if
    it is unknown. A test of unknown duration counts as short.

    The next action is found without examining every test. The computing time for a night is therefore proportional to the number of
    its tests and dependencies, not to the square of this number.
    """

    tests: Sequence[PlannedTest]
    durations: Sequence[float | None]
    hours: NightHours
    zone: tzinfo | None = None
    stopped: str = ""
    _tests: list[_Test] = field(default_factory=list)
    _benches: dict[str, _Bench] = field(default_factory=dict)
    _devices: dict[str, str] = field(default_factory=dict)
    """Maps each device on which no further test begins to the reason."""
    _followers: list[list[int]] = field(default_factory=list)
    """For each test, the tests that begin after it."""
    _dependents: list[list[int]] = field(default_factory=list)
    """For each test, the tests that need it."""
    _paused: list[tuple[float, int]] = field(default_factory=list)
    """Heap of tests that wait only for a certain time, each with this time."""
    _lost: set[int] = field(default_factory=set)
    """Waiting tests that cannot run any more."""

    def __post_init__(self) -> None:
        self._tests = [_Test(pending=len(test.after)) for test in self.tests]
        self._benches = {test.bench: _Bench() for test in self.tests}
        self._followers = [[] for _ in self.tests]
        self._dependents = [[] for _ in self.tests]
        for index, test in enumerate(self.tests):
            for other in test.after:
                self._followers[other].append(index)
            for other in test.needs:
                self._dependents[other].append(index)
            self._wait(index, -math.inf)

    # -- what happened ---------------------------------------------------------------------------------------------------

    def begun(self, test: int, at: float) -> None:
        """Records that a test has begun."""
        state = self._tests[test]
        self._withdraw(test)
        state.state, state.since = "running", at
        state.attempts += 1
        self._benches[self.tests[test].bench].running = test

    def warming(self, bench: str, until: float) -> None:
        self._benches[bench].warm_at = until

    def cooled(self) -> None:
        """Records that every bench needs its warm-up again, for example after a power failure."""
        for bench in self._benches.values():
            bench.warm_at = None

    def ended(self, test: int, at: float, ending: EndOfTest) -> bool:
        """Records that a running test has ended. Returns True if the test will not be repeated, so that its result is final."""
        planned, state = self.tests[test], self._tests[test]
        bench = self._benches[planned.bench]
        bench.running, bench.last_used = None, at
        plan = planned.plan
        if ending is EndOfTest.BUSY:
            self._wait(test, at + BUSY_PAUSE)
            state.attempts -= 1
            return False
        if ending.value in plan.retry_on and state.attempts <= plan.retries and not self.stopped:
            state.failed = ending
            self._wait(test, at + plan.retry_after.value)
            return False
        state.state, state.ending = "ended", ending
        self._settle(test)
        if ending is not EndOfTest.PASSED:
            self._follow(planned, ending)
        return True

    def interrupted(self, test: int) -> None:
        """Records that a running test was interrupted and will continue later. This does not count as an attempt."""
        self._wait(test, -math.inf)
        self._tests[test].attempts -= 1
        self._benches[self.tests[test].bench].running = None

    def abandon(self, test: int) -> EndOfTest | None:
        """Records that a waiting test will not run. If the test waited for a repetition, returns how its last attempt ended; this
        is then the result of the test. Otherwise returns None."""
        self._withdraw(test)
        state = self._tests[test]
        state.state, state.ending = "not run" if state.failed is None else "ended", state.failed
        self._settle(test)
        if state.failed is not None:
            self._follow(self.tests[test], state.failed)
        return state.failed

    def _wait(self, index: int, since: float) -> None:
        """Makes a test wait until an instant. A test that also waits for other tests may wait longer."""
        test, state = self.tests[index], self._tests[index]
        bench = self._benches[test.bench]
        state.state, state.since = "waiting", since
        heappush(bench.longest[test.plan.warm], (-(self.durations[index] or 0.0), index))
        if not state.pending:
            heappush(self._paused, (since, index))
        if self.stopped or bench.stopped or self._devices.get(test.device or ""):
            self._lost.add(index)

    def _settle(self, index: int) -> None:
        """Handles a test that has its result or will not run: tests that waited for this test can now begin, or can no longer
        run."""
        for other in self._followers[index]:
            state = self._tests[other]
            state.pending -= 1
            if not state.pending and state.state == "waiting":
                heappush(self._paused, (state.since, other))
        if self._tests[index].ending is not EndOfTest.PASSED:
            self._lost.update(self._dependents[index])

    def _resume(self, now: float) -> None:
        """Marks the tests whose waiting time has passed as ready."""
        while self._paused and self._paused[0][0] <= now:
            since, index = heappop(self._paused)
            test, state = self.tests[index], self._tests[index]
            bench = self._benches[test.bench]
            ready = bench.ready.setdefault(test.device, [])
            place = bisect_left(ready, index)
            if state.state == "waiting" and state.since == since and ready[place : place + 1] != [index]:
                ready.insert(place, index)
                heappush(bench.first, index)

    def _withdraw(self, index: int) -> None:
        """Removes a test from the tests that are ready to begin."""
        test = self.tests[index]
        bench = self._benches[test.bench]
        ready = bench.ready.get(test.device, [])
        place = bisect_left(ready, index)
        if ready[place : place + 1] == [index]:
            del ready[place]
            if ready:
                heappush(bench.first, ready[0])

    def _follow(self, test: PlannedTest, ending: EndOfTest) -> None:
        """Applies the consequences that the suite states for a failure."""
        if ending is EndOfTest.REFUSED:
            return  # nothing moved: other tests are not concerned
        action = test.plan.on_limit if ending is EndOfTest.LIMIT else test.plan.on_fault
        what = "a limit failed" if ending is EndOfTest.LIMIT else "there was a fault"
        reason = f"{what} in {test.name}"
        if action == "stop_night":
            self.stopped = self.stopped or f"the night was stopped: {reason}"
            self._lost.update(range(len(self.tests)))
        elif action == "stop_bench":
            bench = self._benches[test.bench]
            bench.stopped = bench.stopped or f"bench {test.bench} was stopped: {reason}"
            self._lost.update(other.index for other in self.tests if other.bench == test.bench)
        elif action == "stop_device" and test.device is not None:
            self._devices.setdefault(test.device, f"device {test.device} was stopped: {reason}")
            self._lost.update(other.index for other in self.tests if other.device == test.device)

    # -- what comes next -------------------------------------------------------------------------------------------------

    def next(self, now: float) -> Begin | WarmUp | None:
        """Returns the next action at this instant; None if there is none. The caller confirms the action with `begun` or `warming`
        and asks again."""
        self._resume(now)
        busy = {device for index in self.running if (device := self.tests[index].device) is not None}
        for name, bench in self._benches.items():
            if bench.running is not None or (bench.warm_at is not None and bench.warm_at > now):
                continue
            index = self._first(bench, busy, now) if self._open(name, now) else None
            if index is not None:
                warm_up = self._warm_up(self.tests[index], bench, now)
                return Begin(index, now) if warm_up == 0.0 else WarmUp(name, now, now + warm_up)
        return None

    def out_of_reach(self, now: float) -> Iterator[tuple[int, str]]:
        """Yields the waiting tests that can no longer run, each with the reason. The caller confirms each of them with
        `abandon`."""
        for bench in self._benches.values():
            if bench.running is None:
                self._lost.update(self._too_late(bench, now))
        self._lost = {index for index in self._lost if self._tests[index].state == "waiting"}
        for index in sorted(self._lost):
            if reason := self._obstacle(self.tests[index], now):
                yield index, reason

    def wakes(self, now: float) -> float:
        """Returns the next instant at which a test or warm-up may begin even if no running test ends; inf if there is none."""
        self._resume(now)
        moments = [bench.warm_at for bench in self._benches.values() if bench.warm_at is not None]
        moments += [since for since, _ in self._paused[:1]]
        for hours in self.hours.benches.values():
            moments += [opening.opens for opening in hours.openings or ()]
        return min((moment for moment in (*moments, self.hours.begins) if moment > now), default=math.inf)

    @property
    def running(self) -> tuple[int, ...]:
        return tuple(bench.running for bench in self._benches.values() if bench.running is not None)

    @property
    def waiting(self) -> tuple[int, ...]:
        return tuple(index for index, state in enumerate(self._tests) if state.state == "waiting")

    def attempts(self, test: int) -> int:
        """Returns the number of attempts of a test. Attempts that failed because the bench was in use do not count."""
        return self._tests[test].attempts

    def _open(self, bench: str, now: float) -> bool:
        """Returns True if an instant lies in the hours of a bench."""
        openings_ = self.hours.benches[bench].openings
        within = openings_ is None or any(opening.opens <= now <= opening.closes for opening in openings_)
        return within and self.hours.begins <= now < self.hours.closes

    def _first(self, bench: _Bench, busy: Collection[str], now: float) -> int | None:
        """Returns the first ready test of a bench that could begin now; None if there is none. Such a test has a free device and
        would end within the hours."""
        found: int | None = None
        looked_at: list[int] = []
        too_long: set[tuple[bool, float | None]] = set()
        while bench.first and (found is None or bench.first[0] < found):
            index = heappop(bench.first)
            ready = bench.ready[self.tests[index].device]
            if not ready or ready[0] != index or index in looked_at[-1:]:
                continue
            looked_at.append(index)
            if self.tests[index].device in busy:
                continue
            for one in ready:
                if found is not None and one > found:
                    break
                kind = (self.tests[one].plan.warm, self.durations[one])
                if kind not in too_long and not self._obstacle(self.tests[one], now):
                    if self._starts(one, now) == now:
                        found = one
                        break
                    too_long.add(kind)
        for index in looked_at:
            heappush(bench.first, index)
        return found

    def _too_late(self, bench: _Bench, now: float) -> Iterator[int]:
        """Yields the waiting tests of a bench that no longer fit into the hours of the bench. The tests with and without a warm-up
        are examined separately, each in order of decreasing duration, because the longest test is the first that no longer fits."""
        for heap in bench.longest.values():
            while heap:
                index = heap[0][1]
                if self._tests[index].state == "waiting":
                    if self._starts(index, now, soonest=True) is not None:
                        break
                    yield index
                heappop(heap)

    def _obstacle(self, test: PlannedTest, now: float) -> str:
        """Returns the reason why a waiting test can no longer run; empty if it can still run."""
        stopped = self.stopped or self._benches[test.bench].stopped or self._devices.get(test.device or "", "")
        if stopped:
            return stopped
        for other in test.needs:
            state = self._tests[other]
            if state.state == "not run" or (state.state == "ended" and state.ending is not EndOfTest.PASSED):
                done = "did not run" if state.state == "not run" else "did not pass"
                return f"it needs {self.tests[other].name}, which {done}"
        bench = self._benches[test.bench]
        if bench.running is None and self._starts(test.index, now, soonest=True) is None:
            return self._too_long(test, now)
        return ""

    def _too_long(self, test: PlannedTest, now: float) -> str:
        duration = self.durations[test.index] or 0.0
        closes = self.hours.closes
        limits = self.hours.benches[test.bench].openings
        if limits is not None:
            closes = max((opening.closes for opening in limits if opening.opens < closes), default=now)
            closes = min(closes, self.hours.closes)
        if closes <= now:
            return f"it does not fit: the time for bench {test.bench} ended at {shown_time(closes, self.zone)}"
        return (
            f"it does not fit: it takes {spell_out(duration)}, and bench {test.bench} is available only until "
            f"{shown_time(closes, self.zone)}"
        )

    def _starts(self, index: int, now: float, *, soonest: bool = False) -> float | None:
        """Returns the earliest instant, now or later, at which the suite's hours permit a test to begin; None if the test no longer
        fits into these hours. `soonest`: True to ignore the waiting time before a repetition of the test."""
        test, state = self.tests[index], self._tests[index]
        limits, bench = self.hours.benches[test.bench], self._benches[test.bench]
        earliest = max(now, self.hours.begins, -math.inf if soonest else state.since, bench.warm_at or -math.inf)
        for opening in limits.openings if limits.openings is not None else (_ALWAYS,):
            at = max(earliest, opening.opens)
            length = self._warm_up(test, bench, at) + (self.durations[index] or 0.0)
            if at + length <= min(opening.closes, self.hours.closes) and at < self.hours.closes:
                return at
        return None

    def _warm_up(self, test: PlannedTest, bench: _Bench, at: float) -> float:
        """Returns the time [s] that a bench needs to warm up before a test that begins at a given instant."""
        hours = self.hours.benches[test.bench]
        if not test.plan.warm:
            return 0.0
        if bench.warm_at is None or at - max(bench.warm_at, bench.last_used) > hours.stays_warm:
            return hours.warm_up
        return 0.0


def night_hours(suite: Suite, begins: float, zone: tzinfo | None) -> NightHours:
    """Returns the hours of the night that begins at or after an instant. The night begins at the instant itself if the window is
    open, otherwise when the window opens next."""
    closes = math.inf
    if suite.window is not None:
        opening = next(openings(suite.window, begins, zone))
        begins, closes = max(begins, opening.opens), opening.closes
    if suite.budget is not None:
        closes = min(closes, begins + suite.budget.value)
    benches = {}
    for name, bench in suite.benches.items():
        found = None
        if bench.window is not None:
            found = tuple(
                opening for opening in islice(openings(bench.window, begins, zone), _OPENINGS) if opening.opens < closes
            )
        benches[name] = BenchHours(
            found,
            0.0 if bench.warm_up is None else bench.warm_up.value,
            math.inf if bench.stays_warm is None else bench.stays_warm.value,
        )
    return NightHours(begins, closes, benches)


@dataclass(frozen=True, slots=True)
class Slot:
    """Describes a period of time in which a test or a warm-up occupies a bench. `test`: index of the test; None for a warm-up."""

    bench: str
    begins: float
    ends: float
    test: int | None


@dataclass(frozen=True, slots=True)
class NightForecast:
    """The forecast of a night. `left_out`: index of each test that will not run, with the reason."""

    hours: NightHours
    slots: tuple[Slot, ...]
    left_out: tuple[tuple[int, str], ...]

    @property
    def ends(self) -> float:
        """Returns the predicted end of the night or, if no test runs, the beginning of the night."""
        return max((slot.ends for slot in self.slots), default=self.hours.begins)

    @property
    def slots_of_tests(self) -> dict[int, Slot]:
        """Maps each test that will run to its slot."""
        return {slot.test: slot for slot in self.slots if slot.test is not None}


def foresee(
    tests: Sequence[PlannedTest], durations: Sequence[float | None], hours: NightHours, zone: tzinfo | None
) -> NightForecast:
    """Forecasts a night in which every test takes its planned duration and passes."""
    course = NightCourse(tests, durations, hours, zone)
    now = hours.begins
    slots: list[Slot] = []
    left_out: list[tuple[int, str]] = []
    ends: dict[int, float] = {}
    while True:
        while lost := tuple(course.out_of_reach(now)):
            left_out += lost
            for index, _ in lost:
                course.abandon(index)
        while (step := course.next(now)) is not None:
            if isinstance(step, Begin):
                course.begun(step.test, now)
                ends[step.test] = now + (durations[step.test] or 0.0)
                slots.append(Slot(tests[step.test].bench, now, ends[step.test], step.test))
            else:
                course.warming(step.bench, step.until)
                slots.append(Slot(step.bench, now, step.until, None))
        moment = min([*ends.values(), course.wakes(now)])
        if not math.isfinite(moment):
            break
        now = moment
        for index in [index for index, end in ends.items() if end <= now]:
            del ends[index]
            course.ended(index, now, EndOfTest.PASSED)
    left_out += [(index, "nothing that it waits for can run") for index in course.waiting]
    return NightForecast(hours, tuple(slots), tuple(left_out))

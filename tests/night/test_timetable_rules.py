"""The rules of a night, written a second time in the plainest way: every decision looks at every test.

`NightCourse` must decide the same in random nights with failures, repetitions, windows and warm-ups, and its work must not grow with the
square of the number of tests.
"""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import pytest

from planrunner.base.findings import Findings
from planrunner.night.civil_time import Opening
from planrunner.night.expansion import PlannedTest, expand_suite
from planrunner.night.timetable import BUSY_PAUSE, Begin, BenchHours, EndOfTest, NightCourse, NightHours, foresee
from tests.night.test_timetable import suite_of


class PlainRules:
    """What begins next, according to the documentation of `docs/running-a-night.md`."""

    def __init__(self, tests: tuple[PlannedTest, ...], durations: list[float], hours: NightHours):
        self.tests, self.durations, self.hours = tests, durations, hours
        self.state = ["waiting"] * len(tests)
        self.passed = [False] * len(tests)
        self.since = [-math.inf] * len(tests)
        self.tries = [0] * len(tests)
        self.warm_at: dict[str, float | None] = {test.bench: None for test in tests}
        self.used: dict[str, float] = {test.bench: -math.inf for test in tests}
        self.stopped: set[str] = set()

    def warm_up(self, test: PlannedTest, at: float) -> float:
        warm, hours = self.warm_at[test.bench], self.hours.benches[test.bench]
        cold = warm is None or at - max(warm, self.used[test.bench]) > hours.stays_warm
        return hours.warm_up if test.plan.warm and cold else 0.0

    def soonest(self, test: PlannedTest, now: float) -> float | None:
        for opening in self.hours.benches[test.bench].openings or (Opening(-math.inf, math.inf),):
            at = max(now, self.hours.begins, self.warm_at[test.bench] or -math.inf, opening.opens)
            end = at + self.warm_up(test, at) + self.durations[test.index]
            if end <= min(opening.closes, self.hours.closes) and at < self.hours.closes:
                return at
        return None

    def used_bench(self, bench: str) -> bool:
        return any(self.state[other.index] == "running" for other in self.tests if other.bench == bench)

    def lost(self, test: PlannedTest, now: float) -> bool:
        if self.stopped & {"night", f"bench {test.bench}", f"device {test.device}"}:
            return True
        for other in test.needs:
            if self.state[other] == "not run" or (self.state[other] == "ended" and not self.passed[other]):
                return True
        return not self.used_bench(test.bench) and self.soonest(test, now) is None

    def next(self, now: float) -> tuple[str, Any] | None:
        for bench in dict.fromkeys(test.bench for test in self.tests):
            if self.used_bench(bench) or (self.warm_at[bench] or -math.inf) > now:
                continue
            for test in self.tests:
                devices = {other.device for other in self.tests if self.state[other.index] == "running"} - {None}
                if (
                    test.bench == bench
                    and self.state[test.index] == "waiting"
                    and self.since[test.index] <= now
                    and not self.lost(test, now)
                    and all(self.state[other] in ("ended", "not run") for other in test.after)
                    and test.device not in devices
                    and self.soonest(test, now) == now
                ):
                    return ("warm", bench) if self.warm_up(test, now) else ("begin", test.index)
        return None


def a_night(dice: random.Random) -> tuple[tuple[PlannedTest, ...], list[float], NightHours]:
    benches = {name: {"bench": "virtual"} for name in "abc"[: dice.randint(1, 3)]}
    devices = {f"D{k}": {"benches": dice.sample(list(benches), dice.randint(1, len(benches)))} for k in range(4)}
    actions = ["continue", "stop_device", "stop_bench", "stop_night"]
    plans: dict[str, Any] = {}
    for k in range(dice.randint(1, 5)):
        before = dice.sample(list(plans), min(len(plans), dice.randint(0, 2)))
        plans[f"p{k}"] = {
            "plan": "p",
            ("needs" if dice.random() < 0.5 else "after"): before,
            "warm": dice.random() < 0.7,
            "retries": dice.randint(0, 2),
            "retry_on": dice.choice([["fault"], ["fault", "limit"]]),
            "retry_after": f"{dice.randint(0, 3)} min",
            "on_limit": dice.choices(actions, [6, 2, 1, 1])[0],
            "on_fault": dice.choices(actions, [4, 2, 2, 1])[0],
        }
    keys = {"benches": benches, "plans": plans, **({"devices": devices} if dice.random() < 0.7 else {})}
    tests = expand_suite(suite_of(**keys), Path(), log := Findings())
    if log.errors:  # a device that is on no bench of its plan
        return a_night(dice)
    hours = {}
    for name in benches:
        openings = None
        if dice.random() < 0.5:
            starts = sorted(dice.uniform(-50, 500) for _ in range(dice.randint(1, 3)))
            openings = tuple(Opening(start, start + dice.uniform(10, 200)) for start in starts)
        hours[name] = BenchHours(openings, dice.choice([0.0, 5.0]), dice.choice([math.inf, 10.0]))
    closes = dice.choice([math.inf, dice.uniform(50, 600)])
    return tests, [dice.choice([5.0, 20.0, 45.0]) for _ in tests], NightHours(0.0, closes, hours)


@pytest.mark.parametrize("seed", range(150))
def test_every_decision_is_that_of_the_plain_rules(seed: int) -> None:
    dice = random.Random(seed)
    tests, durations, hours = a_night(dice)
    course, plain = NightCourse(tests, durations, hours), PlainRules(tests, durations, hours)
    ends: dict[int, float] = {}
    failed: dict[int, EndOfTest] = {}

    def stop(index: int, ending: EndOfTest) -> None:
        plan, device = tests[index].plan, tests[index].device
        action = {EndOfTest.LIMIT: plan.on_limit, EndOfTest.FAULT: plan.on_fault}.get(ending, "continue")
        if action != "continue" and (action != "stop_device" or device is not None):
            where = {"stop_night": "night", "stop_bench": f"bench {tests[index].bench}"}
            plain.stopped.add(where.get(action, f"device {device}"))

    now = 0.0
    while True:
        while True:
            expected = [test.index for test in tests if plain.state[test.index] == "waiting" and plain.lost(test, now)]
            found = list(course.out_of_reach(now))
            assert [index for index, _ in found] == expected
            if not found:
                break
            for index in expected:
                ending = failed.get(index)
                assert course.abandon(index) is ending
                plain.state[index] = "not run" if ending is None else "ended"
                if ending is not None:
                    stop(index, ending)
        while True:
            step, wanted = course.next(now), plain.next(now)
            if step is None or wanted is None:
                assert step is None and wanted is None
                break
            if isinstance(step, Begin):
                assert wanted == ("begin", step.test)
                course.begun(step.test, now)
                plain.state[step.test] = "running"
                plain.tries[step.test] += 1
                ends[step.test] = now + durations[step.test] * dice.uniform(0.5, 1.2)
            else:
                assert wanted == ("warm", step.bench)
                course.warming(step.bench, step.until)
                plain.warm_at[step.bench] = step.until
        now = min([*ends.values(), course.wakes(now)])
        if not math.isfinite(now):
            break
        for index in [index for index, end in ends.items() if end <= now]:
            del ends[index]
            ending = dice.choices(list(EndOfTest), [8, 2, 2, 1, 1])[0]
            plan, bench = tests[index].plan, tests[index].bench
            final = course.ended(index, now, ending)
            plain.used[bench] = now
            again = (
                ending.value in plan.retry_on and plain.tries[index] <= plan.retries and "night" not in plain.stopped
            )
            if ending is EndOfTest.BUSY:
                plain.tries[index] -= 1
            if ending is EndOfTest.BUSY or again:
                pause = BUSY_PAUSE if ending is EndOfTest.BUSY else plan.retry_after.value
                plain.state[index], plain.since[index] = "waiting", now + pause
                if ending is not EndOfTest.BUSY:
                    failed[index] = ending
                assert not final
                continue
            assert final
            plain.state[index], plain.passed[index] = "ended", ending is EndOfTest.PASSED
            stop(index, ending)
    assert set(course.waiting) == {index for index, state in enumerate(plain.state) if state == "waiting"}


def test_the_work_grows_with_the_number_of_tests_and_not_with_its_square(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two benches share one device, and a third of the tests wait for others, so that most tests wait most of the time. The work is counted
    in looks at a test; 1000 tests took more than a million of them when every decision looked at every test."""
    looks = 0
    look = NightCourse._obstacle

    def counted(course: NightCourse, test: PlannedTest, now: float) -> str:
        nonlocal looks
        looks += 1
        return look(course, test, now)

    monkeypatch.setattr(NightCourse, "_obstacle", counted)

    def looks_of(count: int) -> int:
        nonlocal looks
        entries: dict[str, Any] = {"plan": "p", "matrix": {"n": [str(number) for number in range(10)]}}
        names = [f"p{k}" for k in range(count // 20)]
        plans = {name: {**entries, **({"after": names[k - 1]} if k % 3 == 2 else {})} for k, name in enumerate(names)}
        suite = suite_of(benches={"a": {"bench": "virtual"}, "b": {"bench": "virtual"}}, devices={"D": {}}, plans=plans)
        tests = expand_suite(suite, Path(), Findings())
        hours = NightHours(0.0, math.inf, {name: BenchHours(None, 0.0, math.inf) for name in "ab"})
        looks = 0
        found = foresee(tests, [10.0] * len(tests), hours, None)
        assert len(tests) == count
        assert len(found.slots) == count
        return looks

    assert looks_of(1000) < 5 * 1000
    assert looks_of(1000) < 6 * looks_of(200)

"""The timetable against hand-worked nights: order, parallel benches, warm-up, windows, budget, daylight saving, failures."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import pytest

from planrunner.base.findings import Findings
from planrunner.night.civil_time import openings, shown_time
from planrunner.night.expansion import expand_suite
from planrunner.night.suite import NightWindow, Suite, read_suite
from planrunner.night.timetable import (
    BUSY_PAUSE,
    Begin,
    EndOfTest,
    NightCourse,
    NightForecast,
    WarmUp,
    foresee,
    night_hours,
)
from planrunner.plan import source

BERLIN = ZoneInfo("Europe/Berlin")
T0 = datetime(2026, 1, 12, 20, 0, tzinfo=UTC).timestamp()
HOUR = 3600.0


def suite_of(**keys: Any) -> Suite:
    log = Findings()
    whole = {"planrunner_suite": 1, "title": "t", "benches": {"a": {"bench": "virtual"}}, **keys}
    suite = read_suite(source.parse(json.dumps(whole), "s"), log)
    assert suite is not None and not log.errors, [str(item) for item in log]
    return suite


def course_of(suite: Suite, hours: dict[str, float] | float, begins: float = T0) -> NightCourse:
    tests = expand_suite(suite, Path(), log := Findings())
    assert not log.errors
    durations = [HOUR * (hours if isinstance(hours, float) else hours[test.entry]) for test in tests]
    return NightCourse(tests, durations, night_hours(suite, begins, UTC), UTC)


def night(
    suite: Suite, hours: dict[str, float] | float, begins: float = T0, zone: Any = UTC
) -> tuple[dict[str, tuple[float, float]], dict[str, str], NightForecast]:
    """Test → begin and end in hours since 20:00 UTC; test → why it does not run."""
    course = course_of(suite, hours, begins)
    found = foresee(course.tests, course.durations, night_hours(suite, begins, zone), zone)
    names = [test.name for test in course.tests]
    times = {
        names[slot.test] if slot.test is not None else f"warm {slot.bench}": (
            (slot.begins - T0) / HOUR,
            (slot.ends - T0) / HOUR,
        )
        for slot in found.slots
    }
    return times, {names[index]: reason for index, reason in found.left_out}, found


TWO = {"a": {"bench": "virtual"}, "b": {"bench": "virtual"}}


def test_benches_work_in_parallel_and_dependencies_hold_across_them() -> None:
    suite = suite_of(
        benches=TWO,
        plans={
            "long": {"plan": "p", "benches": "a"},
            "late": {"plan": "p", "benches": "b", "after": "long"},
            "short": {"plan": "p", "benches": "b"},
        },
    )
    times, left, _ = night(suite, {"long": 3.0, "late": 1.0, "short": 1.0})
    assert times == {"long/a": (0, 3), "short/b": (0, 1), "late/b": (3, 4)}
    assert not left


def test_one_device_is_in_one_place_at_a_time() -> None:
    suite = suite_of(benches=TWO, devices={"D": {}}, plans={"x": {"plan": "p"}})
    assert night(suite, 2.0)[0] == {"x/D/a": (0, 2), "x/D/b": (2, 4)}


def test_the_warm_up_is_shared_and_repeated_after_a_long_rest() -> None:
    benches = {"a": {"bench": "virtual", "warm_up": "30 min", "stays_warm": "1 h"}, "b": {"bench": "virtual"}}
    plans = {
        "cold": {"plan": "p", "benches": "a", "warm": False},
        "one": {"plan": "p", "benches": "a"},
        "two": {"plan": "p", "benches": "a"},
        "other": {"plan": "p", "benches": "b"},
        "three": {"plan": "p", "benches": "a", "after": "other"},
    }
    suite = suite_of(benches=benches, plans=plans)
    hours = {"cold": 0.25, "one": 1.0, "two": 1.0, "other": 4.0, "three": 1.0}
    _, _, found = night(suite, hours)
    on_a = [((slot.begins - T0) / HOUR, (slot.ends - T0) / HOUR) for slot in found.slots if slot.bench == "a"]
    # cold, warm-up, one, two; idle from 2.75 to 4; warm-up again, three
    assert on_a == [(0, 0.25), (0.25, 0.75), (0.75, 1.75), (1.75, 2.75), (4, 4.5), (4.5, 5.5)]


def test_what_does_not_fit_is_left_out_with_the_reason_and_shorter_tests_go_on() -> None:
    suite = suite_of(
        budget="3 h",
        plans={
            "one": {"plan": "p"},
            "long": {"plan": "p"},
            "short": {"plan": "p"},
            "after_long": {"plan": "p", "needs": "long"},
        },
    )
    times, left, found = night(suite, {"one": 1.0, "long": 2.5, "short": 1.0, "after_long": 0.1})
    assert times == {"one/a": (0, 1), "short/a": (1, 2)}
    assert left == {
        "long/a": "it does not fit: it takes 2 h 30 min, and bench a is available only until 2026-01-12 23:00 UTC",
        "after_long/a": "it needs long/a, which did not run",
    }
    assert (found.ends - T0) / HOUR == 2


def test_a_night_begins_when_its_window_opens_and_ends_with_it() -> None:
    suite = suite_of(
        window={"from": "22:00", "to": "01:00"}, plans={"x": {"plan": "p"}, "y": {"plan": "p"}, "z": {"plan": "p"}}
    )
    times, left, _ = night(suite, 1.5)
    assert times == {"x/a": (2, 3.5), "y/a": (3.5, 5)}
    assert "until 2026-01-13 01:00 UTC" in left["z/a"] or "ended at 2026-01-13 01:00 UTC" in left["z/a"]
    within = night(suite, 1.5, begins=T0 + 3 * HOUR)
    assert within[0] == {"x/a": (3, 4.5)}


def test_a_bench_has_its_own_hours() -> None:
    benches = {"a": {"bench": "virtual", "window": {"from": "23:00", "to": "01:00"}}, "b": {"bench": "virtual"}}
    suite = suite_of(benches=benches, plans={"x": {"plan": "p"}, "y": {"plan": "p", "benches": "a"}})
    times, left, _ = night(suite, 1.0, begins=T0)
    assert times == {"x/b": (0, 1), "x/a": (3, 4), "y/a": (4, 5)}
    assert not left


@pytest.mark.parametrize(
    ("day", "hours"),
    [("2026-03-28", 7.0), ("2026-10-24", 9.0), ("2026-01-12", 8.0)],
    ids=["clocks go forward", "clocks go back", "neither"],
)
def test_a_window_over_the_change_of_daylight_saving_has_its_true_length(day: str, hours: float) -> None:
    window = NightWindow(opens="22:00", closes="06:00")
    begins = datetime.fromisoformat(f"{day}T12:00").replace(tzinfo=BERLIN).timestamp()
    opening = next(openings(window, begins, BERLIN))
    assert shown_time(opening.opens, BERLIN).startswith(f"{day} 22:00")
    assert shown_time(opening.closes, BERLIN)[11:16] == "06:00"
    assert (opening.closes - opening.opens) / HOUR == hours
    suite = suite_of(
        zone="Europe/Berlin",
        window={"from": "22:00", "to": "06:00"},
        plans={"x": {"plan": "p", "matrix": {"n": list("123456789")}}},
    )
    _, left, found = night(suite, 1.0, begins, BERLIN)
    assert len(found.slots) == hours
    assert len(left) == 9 - hours


def test_times_that_exist_twice_or_not_at_all_do_no_harm() -> None:
    for day in ("2026-03-29", "2026-10-25"):
        begins = datetime.fromisoformat(f"{day}T00:30").replace(tzinfo=BERLIN).timestamp()
        opening = next(openings(NightWindow(opens="02:30", closes="03:30"), begins, BERLIN))
        assert opening.opens > begins
        assert 0 < opening.closes - opening.opens <= 2 * HOUR


def test_windows_open_on_their_days_only() -> None:
    monday = datetime(2026, 1, 12, 12, 0, tzinfo=UTC).timestamp()
    found = openings(NightWindow(opens="22:00", closes="06:00", days=("fri", "sat")), monday, UTC)
    assert [shown_time(next(found).opens, UTC)[:10] for _ in range(3)] == ["2026-01-16", "2026-01-17", "2026-01-23"]


def step(course: NightCourse, now: float) -> Begin | WarmUp | None:
    found = course.next(now)
    if isinstance(found, Begin):
        course.begun(found.test, now)
    return found


def test_a_fault_is_repeated_after_the_pause_and_then_stops_the_bench() -> None:
    suite = suite_of(
        benches=TWO,
        plans={"x": {"plan": "p", "benches": "a", "retries": 1, "retry_after": "5 min"}, "y": {"plan": "p"}},
    )
    course = course_of(suite, 1.0)
    assert isinstance(step(course, T0), Begin) and isinstance(step(course, T0), Begin)  # x/a and y/b
    assert not course.ended(0, T0 + 60, EndOfTest.FAULT)
    assert isinstance(step(course, T0 + 60), Begin)  # y/a uses the pause
    assert course.running == (1, 2)
    assert course.ended(1, T0 + 61, EndOfTest.PASSED)
    assert course.next(T0 + 61) is None
    assert course.wakes(T0 + 61) == T0 + 60 + 300
    assert step(course, T0 + 360) == Begin(0, T0 + 360)
    assert course.ended(0, T0 + 400, EndOfTest.FAULT)
    assert list(course.out_of_reach(T0 + 400)) == []
    assert course.ended(2, T0 + HOUR, EndOfTest.PASSED)


@pytest.mark.parametrize(
    ("action", "left"),
    [
        ("continue", []),
        ("stop_device", ["y/D1/a"]),
        ("stop_bench", ["x/D2/a", "y/D1/a", "y/D2/a"]),
        ("stop_night", ["x/D2/a", "x/D3/b", "y/D1/a", "y/D2/a", "y/D3/b"]),
    ],
)
def test_what_a_failed_limit_stops(action: str, left: list[str]) -> None:
    devices = {"D1": {"benches": "a"}, "D2": {"benches": "a"}, "D3": {"benches": "b"}}
    suite = suite_of(benches=TWO, devices=devices, plans={"x": {"plan": "p", "on_limit": action}, "y": {"plan": "p"}})
    course = course_of(suite, 1.0)
    assert step(course, T0) == Begin(0, T0)
    assert course.ended(0, T0 + HOUR, EndOfTest.LIMIT)
    assert sorted(course.tests[index].name for index, _ in course.out_of_reach(T0 + HOUR)) == sorted(left)


def test_a_bench_in_use_is_tried_again_without_counting_as_an_attempt() -> None:
    course = course_of(suite_of(plans={"x": {"plan": "p"}}), 1.0)
    for attempt in range(5):
        at = T0 + attempt * BUSY_PAUSE
        assert step(course, at) == Begin(0, at)
        assert not course.ended(0, at, EndOfTest.BUSY)
        assert course.next(at) is None
    assert course.attempts(0) == 0


def test_what_needs_a_failed_test_does_not_run_and_what_comes_after_it_does() -> None:
    suite = suite_of(
        plans={"x": {"plan": "p"}, "needs": {"plan": "p", "needs": "x"}, "after": {"plan": "p", "after": "x"}}
    )
    course = course_of(suite, 1.0)
    step(course, T0)
    course.ended(0, T0 + HOUR, EndOfTest.LIMIT)
    assert list(course.out_of_reach(T0 + HOUR)) == [(1, "it needs x/a, which did not pass")]
    assert step(course, T0 + HOUR) == Begin(2, T0 + HOUR)


def test_two_hundred_tests_are_foreseen() -> None:
    values = [str(number) for number in range(20)]
    plans = {f"p{number}": {"plan": "p", "matrix": {"n": values}} for number in range(10)}
    times, left, found = night(suite_of(budget="180 h", plans=plans), 1.0)
    assert len(times) == 180 and len(left) == 20
    assert math.isclose(found.ends, T0 + 180 * HOUR)

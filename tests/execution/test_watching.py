"""Looking after the bench while a segment dwells: limits of the plan and of the bench, faults, doubts, frames, retakes, links."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from fake_bench import segment
from test_executor import carry_out
from watched_bench import make_watched_bench

from planrunner.archive.run_reader import RunReader
from planrunner.instruments.interfaces import Condition, FrameCounts, InstrumentError, OwnLimits
from planrunner.plan.schedule import Schedule, Spin, Watch


def plan(watch: Watch | None, **given: object) -> Schedule:
    return Schedule((segment(0, "P1", watch=watch, **given),), 0.0)


def events(reader: RunReader, kind: str) -> list[dict[str, object]]:
    lines = (reader.path / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    assert reader.basis.events == len(lines)
    return [event for event in map(json.loads, lines) if event["event"] == kind]


def disturbed_once(first: float, last: float) -> object:
    return lambda now: Condition({"position_error": 1e-3 if first <= now <= last else 1e-6})


def test_a_passed_limit_is_retaken_and_the_first_data_are_kept(tmp_path: Path) -> None:
    """Disturbed at 11 s, 3 s into the first dwell (5 s to move, 3 s to settle): the second attempt, settled anew, counts."""
    bench = make_watched_bench()
    bench.table.course = disturbed_once(10.5, 11.5)
    outcome, reader = carry_out(tmp_path, bench, plan(Watch({"position_error": 1e-4}, retakes=2)))
    assert outcome.ok
    (counts,) = reader.acknowledged()
    assert (counts.attempt, sum(part.rows for part in counts.parts)) == (2, 100)
    (rejected,) = reader.rejected()
    assert rejected.attempt == 1 and rejected.reason.startswith(
        "position error 206.3 arcsec is more than the 20.63 arcsec"
    )
    assert sum(part.rows for part in rejected.parts) == 40
    assert bench.clock.now() == 11 + 3 + 10
    assert reader.sealed and reader.check_digests() == 5  # run, plan, bench, both attempts


def test_a_spinning_table_comes_to_rest_before_it_is_taken_again(tmp_path: Path) -> None:
    bench = make_watched_bench()
    bench.table.course = lambda now: Condition({"rate_error": 1.0 if 11.5 <= now <= 12.5 else 0.0})
    outcome, _ = carry_out(tmp_path, bench, plan(Watch({"rate_error": 0.1}, retakes=1), motion=Spin(1.0)))
    assert outcome.ok
    moves = [call for call in bench.calls if call.startswith(("table.begin", "table.end", "table.orient"))]
    assert moves == ["table.orient 10", "table.begin Spin 13", "table.end"] * 2


@pytest.mark.parametrize(("retakes", "taken"), [(0, 1), (2, 3)])
def test_retakes_are_bounded(tmp_path: Path, retakes: int, taken: int) -> None:
    bench = make_watched_bench()
    bench.table.course = lambda now: Condition({"position_error": 1e-3})
    outcome, reader = carry_out(tmp_path, bench, plan(Watch({"position_error": 1e-4}, retakes=retakes)))
    assert not outcome.finished and len(outcome.failures) == 1
    assert ("it was recorded 3 times" in outcome.failures[0].message) == (retakes == 2)
    assert len(reader.rejected()) == taken
    assert bench.calls[-3:] == ["table.safe", "chamber.safe", "sensor.safe"]


def test_a_segment_that_is_kept_when_cut_short_is_not_kept_when_a_limit_is_passed(tmp_path: Path) -> None:
    bench = make_watched_bench()
    bench.table.course = disturbed_once(9.5, 10.5)
    outcome, reader = carry_out(tmp_path, bench, plan(Watch({"position_error": 1e-4}), on_break="keep"))
    assert not outcome.finished and not reader.acknowledged() and len(reader.rejected()) == 1


def test_a_temperature_that_drifts_during_the_dwell(tmp_path: Path) -> None:
    """0.01 K/s against 0.005 K/s, seen once a minute has passed; a ramp of the plan is no drift."""
    for ramp, ok in ((None, False), (330.15, True)):
        bench = make_watched_bench()
        bench.chamber.course = lambda now: Condition({"temperature": 298.15 + 0.01 * now})
        outcome, reader = carry_out(
            tmp_path, bench, plan(Watch({"temperature_drift": 0.005}), dwell=100.0, ramp_to=ramp)
        )
        assert outcome.ok == ok
        told = [item.reason for item in reader.rejected()]
        assert told == ([] if ok else ["temperature drift 0.6 K/min is more than the 0.3 K/min that the plan allows"])


def test_lost_and_corrupt_frames_are_judged_and_reported(tmp_path: Path) -> None:
    """3 of 1000 lost (one of them by the computer) against 0.2 %; then 2 of 1000, which is no more than that."""
    bench = make_watched_bench()
    good = FrameCounts(received=998, lost=2, details={"latency_s": 0.004})
    bench.sensor.counted = [FrameCounts(received=997, lost=2, overflowed=1), good]
    outcome, reader = carry_out(tmp_path, bench, plan(Watch(lost=0.002, retakes=1)))
    assert outcome.ok
    assert reader.rejected()[0].reason == "3 of 1000 frames were lost (0.003), more than the 0.002 that the plan allows"
    (counted,) = events(reader, "segment")
    assert counted["frames"] == {
        **{"received": 998, "lost": 2, "corrupt": 0, "overflowed": 0, "skipped_bytes": 0},
        "details": {"latency_s": 0.004},
    }
    bench = make_watched_bench()
    bench.sensor.counted = [FrameCounts(received=999, corrupt=1)]
    outcome, _ = carry_out(tmp_path, bench, plan(Watch(corrupt=0.0)))
    assert "1 of 1000 frames were corrupt" in outcome.failures[0].message


@pytest.mark.parametrize("watch", [None, Watch(), Watch(doubts=True, retakes=1)])
def test_doubts_are_noted_once_and_pass_a_limit_where_the_plan_says_so(tmp_path: Path, watch: Watch | None) -> None:
    bench = make_watched_bench()
    bench.sensor.watch = lambda: Condition(doubts=("status bit 3: overload",) if 8 <= bench.clock.now() < 9 else ())
    outcome, reader = carry_out(tmp_path, bench, plan(watch))
    assert outcome.ok
    noted = [(event["instrument"], event["text"], event["label"]) for event in events(reader, "noticed")]
    assert noted == [("sensor", "status bit 3: overload", "P1")]
    assert len(reader.rejected()) == (1 if watch and watch.doubts else 0)


def test_a_fault_ends_the_run_whatever_the_plan_says(tmp_path: Path) -> None:
    bench = make_watched_bench()
    bench.table.course = lambda now: Condition(faults=("the interlock is open",) if now > 8 else ())
    outcome, reader = carry_out(tmp_path, bench, plan(Watch(retakes=5)))
    assert str(outcome.failures[0]) == "segment 'P1', writing samples: 'table' cannot continue: the interlock is open"
    assert len(reader.rejected()) == 1
    assert bench.clock.now() < 11


@pytest.mark.parametrize(
    ("values", "limits", "told"),
    [
        ({"temperature": 350.0}, OwnLimits(hottest=348.15), "76.9 degC, hotter than the 75.0 degC"),
        ({"temperature": 200.0}, OwnLimits(coldest=223.15), "colder than the -50.0 degC"),
        ({"position_error": -0.1}, OwnLimits(position_error=0.03), "error of 0.1 rad, more than the 0.03 rad"),
    ],
)
def test_the_bench_is_kept_to_its_protection(
    tmp_path: Path, values: dict[str, float], limits: OwnLimits, told: str
) -> None:
    bench = make_watched_bench()
    bench.limits = limits
    bench.chamber.course = lambda now: Condition(values if now > 1 else {})
    outcome, _ = carry_out(tmp_path, bench, plan(None))
    assert told in outcome.failures[0].message


def test_control_is_taken_before_the_first_command_and_no_sooner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that fails before answers for the instruments that it has commanded by then, and for no others."""
    bench = make_watched_bench()
    monkeypatch.setattr(bench.chamber, "identify", lambda: dict[int, str]()[0])
    outcome, reader = carry_out(tmp_path / "asked", bench, plan(None))
    assert outcome.untouched == ("table", "chamber", "sensor") and bench.controlled == set()
    assert events(reader, "safe")[0]["untouched"] == ["table", "chamber", "sensor"]

    bench = make_watched_bench()
    known: list[set[str]] = []

    def refuses(limits: OwnLimits) -> list[str]:
        known.append(set(bench.controlled))
        raise InstrumentError("it keeps another limit")

    monkeypatch.setattr(bench.table, "limit", refuses)
    outcome, reader = carry_out(tmp_path / "limited", bench, plan(None))
    assert known == [{"table"}] and outcome.untouched == ("chamber", "sensor")

    bench = make_watched_bench()
    outcome, reader = carry_out(tmp_path / "whole", bench, plan(None))
    assert outcome.ok and outcome.untouched == () and "untouched" not in events(reader, "safe")[0]


def test_nothing_is_commanded_when_nobody_guards_the_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_watched_bench()

    def gone(*names: str) -> None:
        raise InstrumentError("the watchdog process has ended")

    monkeypatch.setattr(bench, "take_control", gone)
    outcome, _ = carry_out(tmp_path, bench, plan(None))
    assert "watchdog process has ended" in outcome.failures[0].message
    commands = ("table.limit", "table.orient", "table.begin", "chamber.set", "sensor.block")
    assert not [call for call in bench.calls if call.startswith(commands)]


def test_own_limits_are_set_before_the_first_move_and_kept_in_the_journal(tmp_path: Path) -> None:
    bench = make_watched_bench()
    bench.limits = OwnLimits(rate=5.5, silence=30.0)
    outcome, reader = carry_out(tmp_path, bench, plan(None))
    assert outcome.ok
    assert bench.table.told == [OwnLimits(rate=5.5, silence=30.0)]
    assert bench.calls.index("table.limit") < bench.calls.index("table.orient 10")
    assert events(reader, "protected")[0]["limits"] == {"table": ["rate at most 5.5 rad/s"]}


def test_a_limit_that_cannot_be_set_prevents_the_first_move(tmp_path: Path) -> None:
    bench = make_watched_bench()
    bench.calls.fail_at = "table.limit"
    outcome, _ = carry_out(tmp_path, bench, plan(None))
    assert str(outcome.failures[0]) == "setting the limits in the instruments: the cable is out"
    assert "table.orient 10" not in bench.calls


def test_a_lost_link_is_noticed_during_a_long_soak(tmp_path: Path) -> None:
    """The sensor's link breaks 100 s into a soak of an hour: told within a second or so, not after the hour."""
    bench = make_watched_bench()

    def beat() -> None:
        if bench.clock.now() > 100:
            raise InstrumentError("sensor: no answer on /dev/ttyUSB0")

    bench.sensor.heartbeat = beat
    outcome, _ = carry_out(tmp_path, bench, plan(None, temperature=298.15, soak=3600.0))
    assert str(outcome.failures[0]) == "segment 'P1', soaking: sensor: no answer on /dev/ttyUSB0"
    assert bench.clock.now() < 103


def test_a_run_ends_when_its_watchdog_is_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_watched_bench()

    def gone() -> None:
        if bench.clock.now() > 8:
            raise InstrumentError("the watchdog process has ended")

    monkeypatch.setattr(bench, "sign_of_life", gone)
    outcome, _ = carry_out(tmp_path, bench, plan(None))
    assert outcome.failures[0].message == "the watchdog process has ended"
    assert bench.calls[-3:] == ["table.safe", "chamber.safe", "sensor.safe"]


def test_what_drivers_had_to_do_again_is_in_the_journal(tmp_path: Path) -> None:
    bench = make_watched_bench()
    bench.sensor.said = ["asked twice: no answer to ':read:pos? 1' within 0.2 s"]
    outcome, reader = carry_out(tmp_path, bench, plan(None))
    assert outcome.ok
    assert [event["text"] for event in events(reader, "noticed")] == [
        "asked twice: no answer to ':read:pos? 1' within 0.2 s"
    ]


def test_a_limit_without_a_value_is_reported(tmp_path: Path) -> None:
    outcome, reader = carry_out(tmp_path, make_watched_bench(), plan(Watch({"rate_error": 1.0})))
    assert outcome.ok
    assert [event["text"] for event in events(reader, "noticed")] == ["no instrument reports the rate error"]


def test_blocks_without_rows_only_let_the_bench_be_looked_after(tmp_path: Path) -> None:
    """A stream that has nothing to give for 5 s: five empty blocks, five looks, no rows."""
    bench = make_watched_bench()
    stream = bench.sensor.stream

    def waiting(item: object) -> object:
        first = None
        for block in stream(item):
            if first is None:
                first = block
                for _ in range(5):
                    bench.clock.sleep(1.0)
                    yield type(block)(block.time[:0], {name: values[:0] for name, values in block.channels.items()})
            yield block

    bench.sensor.stream = waiting
    outcome, reader = carry_out(tmp_path, bench, plan(None))
    assert outcome.ok and bench.table.looks >= 14
    assert sum(part.rows for part in reader.acknowledged()[0].parts) == 100

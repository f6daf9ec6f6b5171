"""The executor: what it asks of the bench and in which order, what it waits for, and how it ends."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_bench import DOWN, Bench, make_bench, mixed_schedule, segment

from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.execution.executor import Outcome, execute
from planrunner.execution.progress import Advanced, SegmentBegun, SegmentFinished
from planrunner.execution.reaching import Patience
from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.schedule import Rest, Schedule, Spin


def new_run(root: Path) -> RunWriter:
    return RunWriter.create(root, "mixed", b"plan", b"bench", {"operator": "A. B."}, "flushed", seed=7)


def carry_out(root: Path, bench: Bench, schedule: Schedule, **options: Any) -> tuple[Outcome, RunReader]:
    options.setdefault("stop", StopRequest())
    with new_run(root) as writer:
        outcome = execute(schedule, bench, writer, **options)
    return outcome, RunReader.open(writer.path)


def test_calls_in_order_for_rest_repeat_and_spin(tmp_path: Path) -> None:
    """Temperature and orientation only where they change; orientation again after a motion."""
    bench = make_bench(block=1000)
    schedule = Schedule(
        (
            segment(0, "a", temperature=308.15, soak=30.0),
            segment(1, "b", temperature=308.15),
            segment(2, "c", attitude=DOWN, motion=Spin(1.0)),
            segment(3, "d", attitude=DOWN),
        ),
        0.0,
    )
    outcome, _ = carry_out(tmp_path, bench, schedule)
    assert outcome == Outcome(4, 4, True)
    told = [call for call in bench.calls if not call.endswith(("identify", "channels", "checkpoint", "read", "block"))]
    assert told == [
        *("chamber.set 308.15", "chamber.at", "table.orient 10", "table.holding", "sensor.stream a"),
        "sensor.stream b",
        *("table.orient -10", "table.holding", "table.begin Spin 13", "table.holding", "sensor.stream c"),
        *("table.end", "table.holding"),
        *("table.orient -10", "table.holding", "sensor.stream d"),
        *("table.safe", "chamber.safe", "sensor.safe"),
    ]
    # chamber 100 + soak 30 + move 5 + settle 3 + dwell 10; then 3 + 10; then 5 + spin-up 2 + 3 + 10 + stop 2; then 5 + 3 + 10
    assert bench.clock.now() == pytest.approx(148 + 13 + 22 + 18)


def test_a_profile_is_settled_before_it_begins(tmp_path: Path) -> None:
    bench = make_bench(block=1000)
    carry_out(tmp_path, bench, Schedule(mixed_schedule().segments[:6], 0.0))
    assert "table.begin Rock 10" in bench.calls
    assert "table.begin Cycle 20" in bench.calls


def test_a_mode_is_entered_once_and_waited_for(tmp_path: Path) -> None:
    """A sensor that is caged, then navigates twice: two changes, two seconds each as the sensor says."""
    bench = make_bench(block=1000)
    modes = ("caged", "navigation", "navigation")
    schedule = Schedule(tuple(segment(k, f"s{k}", mode=mode) for k, mode in enumerate(modes)), 0.0)
    outcome, _ = carry_out(tmp_path, bench, schedule)
    assert outcome.ok
    assert [call for call in bench.calls if "mode" in call] == ["sensor.set_mode caged", "sensor.set_mode navigation"]
    assert bench.clock.now() == pytest.approx(5 + 3 * (3 + 10) + 2 * 2)  # move, settle and dwell, modes


def test_recording_is_what_the_sensor_gave(tmp_path: Path) -> None:
    bench = make_bench()
    schedule = mixed_schedule()
    outcome, reader = carry_out(tmp_path, bench, schedule)
    assert outcome.ok
    recording = reader.recording(schedule)
    assert [item.label for item in recording] == [item.label for item in schedule.segments]
    assert recording[0].units == {"x": "pulse/s", "y": "pulse/s"}
    noise = np.random.default_rng(7)  # the sensor's first segment: blocks of 50 rows, one move
    expected = np.concatenate([noise.standard_normal((2, 50)) + 1 for _ in range(2)], axis=1)
    (block,) = recording[0].blocks(["y", "x"])
    np.testing.assert_array_equal(block.channels["x"], expected[0])
    np.testing.assert_array_equal(block.channels["y"], expected[1])
    np.testing.assert_allclose(recording[0].statistics.mean, expected.mean(axis=1), rtol=1e-12)
    assert recording[3].readings == {"chamber.air_K": 320.15}
    assert reader.instruments["sensor"] == {"model": "S", "serial": "9"}
    assert reader.sealed
    assert reader.check_digests() == 11
    assert reader.basis.events == 4 + 2 * 8 + 1  # created, instruments, started, safe; two a segment; finished


CALLS = (
    *("table.identify", "chamber.identify", "sensor.identify", "sensor.channels", "chamber.set", "chamber.at"),
    *("table.orient", "table.holding", "table.begin", "table.end", "sensor.stream", "sensor.block"),
    *("chamber.read", "table.checkpoint", "sensor.checkpoint"),
)


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("kind", [InstrumentError, ZeroDivisionError, SystemExit, MemoryError])
def test_a_failing_driver_leaves_the_bench_safe(tmp_path: Path, call: str, kind: type[BaseException]) -> None:
    bench = make_bench()
    bench.calls.fail_at, bench.calls.error = call, kind
    outcome, reader = carry_out(tmp_path, bench, mixed_schedule())
    assert not outcome.finished
    assert len(outcome.failures) == 1
    assert outcome.failures[0].kind == kind.__name__
    assert [name for name in bench.calls if name.endswith("safe")] == ["table.safe", "chamber.safe", "sensor.safe"]
    failing = max(index for index, name in enumerate(bench.calls) if name.startswith(call))
    assert bench.calls.index("table.safe") >= failing or call.endswith("checkpoint")
    assert reader.seal is None
    assert reader.state.failures == [str(outcome.failures[0])]


def test_the_failure_names_segment_and_activity(tmp_path: Path) -> None:
    bench = make_bench()
    bench.calls.fail_at = "table.begin Spin"
    outcome, _ = carry_out(tmp_path, bench, mixed_schedule())
    assert str(outcome.failures[0]) == "segment '+300 deg/s', starting the motion: the cable is out"
    assert outcome.completed == 3


def test_a_table_that_never_holds_is_given_up(tmp_path: Path) -> None:
    bench = make_bench()
    bench.table.stuck = True
    outcome, _ = carry_out(tmp_path, bench, mixed_schedule(), patience=Patience(table=7.0))
    assert "does not hold 'P1', 12 s after the command; 5 s were expected" in outcome.failures[0].message
    assert bench.calls[-1] == "sensor.safe"


@pytest.mark.parametrize("expected", [float("nan"), float("inf"), -1.0])
def test_an_expected_time_that_is_none(tmp_path: Path, expected: float) -> None:
    bench = make_bench()
    bench.table.orient = lambda attitude: expected
    outcome, _ = carry_out(tmp_path, bench, mixed_schedule())
    assert "not a time" in outcome.failures[0].message


def test_what_cannot_be_made_safe_is_reported(tmp_path: Path) -> None:
    bench = make_bench()
    bench.safe_fails = True
    outcome, _ = carry_out(tmp_path, bench, mixed_schedule())
    assert outcome.finished
    assert not outcome.ok
    assert outcome.unsafe == ("table: the brake does not answer",)


def test_make_safe_is_asked_again_when_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench, asked = make_bench(), []

    def interrupted() -> list[str]:
        asked.append(1)
        if len(asked) == 1:
            raise KeyboardInterrupt
        return []

    monkeypatch.setattr(bench, "make_safe", interrupted)
    outcome, _ = carry_out(tmp_path, bench, mixed_schedule())
    assert outcome.ok
    assert len(asked) == 2


def test_bench_without_table_and_chamber(tmp_path: Path) -> None:
    """A recording being played back: nothing to move, dwell as long as it lasts."""
    bench = make_bench()
    bench.table = bench.chamber = None
    bench.instruments = {"sensor": bench.sensor}
    schedule = Schedule((segment(0, "all", attitude=None, dwell=None, settle=0.0, transition=0.0),), 0.0)
    outcome, reader = carry_out(tmp_path, bench, schedule)
    assert outcome.ok
    assert reader.recording(schedule)[0].statistics.count == 20


def test_a_motion_that_the_table_cannot_do_is_refused(tmp_path: Path) -> None:
    class Positioner:
        def identify(self) -> dict[str, str]:
            return {}

        def make_safe(self) -> None: ...

        def close(self) -> None: ...

        def orient(self, attitude: object) -> float:
            return 0.0

        def holding(self) -> bool:
            return True

    bench = make_bench()
    bench.table = bench.instruments["table"] = Positioner()
    outcome, _ = carry_out(tmp_path, bench, mixed_schedule())
    assert "cannot carry out the motion of '+300 deg/s'" in outcome.failures[0].message


# -- going on --------------------------------------------------------------------------------------------------------------


def samples(reader: RunReader, schedule: Schedule) -> list[tuple[Any, ...]]:
    rows = []
    for item in reader.recording(schedule):
        blocks = list(item.blocks(["x", "y"]))
        joined = [np.concatenate([block.time for block in blocks]).tolist()]
        joined += [np.concatenate([block.channels[name] for block in blocks]).tolist() for name in ("x", "y")]
        statistics = item.statistics
        rows.append((item.label, joined, statistics.mean.tolist(), statistics.covariance.tolist(), item.readings))
    return rows


@pytest.mark.parametrize(
    "call", ["sensor.stream P2", "table.begin Rock", "table.end", "chamber.set 330", "table.orient 11"]
)
def test_resumed_after_a_failure_equals_uninterrupted(tmp_path: Path, call: str) -> None:
    schedule = mixed_schedule()
    _, whole = carry_out(tmp_path, make_bench(), schedule)
    bench = make_bench()
    bench.calls.fail_at = call
    outcome, broken = carry_out(tmp_path, bench, schedule)
    assert outcome.failures
    bench = make_bench()
    with RunWriter.reopen(broken.path) as writer:
        outcome = execute(schedule, bench, writer, stop=StopRequest(), start_at=writer.next_segment)
    assert outcome.ok
    resumed = RunReader.open(broken.path)
    assert samples(resumed, schedule) == samples(whole, schedule)
    assert resumed.check_digests() > 0


def test_a_real_bench_is_brought_to_its_state_again(tmp_path: Path) -> None:
    """Without checkpoints nothing is known after a break: orientation, temperature and soak again."""
    schedule = Schedule(tuple(segment(i, f"s{i}", temperature=308.15, soak=50.0) for i in range(3)), 0.0)

    class Real:
        def __init__(self, inner: Any, *names: str):
            for name in ("identify", "make_safe", "close", *names):
                setattr(self, name, getattr(inner, name))

    def real_bench() -> Bench:
        bench = make_bench()
        bench.table = Real(bench.table, "orient", "holding", "begin_motion", "end_motion")
        bench.chamber = Real(bench.chamber, "set_temperature", "at_temperature")
        bench.sensor = Real(bench.sensor, "channels", "stream")
        bench.instruments = {"table": bench.table, "chamber": bench.chamber, "sensor": bench.sensor}
        return bench

    first = real_bench()
    first.calls.fail_at = "sensor.stream s1"
    _, reader = carry_out(tmp_path, first, schedule)
    second = real_bench()
    second.chamber.set_temperature.__self__.kelvin = 308.15  # still warm
    with RunWriter.reopen(reader.path) as writer:
        start = writer.resume_point.clock
        assert execute(schedule, second, writer, stop=StopRequest(), start_at=1).ok
    moves = [call for call in second.calls if call.startswith(("table.end", "table.orient"))]
    assert moves == ["table.end", "table.orient 10"]  # it might be turning still
    assert second.clock.now() == pytest.approx(start + 50 + 2 + 5 + 3 + 10 + 3 + 10)


def test_another_instrument_in_its_place_is_refused(tmp_path: Path) -> None:
    schedule, bench = mixed_schedule(), make_bench()
    bench.calls.fail_at = "sensor.stream P2"
    _, reader = carry_out(tmp_path, bench, schedule)
    other = make_bench()
    other.sensor.identify = lambda: {"model": "S", "serial": "10"}
    with RunWriter.reopen(reader.path) as writer:
        outcome = execute(schedule, other, writer, stop=StopRequest(), start_at=1)
    assert "had serial 9 when the run began and has 10 now" in outcome.failures[0].message


# -- progress --------------------------------------------------------------------------------------------------------------


def test_progress_counts_planned_time(tmp_path: Path) -> None:
    schedule = Schedule(
        (segment(0, "short", dwell=2.0), segment(1, "long", dwell=22.0), segment(2, "again", dwell=2.0)), 0.0
    )  # 10, 30 and 10 s with moving and settling
    events: list[Any] = []
    carry_out(tmp_path, make_bench(), schedule, progress=events.append)
    begun = [event for event in events if isinstance(event, SegmentBegun)]
    finished = [event for event in events if isinstance(event, SegmentFinished)]
    assert [event.label for event in begun] == ["short", "long", "again"]
    assert [event.fraction for event in begun] == pytest.approx([0.0, 0.2, 0.8])
    assert [event.fraction for event in finished] == pytest.approx([0.2, 0.8, 1.0])
    assert begun[0].time_left is None
    assert finished[-1].time_left == pytest.approx(0.0)


def test_progress_within_a_segment_on_a_slow_sensor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planrunner.execution.progress.EVERY", 0.0)
    events: list[Any] = []
    carry_out(tmp_path, make_bench(block=10), Schedule((segment(0, "only"),), 0.0), progress=events.append)
    fractions = [event.fraction for event in events if isinstance(event, Advanced)]
    assert fractions == sorted(fractions)
    assert {event.activity for event in events if isinstance(event, Advanced)} >= {"moving the table", "recording"}
    assert len({round(fraction, 6) for fraction in fractions}) > 10


def test_a_broken_progress_display_does_not_end_the_run(tmp_path: Path) -> None:
    def broken(event: Any) -> None:
        raise ValueError("no terminal")

    outcome, _ = carry_out(tmp_path, make_bench(), mixed_schedule(), progress=broken)
    assert outcome.ok


def test_steps_without_planned_time_are_counted(tmp_path: Path) -> None:
    steps = tuple(replace(segment(i, f"s{i}"), dwell=0.0, settle=0.0, transition=0.0, motion=Rest()) for i in range(4))
    events: list[Any] = []
    bench = make_bench()
    bench.sensor = None
    del bench.instruments["sensor"]
    outcome, reader = carry_out(tmp_path, bench, Schedule(steps, 0.0), progress=events.append)
    assert outcome.ok
    assert [event.fraction for event in events if isinstance(event, SegmentFinished)] == [0.25, 0.5, 0.75, 1.0]
    recording = reader.recording(Schedule(steps, 0.0))
    assert recording[2].readings == {"chamber.air_K": 298.15}
    assert recording[2].statistics.count == 0

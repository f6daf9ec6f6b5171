"""How a run ends that is interrupted, terminated or asked to stop: what was recorded stays, the bench is safe."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
from fake_bench import Bench, make_bench, mixed_schedule
from test_executor import carry_out

from planrunner.archive.run_folder import RunWriter
from planrunner.execution.executor import execute
from planrunner.execution.stopping import StopRequest


def stop_on(bench: Bench, call: str, action: Any) -> None:
    """Do `action` when `call` comes."""

    def when_it_comes(noted: str) -> None:
        if noted == call and bench.calls.count(call) == 1:
            action()

    bench.calls.then = when_it_comes


def test_first_interrupt_ends_after_the_segment(tmp_path: Path) -> None:
    bench = make_bench()
    stop_on(bench, "sensor.stream P2", lambda: signal.raise_signal(signal.SIGINT))
    before = signal.getsignal(signal.SIGINT)
    with StopRequest() as stop:
        outcome, reader = carry_out(tmp_path, bench, mixed_schedule(), stop=stop)
    assert signal.getsignal(signal.SIGINT) is before
    assert (outcome.completed, outcome.stopped, outcome.finished) == (2, "after the segment", False)
    assert [item.label for item in reader.acknowledged()] == ["P1", "P2"]
    assert bench.calls[-3:] == ["table.safe", "chamber.safe", "sensor.safe"]


@pytest.mark.parametrize("signals", [("SIGINT", "SIGINT"), ("SIGTERM",)])
def test_second_interrupt_or_termination_ends_at_once(tmp_path: Path, signals: tuple[str, ...]) -> None:
    bench = make_bench(block=10)

    def press() -> None:
        for name in signals:
            signal.raise_signal(getattr(signal, name))

    stop_on(bench, "sensor.stream P2", press)
    with StopRequest() as stop:
        outcome, reader = carry_out(tmp_path, bench, mixed_schedule(), stop=stop)
    assert (outcome.completed, outcome.stopped) == (1, "at once")
    assert bench.sensor.closed == 2
    (rejected,) = reader.rejected()
    assert (rejected.label, rejected.parts[0].rows) == ("P2", 10)  # the block that was there is kept
    assert rejected.reason.startswith("stopped at once")
    assert bench.calls[-3:] == ["table.safe", "chamber.safe", "sensor.safe"]


def test_third_interrupt_breaks_into_a_driver_that_does_not_return(tmp_path: Path) -> None:
    bench = make_bench()

    def press() -> None:
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)

    stop_on(bench, "table.orient -10", press)
    with StopRequest() as stop:
        outcome, _ = carry_out(tmp_path, bench, mixed_schedule(), stop=stop)
    assert outcome.stopped == "at once"
    assert bench.calls[-1] == "sensor.safe"


def test_keyboard_interrupt_without_handlers(tmp_path: Path) -> None:
    bench = make_bench()
    bench.calls.fail_at, bench.calls.error = "sensor.stream P2", KeyboardInterrupt
    outcome, _ = carry_out(tmp_path, bench, mixed_schedule())
    assert (outcome.completed, outcome.stopped, outcome.failures) == (1, "at once", ())
    assert bench.calls[-1] == "sensor.safe"


def test_a_kept_segment_counts_as_truncated(tmp_path: Path) -> None:
    bench, stop = make_bench(block=10), StopRequest()
    stop_on(bench, "sensor.stream last", lambda: stop.request(at_once=True, reason="enough"))
    schedule = mixed_schedule()
    outcome, reader = carry_out(tmp_path, bench, schedule, stop=stop)
    assert outcome.stopped == "at once"
    last = reader.recording(schedule)[-1]
    assert (last.label, last.truncated, last.statistics.count) == ("last", True, 10)
    with RunWriter.reopen(reader.path) as writer:
        again = execute(schedule, make_bench(), writer, stop=StopRequest(), start_at=writer.next_segment)
    assert again.finished
    assert again.completed == 0


def test_a_request_before_the_start_moves_nothing(tmp_path: Path) -> None:
    bench, stop = make_bench(), StopRequest()
    stop.request()
    outcome, _ = carry_out(tmp_path, bench, mixed_schedule(), stop=stop)
    assert outcome.completed == 0
    assert not [call for call in bench.calls if call.startswith(("table.orient", "chamber.set"))]

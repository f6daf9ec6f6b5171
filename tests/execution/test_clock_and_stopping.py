"""Clocks and requests to stop."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from planrunner.bench.clock import VirtualClock, WallClock
from planrunner.execution.stopping import StopRequest


def test_virtual_time_passes_by_sleeping_only() -> None:
    clock = VirtualClock()
    began = time.perf_counter()
    clock.sleep(86_400.0)
    clock.sleep(-5.0)
    assert clock.now() == 86_400.0
    clock.set(10.0)
    assert clock.now() == 10.0
    assert time.perf_counter() - began < 3600


def test_wall_clock_sleeps_and_goes_on_from_a_time() -> None:
    clock = WallClock()
    clock.set(1000.0)
    clock.sleep(0.05)
    assert 1000.05 <= clock.now() < 2000


def test_wall_clock_sleep_is_interruptible() -> None:
    clock = WallClock(slice=0.01)
    asked: list[int] = []

    def callback() -> bool:
        asked.append(1)
        return len(asked) == 3

    clock.attend(callback)
    clock.sleep(3600.0)
    assert len(asked) == 3
    assert clock.now() < 3600


def test_requests_without_signals() -> None:
    told: list[str] = []
    stop = StopRequest(told.append)
    assert not stop.after_segment
    stop.request()
    assert (stop.after_segment, stop.at_once) == (True, False)
    stop.request(at_once=True, reason="enough")
    stop.request()
    assert (stop.at_once, len(told)) == (True, 3)


def test_a_display_that_fails_does_not_keep_the_run_from_stopping() -> None:
    def broken(text: str) -> None:
        raise RuntimeError("reentrant call")

    stop = StopRequest(broken)
    stop.request()
    assert stop.after_segment


def test_handlers_are_restored_after_an_error() -> None:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def fails() -> None:
        with StopRequest():
            assert signal.getsignal(signal.SIGTERM) != before[signal.SIGTERM]
            raise ValueError

    with pytest.raises(ValueError, match=r"^$"):
        fails()
    assert {number: signal.getsignal(number) for number in before} == before


def test_outside_the_main_thread_signals_are_left_alone() -> None:
    seen: list[object] = []

    def work() -> None:
        with StopRequest() as stop:
            seen.append(stop.after_segment)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [False]


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
@pytest.mark.parametrize(("sent", "acknowledged"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_signals_to_a_process_on_the_wall_clock(tmp_path: Path, sent: signal.Signals, acknowledged: bool) -> None:
    """A real process in the middle of a dwell: one Ctrl-C waits for the segment, SIGTERM does not. The dwell begins to end once the
    request is there, however late it comes."""
    script = """
import sys
from dataclasses import replace
from pathlib import Path
from fake_bench import make_bench, segment
from planrunner.archive.run_folder import RunWriter
from planrunner.bench.clock import WallClock
from planrunner.execution.executor import execute
from planrunner.execution.stopping import StopRequest
from planrunner.plan.schedule import Schedule
bench = make_bench()
class Dwelling(WallClock):
    def sleep(self, seconds):
        if seconds > 0.1 and not stop.after_segment:
            print("dwelling", flush=True)
            while not stop.after_segment:
                super().sleep(0.05)
        super().sleep(seconds)
bench.clock = bench.table.clock = bench.chamber.clock = Dwelling()
bench.table.orient = lambda attitude: 0.0
bench.table.until = 0.0
del bench.instruments["sensor"]
bench.sensor = None
schedule = Schedule(tuple(segment(i, f"s{i}", dwell=DWELL, settle=0.0) for i in range(40)), 60.0)
with StopRequest() as stop, RunWriter.create(Path(sys.argv[1]), "p", b"", b"", {}) as writer:
    outcome = execute(schedule, bench, writer, stop=stop)
print(outcome.completed, outcome.stopped, bench.calls[-2:])
"""
    dwell = "0.3" if acknowledged else "3600.0"
    arguments = [sys.executable, "-c", script.replace("DWELL", dwell), str(tmp_path)]
    here = str(Path(__file__).parent)
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, cwd=here) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "dwelling\n"
        process.send_signal(sent)
        told, _ = process.communicate(timeout=240)
    expected = "1 after the segment" if acknowledged else "0 at once"
    assert told == f"{expected} ['table.safe', 'chamber.safe']\n"

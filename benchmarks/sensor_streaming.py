"""Records four STIM300 at 2 kHz for ten minutes: lost frames, processor load, and the time from the request of a stop to the safe state.

The sensors are simulated in a separate process, on pseudo-terminals. Like a UART, this process drops bytes that a line does not accept
immediately.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from planrunner.archive.run_folder import RunWriter
from planrunner.bench.clock import WallClock
from planrunner.execution.executor import execute
from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import OwnLimits, Surroundings
from planrunner.instruments.sensors.stim300 import Stim300
from planrunner.physics.earth import Site
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.schedule import Rest, Schedule, Segment

RATE, DATAGRAM = 2000, 0xAF


@dataclass(frozen=True, slots=True)
class Size:
    sensors: int
    seconds: float
    stops: int


FULL, SMALL = Size(4, 600.0, 200), Size(2, 0.5, 2)


def send(lines: list[int]) -> None:
    """Sends STIM300 frames with all contents, each followed by CR LF, on every line until standard input ends."""
    from planrunner.simulators.stim300 import Stim300 as Unit

    index = np.arange(256)
    columns = {f"{name}_{axis}": np.zeros(256) for name in ("gyro", "acc", "incl") for axis in "xyz"}
    columns |= {f"{name}_T_{axis}": np.zeros(256) for name in ("gyro", "acc", "incl") for axis in "xyz"} | {
        "aux": np.zeros(256)
    }
    turn = Unit(DATAGRAM, crlf=True).frames(columns, index, np.full(256, 300))
    size, turns = turn.shape[1], turn.tobytes() * 9  # a second and more, so that any stretch is one slice
    for line in lines:
        os.set_blocking(line, False)
    ended = threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait_for_the_end, daemon=True).start()
    print("sending", flush=True)
    begun, sent = time.monotonic(), 0
    while not ended.wait(0.002):
        due = min(int((time.monotonic() - begun) * RATE), sent + RATE)
        data = turns[(sent % 256) * size : (sent % 256 + due - sent) * size]
        for line in lines:
            with contextlib.suppress(BlockingIOError):
                os.write(line, data)
        sent = due


class Units:
    """The process that sends frames, and the names of its lines."""

    def __init__(self, count: int):
        import tty

        pairs = [os.openpty() for _ in range(count)]
        for _, slave in pairs:
            tty.setraw(slave)
        self.ports = [os.ttyname(slave) for _, slave in pairs]
        masters = [master for master, _ in pairs]
        command = [sys.executable, "-m", "benchmarks.sensor_streaming", *map(str, masters)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, pass_fds=masters
        )
        self._lines = [line for pair in pairs for line in pair]

    def __enter__(self) -> Units:
        assert self._process.stdout is not None
        self._process.stdout.readline()  # it sends
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()
        for line in self._lines:
            os.close(line)


def connected(port: str, clock: WallClock) -> Stim300:
    keys: Any = SimpleNamespace(
        port=port,
        baud=1843200,
        sample_rate=parse_quantity(f"{RATE} Hz"),
        silence=parse_quantity("1 s"),
        datagram=DATAGRAM,
        acceleration_range="10 g",
        gyro_output="rate",
    )
    sensor = Stim300.connect(keys, Surroundings(clock, Site(0.7, 9.8), real_time=True))
    assert isinstance(sensor, Stim300)
    return sensor


def segment(dwell: float) -> Segment:
    return Segment(0, "stream", None, "", Rest(), dwell)


def sustained(count: int, seconds: float) -> dict[str, object]:
    clock, rows = WallClock(), [0] * count

    def stream(place: int, sensor: Stim300) -> None:
        for block in sensor.stream(segment(seconds)):
            rows[place] += block.time.size

    with Units(count) as units:
        sensors = [connected(port, clock) for port in units.ports]
        threads = [threading.Thread(target=stream, args=item) for item in enumerate(sensors)]
        began, processor = time.perf_counter(), time.process_time()
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        took, used = time.perf_counter() - began, time.process_time() - processor
        counts = [sensor.counts() for sensor in sensors]
        for sensor in sensors:
            sensor.close()
    assert rows == [count.received for count in counts]
    return {
        "sensors × s": f"{count} × {seconds:g}",
        "frames recorded": sum(rows),
        "frames lost (target 0)": sum(count.lost for count in counts),
        "frames corrupt (target 0)": sum(count.corrupt for count in counts),
        "frames dropped because the buffer was full (target 0)": sum(count.overflowed for count in counts),
        "share of one processor [%]": 100 * used / took,
        "usual delay of a reading [ms]": 1e3 * max(count.details["usual_delay_s"] for count in counts),
        "largest delay of a reading [ms]": 1e3 * max(count.details["worst_delay_s"] for count in counts),
    }


class Bench:
    """A bench with one sensor. It records the time at which it is made safe."""

    def __init__(self, sensor: Stim300, clock: WallClock):
        self.clock, self.sensor = clock, sensor
        self.table = self.chamber = None
        self.monitors: dict[str, Any] = {}
        self.instruments = {"imu": sensor}
        self.limits = OwnLimits()
        self.safe_at = 0.0

    def sign_of_life(self) -> None:
        """Does nothing, because there is no watchdog."""

    def take_control(self, *names: str) -> None:
        """Does nothing, because the whole bench is always made safe."""

    @property
    def untouched(self) -> tuple[str, ...]:
        return ()

    def make_safe(self) -> list[str]:
        self.safe_at = time.perf_counter()
        return []


def stops(folder: Path, count: int) -> dict[str, object]:
    """Returns the times from the second Ctrl-C to the call that makes the bench safe, s. During this time, the sensor streams at
    its full rate."""
    draw, clock, waited = np.random.default_rng(0), WallClock(), []
    with Units(1) as units:
        sensor = connected(units.ports[0], clock)
        for _ in range(count):
            bench, stop, asked = Bench(sensor, clock), StopRequest(), [0.0]

            def ask(stop: StopRequest = stop, asked: list[float] = asked) -> None:
                asked[0] = time.perf_counter()
                stop.request(at_once=True, reason="benchmark")

            timer = threading.Timer(draw.uniform(0.3, 0.5), ask)
            with RunWriter.create(folder, "stop", b"", b"", {}, "flushed") as writer:
                timer.start()
                outcome = execute(Schedule((segment(60.0),), 0.0), bench, writer, stop=stop)
            assert outcome.stopped == "at once" and not outcome.failures
            waited.append(bench.safe_at - asked[0])
        sensor.close()
    return {
        f"stop to safe, median of {count} [ms]": 1e3 * float(np.median(waited)),
        "stop to safe, 99 % quantile [ms]": 1e3 * float(np.quantile(waited, 0.99)),
    }


def run(size: Size = FULL) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder:
        return sustained(size.sensors, size.seconds) | stops(Path(folder), size.stops)


if __name__ == "__main__":
    send([int(number) for number in sys.argv[1:]])

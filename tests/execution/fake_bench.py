"""A small bench for the executor's tests: instruments that keep a list of the calls they got, and fail on demand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from planrunner.bench.clock import VirtualClock
from planrunner.instruments.interfaces import Block, InstrumentError, OwnLimits
from planrunner.plan.schedule import Cycle, Motion, Move, Rest, Rock, Schedule, Segment, Spin

UP = np.eye(3)
DOWN = np.diag([1.0, -1.0, -1.0])
EAST = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


class Calls(list[str]):
    """What was asked of the bench, in order. `fail_at` names a call that raises a new `error`; `then` is called after each call."""

    fail_at: str = ""
    error: type[BaseException] = InstrumentError
    clock: Any = None
    then: Callable[[str], None] | None = None

    def note(self, call: str) -> None:
        self.append(call)
        if self.fail_at and call.startswith(self.fail_at):
            raise self.error("the cable is out")
        if self.then is not None:
            self.then(call)


class Table:
    def __init__(self, clock: VirtualClock, calls: Calls):
        self.clock, self.calls = clock, calls
        self.until = 0.0
        self.rate = 0.0
        self.stuck = False
        self.moves = 0

    def identify(self) -> Mapping[str, str]:
        self.calls.note("table.identify")
        return {"model": "T", "serial": "1"}

    def orient(self, attitude: Any) -> float:
        self.calls.note(f"table.orient {int(attitude[2, 2])}{int(attitude[0, 1])}")
        self.moves += 1
        self.until = self.clock.now() + 5
        return 5.0

    def holding(self) -> bool:
        self.calls.note("table.holding")
        return not self.stuck and self.clock.now() >= self.until

    def begin_motion(self, motion: Motion, seconds: float) -> float:
        self.calls.note(f"table.begin {type(motion).__name__} {seconds:g}")
        self.rate = motion.rate if isinstance(motion, Spin) else 0.1
        self.until = self.clock.now() + 2
        return 2.0

    def end_motion(self) -> float:
        self.calls.note("table.end")
        self.rate = 0.0
        self.until = self.clock.now() + 2
        return 2.0

    def make_safe(self) -> None:
        self.calls.append("table.safe")
        self.rate = 0.0

    def close(self) -> None: ...

    def checkpoint(self) -> Mapping[str, Any]:
        self.calls.note("table.checkpoint")
        return {"moves": self.moves, "rate": self.rate}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.moves, self.rate = state["moves"], state["rate"]


class Chamber:
    def __init__(self, clock: VirtualClock, calls: Calls):
        self.clock, self.calls = clock, calls
        self.kelvin = 298.15
        self.until = 0.0

    def identify(self) -> Mapping[str, str]:
        self.calls.note("chamber.identify")
        return {"model": "C"}

    def set_temperature(self, kelvin: float) -> float:
        self.calls.note(f"chamber.set {kelvin:g}")
        seconds = abs(kelvin - self.kelvin) * 10
        self.kelvin, self.until = kelvin, self.clock.now() + seconds
        return seconds

    def at_temperature(self) -> bool:
        self.calls.note("chamber.at")
        return self.clock.now() >= self.until

    def read(self) -> Mapping[str, float]:
        self.calls.note("chamber.read")
        return {"air_K": self.kelvin}

    def make_safe(self) -> None:
        self.calls.append("chamber.safe")

    def close(self) -> None: ...

    def checkpoint(self) -> Mapping[str, Any]:
        return {"kelvin": self.kelvin, "until": self.until}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.kelvin, self.until = state["kelvin"], state["until"]


class Sensor:
    """Two outputs that depend on noise, on how often the table moved and on its rate, so that a wrong resume shows."""

    def __init__(self, clock: VirtualClock, calls: Calls, table: Table, rate: float = 10.0, block: int = 50):
        self.clock, self.calls, self.table = clock, calls, table
        self.rate, self.block = rate, block
        self.noise = np.random.default_rng(7)
        self.closed = 0

    def identify(self) -> Mapping[str, str]:
        self.calls.note("sensor.identify")
        return {"model": "S", "serial": "9"}

    def set_mode(self, mode: str) -> float:
        self.calls.note(f"sensor.set_mode {mode}")
        return 2.0

    def channels(self) -> Mapping[str, str]:
        self.calls.note("sensor.channels")
        return {"x": "pulse/s", "y": "pulse/s"}

    def stream(self, segment: Segment) -> Iterator[Block]:
        self.calls.note(f"sensor.stream {segment.label}")
        left = round((segment.dwell or 2.0) * self.rate)
        try:
            while left:
                self.calls.note("sensor.block")
                count = min(left, self.block)
                time = self.clock.now() + np.arange(1, count + 1) / self.rate
                values = self.noise.standard_normal((2, count)) + self.table.moves
                yield Block(time, {"x": values[0], "y": values[1] + self.table.rate})
                self.clock.sleep(count / self.rate)
                left -= count
        finally:
            self.closed += 1

    def make_safe(self) -> None:
        self.calls.append("sensor.safe")

    def close(self) -> None: ...

    def checkpoint(self) -> Mapping[str, Any]:
        self.calls.note("sensor.checkpoint")
        return {"noise": self.noise.bit_generator.state}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.noise.bit_generator.state = state["noise"]


@dataclass
class Bench:
    clock: Any
    table: Any
    chamber: Any
    sensor: Any
    instruments: dict[str, Any] = field(default_factory=dict)
    calls: Calls = field(default_factory=Calls)
    safe_fails: bool = False
    limits: OwnLimits = field(default_factory=OwnLimits)

    controlled: set[str] = field(default_factory=set)

    def sign_of_life(self) -> None: ...

    def take_control(self, *names: str) -> None:
        self.controlled |= set(names or self.instruments)

    @property
    def untouched(self) -> tuple[str, ...]:
        return tuple(name for name in self.instruments if name not in self.controlled)

    def make_safe(self) -> list[str]:
        for instrument in self.instruments.values():
            instrument.make_safe()
        return ["table: the brake does not answer"] if self.safe_fails else []


def make_bench(**sensor: Any) -> Bench:
    clock, calls = VirtualClock(), Calls()
    table, chamber = Table(clock, calls), Chamber(clock, calls)
    probe = Sensor(clock, calls, table, **sensor)
    named = {"table": table, "chamber": chamber, "sensor": probe}
    return Bench(clock, table, chamber, probe, named, calls)


def segment(index: int, label: str, **given: Any) -> Segment:
    return Segment(
        index,
        label,
        **{
            "attitude": UP,
            "orientation": label,
            "motion": Rest(),
            "dwell": 10.0,
            "settle": 3.0,
            "transition": 5.0,
            **given,
        },
    )


def mixed_schedule() -> Schedule:
    """Rest, repeated state, spin, rock, cycle, temperatures and a ramp; the last is kept when cut short."""
    cycle = Cycle({"A": 0.0, "B": 1.0}, (Move("A", 1.0, "B"), Move("B", -1.0, "A")), 0.1, 2.0)
    return Schedule(
        (
            segment(0, "P1", temperature=298.15, soak=60.0),
            segment(1, "P2", attitude=DOWN, temperature=298.15),
            segment(2, "P2 again", attitude=DOWN),
            segment(3, "+300 deg/s", attitude=DOWN, motion=Spin(5.0), temperature=320.15, soak=60.0),
            segment(4, "rocking", attitude=DOWN, motion=Rock(0.05, 0.2, (0.0,), 8.0)),
            segment(5, "turning", attitude=EAST, motion=cycle, dwell=20.0),
            segment(6, "warming", ramp_to=330.15),
            segment(7, "last", temperature=330.15, on_break="keep"),
        ),
        500.0,
    )

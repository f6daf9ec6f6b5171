"""The small bench of `fake_bench` with instruments that say what they see of themselves, as a course over the bench's clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from fake_bench import Bench, Calls, Chamber, Sensor, Table

from planrunner.bench.clock import VirtualClock
from planrunner.instruments.interfaces import Block, Condition, FrameCounts, OwnLimits
from planrunner.plan.schedule import Segment

Course = Callable[[float], Condition]


def quiet(seconds: float) -> Condition:
    return Condition()


class WatchedTable(Table):
    course: Course = staticmethod(quiet)
    looks = 0
    told: Sequence[OwnLimits] = ()

    def watch(self) -> Condition:
        self.looks += 1
        return self.course(self.clock.now())

    def limit(self, limits: OwnLimits) -> Sequence[str]:
        self.calls.note("table.limit")
        self.told = [*self.told, limits]
        return [f"rate at most {limits.rate} rad/s"]


class WatchedChamber(Chamber):
    course: Course = staticmethod(quiet)

    def watch(self) -> Condition:
        return self.course(self.clock.now())


class CountingSensor(Sensor):
    """Its counts come from a list, one for each time that it streams."""

    counted: list[FrameCounts]
    beats = 0

    def heartbeat(self) -> None:
        self.beats += 1
        self.calls.note("sensor.heartbeat")

    def stream(self, segment: Segment) -> Iterator[Block]:
        self._counts = self.counted.pop(0) if self.counted else FrameCounts(received=100)
        yield from super().stream(segment)

    def counts(self) -> FrameCounts:
        return self._counts

    def remarks(self) -> Sequence[str]:
        said, self.said = self.said, []
        return said

    said: list[str]


def make_watched_bench(**sensor: Any) -> Bench:
    clock, calls = VirtualClock(), Calls()
    table, chamber = WatchedTable(clock, calls), WatchedChamber(clock, calls)
    probe = CountingSensor(clock, calls, table, **{"block": 10, **sensor})
    probe.counted, probe.said = [], []
    named: Mapping[str, Any] = {"table": table, "chamber": chamber, "sensor": probe}
    return Bench(clock, table, chamber, probe, dict(named), calls)

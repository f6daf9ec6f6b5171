"""Runs the virtual bench, with table, chamber and sensor, at a given multiple of real time.

The whole simulation runs in one thread. Before the virtual world is changed, all recorders (functions that make the samples up to
the present time) are called, so that a command does not affect earlier samples.

The sensor runs freely: each sample is made at the end of its interval, even if nobody reads it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from planrunner.instruments.interfaces import Block, Clock, HasModes, InstrumentError
from planrunner.instruments.virtual.chamber import VirtualChamber
from planrunner.instruments.virtual.noise import generator
from planrunner.instruments.virtual.streaming import Sampling
from planrunner.instruments.virtual.table import VirtualTable
from planrunner.instruments.virtual.world import World
from planrunner.plan.quantity import Quantity


class RunningClock:
    """Counts the seconds since the simulated bench was switched on. `speed`: seconds of the bench per second of real time."""

    def __init__(self, speed: float = 1.0):
        self.speed = speed
        self._origin = time.monotonic()

    def now(self) -> float:
        return (time.monotonic() - self._origin) * self.speed

    def sleep(self, seconds: float) -> None:
        """Must not be called, because a simulated instrument cannot wait: it is queried at its current time."""
        raise AssertionError("a simulated instrument cannot wait")


class SampledAtRate(Protocol):
    """States the sample rate among the keys of a sensor."""

    @property
    def sample_rate(self) -> Quantity: ...


@runtime_checkable
class RunsFreely(Protocol):
    """A virtual sensor that makes samples without a segment."""

    @property
    def parameters(self) -> SampledAtRate: ...

    def channels(self) -> Mapping[str, str]: ...

    def sampler(self, sampling: Sampling, draw: np.random.Generator) -> Callable[[int, int], Block]: ...


@dataclass(slots=True)
class LiveWorld:
    """Runs the virtual world and its instruments with a running clock. `table`, `chamber`: the virtual instruments, which know the
    true state; None if the bench has none. `recorders`: functions that are called before each change of the world; the argument is
    the present time."""

    world: World
    clock: Clock
    table: VirtualTable | None = None
    chamber: VirtualChamber | None = None
    recorders: list[Callable[[float], None]] = field(default_factory=list)

    def now(self) -> float:
        return self.clock.now()

    def before_change(self) -> float:
        """Brings all recorders up to date; returns the time."""
        now = self.now()
        for record in self.recorders:
            record(now)
        return now


_GRID = 0.02  # s over which slow noise and temperature are constant
_PIECE = 20_000  # samples made at once
_FREE_RUNNING = 2  # second part of the key of the random generator; segments and switch-on have other keys


class SensorFeed:
    """Makes the samples of the sensor in a live world. `rate`: sample rate, Hz; each sample is a mean over its sampling interval."""

    def __init__(self, live: LiveWorld, sensor: RunsFreely, rate: float):
        self.live = live
        self.sensor = sensor
        self.rate = rate
        self.runs = 0
        self.waiting: list[Block] = []
        self.start_over()
        live.recorders.append(self.catch_up)

    def start_over(self) -> None:
        """Restarts the samples, as after switching on."""
        hold = max(1, round(self.rate * _GRID))
        now = self.live.now()
        self.sampling = Sampling(now, self.rate, 0, hold, hold)
        draw = generator(self.live.world.seed, self.runs, _FREE_RUNNING)
        self.make: Callable[[int, int], Block] = self.sensor.sampler(self.sampling, draw)
        self.made = 0
        self.runs += 1

    def catch_up(self, now: float) -> None:
        """Makes all samples whose interval has ended."""
        hold = self.sampling.hold
        due = math.floor((now - self.sampling.start) * self.rate) // hold * hold
        while self.made < due:
            length = min(_PIECE // hold * hold or hold, due - self.made)
            self.waiting.append(self.make(self.made, length))
            self.made += length

    def take(self) -> list[Block]:
        """Returns the samples that have been made since the last call."""
        self.catch_up(self.live.now())
        taken, self.waiting = self.waiting, []
        return taken

    def set_mode(self, mode: str) -> None:
        """Switches the sensor to one of its modes. Raises `InstrumentError` if the sensor has no modes."""
        if not isinstance(self.sensor, HasModes):
            raise InstrumentError(f"the virtual sensor '{type(self.sensor).__name__}' has no modes")
        self.live.before_change()
        self.sensor.set_mode(mode)
        self.start_over()

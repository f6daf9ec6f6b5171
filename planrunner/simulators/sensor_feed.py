"""The virtual sensor as it runs freely: samples in running time, each made when its time is over, whether anybody listens or not."""

from __future__ import annotations

import math
from collections.abc import Callable

from planrunner.instruments.interfaces import Block
from planrunner.instruments.virtual.noise import generator
from planrunner.instruments.virtual.streaming import Sampling
from planrunner.simulators.live_world import LiveWorld

_GRID = 0.02  # s for which slow noise and temperature stand still
_PIECE = 20_000  # samples made at once
_FREE_RUNNING = 2  # second part of the key of its noise: apart from those of segments and of switching on


class SensorFeed:
    """Samples of a live world's sensor. rate: Hz that it is set to; each sample is a mean over its interval."""

    def __init__(self, live: LiveWorld, rate: float):
        self.live = live
        self.rate = rate
        self.runs = 0
        self.waiting: list[Block] = []
        self.start_over()
        live.recorders.append(self.catch_up)

    def start_over(self) -> None:
        """Begin anew, as after switching on."""
        hold = max(1, round(self.rate * _GRID))
        now = self.live.now()
        self.sampling = Sampling(now, self.rate, 0, hold, hold)
        draw = generator(self.live.world.seed, self.runs, _FREE_RUNNING)
        self.make: Callable[[int, int], Block] = self.live.sensor.sampler(self.sampling, draw)
        self.made = 0
        self.runs += 1

    def catch_up(self, now: float) -> None:
        """Make all samples that are over."""
        hold = self.sampling.hold
        due = math.floor((now - self.sampling.start) * self.rate) // hold * hold
        while self.made < due:
            length = min(_PIECE // hold * hold or hold, due - self.made)
            self.waiting.append(self.make(self.made, length))
            self.made += length

    def take(self) -> list[Block]:
        """What was made since it was last asked."""
        self.catch_up(self.live.now())
        taken, self.waiting = self.waiting, []
        return taken

    def set_mode(self, mode: str) -> None:
        """Switch the sensor into one of its modes."""
        self.live.before_change()
        self.live.sensor.set_mode(mode)
        self.start_over()

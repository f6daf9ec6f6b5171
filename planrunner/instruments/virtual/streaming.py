"""Sends the samples of a simulated sensor in blocks of limited size, in step with the clock of the bench."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.instruments.interfaces import Block, InstrumentError
from planrunner.instruments.models import SensorModel
from planrunner.plan.schedule import Segment

if TYPE_CHECKING:
    from planrunner.instruments.virtual.world import World

BLOCK = 100_000  # samples
_SAMPLES = np.arange(BLOCK + 1, dtype=float)


@dataclass(frozen=True, slots=True)
class Sampling:
    """Describes how the dwell of one segment is sampled.

    `start`: start time of the dwell, s. `rate`: sample rate, Hz. `count`: number of samples in all blocks. `hold`: number of
    samples in about one second; slow quantities of the sensor are held constant over this number of samples. `size`: number of
    samples in a block, a multiple of `hold`.
    """

    start: float
    rate: float
    count: int
    hold: int
    size: int

    @classmethod
    def of(cls, world: World, segment: Segment, sensor: SensorModel) -> Sampling:
        """Returns a `Sampling` for a dwell that begins now. Raises `InstrumentError` if the dwell is not planned or the sensor
        cannot be sampled at the requested rate."""
        if segment.dwell is None:
            raise InstrumentError(
                f"'{segment.label}' has the dwell 'recorded', which is only possible with a recording"
            )
        rate = segment.sample_rate or sensor.sample_rate
        if refused := sensor.rate_refused(segment.sample_rate):
            raise InstrumentError(f"'{segment.label}': {refused}")
        hold = max(1, min(BLOCK, round(rate)))
        size = max(hold, hold * ((round(rate) if world.real_time else BLOCK) // hold))
        return cls(world.now(), rate, max(1, round(segment.dwell * rate)), hold, size)

    def blocks(self, world: World, make: Callable[[int, int], Block]) -> Iterator[Block]:
        """Yields the result of `make(first, length)` for each block, at the time at which the block is complete."""
        for first in range(0, self.count, self.size):
            length = min(self.size, self.count - first)
            block = make(first, length)
            world.clock.sleep(length / self.rate)
            yield block

    def times(self, first: int, length: int, delay: int = 0) -> Array:
        """Returns the times [s] of the samples first … first + length − 1, shape (length,). `delay`: 0 for the start of the
        sampling intervals, 1 for their end."""
        time: Array = _SAMPLES[delay : length + delay] / self.rate
        time += self.start + first / self.rate
        return time

    def middles(self, first: int, length: int) -> Array:
        """Returns the times [s] in the middle of each group of `hold` samples, for the samples first … first + length − 1."""
        middle: Array = np.arange(0.5, -(-length // self.hold)) * self.hold
        return self.start + (first + middle) / self.rate

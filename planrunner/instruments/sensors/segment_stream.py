"""Makes the samples of one segment: converts bytes to blocks with time stamps, and counts losses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.instruments.interfaces import Block, FrameCounts
from planrunner.instruments.sensors.samples import Decoder, Samples, Whole
from planrunner.instruments.wire.framing import Framer, Piece
from planrunner.instruments.wire.host_clock import HostClock, Unwrapping
from planrunner.instruments.wire.serial_stream import Ring

FIRST = 0.25
"""Time [s] for which frames are collected before the first frames get time stamps. The frame with the smallest delay determines
these time stamps."""


class Arriving(Protocol):
    """A source of bytes from a sensor. `ring`: buffer of the bytes that have not been taken."""

    @property
    def ring(self) -> Ring: ...

    def take(self) -> Sequence[Piece]:
        """Returns all bytes that have arrived since the last call, oldest first."""


class SegmentStream:
    """The stream of one segment. The stream takes `wanted` samples after the time `start` [s by the bench's clock].

    `byte_time`: transmission time of one byte, s. `skew`: relative skew of the sensor's clock, as determined from earlier frames.
    `haste`: seconds of the bench's clock per second of real time. `over`: True after all samples have been returned. `heard`:
    number of valid frames in the last call of `advance`. `fresh`: number of these frames whose counter is later than the counters
    of all earlier frames.
    """

    def __init__(
        self,
        decoder: Decoder,
        link: Arriving,
        start: float,
        wanted: int,
        byte_time: float,
        skew: float,
        haste: float = 1.0,
    ):
        self.over = False
        self.heard = self.fresh = 0
        self._decoder, self._link = decoder, link
        self._start, self._wanted, self._haste = start, wanted, haste
        self._framer = Framer(decoder.framing, byte_time)
        self._unwrapping = Unwrapping(decoder.counter, haste)
        self._clock = HostClock(decoder.counter, skew, haste)
        self._pending: Samples | None = None
        self._doubts: dict[str, None] = {}
        self._last = -1
        self._recorded = self._reached = self._repeated = self._disordered = self._refused = self._doubtful = 0
        self._first = math.nan
        self._latency = 0.0

    @property
    def skew(self) -> float:
        """Returns the relative skew of the sensor's clock; positive if this clock is slow."""
        return self._clock.skew

    def take_doubts(self) -> tuple[str, ...]:
        """Returns the doubts that status bits have raised since the last call."""
        doubts, self._doubts = tuple(self._doubts), {}
        return doubts

    def advance(self) -> Block:
        """Returns the samples that have arrived since the last call; there may be none. Raises `InstrumentError` if the port no
        longer exists."""
        samples = self._decoder.decode(self._framer.push(self._link.take()))
        self.heard = len(samples)
        self._refused += samples.refused
        self._doubts |= dict.fromkeys(samples.doubts)
        waiting = samples if self._pending is None else self._pending.and_then(samples)
        index = np.empty(0, np.int64)
        if self._last >= 0 or (len(waiting) and waiting.received[-1] - waiting.received[0] >= FIRST * self._haste):
            index = self._unwrapping.resolve(waiting.received, waiting.counter)
        self._pending = waiting.part(slice(index.size, None))
        chosen = self._onwards(index)
        self.fresh = int(np.count_nonzero(chosen))
        ready = waiting.part(slice(0, index.size)).part(chosen)
        time = self._clock.stamp(index[chosen], ready.received - ready.latency)
        return self._within(time, index[chosen], ready)

    def counts(self) -> FrameCounts:
        details = {
            "clock_skew_ppm": 1e6 * self._clock.skew,
            "worst_delay_s": self._clock.worst_delay,
            "repeated_frames": float(self._repeated),
            "disordered_frames": float(self._disordered),
            "doubtful_frames": float(self._doubtful),
        }
        if self._recorded:
            details["usual_delay_s"] = self._clock.usual_delay
            details["latency_s"] = (
                self._clock.usual_delay + self._framer.length * self._framer.byte_time + self._latency
            )
        return FrameCounts(
            self._recorded,
            self._reached - self._recorded,
            self._framer.corrupt + self._refused,
            math.ceil(self._link.ring.dropped / self._framer.length),
            self._framer.skipped,
            details,
        )

    def _onwards(self, index: Whole) -> NDArray[np.bool_]:
        """Returns a mask of the frames whose counter is later than the counters of all earlier frames. All other frames were sent
        twice or arrived out of order; they are counted."""
        before = np.maximum.accumulate(np.concatenate([[self._last], index]))
        onwards: NDArray[np.bool_] = index > before[:-1]
        again = int(np.count_nonzero(index == before[:-1]))
        self._repeated += again
        self._disordered += index.size - int(np.count_nonzero(onwards)) - again
        self._last = int(before[-1])
        return onwards

    def _within(self, time: Array, index: Whole, ready: Samples) -> Block:
        """Selects the samples of the dwell: the requested number of sampling times, beginning with the first frame after the start
        of the dwell."""
        inside = time > self._start
        if math.isnan(self._first) and inside.any():
            self._first = float(index[inside][0])
        places = np.rint((index - self._first) / self._decoder.counter.step)
        inside &= places < self._wanted
        if inside.any():
            kept = ready.part(inside)
            self._recorded += len(kept)
            self._reached = int(places[inside][-1]) + 1
            self._doubtful += int(np.count_nonzero(kept.doubtful))
            self._latency = float(np.median(kept.latency))
        if places.size and places[-1] >= self._wanted - 1:
            self.over, self._reached = True, self._wanted
        return Block(time[inside], ready.part(inside).channels)

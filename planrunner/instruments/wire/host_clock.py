"""Computes the times of samples from the counter of a sensor, and from the times at which the computer read its frames.

A frame cannot be read early, but buffers and the operating system can delay the reading. Each reading is a point in a diagram of
the time of reading against the counter. The line that relates the counter to the computer's clock is the highest line below all
points. This line contains an edge of the lower convex hull of the points (Moon, Skelly and Towsley, Estimation and removal of clock
skew from network delay measurements, INFOCOM 1999; Zhang, Liu and Xia, Clock synchronization algorithms for network measurements,
INFOCOM 2002). This method cannot find a constant delay. Therefore the transmission time, and the latency that the sensor reports,
are subtracted first."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.instruments.interfaces import InstrumentError

Whole = NDArray[np.int64]

WINDOW = 1.0
"""Length of a window, s. From each window, the reading with the smallest delay is kept."""
MEMORY = 600
"""Number of stored windows. Over their total duration of some minutes, the rate of a crystal oscillator is nearly constant."""
SKEW_AFTER = 20.0
"""Minimum duration of the readings for an estimate of the clock skew, s."""
SLEW = 0.01
"""When the estimated line changes, the time stamps approach the new line gradually. Their rate differs from the rate of the line by
at most this fraction."""
PATIENCE = 0.5
"""Duration [s] of the readings after an interruption that are used to decide whether the computer slept or frames were lost."""
BACKWARDS = 16
"""Largest number of frames by which a counter may step back if frames arrive out of order. The step is also limited to an eighth of
the counter's range."""
FORESTALLED = 1.0
"""If a frame appears to have been read more than this time [s] before it was sent, its counter was reset."""


@dataclass(frozen=True, slots=True)
class FrameCounter:
    """Describes the counter of a sensor: one count lasts `tick` seconds, the counts of successive frames differ by `step`, and the
    counter restarts at `modulus`. For a sensor without a counter, the modulus is 1; in this case, lost frames are detected only if
    they interrupt the stream."""

    tick: float
    step: float = 1.0
    modulus: int = 1

    @property
    def interval(self) -> float:
        """Returns the time between two frames [s]."""
        return self.tick * self.step


@dataclass
class Unwrapping:
    """Extends a counter beyond its modulus, even if the counter has completed one or more periods during a pause in the data.

    After a pause, it may be unclear whether the counter has completed one more period. There are two possibilities. If the computer
    slept, the delays of reading become as small as before. If frames were lost, the delays remain larger. Readings over `PATIENCE`
    seconds decide between these possibilities.
    """

    counter: FrameCounter
    haste: float = 1.0
    """Rate of the clock that gives the times of reading, in seconds per second of real time. The rate differs from 1 for an
    accelerated simulated sensor. Delays that the computer causes always occur in real time."""
    _raw: int = 0
    _index: int = 0
    _received: float = math.nan
    _floor: float = math.nan

    def resolve(self, received: Array, raw: Whole, final: bool = False) -> Whole:
        """Returns the indices of frames, which are counts since the first frame. The result covers the given frames up to the last
        frame whose index is certain, or all frames if `final` is True. The caller must pass the remaining frames again, together
        with the frames that follow. `received`: array of shape (n,), times of reading, s. `raw`: array of shape (n,), values of the
        counter. Raises `InstrumentError` if the counter was reset."""
        if received.size == 0:
            return np.empty(0, np.int64)
        if math.isnan(self._received):
            self._raw, self._received = int(raw[0]) - round(self.counter.step), float(received[0])
            self._index = -round(self.counter.step)
        index, waited = self._index + np.cumsum(self._steps(raw)), np.diff(received, prepend=self._received)
        steps = np.diff(index, prepend=self._index)
        period = self.counter.modulus * self.counter.tick
        doubtful = (
            max(period / 2, 0.1 * self.haste, 5 * self.counter.interval) if self.counter.modulus == 1 else period / 2
        )
        ready = received.size
        for place in np.flatnonzero(waited - steps * self.counter.tick > doubtful):
            if not final and received[-1] - received[place] < PATIENCE * self.haste:
                ready = int(place)
                break
            behind = float(np.min((received - index * self.counter.tick)[place:]))
            before = self._floor if place == 0 else self._lowest(received[:place], index[:place])
            if not math.isnan(before):
                index[place:] += max(0, round((behind - before) / period)) * self.counter.modulus
        if ready:
            self._refuse_jumps(received[:ready] - index[:ready] * self.counter.tick)
            self._floor = self._lowest(received[:ready], index[:ready])
            self._raw, self._index, self._received = (
                int(raw[ready - 1]),
                int(index[ready - 1]),
                float(received[ready - 1]),
            )
        return index[:ready]

    def _refuse_jumps(self, delay: Array) -> None:
        """Raises `InstrumentError` if the counter has jumped ahead, so that frames would have been measured after they were read.
        `delay`: delays of reading, s, relative to a common constant."""
        least, usual = float(np.min(delay)), float(delay[0]) if math.isnan(self._floor) else self._floor
        if least < usual - FORESTALLED * self.haste:
            message = f"the sensor's counter is {usual - least:.3g} s ahead of the received frames"
            raise InstrumentError(
                f"{message}: check whether the sensor was switched off and on, check its power, then resume the run"
            )

    def _steps(self, raw: Whole) -> Whole:
        """Returns the counts between successive frames; negative if the counter has stepped back a little."""
        if self.counter.modulus == 1:
            return np.ones(raw.size, np.int64)
        steps: Whole = np.mod(np.diff(raw, prepend=self._raw), self.counter.modulus)
        back = min(self.counter.modulus // 8, BACKWARDS * self.counter.step)
        steps[steps > self.counter.modulus - back] -= self.counter.modulus
        return steps

    def _lowest(self, received: Array, index: Whole) -> float:
        """Returns the smallest delay of reading in the last second, s, relative to a common constant. `received`: array of shape
        (n,), times of reading, s. `index`: array of shape (n,), indices of the frames."""
        delay = received - index * self.counter.tick
        recent = float(np.min(delay[received >= received[-1] - self.haste]))
        return (
            recent if math.isnan(self._floor) or received[-1] - received[0] >= self.haste else min(recent, self._floor)
        )


@dataclass
class HostClock:
    """Determines the line that relates a counter to the computer's clock. `skew`: relative skew, positive if the ticks of the
    sensor are longer than nominal. The initial value of `skew` is used until there are enough readings. `usual_delay`,
    `worst_delay`: median and largest delay of reading frames relative to the line, s."""

    counter: FrameCounter
    skew: float = 0.0
    haste: float = 1.0
    worst_delay: float = 0.0
    _points: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=MEMORY))
    _delays: deque[float] = field(default_factory=lambda: deque(maxlen=MEMORY))
    _offset: float = math.nan
    _last: tuple[int, float] | None = None

    def stamp(self, index: Whole, received: Array) -> Array:
        """Returns the times of samples, s, shape (n,). The times increase strictly with the indices, also from one call to the
        next. `index`: array of shape (n,), increasing. `received`: array of shape (n,), times of reading minus all known delays, s."""
        if index.size == 0:
            return np.empty(0)
        nominal = index.astype(float) * self.counter.tick
        self._observe(nominal, received)
        rate = self.counter.tick * (1 + self.skew)
        end = self._offset + index[-1] * rate
        if self._last is None:
            times: Array = end + (index - index[-1]).astype(float) * rate
        else:
            first, begun = self._last
            slope = float(np.clip((end - begun) / ((int(index[-1]) - first) * rate), 1 - SLEW, 1 + SLEW)) * rate
            times = begun + (index - first).astype(float) * slope
        self._last = (int(index[-1]), float(times[-1]))
        late = received - times
        self._delays.append(float(np.median(late)))
        self.worst_delay = max(self.worst_delay, float(np.max(late)))
        return times

    @property
    def usual_delay(self) -> float:
        return float(np.median(self._delays)) if self._delays else math.nan

    def _observe(self, nominal: Array, received: Array) -> None:
        delay = received - nominal
        for begin in range(0, nominal.size, 4096):
            least = begin + int(np.argmin(delay[begin : begin + 4096]))
            self._keep(float(nominal[least]), float(delay[least]))
        span = self._points[-1][0] - self._points[0][0]
        if span >= SKEW_AFTER * self.haste:
            self.skew, self._offset = line_under(np.array(self._points))
        else:
            self._offset = min(delay - self.skew * when for when, delay in self._points)

    def _keep(self, nominal: float, delay: float) -> None:
        """Keeps only the smallest delay of every window. `nominal`: time of the frame according to the counter, s. `delay`: time of
        reading minus this time, s."""
        window = WINDOW * self.haste
        if self._points and nominal // window == self._points[-1][0] // window:
            if delay < self._points[-1][1]:
                self._points[-1] = (nominal, delay)
        else:
            self._points.append((nominal, delay))


def line_under(points: Array) -> tuple[float, float]:
    """Returns the slope and the offset of the line that lies below all points and is, on average, closest to them. The points have
    the shape (n, 2). The line contains one edge of the lower convex hull of the points: the edge whose range of abscissae contains
    the mean abscissa of all points. The abscissae must increase."""
    hull: list[tuple[float, float]] = []
    for x, y in points.tolist():
        while len(hull) > 1 and (hull[-1][1] - hull[-2][1]) * (x - hull[-2][0]) >= (y - hull[-2][1]) * (
            hull[-1][0] - hull[-2][0]
        ):
            hull.pop()
        hull.append((x, y))
    middle = float(np.mean(points[:, 0]))
    for (left, low), (right, high) in pairwise(hull):
        if middle <= right:
            slope = (high - low) / (right - left)
            return slope, low - slope * left
    return 0.0, hull[-1][1]

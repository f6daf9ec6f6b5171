"""Finds spikes in recorded angles: single samples that do not agree with the motion around them.

The angle of an encoder or a gimbal may keep one value for a long time. While the base rocks, however, the difference between
successive samples is far larger than a harmful spike. Each sample is therefore compared with a prediction from the three samples
before it and the three samples after it: the interpolation through these six equally spaced points. For a sine whose phase advances
by φ from sample to sample, the error of the prediction is (2·sin(φ/2))⁶/20 of the amplitude: 3·10⁻⁴ for 15 samples per period. A
sample is a spike if two conditions hold. First, neither the noise nor the motion around the sample explains its distance from the
prediction. Second, after the prediction has replaced the sample, all neighbours of the sample agree with the motion. The second
condition excludes steps, and sudden starts and stops of the motion. A small sudden change of the angular rate is similar to a
spike. The explanation that fits better is chosen.

The samples next to the ends of a segment have fewer than three neighbours on one side. These samples are compared with the parabola
through the next three samples. The first and the last sample are not examined, because a motion may begin or end there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import Find, FindKind
from planrunner.base.arrays import Array

RowNumbers = NDArray[np.int64]

_PIECE = 1 << 14  # samples that are examined together
_CONTEXT = 128  # samples before and after these
_STRETCH = 64  # samples of a stretch, from which the scale of the deviations is taken
_LEAST = 20  # samples of a segment that is examined: in a shorter one, a spike's own deviations hide it from `_SUSPECT`
_SIDE = 3  # neighbours on each side
_WEIGHTS = np.array([-1.0, 6.0, -15.0, 20.0, -15.0, 6.0, -1.0]) / 20
_FACTOR = float(np.linalg.norm(_WEIGHTS))  # standard deviation of a deviation, for white noise with the variance 1
_PARABOLA = np.array([1.0, -3.0, 3.0, -1.0])
_PARABOLA_FACTOR = float(np.linalg.norm(_PARABOLA))
_SCALE = 1.4826  # standard deviations per median absolute deviation, for white noise
_SUSPECT = (
    6.0  # mean deviations: a stretch without a larger one, 4.8 standard deviations of white noise, is not examined
)
_AGREES, _SHARE = 4.0, 0.02
"""A neighbour counts as undisturbed if it deviates by at most `_AGREES` standard deviations, or by at most the fraction `_SHARE` of
the spike."""
_KINK = np.array([0.0, -0.1, 0.4, -0.6, 0.4, -0.1, 0.0])  # deviations of |t| at t = −3 … 3
_CLEAR = 3.0  # standard deviations by which a spike fits better than a sudden change of the angular rate
_COUNTS = 3.0  # counts: a smaller deviation can come from rounding
_SMALLEST = math.radians(10 / 3600)  # rad: a smaller deviation changes no result
_COARSE = math.radians(3 / 60)  # rad: a larger deviation does not come from counts that are not declared
_ROUNDED = 1e-9  # rad: a smaller change of the rate comes from the rounding of numbers


class AngleSpikes:
    """Finds spikes in the samples of one channel in one pass over a segment."""

    def __init__(self, channel: str, radian: float, count: float, factor: float) -> None:
        """`radian`: one radian in the channel's unit. `count`: declared resolution in the channel's unit; 0 if none is declared.
        `factor`: number of standard deviations that a spike must exceed."""
        self.channel, self.radian, self.count, self.factor = channel, radian, count, factor
        self.parts: list[tuple[Array, RowNumbers, Array]] = []
        self.held, self.begun = 0, False
        self.found: list[Find] = []

    def add(self, values: Array, first: int, time: Array) -> None:
        """Adds the next samples. `values`, `time`: arrays of shape (n,), the samples and their times [s]. `first`: row number of
        the first of these samples. Samples that are not finite are left out."""
        for low in range(0, len(values), _PIECE):
            part = slice(low, low + _PIECE)
            self._add(values[part], first + low, time[part])

    def _add(self, values: Array, first: int, time: Array) -> None:
        rows = np.arange(first, first + len(values))
        if not math.isfinite(float(values.sum())):
            good = np.isfinite(values)
            values, rows, time = values[good], rows[good], time[good]
        self.parts.append((values.copy(), rows, time.copy()))
        self.held += len(values)
        if self.held >= _PIECE:
            self._examine(last=False)

    def finish(self) -> list[Find]:
        """Returns all findings. The method must be called once, after the last samples."""
        self._examine(last=True)
        return self.found

    def _examine(self, *, last: bool) -> None:
        if not self.parts:
            return
        values, rows, time = (np.concatenate(one) for one in zip(*self.parts, strict=True))
        n = len(values)
        if n >= _LEAST:
            low, high = (_CONTEXT if self.begun else 0), (n if last else n - _CONTEXT)
            for place, off, scale in self._spikes(values, low, high):
                course = float(values[place]) - off
                seconds = float(np.median(np.diff(time)))
                row, at = int(rows[place]), float(time[place])
                spike = Find(FindKind.SPIKE, self.channel, row, 1, at, seconds, off, scale, course, course)
                self.found.append(spike)
        kept = slice(max(n - 2 * _CONTEXT, 0), n)
        self.parts, self.held, self.begun = [(values[kept].copy(), rows[kept], time[kept])], min(n, 2 * _CONTEXT), True

    def _spikes(self, values: Array, low: int, high: int) -> list[tuple[int, float, float]]:
        """Returns the index, the deviation and the noise of each spike among the samples `values` (n,) with an index from `low` up
        to but not including `high`."""
        turn = 2 * math.pi * self.radian
        x = unwrapped = _unwrapped(values, turn) if np.ptp(values) > turn / 2 else values
        off = np.zeros(len(x))
        off[_SIDE:-_SIDE] = _off_course(x)
        size = np.abs(off)
        begins = np.arange(0, max(len(x) - _STRETCH // 2, 1), _STRETCH)
        lengths = np.diff(begins, append=len(x))
        suspect = np.maximum.reduceat(size, begins) > _SUSPECT * np.add.reduceat(size, begins) / lengths
        found: list[tuple[int, float, float]] = []
        if suspect.any():
            scales = np.array([np.median(size[begin : begin + n]) for begin, n in zip(begins, lengths, strict=True)])
            padded = np.pad(_SCALE * scales, 1, mode="edge")
            scale = np.repeat(np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:]), lengths)
            x = x.copy()
            large = np.flatnonzero(size > np.maximum(self.factor * scale, self._smallest))
            large = large[(large >= max(low, _SIDE)) & (large < min(high, len(x) - _SIDE))]
            for k in large[np.argsort(-size[large])].tolist():
                found += self._judged(x, k, float(scale[k]))
        if low == 0:
            found += self._at_the_end(x[: _STRETCH + _SIDE])
        if high == len(x):
            ends = self._at_the_end(x[: -_STRETCH - _SIDE - 1 : -1])
            found += [(len(x) - 1 - place, off, scale) for place, off, scale in ends]
        turns = np.round((unwrapped - values) / turn)
        return sorted((k, off + turn * (_usual(turns, k) - turns[k]), scale) for k, off, scale in found)

    @property
    def _smallest(self) -> float:
        return max(_COUNTS * self.count, _SMALLEST * self.radian)

    def _judged(self, x: Array, k: int, scale: float) -> list[tuple[int, float, float]]:
        """If the sample x[k] is a spike, returns its index, its deviation and the noise as the only entry of a list, and replaces
        the sample in x; otherwise returns an empty list. `scale`: estimate of the size of the deviations around the sample."""
        off = float(_off_course(x[k - _SIDE : k + _SIDE + 1])[0])
        least = max(self.factor * scale, self._smallest)
        if abs(off) <= least or abs(off) <= self._seen_counts(x, k):
            return []
        near = x[max(k - 2 * _SIDE, 0) : k + 2 * _SIDE + 1].copy()
        with_spike = _off_course(near)
        near[min(k, 2 * _SIDE)] -= off
        without = _off_course(near)
        if np.abs(without).max() > max(_AGREES * scale, _SHARE * abs(off)):
            return []
        if len(without) == len(_KINK) and _after_fit(with_spike, _KINK) - without @ without <= (_CLEAR * scale) ** 2:
            return []
        x[k] -= off
        return [(k, off, scale / _FACTOR)]

    def _seen_counts(self, x: Array, k: int) -> float:
        """Returns the smallest deviation of the sample x[k] that rounding cannot cause. This deviation is estimated from the steps
        between the other samples of x (n,)."""
        bends = np.abs(np.diff(x, 2))
        bends[max(k - 2, 0) : k + 1] = 0.0
        bends = bends[bends > _ROUNDED * self.radian]
        return min(_COUNTS * float(bends.min(initial=math.inf)), _COARSE * self.radian)

    def _at_the_end(self, x: Array) -> list[tuple[int, float, float]]:
        """Finds a spike among the first samples of x (n,). For the last samples of a segment, x must be reversed. Returns the index
        of the spike in x, the deviation and the noise as the only entry of a list. The list is empty if there is no spike."""
        scale = _SCALE * float(np.median(np.abs(_off_parabola(x))))
        for k in range(1, _SIDE):
            off = float(_off_parabola(x[k : k + 4])[0])
            if abs(off) <= max(self.factor * scale, self._smallest, self._seen_counts(x, k)):
                continue
            near = x[: k + 8].copy()
            near[k] -= off
            # The replaced sample has three times the weight in the deviation of its neighbour.
            if np.abs(_off_parabola(near)).max() <= max(3 * _AGREES * scale, _SHARE * abs(off)):
                return [(k, off, scale / _PARABOLA_FACTOR)]
        return []


def _unwrapped(values: Array, turn: float) -> Array:
    """Returns the angles of shape (n,) without jumps of a whole turn from sample to sample. If a single sample differs by about half
    a turn from both neighbours, noise decides whether the way to the sample and the way back seem to go in the same direction. The
    way back is then reversed, because the samples after it would otherwise be shifted by a turn."""
    steps = np.diff(values)
    ways = steps - turn * np.round(steps / turn)
    large = np.pad(np.abs(ways) > turn / 4, 1)
    both = ways[:-1] + ways[1:]
    alone = large[1:-2] & large[2:-1] & ~large[:-3] & ~large[3:]
    back = np.flatnonzero(alone & (ways[:-1] * ways[1:] > 0) & (np.abs(both - turn * np.round(both / turn)) < turn / 4))
    ways[back + 1] -= turn * np.sign(ways[back])
    return np.asarray(values + turn * np.concatenate(([0.0], np.cumsum(np.round((ways - steps) / turn)))))


def _usual(turns: Array, k: int) -> float:
    """Returns the whole turns by which the neighbours of the sample k were shifted. `turns`: array of shape (n,), the turns by which
    each sample was shifted."""
    near = np.concatenate((turns[max(k - _SIDE, 0) : k], turns[k + 1 : k + 1 + _SIDE]))
    return float(np.sort(near)[len(near) // 2])


def _off_course(x: Array) -> Array:
    """Returns the deviations of the samples x (n,) from the interpolation through their six neighbours, three on each side, shape
    (n − 6,)."""
    return np.correlate(x, _WEIGHTS, "valid")


def _off_parabola(x: Array) -> Array:
    """Returns the deviations of the samples x (n,) from the parabola through the next three samples, shape (n − 3,)."""
    return np.correlate(x, _PARABOLA, "valid")


def _after_fit(x: Array, pattern: Array) -> float:
    """Returns the sum of squares of x that remains after `pattern` has been fitted to x."""
    return float(x @ x - (x @ pattern) ** 2 / (pattern @ pattern))

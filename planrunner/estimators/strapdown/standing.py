"""Examines the readings of a navigating sensor at its stops. These readings show biases that change, and gyros with the wrong sign.

While the sensor stands still, it measures the Earth's rate and gravity. The Earth's rate and gravity are constant in each position,
so every change of the readings within a position is a change of the sensor (or a slow tilt of its base). The sensor counts as still
while its rate, averaged over about a second, does not exceed a few Earth rates. Positions are distinguished by the navigated
attitude.
"""

from __future__ import annotations

import math
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.strapdown.reading import Increments

_STILL = 2.0  # Earth rates; the alignment accepts gyros whose errors are a tenth of one
_SIGMAS = 6.0  # standard deviations of a mean over the time between knots
_SAME = math.radians(1.0)  # largest angle between attitudes of one position
_SHOWN = 0.1  # Earth rates: smallest change of the rate about an axis that shows the sign of a gyro
_CERTAIN = 4.0  # standard deviations of the slope of readings over expected rates
_BLOCKS = 128  # most blocks of time, in each of which the readings of a position are averaged
_SHORTEST = 10.0  # s, shortest block


@dataclass(frozen=True, slots=True, eq=False)
class Stops:
    """Contains mean readings over parts of the stops.

    `time`: array of shape (n,) in s, mean time of each part since the alignment began. `seconds`: array of shape (n,) in s, length
    of the part. `means`: array of shape (n, 6), mean readings of gyros [rad/s] and accelerometers [m/s²]. `position`: array of
    shape (n,), number of the position. `kelvin`: array of shape (n,), temperature, NaN where it is not known. `rotation`: array of
    shape (n, 3, 3), navigated attitude, with the body axes as columns in East-North-Up. `white`: array of shape (6,), white noise,
    rad/√s and m/s/√s, computed from the differences of means over successive intervals of the navigator. `freedom`: degrees of
    freedom of `white`.
    """

    time: Array
    seconds: Array
    means: Array
    position: Array
    kelvin: Array
    rotation: Array
    white: Array
    freedom: float


@dataclass(slots=True, eq=False)
class _Part:
    """Sums of readings in one position of the sensor during one block of time. `rotation`: attitude in this position at the start
    of the block. `sums`: array of shape (9,), sums of the increments, of the seconds, of seconds × time, and of seconds ×
    temperature."""

    position: int
    rotation: Array
    sums: Array = field(default_factory=lambda: np.zeros(9))


class StopReader:
    """Collects the readings at stops, interval by interval of the navigator. The memory needed does not depend on the length of the
    recording."""

    def __init__(self, earth_rate: float, white: Array, seconds: float, begin: float):
        """`earth_rate`: Earth rate, rad/s. `white`: array of shape (6,), noise at rest, rad/√s and m/s/√s. `seconds`: total time of
        alignment and navigation, s. `begin`: time at which the alignment begins, s."""
        self._limit, self._white, self._begin = _STILL * earth_rate, white, begin
        self._block = max(_SHORTEST, seconds / _BLOCKS)
        self._parts: dict[tuple[int, int], _Part] = {}
        self._positions: list[Array] = []  # last attitude of each position
        self._carried = np.zeros(8)
        self._before: tuple[Array, Array, Array] | None = None  # the interval that ends with the last knot
        self._was_still = False
        self._squares, self._count = np.zeros(6), 0
        self._last: tuple[int, Array] | None = None  # position and means of the last interval used

    def part(self) -> None:
        """Records that there is a gap without samples."""
        self._carried = np.zeros(8)
        self._before, self._last, self._was_still = None, None, False

    def take(self, piece: Increments, at: NDArray[np.int64], rotations: Array) -> None:
        """Adds the samples of a piece of the recording. `at`: array of shape (m,), indices of those samples at which intervals of
        the navigator end. `rotations`: array of shape (m, 3, 3), attitude at these samples."""
        kelvin = np.full(piece.time.size, math.nan) if piece.kelvin is None else piece.kelvin
        known = np.isfinite(kelvin)
        if known.any() and not known.all():  # a thermometer may be slower than the sensor
            kelvin = np.interp(piece.time, piece.time[known], kelvin[known])
        sums = np.cumsum(np.vstack([piece.values, piece.interval, kelvin * piece.interval]), axis=1)
        sums += self._carried[:, None]
        self._carried = sums[:, -1] - (sums[:, at[-1]] if len(at) else 0.0)
        if not len(at):
            return
        each = np.diff(sums[:, at], axis=1, prepend=0.0).T
        times = piece.time[at] - self._begin - each[:, 6] / 2
        if self._before is not None:
            each = np.concatenate([self._before[0], each])
            times = np.concatenate([self._before[1], times])
            rotations = np.concatenate([self._before[2], rotations])
        spread = _SIGMAS * float(np.linalg.norm(self._white[:3])) / np.sqrt(each[:, 6])
        slow = np.linalg.norm(each[:, :3], axis=1) / each[:, 6] <= self._limit + spread
        # An interval next to a turn may contain the table's settling.
        still = slow & np.append(self._was_still, slow[:-1]) & np.append(slow[1:], False)
        block = (times / self._block).astype(np.int64)
        changes = np.flatnonzero((np.diff(still) != 0) | (np.diff(block) != 0)) + 1
        for run in np.split(np.arange(len(each) - 1), changes[changes < len(each) - 1]):
            if len(run) and still[run[0]]:
                self._add(each[run], times[run], rotations[run[-1]], int(block[run[0]]))
            elif len(run):
                self._last = None
        if len(each) > 1:
            self._was_still = bool(slow[-2])
        self._before = each[-1:], times[-1:], rotations[-1:]

    def _add(self, each: Array, times: Array, rotation: Array, block: int) -> None:
        """Adds successive intervals of one stop. `each`: array of shape (m, 8), increments, seconds, and seconds × temperature of
        each interval. `times`: array of shape (m,), middle of each interval, s. `rotation`: array of shape (3, 3), attitude.
        `block`: index of the block of time."""
        position = self._position(rotation)
        part = self._parts.setdefault((block, position), _Part(position, rotation))
        part.sums += np.array([*each[:, :7].sum(axis=0), times @ each[:, 6], each[:, 7].sum()])
        means = each[:, :6] / each[:, 6:7]
        if self._last is not None and self._last[0] == position:
            means = np.concatenate([self._last[1], means])
        self._squares += np.sum(np.diff(means, axis=0) ** 2, axis=0) / 2 * each[-1, 6]
        self._count += len(means) - 1
        self._last = position, means[-1:]

    def _position(self, rotation: Array) -> int:
        for k, known in enumerate(self._positions):
            cosine = (float(np.sum(known * rotation)) - 1) / 2
            if cosine >= math.cos(_SAME):
                self._positions[k] = rotation
                return k
        self._positions.append(rotation)
        return len(self._positions) - 1

    def finish(self) -> Stops:
        """Returns the collected readings at all stops."""
        parts = [self._parts[key] for key in sorted(self._parts)]
        sums = np.array([one.sums for one in parts]).reshape(-1, 9)
        seconds = sums[:, 6]
        return Stops(
            sums[:, 7] / seconds,
            seconds,
            sums[:, :6] / seconds[:, None],
            np.array([one.position for one in parts], dtype=np.float64),
            sums[:, 8] / seconds,
            np.array([one.rotation for one in parts]).reshape(-1, 3, 3),
            np.sqrt(self._squares / max(self._count, 1)),
            2 / 3 * self._count,
        )


def opposed_gyros(stops: Stops, earth_rate: Array) -> tuple[int, ...]:
    """Returns the indices of the gyros whose readings change, from position to position, in the opposite sense to the Earth's rate.
    `earth_rate`: array of shape (3,), Earth rate in East-North-Up, rad/s. A constant error of a gyro does not affect the result."""
    found = []
    expected = np.einsum("nij,i->nj", stops.rotation, earth_rate)
    weights = np.sqrt(stops.seconds)
    for k in range(3):
        about = expected[:, k] - np.average(expected[:, k], weights=stops.seconds)
        square = float(np.sum((weights * about) ** 2))
        if len(about) < 3 or np.ptp(expected[:, k]) < _SHOWN * np.linalg.norm(earth_rate):
            continue
        slope = float(np.sum(stops.seconds * about * stops.means[:, k])) / square
        left = stops.means[:, k] - np.average(stops.means[:, k], weights=stops.seconds) - slope * about
        noise = float(np.sum((weights * left) ** 2)) / (len(about) - 2)
        if slope + _CERTAIN * math.sqrt(noise / square) < 0:
            found.append(k)
    return tuple(found)

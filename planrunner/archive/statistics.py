"""Computes the statistics of a segment in one pass over its samples.

Valid samples are processed in chunks of fixed size, counted from the beginning of the segment. The result therefore does not depend
on the division into blocks, row groups or files. Means and covariances of chunks are merged by the formula of Chan, Golub and
LeVeque, "Updating formulae and a pairwise algorithm for computing sample variances" (1979). The standard error of the mean is
computed from the scatter of consecutive batch means (Law, "Simulation Modeling and Analysis", 5th ed., section 9.5.3), so the error
includes noise that is correlated over less than a batch.

If the table turns or rocks during a segment, the sensor measures the Earth's rate, gravity and its own motion, which cause a
periodic signal in the samples. In this module, this signal is called the course of the motion. The scatter is computed from the
differences from the course. The course is fitted to averages over a few consecutive samples; a batch contains many such averages.
The fitted course is then subtracted from the batch means, and its contribution is subtracted from the covariance.

The course repeats with the period of the motion. An output that is linear in the sensed quantity contains the fundamental
frequency; a second-order effect adds twice this frequency. The amplitude and phase of the fundamental may change linearly over the
segment: if the rate of a table is wrong by some ppm, the phase of the signal drifts away from the planned phase. A rocking table
causes more harmonics, because the sensed quantity is a sine of an angle that is itself a sine of time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import BATCHES, Ranges, Statistics, Watcher
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.instruments.interfaces import Block
from planrunner.physics.sampled_motion import period_of
from planrunner.plan.schedule import Motion, Rest, Rock, Spin

_TURNING = 2  # harmonics
_ROCKING = 5  # harmonics: at an amplitude of 60 deg the next Bessel function, J6(1.05), is 3e-5
_VANISHING = 1e-6  # root mean square of a column that is zero but for rounding
_FADED = 0.1  # of a wave: averaging that leaves less is not undone, because noise would grow with it
_RANK = 1e-10  # of the largest eigenvalue
_PER_COLUMN = 4  # times as many means as columns that a fit needs


@dataclass(frozen=True, slots=True)
class MotionCourse:
    """Describes the course of a motion, that is, the periodic signal that the motion causes in the samples.

    `columns`: array of shape (c, p), values of the p functions that make up the periodic signal, each averaged over c short
    intervals. Weighted by the number of samples in each interval, the columns are orthonormal and have zero mean. `samples`: array
    of shape (c,), number of samples in each interval; zero while the table is not in its steady motion. `products`: array of shape
    (p, p), inner products of the p functions at single samples. Averages over intervals would attenuate these products."""

    columns: Array
    samples: Array
    products: Array


def follows_course(motion: Motion) -> bool:
    """Returns True if a motion causes a periodic signal in the samples."""
    return isinstance(motion, Rock) or (isinstance(motion, Spin) and motion.rate != 0)


def course_of(motion: Motion, time: Array, samples: Array, interval: float) -> MotionCourse | None:
    """Returns the periodic signal that a motion causes in averages over a few consecutive samples. Returns None if there are too
    few such averages.

    `time`: array of shape (c,) in s, middle of the interval of each average, counted from the segment's first sample. `samples`:
    array of shape (c,), number of samples in each average. `interval`: time between samples, s.
    """
    if isinstance(motion, Rock):
        since = time - motion.steady
        samples = np.where((since >= 0) & (since <= motion.duration), samples, 0.0)
    harmonics = _ROCKING if isinstance(motion, Rock) else _TURNING
    if np.count_nonzero(samples) < _PER_COLUMN * 2 * (harmonics + 1):
        return None
    pulse = 2 * np.pi / period_of(motion)
    total = samples.sum()
    middle = float(samples @ time / total)
    along = (time - middle) / max(float(np.abs(time - middle).max()), interval)
    found, faded = [], []
    for harmonic in range(1, harmonics + 1):
        # The mean of n samples of a sine is the sine at their middle times Dirichlet's kernel sin(nx)/(n·sin x).
        half = harmonic * pulse * interval / 2
        waves, left = np.exp(1j * harmonic * pulse * time), np.sinc(samples * half / np.pi) / np.sinc(half / np.pi)
        for wave in (waves, waves * along) if harmonic == 1 else (waves,):
            found += [wave.real, wave.imag]
            faded += [left, left]
    fading = np.column_stack(faded)
    columns = np.column_stack(found) * fading
    columns -= samples @ columns / total
    size = np.sqrt(samples @ columns**2 / total)
    seen = size > _VANISHING
    columns, fading = columns[:, seen] / size[seen], np.maximum(np.abs(fading[:, seen]), _FADED)
    values, vectors = np.linalg.eigh(columns.T @ (samples[:, None] * columns))
    kept = values > _RANK * values.max(initial=0.0)
    mixed = vectors[:, kept] / np.sqrt(values[kept])
    unfaded = columns / fading @ mixed
    return MotionCourse(columns @ mixed, samples, unfaded.T @ (samples[:, None] * unfaded))


CHUNK = 65_536
SHORT = 128
"""Maximum number of short means in a batch. It is sufficient for 16 short means in each of 256 turns."""
_ROUNDING = 1e-9
"""If the remainder after the fit of a course is smaller than this fraction of the scatter of the batch means, it consists only of
rounding errors."""
UNSHARED = 8_192
"""Number of samples in one inner product. For more than 10 000 numbers, BLAS would use threads."""
AT_REST = Rest()
LARGEST = 1e100
"""Largest accepted sample. A larger sample cannot be a measurement, and its square could overflow."""


def statistics_of(
    blocks: Iterable[Block],
    channels: Sequence[str],
    rows: int,
    watcher: Watcher | None = None,
    motion: Motion = AT_REST,
) -> Statistics:
    """Computes the statistics of `blocks`, which were recorded during the given motion. `rows`: total number of rows, which is
    known from the files before they are read.

    A row with a non-finite value in any channel is omitted and counted in `rejected`. With one sample, covariance and standard
    error are NaN; without samples, the mean is NaN too. `watcher`: examines the samples while they are read for the statistics.

    Raises ValueError if the time of a valid sample is not a finite number, or if there are several valid samples, but none is later
    than the one before it. Single steps back in time raise no error.
    """
    gathered = _Gathered(len(channels), rows, motion)
    for block in blocks:
        if len(block.time):
            low, high = gathered.add(block.time, [block.channels[name] for name in channels])
            if watcher is not None:
                values = dict(zip(channels, zip(low, high, strict=True), strict=True))
                watcher.add(block, Ranges(values, gathered.steps))
    return gathered.statistics(tuple(channels))


def _products(values: Array) -> Array:
    """Returns the product values @ values.T, (k, k), computed as inner products of short pieces. Longer pieces would start threads
    that cost more time than they save, and a matrix product of a few long rows is slower too."""
    channels, rows = values.shape
    whole = rows - rows % UNSHARED
    out = np.zeros((channels, channels))
    for part, size in ((values[:, :whole], UNSHARED), (values[:, whole:], rows - whole)):
        if part.size:
            pieces = part.reshape(channels, -1, 1, size)
            for row, piece in enumerate(pieces):
                out[row, row:] += (pieces[row:] @ piece.swapaxes(1, 2)).sum(axis=(1, 2, 3))
                out[row:, row] = out[row, row:]
    return out


def _range(columns: list[Array]) -> tuple[Array, Array]:
    """Returns the smallest and the largest sample of each column; NaN for a column that contains NaN."""
    return np.array([column.min() for column in columns]), np.array([column.max() for column in columns])


class _Gathered:
    """State of one pass over the samples: a chunk of samples, and a few numbers for each channel and batch. The size of this state
    does not depend on the length of the segment.

    Samples are stored as deviations from the first sample of their chunk. No sample of n is further than √n standard deviations
    from the mean of all n samples. Rounding errors therefore grow at most by the factor n when the sums of products are converted
    to sums about the mean.
    """

    def __init__(self, channels: int, rows: int, motion: Motion):
        self.motion = motion
        self.row = 0
        self.count = 0
        self.minimum = np.full(channels, math.inf)
        self.maximum = np.full(channels, -math.inf)
        self.start, self.end, self.gap = math.nan, math.nan, 0.0
        self.steps = (math.nan, math.nan)  # of the rows added last: see `Ranges`
        self.chunk = np.empty((channels, max(1, min(CHUNK, rows))))
        self.filled = 0
        self.first = np.zeros(channels)  # the chunk's first sample
        self.merged = 0  # number of samples, without those in the chunk
        self.origin = np.zeros(channels)  # the segment's first sample: means and batch sums are of deviations from it
        self.mean = np.zeros(channels)
        self.squares = np.zeros((channels, channels))  # sum of products of deviations from the mean
        batches = max(1, min(BATCHES, rows))
        # Short means in a batch: below, what is called a batch is a short mean, which at rest is the same.
        self.follows = follows_course(motion)
        self.parts = max(1, min(SHORT, rows // batches)) if self.follows else 1
        batches *= self.parts
        self.edges = np.linspace(0, rows, batches + 1).round().astype(np.int64)
        self.opened = np.zeros(batches)  # time of the first row of each batch
        self.begins = np.full(batches + 1, np.iinfo(np.int64).max)  # edges of batches, counted in valid samples
        self.begins[0] = 0
        self.batch_sum = np.zeros((channels, batches))
        self.batch_count = np.zeros(batches)

    def add(self, time: Array, columns: list[Array]) -> tuple[Array, Array]:
        """Adds the next rows, one or more. Returns the smallest and the largest number of each column in these rows, NaN if a
        number is missing."""
        here = np.flatnonzero((self.edges[:-1] > self.row) & (self.edges[:-1] <= self.row + len(time)))
        at = self.edges[here] - self.row
        if self.follows:
            opening = slice(*np.searchsorted(self.edges[:-1], [self.row, self.row + len(time)]))
            self.opened[opening] = time[self.edges[opening] - self.row]
        before = self.row
        good: NDArray[np.bool_] | None = None
        self.row += len(time)
        low, high = found = _range(columns)
        whole = low.min() > -LARGEST and high.max() < LARGEST  # both comparisons are False for NaN
        if not whole:
            good = np.all([np.abs(column) < LARGEST for column in columns], axis=0)
            at = np.concatenate(([0], np.cumsum(good)))[at]
            time, columns = time[good], [column[good] for column in columns]
            if len(time):
                low, high = _range(columns)
        self.begins[here] = self.count + at
        if len(time):
            np.minimum(self.minimum, low, out=self.minimum)
            np.maximum(self.maximum, high, out=self.maximum)
            self._times(time, before, good)
            self._fill(columns, len(time))
        if not whole:
            self.steps = (math.nan, math.nan)
        return found

    def _times(self, time: Array, before: int, good: NDArray[np.bool_] | None) -> None:
        """Adds the times of the valid samples of a block. `before`: number of rows before the block. `good`: True for each row of
        the block with a valid sample; None if all are valid."""
        if self.count:
            self.gap = max(self.gap, float(time[0]) - self.end)
        else:
            self.start = float(time[0])
        if not math.isfinite(time[0]):
            raise _no_time(before, good, 0, time[0])
        self.steps = (math.inf, -math.inf)
        if len(time) > 1:
            steps = time[1:] - time[:-1]
            self.steps = float(steps.min()), float(steps.max())
            if not (self.steps[0] > -math.inf and self.steps[1] < math.inf):  # true for NaN as well
                worst = int(np.argmin(np.isfinite(time)))
                raise _no_time(before, good, worst, time[worst])
            self.gap = max(self.gap, self.steps[1])
        self.end = float(time[-1])

    def _fill(self, columns: list[Array], count: int) -> None:
        taken = 0
        while taken < count:
            if self.filled == 0:
                self.first = np.array([column[taken] for column in columns])
                if self.count == 0:
                    self.origin = self.first
            step = min(self.chunk.shape[1] - self.filled, count - taken)
            for row, column in enumerate(columns):
                place = self.chunk[row, self.filled : self.filled + step]
                np.subtract(column[taken : taken + step], self.first[row], out=place)
            self.filled, self.count, taken = self.filled + step, self.count + step, taken + step
            if self.filled == self.chunk.shape[1]:
                self._merge()

    def _merge(self) -> None:
        """Merges the chunk into the totals."""
        values, count, shift = self.chunk[:, : self.filled], self.filled, self.first - self.origin
        at = np.minimum(np.maximum(self.begins - self.merged, 0), count)
        sizes = at[1:] - at[:-1]
        present = np.flatnonzero(sizes)
        sums = np.add.reduceat(values, at[present], axis=1)
        self.batch_sum[:, present] += sums + np.outer(shift, sizes[present])
        self.batch_count[present] += sizes[present]
        total = sums.sum(axis=1)
        difference = shift + total / count - self.mean
        before, self.merged, self.filled = self.merged, self.merged + count, 0
        self.squares += _products(values) - np.outer(total, total) / count
        self.squares += np.outer(difference, difference) * (before * count / self.merged)
        self.mean = self.mean + difference * (count / self.merged)

    def statistics(self, channels: tuple[str, ...]) -> Statistics:
        if self.filled:
            self._merge()
        if self.count > 1 and not self.end > self.start and self.gap <= 0:
            raise ValueError(
                f"the time does not increase: it is {self.start:g} s at the first of {self.count} samples and {self.end:g} s at the "
                "last; give the time of each sample in seconds"
            )
        unknown = np.full(len(channels), math.nan)
        sums, counts = self.batch_sum, self.batch_count
        course = self._course()
        squares, fitted = self.squares, 0
        if course is not None:
            counts, fitted = course.samples, course.columns.shape[1]
            sums = np.where(counts > 0, sums, 0.0)
            amplitudes = sums @ course.columns
            squares = _less(squares, amplitudes @ course.products @ amplitudes.T)
            sums, counts = (one.reshape(*one.shape[:-1], -1, self.parts).sum(axis=-1) for one in (sums, counts))
        used = counts > 0
        batches, error, shape = int(used.sum()), unknown, np.zeros((fitted, int(used.sum())))
        joint = np.zeros((0, 0))
        if batches > 1:
            counts = counts[used]
            means = sums[:, used] / counts
            centre = (means @ counts / counts.sum())[:, None]
            scatter, freedom = (means - centre) * np.sqrt(counts), batches - 1.0
            if course is not None:
                each = (course.samples[:, None] * course.columns).reshape(-1, self.parts, fitted).sum(axis=1)
                shape = each[used].T / np.sqrt(counts)
                left = scatter - amplitudes @ shape
                scatter = np.where(np.abs(left) > _ROUNDING * np.abs(scatter).max(axis=1, keepdims=True), left, 0.0)
                freedom -= float(np.sum(shape**2))
            if freedom > 0:
                error = np.sqrt(np.sum(scatter**2, axis=1) / freedom / self.count)
                joint = scatter @ scatter.T / freedom / self.count
        return Statistics(
            channels=channels,
            count=self.count,
            rejected=self.row - self.count,
            mean=self.origin + self.mean if self.count else unknown,
            minimum=self.minimum if self.count else unknown,
            maximum=self.maximum if self.count else unknown,
            covariance=squares / (self.count - 1 - fitted) if self.count > 1 else np.full_like(self.squares, math.nan),
            standard_error=error,
            batches=batches,
            start=self.start,
            end=self.end,
            largest_gap=self.gap,
            course=shape,
            mean_covariance=joint,
        )

    def _course(self) -> MotionCourse | None:
        """Returns the periodic signal that the motion causes, determined from averages over a few samples; None if the motion
        causes no periodic signal or there are too few samples."""
        if not self.follows or self.count < 3:
            return None
        interval = (self.end - self.start - self.gap) / max(self.count - 2, 1)
        middle = self.opened - self.opened[0] + (self.edges[1:] - self.edges[:-1] - 1) * interval / 2
        return course_of(self.motion, middle, self.batch_count, interval)


def _no_time(before: int, good: NDArray[np.bool_] | None, sample: int, value: float) -> ValueError:
    """Returns the error for a time that is not a finite number. `sample`: number of valid samples before it in its block. `before`,
    `good`: see `_Gathered._times`."""
    row = before + (sample if good is None else int(np.flatnonzero(good)[sample]))
    return ValueError(
        f"the time of sample {row + 1} is {value:g}, which is not a finite number; leave the sample out or correct its time"
    )


def _less(squares: Array, explained: Array) -> Array:
    """Returns the sums of products (k, k) after the explained part has been subtracted; zero where only rounding errors remain."""
    left = np.asarray(squares - explained)
    left[:, (gone := np.diagonal(left) <= _ROUNDING * np.diagonal(squares))] = 0.0
    left[gone] = 0.0
    return left

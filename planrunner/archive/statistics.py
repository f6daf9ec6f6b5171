"""Statistics of a segment, made in one pass over its samples.

Samples are taken in chunks of a fixed number of rows counted from the segment's beginning, so the result does not
depend on how they were cut into blocks, row groups or files. Means and covariances of chunks are merged by the
formula of Chan, Golub and LeVeque, "Updating formulae and a pairwise algorithm for computing sample variances"
(1979). The standard error of the mean comes from the scatter of consecutive batch means (Law, "Simulation Modeling
and Analysis", 5th ed., section 9.5.3), which accounts for noise that is correlated over less than a batch.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import Statistics
from planrunner.instruments.interfaces import Block

Array = NDArray[np.float64]

BATCHES = 32
CHUNK = 65_536
LARGEST = 1e100
"""A larger sample is no measurement: its square could not be told from infinity."""


def rechunk(blocks: Iterable[Block], channels: Sequence[str], rows: int = CHUNK) -> Iterator[tuple[Array, Array]]:
    """The same samples as (time (n,), values (k, n)), every piece but the last of exactly `rows` rows."""
    time, values, filled = np.empty(rows), np.empty((len(channels), rows)), 0
    for block in blocks:
        taken, count = 0, len(block.time)
        while taken < count:
            step = min(rows - filled, count - taken)
            time[filled : filled + step] = block.time[taken : taken + step]
            for row, name in enumerate(channels):
                values[row, filled : filled + step] = block.channels[name][taken : taken + step]
            filled, taken = filled + step, taken + step
            if filled == rows:
                yield time, values
                time, values, filled = np.empty(rows), np.empty((len(channels), rows)), 0
    if filled:
        yield time[:filled], values[:, :filled]


def statistics_of(blocks: Iterable[Block], channels: Sequence[str], rows: int) -> Statistics:
    """Statistics of `blocks`, which together have `rows` rows (known from the files before the pass).

    A row with a value that is not finite in any channel is left out of everything and counted in `rejected`. With one
    sample, covariance and standard error are NaN; with none, the mean too.
    """
    gathered = _Gathered(len(channels), rows)
    for time, values in rechunk(blocks, channels):
        gathered.add(time, values)
    return gathered.statistics(tuple(channels))


class _Gathered:
    """What one pass keeps: a few numbers a channel and a batch, whatever the length."""

    def __init__(self, channels: int, rows: int):
        self.row = 0
        self.count = 0
        self.mean = np.zeros(channels)
        self.squares = np.zeros((channels, channels))  # sum of products of deviations from the mean
        self.minimum = np.full(channels, math.inf)
        self.maximum = np.full(channels, -math.inf)
        self.shift: Array | None = None  # batch sums are of deviations from this, to keep their last digits
        batches = max(1, min(BATCHES, rows))
        self.edges = np.linspace(0, rows, batches + 1).round().astype(np.int64)
        self.batch_sum = np.zeros((channels, batches))
        self.batch_count = np.zeros(batches)
        self.start, self.end, self.gap = math.nan, math.nan, 0.0

    def add(self, time: Array, values: Array) -> None:
        rows = np.arange(self.row, self.row + len(time))
        first = self.row
        self.row += len(time)
        low, high = values.min(axis=1), values.max(axis=1)
        whole = bool(np.all(low > -LARGEST) and np.all(high < LARGEST))  # neither holds where there is a NaN
        if not whole:
            good = (np.abs(values) < LARGEST).all(axis=0)
            if not good.any():
                return
            time, values, rows = time[good], values[:, good], rows[good]
            low, high = values.min(axis=1), values.max(axis=1)
        self._times(time)
        self._batches(values, rows, first, whole)
        np.minimum(self.minimum, low, out=self.minimum)
        np.maximum(self.maximum, high, out=self.maximum)
        self._merge(values, values.mean(axis=1))

    def _times(self, time: Array) -> None:
        if self.count:
            self.gap = max(self.gap, float(time[0]) - self.end)
        else:
            self.start = float(time[0])
        if len(time) > 1:
            self.gap = max(self.gap, float(np.diff(time).max()))
        self.end = float(time[-1])

    def _batches(self, values: Array, rows: NDArray[np.int64], first: int, whole: bool) -> None:
        if self.shift is None:
            self.shift = values[:, 0].copy()
        shifted = values - self.shift[:, None]
        at = self.edges[:-1] - first if whole else np.searchsorted(rows, self.edges[:-1])
        first_batch = int(np.searchsorted(self.edges, rows[0], side="right")) - 1
        last_batch = int(np.searchsorted(self.edges, rows[-1], side="right")) - 1
        bounds = np.clip(at[first_batch : last_batch + 1], 0, len(rows))
        bounds[0] = 0
        sizes = np.diff(np.append(bounds, len(rows)))
        present = sizes > 0
        batches = np.arange(first_batch, last_batch + 1)[present]
        self.batch_sum[:, batches] += np.add.reduceat(shifted, bounds[present], axis=1)
        self.batch_count[batches] += sizes[present]

    def _merge(self, values: Array, mean: Array) -> None:
        count = values.shape[1]
        deviations = values - mean[:, None]
        total = self.count + count
        difference = mean - self.mean
        self.squares += deviations @ deviations.T + np.outer(difference, difference) * (self.count * count / total)
        self.mean = self.mean + difference * (count / total)
        self.count = total

    def statistics(self, channels: tuple[str, ...]) -> Statistics:
        unknown = np.full(len(channels), math.nan)
        used = self.batch_count > 0
        batches = int(used.sum())
        error = unknown
        if batches > 1:
            counts = self.batch_count[used]
            means = self.batch_sum[:, used] / counts
            centre = (means @ counts / self.count)[:, None]
            error = np.sqrt((means - centre) ** 2 @ counts / (batches - 1) / self.count)
        return Statistics(
            channels=channels,
            count=self.count,
            rejected=self.row - self.count,
            mean=self.mean if self.count else unknown,
            minimum=self.minimum if self.count else unknown,
            maximum=self.maximum if self.count else unknown,
            covariance=self.squares / (self.count - 1) if self.count > 1 else np.full_like(self.squares, math.nan),
            standard_error=error,
            batches=batches,
            start=self.start,
            end=self.end,
            largest_gap=self.gap,
        )

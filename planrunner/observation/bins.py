"""Averages a long recording with a limited amount of memory. In one pass over the blocks of a segment, consecutive samples are
averaged in bins.

A recording of up to `BUDGET` samples is not averaged. In a longer recording, the bins are so large that there are at most about
`BUDGET` bins. However, a turn or a period of rocking has at least `PER_PERIOD` bins, and a segment has at least `FEWEST` bins.
During motion, the number of bins therefore depends on the number of turns, not on the number of samples. Three properties can be
measured only on single samples, and the same pass measures them. The first is the white noise level; it comes from the same orders
of the cosine transform as in a short recording. The second is the size of a count. The third is outliers, which are replaced by
interpolation between their neighbours. Frequencies above half the bin rate are lost. Up to `size` − 1 samples at the end of a
segment are also lost, because they do not fill a bin of `size` samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.error_model.observed import Bins
from planrunner.instruments.interfaces import Block
from planrunner.observation.lattice import levels_of, settled
from planrunner.physics.sampled_motion import period_of, turned_by

BUDGET = 200_000  # largest recording that is used unchanged, in samples, and approximate number of bins of a longer one
PER_PERIOD = 64  # bins in a turn or a period: the middle value and the curvature then describe a signal in a bin
FEWEST = 64  # bins in a segment
SPIKE = 6.5  # robust standard deviations: about one normal sample in 10^10
_PIECE = 1 << 15  # samples taken at once
_BESIDE = (-2, -1, 1, 2)  # neighbours that a sample is compared with
SQUARED = 1e150  # larger numbers cannot be squared and count as missing
_ROUNDS = 4


@dataclass
class Averaged:
    """One segment, averaged in bins.

    `begin`: time of the first sample, s. `step`: time between samples, s. `time`: array of shape (n,), times of the bins, s.
    `table`: the means (n,) of each channel, in the channel's unit. `rejected`: number of rows that were left out because of a NaN.
    The other attributes are the same as in `Bins`, in SI units.
    """

    begin: float = np.nan
    step: float = np.nan
    time: Array = field(default_factory=lambda: np.empty(0))
    table: dict[str, Array] = field(default_factory=dict)
    rejected: int = 0
    energy: Array = field(default_factory=lambda: np.zeros((0, 0)))
    count: float = 0.0
    spikes: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    levels: list[Array] = field(default_factory=list)


def sizes(recording: Sequence[RecordedSegment]) -> NDArray[np.int64] | None:
    """Returns the number of samples per bin for each segment, shape (S,); None if the recording is not averaged."""
    counts = np.array([item.statistics.count for item in recording])
    if counts.sum() <= BUDGET:
        return None
    most = np.array([_most(item) for item in recording])
    size = int(np.ceil(counts.sum() / BUDGET))
    while np.sum(counts // np.minimum(size, most)) > BUDGET and size < most.max():
        size += max(1, size // 20)
    bounded: NDArray[np.int64] = np.minimum(size, most)
    return bounded


def _most(item: RecordedSegment) -> int:
    """Returns the largest bin size that still resolves the motion of a segment."""
    known = item.statistics
    most = known.count // FEWEST
    period = period_of(item.segment.motion)
    if np.isfinite(period):
        most = min(most, int(period / known.period / PER_PERIOD))
    return max(1, most)


def bins_of(size: NDArray[np.int64], parts: Sequence[Averaged]) -> Bins:
    """Combines the bins of all segments into the bins of the recording."""
    levels = [reduce(np.union1d, each) for each in zip(*(part.levels for part in parts), strict=True)]
    return Bins(
        size,
        1 / float(np.median([part.step for part in parts])),
        np.array([part.energy for part in parts]),
        np.array([part.count for part in parts]),
        np.sum([part.spikes for part in parts], axis=0),
        tuple(levels),
    )


def seen_along(bins: Bins, along: Array) -> Bins:
    """Returns the bins of a triad's readings after the readings have been projected onto one direction for each segment. `along`:
    array of shape (S, 3), unit vectors. The projected readings are not multiples of a count."""
    energy = np.einsum("si,sij,sj->s", along, bins.energy, along)[:, None, None]
    return replace(bins, energy=energy, spikes=bins.spikes.sum(keepdims=True), levels=(np.empty(0),))


def averaged(
    item: RecordedSegment,
    names: Sequence[str],
    factors: Array,
    counts: Array,
    smallest: Array,
    size: int,
    encoder: tuple[str, float] | None = None,
) -> Averaged:
    """Averages a segment in bins of `size` samples, in one pass.

    `names`: names of the channels; the K measured channels come first. `factors`: array of shape (K,), factors from the channels'
    units to SI units. `counts`: array of shape (K,), size of one count in SI units. `smallest`: array of shape (K,), lower limit of
    the noise that the detection of outliers assumes, in SI units. `encoder`: name of a channel whose values wrap after one turn,
    and the number of its units per turn.
    """
    out = Averaged(energy=np.zeros((len(factors),) * 2), spikes=np.zeros(len(factors), dtype=np.int64))
    out.levels = [np.empty(0) for _ in factors]
    times, means, last = [], [], None
    for time, values in rechunk(_usable(item, names, out), names, size * max(1, _PIECE // size)):
        if np.isnan(out.begin):
            out.begin, out.step = float(time[0]), float(np.median(np.diff(time))) if len(time) > 1 else np.nan
        if encoder is not None:
            row, turn = list(names).index(encoder[0]), encoder[1]
            planned = turned_by(item.segment.motion, time - out.begin) / (2 * np.pi) * turn
            rest = values[row] - planned
            values[row] = np.unwrap(np.concatenate(([rest[0] if last is None else last], rest)), period=turn)[1:]
            last = float(values[row, -1])
            values[row] += planned
        _look_at(values[: len(factors)] * factors[:, None], counts, out)
        repaired, replaced = without_spikes(values[: len(factors)], smallest / np.abs(factors))
        values[: len(factors)] = repaired
        out.spikes += replaced
        _upper(repaired * factors[:, None], out)
        whole = len(time) - len(time) % size
        times.append(time[:whole].reshape(-1, size).mean(1))
        means.append(values[:, :whole].reshape(len(names), -1, size).mean(2))
    if times:
        out.time = np.concatenate(times)
        out.table = dict(zip(names, np.concatenate(means, axis=1), strict=True))
    return out


def _usable(item: RecordedSegment, names: Sequence[str], out: Averaged) -> Iterator[Block]:
    """Yields the blocks without the rows that contain a NaN, and counts the omitted rows."""
    for block in item.blocks(names):
        good = np.isfinite(block.time)
        for name in names:
            good &= np.abs(block.channels[name]) < SQUARED  # false for NaN as well
        left = int(np.count_nonzero(~good))
        out.rejected += left
        yield block if not left else Block(block.time[good], {name: block.channels[name][good] for name in names})


def _look_at(values: Array, counts: Array, out: Averaged) -> None:
    """Collects the levels (distinct values) of each channel until they confirm its declared count."""
    for channel, step in enumerate(counts):
        if step > 0 and not settled(out.levels[channel]):
            out.levels[channel] = np.union1d(out.levels[channel], levels_of(values[channel], float(step)))


def _upper(values: Array, out: Averaged) -> None:
    """Adds to `out` the energy that the samples `values` (K, n) of a piece have in the upper three quarters of the orders of their
    cosine transform. These orders belong to frequencies above one eighth of the sampling rate."""
    from scipy.fft import dct

    quarter = values.shape[1] // 4
    if quarter >= FEWEST // 4:
        upper = dct(values, type=2, norm="ortho", axis=1)[:, quarter:]
        out.energy += upper @ upper.T
        out.count += upper.shape[1]


def without_spikes(values: Array, smallest: Array) -> tuple[Array, NDArray[np.int64]]:
    """Replaces outliers in the samples `values` (K, n) by linear interpolation. Returns the samples and the number of outliers in
    each channel (K,). An outlier lies far from the mean of its four neighbours. `smallest`: array of shape (K,), lower limit of the
    noise that is assumed, in the channels' units.

    For white noise, the difference between a sample and this mean has 1.25 times the variance of the noise. If there are several
    outliers within two samples, the largest is replaced first.
    """
    from scipy.ndimage import maximum_filter1d

    out, replaced = values.copy(), np.zeros(values.shape, dtype=bool)
    if values.shape[1] < 5:
        return out, replaced.sum(axis=1)
    n = values.shape[1]
    for _ in range(_ROUNDS):
        wide = np.pad(out, ((0, 0), (2, 2)), mode="reflect", reflect_type="odd")
        off = np.abs(out - sum(wide[:, 2 + by : 2 + by + n] for by in _BESIDE) / len(_BESIDE))
        sigma = np.maximum(1.4826 * np.median(off, axis=1), smallest * np.sqrt(1.25))
        rows, _ = np.nonzero(off > SPIKE * sigma[:, None])
        if not len(rows):
            break
        for channel in np.unique(rows):
            own = off[channel]
            replaced[channel] |= (own > SPIKE * sigma[channel]) & (own == maximum_filter1d(own, 5))
            bad = replaced[channel]
            out[channel, bad] = np.interp(np.flatnonzero(bad), np.flatnonzero(~bad), values[channel, ~bad])
    return out, replaced.sum(axis=1)


def rechunk(blocks: Iterable[Block], channels: Sequence[str], rows: int) -> Iterator[tuple[Array, Array]]:
    """Divides the samples of the blocks into pieces of `rows` rows. Each piece consists of the times (n,) and the values (k, n).
    Only the last piece may be shorter."""
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

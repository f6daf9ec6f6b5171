"""Reduces a recorded run to its two windows, which contain the samples of accelerometers and encoders after a zero-phase low-pass
filter.

Only samples within a few filter lengths of a window are kept in memory, so long runs need no more memory than short runs. The
filter is a Butterworth low-pass filter of fourth order that runs forwards and backwards. Before the filter, a parabola is
subtracted from the samples around each window; after the filter, it is added again. The slow rotation of the element relative to
gravity therefore does not distort the ends of the filtered samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.interface import EstimationError, UnfitDataError
from planrunner.plan.units import UnknownUnitError, unit

ORDER = 4
REACH = 3.0  # filter lengths 1/cutoff on either side of a window: weights beyond are below 1e-5
SAMPLES = 4  # fewest samples in a period of the cutoff frequency
LONGEST_GAP = 0.5  # s, longest gap that is filled by linear interpolation


@dataclass(frozen=True, slots=True)
class Windows:
    """States the positions of the windows in a record. All times are in s from the start of the record. `before`: the start of a
    third window, which lies between the first and the second window and ends when the base begins to rock; None if there is no such
    window. `end`: the end of the record."""

    first: float
    second: float
    length: float
    cutoff: float
    end: float
    before: float | None = None

    @property
    def begins(self) -> tuple[float, ...]:
        """Returns the start of each window, s."""
        return (self.first, self.second) if self.before is None else (self.first, self.second, self.before)

    @property
    def pieces(self) -> tuple[tuple[float, float], ...]:
        """Returns, for each window, the start and the end of the time [s] that is read around it."""
        reach = REACH / self.cutoff
        return tuple((max(0.0, begin - reach), min(self.end, begin + self.length + reach)) for begin in self.begins)

    def with_rest(self, rest: float) -> Windows:
        """Returns the windows of a run whose base is at rest during the first `rest` seconds of its record. A third window at the
        end of this time is added, if there is at least one filter length between the end of the first window and the start of the
        third."""
        before = rest - self.length
        apart = before >= self.first + self.length + 1 / self.cutoff
        return replace(self, before=before) if apart else self


@dataclass(frozen=True, slots=True)
class RecordPiece:
    """Contains evenly spaced samples of a part of a record. `time`: array of shape (n,), s from the start of the record. `values`:
    array of shape (n, k) in SI units."""

    time: Array
    values: Array


def read_pieces(recorded: RecordedSegment, channels: Sequence[str], windows: Windows) -> list[RecordPiece]:
    """Reads the samples around each window of a run; the channels are the columns. Raises `EstimationError` if the run has no
    suitable samples there."""
    scales = [scale(recorded, name) for name in channels]
    statistics = recorded.statistics
    rate = (statistics.count + statistics.rejected - 1) / max(statistics.end - statistics.start, 1e-9)
    if windows.cutoff > rate / SAMPLES:
        raise EstimationError(
            f"a cutoff of {windows.cutoff:g} Hz needs {SAMPLES * windows.cutoff:g} samples per "
            f"second; '{recorded.label}' has {rate:.3g}"
        )
    times: list[list[Array]] = [[] for _ in windows.pieces]
    values: list[list[Array]] = [[] for _ in windows.pieces]
    for block in recorded.blocks(channels):
        since = block.time - recorded.statistics.start
        for k, (begin, end) in enumerate(windows.pieces):
            inside = (since >= begin) & (since < end)
            if inside.any():
                times[k].append(since[inside])
                values[k].append(np.column_stack([block.channels[name][inside] for name in channels]) * scales)
    made = []
    for k, (begin, end) in enumerate(windows.pieces):
        if not times[k]:
            raise UnfitDataError(
                f"'{recorded.label}' has no samples from {begin:g} to {end:g} s: its run was cut short"
            )
        made.append(_even(recorded.label, np.concatenate(times[k]), np.concatenate(values[k]), begin, end))
    return made


def low_pass(piece: RecordPiece, cutoff: float) -> Array:
    """Filters the values of a piece with a low-pass filter that causes no delay and that removes changes faster than `cutoff` [Hz].
    Returns an array of shape (n, k)."""
    from scipy.signal import sosfiltfilt

    rate = 1 / float(piece.time[1] - piece.time[0])
    middle = piece.time - piece.time.mean()
    trend = np.vander(middle / max(float(np.abs(middle).max()), 1e-12), 3)
    slow = trend @ np.linalg.lstsq(trend, piece.values, rcond=None)[0]
    padding = min(len(middle) - 1, round(REACH / cutoff * rate))
    filtered = sosfiltfilt(_sections(cutoff / rate), piece.values - slow, axis=0, padtype="even", padlen=padding)
    return np.asarray(slow + filtered)


@lru_cache(maxsize=16)
def _sections(ratio: float) -> Array:
    """Returns the second-order sections of the filter. `ratio`: the cutoff frequency as a fraction of the sampling rate."""
    from scipy.signal import butter

    return np.asarray(butter(ORDER, ratio, fs=1.0, output="sos"))


def passed(frequency: float, cutoff: float) -> float:
    """Returns the fraction of a sine's amplitude that remains after the filter has run forwards and backwards. `frequency`,
    `cutoff`: frequency of the sine and cutoff frequency of the filter, Hz."""
    return 1 / (1 + (frequency / cutoff) ** (2 * ORDER))


def within(piece: RecordPiece, begin: float, length: float) -> NDArray[np.bool_]:
    """Returns a mask of shape (n,), which is True for the samples of a piece that are in the window from `begin` to `begin` +
    `length`, s."""
    return (piece.time >= begin - 1e-6) & (piece.time < begin + length - 1e-6)


def scale(recorded: RecordedSegment, name: str) -> float:
    """Returns the SI value of one unit of a channel. Raises `EstimationError` for a channel that is missing or has an unknown unit."""
    try:
        return unit(recorded.units[name]).factor
    except KeyError:
        raise EstimationError(f"the recording has no channel '{name}'") from None
    except UnknownUnitError:
        raise EstimationError(f"the unit '{recorded.units[name]}' of channel '{name}' is not known") from None


def _even(label: str, time: Array, values: Array, begin: float, end: float) -> RecordPiece:
    """Returns the samples between `begin` and `end` [s] as evenly spaced samples. Short gaps are filled by linear interpolation. A
    gap consists of samples that are missing or not a number. `time`: array of shape (n,), s. `values`: array of shape (n, k)."""
    sound = np.isfinite(values).all(axis=1)
    time, values = time[sound], values[sound]
    if time.size < 16:
        raise UnfitDataError(f"'{label}' has too few samples from {begin:g} to {end:g} s")
    intervals = np.diff(time)
    step = float(np.median(intervals))
    longest = float(max(intervals.max(), time[0] - begin, end - step - time[-1]))
    if longest > max(LONGEST_GAP, 1.5 * step):
        raise UnfitDataError(
            f"'{label}' misses {longest:.3g} s of samples between {begin:g} and {end:g} s: repeat the run"
        )
    grid = time[0] + step * np.arange(round((time[-1] - time[0]) / step) + 1)
    if grid.size == time.size and np.abs(grid - time).max() < 1e-3 * step:
        return RecordPiece(grid, values)
    return RecordPiece(grid, np.column_stack([np.interp(grid, time, column) for column in values.T]))

"""Divides the rows of a recording at changes of its sample rate."""

from __future__ import annotations

import math
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass

RowValue = TypeVar("RowValue", bound=np.generic)
"""Type of the value that belongs to each time."""
_ROWS = 64
"""Number of rows from which the rate is determined."""
_OTHER = 0.2
"""Relative difference above which two rates count as different."""


@dataclass(frozen=True, slots=True)
class RowsAtOneRate(Generic[RowValue]):
    """Consecutive rows with one sample rate. `time`: array of shape (n,), s. `data`: array with n rows, one for each time.
    `period`: sample period, s; NaN if there is only one row. `changed`: True if the rate changed before the first of these rows."""

    time: Array
    data: NDArray[RowValue]
    period: float
    changed: bool


class SampleRates(Generic[RowValue]):
    """Divides rows at changes of the sample rate. The rows are given in batches of any size.

    A change of the rate is recognised if it lasts for 128 rows, and if both the median and the mean of the time steps change.
    Jitter and rounded times change only the median; lost rows and pauses change only the mean.
    """

    def __init__(self) -> None:
        self._period = math.nan
        self._time: Array = np.empty(0)
        self._data: NDArray[RowValue] | None = None
        self._changed = False
        self._means: list[float] = []

    def take(self, time: Array, data: NDArray[RowValue]) -> list[RowsAtOneRate[RowValue]]:
        """Takes the next rows, and returns all rows whose rate is now known. `time`: array of shape (n,), increasing times, s.
        `data`: array with n rows."""
        if self._data is not None:
            time, data = np.concatenate([self._time, time]), np.concatenate([self._data, data])
        return self._divided(time, data, final=False)

    def rest(self) -> list[RowsAtOneRate[RowValue]]:
        """Returns the last rows, after all rows were taken."""
        return [] if self._data is None else self._divided(self._time, self._data, final=True)

    def _divided(self, time: Array, data: NDArray[RowValue], final: bool) -> list[RowsAtOneRate[RowValue]]:
        """Divides rows. If `final` is False, the last rows are kept for the next call, because later rows are needed to recognise a
        change of the rate. `time`, `data`: the same as in `take`."""
        found: list[RowsAtOneRate[RowValue]] = []
        steps = np.diff(time)
        count = len(steps) // _ROWS
        increasing = bool((steps > 0).all() and np.isfinite(steps).all())
        if not final and increasing and count < 3:
            self._time, self._data = time, data
            return found
        begin = 0
        if increasing and count >= 2:
            begin = self._changes(time, data, found)
        elif math.isnan(self._period) and len(steps):
            self._period = float(np.median(steps))
        keep = len(time) if final or not increasing else max(begin, _ROWS * (count - 2))
        self._add(time[begin:keep], data[begin:keep], found)
        self._time, self._data = time[keep:].copy(), data[keep:].copy()
        return found

    def _changes(self, time: Array, data: NDArray[RowValue], found: list[RowsAtOneRate[RowValue]]) -> int:
        """Adds the rows before the last change to `found`. Returns the index of the first row after this change. `time`, `data`:
        the same as in `take`."""
        steps = np.diff(time)
        count = len(steps) // _ROWS
        edges = _ROWS * np.arange(count + 1)
        medians = np.median(steps[: edges[-1]].reshape(count, _ROWS), axis=1)
        means = np.diff(time[edges]) / _ROWS
        if math.isnan(self._period):
            alike = np.abs(means / means[0] - 1).max() <= _OTHER
            self._period = float(np.median(steps)) if alike else float(medians[0])
        begin = own = 0
        if np.abs(medians / self._period - 1).max() > _OTHER:
            for k in range(count - 1):
                first, second = medians[k : k + 2]
                if _differ(first, self._period) and _differ(second, self._period) and not _differ(second, first):
                    usual = float(np.median([*self._means, *means[own:k]] or [self._period]))
                    if not (_differ(means[k], usual) and _differ(means[k + 1], usual)):
                        continue
                    low = max(k - 1, 0)
                    around = steps[edges[low] : edges[k + 1]]
                    earlier = np.flatnonzero(np.abs(np.log(around / self._period)) < np.abs(np.log(around / first)))
                    place = int(edges[low]) + (int(earlier[-1]) + 2 if len(earlier) else 0)
                    self._add(time[begin:place], data[begin:place], found)
                    begin, own, self._period, self._changed = max(place, begin), k + 1, float(first), True
                    self._means = []
        self._means = [*self._means, *means[own : max(count - 2, own)].tolist()][:_ROWS]
        return begin

    def _add(self, time: Array, data: NDArray[RowValue], found: list[RowsAtOneRate[RowValue]]) -> None:
        if len(time):
            found.append(RowsAtOneRate(time, data, self._period, self._changed))
            self._changed = False


def _differ(one: float, other: float) -> bool:
    return abs(one / other - 1) > _OTHER

"""Defines half-open intervals of time: [start, end). A sample at `start` belongs to the interval; a sample at `end` belongs to the
next interval.

Played-back recordings, still spans and detected segments all use this definition. Adjacent intervals therefore share no sample, and
the duration of n samples with the period T is n·T.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass

ROUNDING = 1e-3
"""A time stamp counts as on a boundary if its distance from the boundary is at most this fraction of the sample period. The
tolerance allows for rounded boundaries, and for time stamps that were converted from other units to seconds."""


@dataclass(frozen=True, slots=True)
class Span:
    """Describes an interval start ≤ time < end, s; `end` may be infinite."""

    start: float
    end: float

    @property
    def seconds(self) -> float:
        """Returns the duration of the interval, s."""
        return self.end - self.start

    def of(self, time: Array, period: float) -> slice:
        """Returns the slice of `time` that lies in the interval. `time`: array of shape (n,), ascending times, s. `period`: time
        between samples, s, or NaN if it is not known."""
        rounding = 0.0 if math.isnan(period) else ROUNDING * period
        first, last = np.searchsorted(time, [self.start - rounding, self.end - rounding], side="left").tolist()
        return slice(first, last)


EVERYTHING = Span(-math.inf, math.inf)

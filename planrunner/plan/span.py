"""A stretch of time, half-open: [start, end). A sample at `start` belongs to it, one at `end` to the stretch that follows.

Recordings that are played back, still spans and detected segments all use this one definition, so that neighbours share no sample
and n samples with the period T last n·T.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass

Array = NDArray[np.float64]

ROUNDING = 1e-3
"""Of the sample period: a time stamp that is nearer than this to a boundary counts as on it. Tables write boundaries in decimals, and
time stamps in other units than seconds are scaled."""


@dataclass(frozen=True, slots=True)
class Span:
    """start ≤ time < end, s; `end` may be infinite."""

    start: float
    end: float

    @property
    def seconds(self) -> float:
        """How long it is."""
        return self.end - self.start

    def of(self, time: Array, period: float) -> slice:
        """Which of some increasing times, (n,) s, lie in it. period: s between samples, NaN where it is not known."""
        rounding = 0.0 if math.isnan(period) else ROUNDING * period
        first, last = np.searchsorted(time, [self.start - rounding, self.end - rounding], side="left").tolist()
        return slice(first, last)


EVERYTHING = Span(-math.inf, math.inf)

"""Divides the times of a recording at the places where its sample rate changes."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from planrunner.base.arrays import Array

_ROWS = 64
"""Rows over which the rate is determined."""
_OTHER = 0.2
"""Relative difference from which the rate counts as another one. Lost rows and jitter do not change the median step so much."""


def constant_rates(times: Array, period: float) -> Iterator[tuple[slice, float]]:
    """Yields the parts of `times` that have one sample rate, each with its sample period [s].

    `times`: (n,), increasing times, s. `period`: sample period before these times, s; NaN if there are none. A change of the rate
    counts if it lasts for 128 rows.
    """
    count = (len(times) - 1) // _ROWS
    steps = np.diff(times)
    if count < 2 or not np.isfinite(steps).all() or not (steps > 0).all():
        known = math.isnan(period) and len(steps) > 0
        yield slice(0, len(times)), float(np.median(steps)) if known else period
        return
    medians = np.median(steps[: count * _ROWS].reshape(count, _ROWS), axis=1)
    edges = _ROWS * np.arange(count + 1)
    period = float(medians[0]) if math.isnan(period) else period
    begin = 0
    if np.abs(medians / period - 1).max() <= _OTHER:
        yield slice(0, len(times)), period
        return
    for k in range(count - 1):
        first, second = medians[k : k + 2]
        if min(abs(first / period - 1), abs(second / period - 1)) > _OTHER and abs(second / first - 1) < _OTHER:
            around = steps[edges[max(k - 1, 0)] : edges[k + 1]]
            earlier = np.flatnonzero(np.abs(np.log(around / period)) < np.abs(np.log(around / first)))
            place = int(edges[max(k - 1, 0)]) + (int(earlier[-1]) + 2 if len(earlier) else 0)
            if place > begin:
                yield slice(begin, place), period
            begin, period = place, float(first)
    yield slice(begin, len(times)), period

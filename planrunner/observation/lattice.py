"""Detection of a channel's count, the step of which all values are multiples: levels in hundredths of the declared count, collected piece
by piece."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
COARSER = 1.2  # of the declared count: a larger common step is another resolution
DISTINCT = 20  # different values needed to recognise a lattice
_PIECE = 4096  # values taken at once


def levels_of(values: Array, step: float) -> Array:
    """The distinct values (n,) in declared counts, ascending."""
    return np.unique(np.round(values / step, 2))


def coarsening(levels: Array) -> float:
    """The common step of the levels in declared counts; 1 if no coarser step is found."""
    if len(levels) < DISTINCT:
        return 1.0
    smallest = float(np.diff(levels).min())
    return smallest if smallest > COARSER else 1.0


def settled(levels: Array) -> bool:
    """Whether further values cannot change the result, because the declared count is already confirmed."""
    return len(levels) >= DISTINCT and coarsening(levels) == 1.0


def seen_levels(values: Array, step: float) -> Array:
    """The levels of values (N,), collected piece by piece until further ones cannot change the result."""
    levels = np.empty(0)
    for first in range(0, len(values), _PIECE):
        levels = np.union1d(levels, levels_of(values[first : first + _PIECE], step))
        if settled(levels):
            break
    return levels

"""Finds the count of a channel. All values of the channel are multiples of its count. The levels of a channel are its distinct
values in units of the declared count, rounded to hundredths. The levels are collected piece by piece."""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array

COARSER = 1.2  # of the declared count: a larger common step is another resolution
DISTINCT = 20  # different values needed to recognise a lattice
MANY = 4  # different values needed to recognise the lattice of a channel without a declared count
REPEATED = 4  # each value of a lattice occurs at least this many times on average
STUCK = 0.1  # fraction of samples equal to their predecessor from which a channel with many values shows a count
ROUNDED = 1.1  # of the smallest step: steps up to this differ from it by floating-point rounding
OFF_LATTICE = 0.05  # of a count: tolerance of a lattice
NEAR = 100  # most counts between neighbouring values that are compared with a lattice
_PIECE = 4096  # values taken at once


def levels_of(values: Array, step: float) -> Array:
    """Returns the n distinct values of a channel in units of the declared count `step`, in ascending order, shape (n,)."""
    return np.unique(np.round(values / step, 2))


def coarsening(levels: Array) -> float:
    """Returns the smallest step between the levels, in units of the declared count. Returns 1 if this step is not clearly larger
    than the declared count, or if there are too few levels."""
    if len(levels) < DISTINCT:
        return 1.0
    smallest = float(np.diff(levels).min())
    return smallest if smallest > COARSER else 1.0


def settled(levels: Array) -> bool:
    """Returns True if the levels already confirm the declared count, so that further values cannot change the result."""
    return len(levels) >= DISTINCT and coarsening(levels) == 1.0


def holds(levels: Array) -> bool:
    """Returns True if the levels are whole numbers within a tolerance. The values of the channel are then multiples of the declared
    count."""
    return float(np.abs(levels - np.round(levels)).max(initial=0.0)) <= 2 * OFF_LATTICE


def undeclared_step(values: Array, fewest: int = MANY) -> float:
    """Returns the count of a channel that has no declared count, in the channel's unit; 0 if the values are not multiples of any
    count. `values`: array of shape (N,). `fewest`: number of different values needed to recognise the count."""
    some = values[:: max(len(values) // _PIECE, 1)]
    distinct = np.unique(np.round((some - some.min()) / max(float(np.ptp(some)), 1e-300), 9))
    steps = np.diff(distinct) * float(np.ptp(some))
    repeated = len(distinct) <= len(some) / REPEATED or float(np.mean(np.diff(values) == 0)) > STUCK
    if len(distinct) < fewest or not repeated:
        return 0.0
    count = float(np.median(steps[steps < ROUNDED * steps.min()]))
    whole = np.round(steps / count)
    near = whole <= NEAR  # beyond, the error of the count adds up to more than the tolerance
    count = float(steps[near].sum() / whole[near].sum())
    return count if float(np.abs(steps[near] / count - whole[near]).max()) < OFF_LATTICE else 0.0


def seen_levels(values: Array, step: float) -> Array:
    """Returns the levels of the values (N,). The values are read piece by piece, until further values cannot change the result."""
    levels = np.empty(0)
    for first in range(0, len(values), _PIECE):
        levels = np.union1d(levels, levels_of(values[first : first + _PIECE], step))
        if settled(levels):
            break
    return levels

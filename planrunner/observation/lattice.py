"""Finds the count of a channel. All values of the channel are multiples of its count. The levels of a channel are its distinct
values in units of the declared count, rounded to hundredths. The levels are collected piece by piece."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array

COARSER = 1.2  # of the declared count: a larger common step is another resolution
DISTINCT = 20  # different values needed to recognise a lattice
MANY = 4  # different values needed to recognise the lattice of a channel without a declared count
REPEATED = 4  # each value of a lattice occurs at least this many times on average
STUCK = 0.1  # fraction of samples equal to their predecessor from which a channel with many values shows a count
ROUNDED = 1.1  # of the smallest step: steps up to this differ from it by floating-point rounding
OFF_LATTICE = 0.05  # of a count: tolerance of a lattice
ROUNDING = 1e-12  # of a value: values that differ by less are equal except for floating-point rounding
_OF_SPAN = 1e-9  # of the range of the values: the same, for values that are differences of larger numbers
NEAR = 100  # most counts between neighbouring values that are compared with a lattice
_PIECE = 4096  # values taken at once
_MIDDLE = (0.8413, 0.1587)  # quantiles one standard deviation above and below the mean of a normal distribution
_SMOOTH = 0.01  # largest amplitude that a normal distribution has at the frequencies that are examined
_FASTEST = 0.5  # periods per count: the frequency at which every other count is preferred
_SLOWEST = 0.25  # periods per count: lower frequencies show another count of more than four times this count
_TRIED = 1501  # frequencies
_WIDEST = (
    100.0  # counts: with more noise, the frequencies are not close enough, and rounding errors average out in any case
)
_GROUPS = 32  # most groups of values that are examined
_SEEN = 1e-6  # probability by chance, over all frequencies, below which the counts are uneven


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


def undeclared_step(values: Array, fewest: int = MANY, repeating: float | None = None) -> float:
    """Finds the count of a channel that has no declared count, in the channel's unit. Returns 0 if the N values are not multiples
    of any count. `fewest`: different values needed to recognise the count. `repeating`: share of the channel's samples that repeat
    the sample before them; by default, this share of the values."""
    if not len(values):
        return 0.0
    some = values[:: max(len(values) // _PIECE, 1)]
    steps = _steps(some)
    if len(steps) + 1 < max(fewest, 2):
        return 0.0
    share = float(np.mean(np.diff(values) == 0)) if repeating is None else repeating
    if len(steps) + 1 > len(some) / REPEATED and share <= STUCK:
        return 0.0
    count = float(np.median(steps[steps < ROUNDED * steps.min()]))
    whole = np.round(steps / count)
    near = whole <= NEAR  # beyond, the error of the count adds up to more than the tolerance
    count = float(steps[near].sum() / whole[near].sum())
    return count if float(np.abs(steps[near] / count - whole[near]).max()) < OFF_LATTICE else 0.0


def _steps(values: Array) -> Array:
    """Returns the steps between successive distinct values of the N values, in ascending order of the values. Values that differ by
    no more than the rounding of floating-point numbers count as equal. A few values far from the others do not change what counts
    as equal among the others."""
    distinct = np.unique(values)
    ordered = np.sort(values)
    outside = 1 + len(ordered) // 1000
    inner = float(ordered[-1 - outside] - ordered[outside]) if len(ordered) > 2 * outside else 0.0
    span = inner if inner > 0 else float(np.ptp(values))
    steps = np.diff(distinct)
    sizes = np.maximum(np.abs(distinct[:-1]), np.abs(distinct[1:]))
    return np.asarray(steps[steps > np.maximum(ROUNDING * sizes, _OF_SPAN * span)])


def differ(low: float, high: float) -> bool:
    """Returns True if two values differ by more than the rounding of floating-point numbers."""
    return high - low > ROUNDING * max(abs(low), abs(high))


def seen_levels(values: Array, step: float) -> Array:
    """Returns the levels of the values (N,). The values are read piece by piece, until further values cannot change the result."""
    levels = np.empty(0)
    for first in range(0, len(values), _PIECE):
        levels = np.union1d(levels, levels_of(values[first : first + _PIECE], step))
        if settled(levels):
            break
    return levels


def unevenness(groups: Sequence[Array], count: float) -> float:
    """Returns how unevenly values occur at the multiples of a count, on a scale from 0 to 1; 0 if chance explains the difference.

    Noise with a standard deviation of more than one count is spread smoothly over the counts. If the values were multiples of
    another count before, some counts occur more often than their neighbours. The rounding errors then do not average out. The
    result is the largest amplitude of the empirical characteristic function at 1/4 to 1/2 periods per count (B. Widrow and I.
    Kollár, Quantization Noise, 4). At these frequencies, the amplitude of normal noise is small. A large amplitude at a lower
    frequency means that the other count is more than four times as large. Compared with its rounding errors, those of the smaller
    count do not matter, and the result is 0. `groups`: arrays of shape (n_g,), values at a constant input.
    """
    shown = [np.round((one - one[0]) / count) for one in groups if len(one) > 1]
    if not shown:
        return 0.0
    shown = shown[:: -(-len(shown) // _GROUPS)]
    samples = np.array([len(one) for one in shown])
    middle = np.array([min(float(np.subtract(*np.quantile(one, _MIDDLE))) / 2, float(np.std(one))) for one in shown])
    sigma = math.sqrt(float(np.average(middle**2, weights=samples)))
    smooth = math.sqrt(-2 * math.log(_SMOOTH)) / (2 * math.pi * max(sigma, 1e-9))
    if smooth > _FASTEST or sigma > _WIDEST:
        return 0.0
    from scipy.special import chdtrc

    frequencies = np.linspace(smooth, _FASTEST, _TRIED)
    squares = np.zeros(_TRIED)
    for one in shown:
        levels, times = np.unique(one, return_counts=True)
        waves = np.exp(2j * math.pi * np.outer(frequencies, levels)) @ times
        squares += np.abs(waves) ** 2 / len(one)  # of independent values: exponentially distributed, mean 1
    first = int(np.argmax(squares >= squares.max() / 4))  # half the largest amplitude
    if frequencies[first] < _SLOWEST or chdtrc(2 * len(shown), 2 * float(squares.max())) * _TRIED > _SEEN:
        return 0.0
    return math.sqrt(min(max((float(squares.max()) - len(shown)) / float(samples.sum() - len(shown)), 0.0), 1.0))

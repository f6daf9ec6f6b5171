"""Describes slow noise by the exact covariances of its means over segments, and by its spectra. The spectra describe what remains
of the noise within a segment.

Flicker is represented by a sum of Ornstein–Uhlenbeck processes whose correlation times are two octaves apart (Keshner, "1/f noise",
Proc. IEEE 70, 1982); a random walk has the covariance q²·min(t, t'). Both are averaged over the segments in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planrunner.base.arrays import Array

OCTAVES = 2.0 ** np.arange(0, 15, 2)  # s, correlation times: from a second to hours, two octaves apart


def ornstein_uhlenbeck(starts: Array, ends: Array, tau: float) -> Array:
    """Computes the covariance of the means over the intervals [start, end] of a process with unit variance and the covariance
    function exp(−|t − t'|/τ). Returns an array of shape (S, S).

    A segment of length T has the variance 2(x − 1 + e^−x)/x² with x = T/τ. Two disjoint segments have the covariance e^(−gap/τ)·Π(1 −
    e^−x_i)/x_i, where gap is the time between them.
    """
    lasting = ends - starts
    x = lasting / tau
    part = -np.expm1(-x) / x
    gap = np.maximum(starts[None, :] - ends[:, None], starts[:, None] - ends[None, :])
    covariance = np.exp(-np.maximum(gap, 0.0) / tau) * np.outer(part, part)
    with np.errstate(divide="ignore", invalid="ignore"):
        own = np.where(x > 1e-4, 2 * (x + np.expm1(-x)) / x**2, 1 - x / 3)
    np.fill_diagonal(covariance, own)
    return covariance


def flicker(starts: Array, ends: Array) -> Array:
    """Computes the covariance of the segment means of flicker noise whose coefficient of bias instability B is 1, shape (S, S).

    Flicker noise has the one-sided density B²/(π·f), and the Allan deviation √(2·ln 2/π)·B = 0.664·B (IEEE Std 952, annex C). It is
    represented by a sum of processes of variance v whose correlation times differ by a factor r. Between the corner frequencies of
    the processes, their total density is v/(ln r·f). It equals B²/(π·f) with B = 1 if v = ln r/π.
    """
    level = math.log(OCTAVES[1] / OCTAVES[0]) / math.pi
    total = np.zeros((len(starts), len(starts)))
    for tau in OCTAVES:
        total += level * ornstein_uhlenbeck(starts, ends, float(tau))
    return total


def random_walk(starts: Array, ends: Array) -> Array:
    """Computes the covariance of the segment means of a random walk with unit density (1/√s), shape (S, S). The walk starts from
    zero at the first start time.

    The covariance of two disjoint segments is the middle time of the earlier segment. The variance of a segment of length T is its
    start time plus T/3.
    """
    begin = starts - starts[0]
    middles = (begin + ends - starts[0]) / 2
    covariance: Array = np.minimum(middles[:, None], middles[None, :])
    np.fill_diagonal(covariance, begin + (ends - starts) / 3)
    return covariance


@dataclass(frozen=True)
class SlowMeans:
    """Contains two covariances (S, S) of the segment means: one for flicker with B = 1, and one for a random walk with unit
    density."""

    flicker: Array
    random_walk: Array

    @classmethod
    def of(cls, starts: Array, ends: Array) -> SlowMeans:
        return cls(flicker(starts, ends), random_walk(starts, ends))


def flicker_spectrum(frequency: Array) -> Array:
    """Returns the one-sided spectral density [1/Hz] of the noise of `flicker` at frequencies [Hz] above zero."""
    return np.asarray(1 / (math.pi * frequency))


def random_walk_spectrum(frequency: Array) -> Array:
    """Returns the one-sided spectral density of the noise of `random_walk` at frequencies [Hz] above zero."""
    return np.asarray(2 / (2 * np.pi * frequency) ** 2)

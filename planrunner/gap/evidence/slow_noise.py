"""Describes slow noise: flicker and random walk. Flicker is described by the exact covariances of its means over segments, and by
its spectrum within the segments. A random walk is described by the exact covariances of all coefficients, that is, of the segment
means and of the coefficients that describe the changes within the segments.

Flicker is represented by a sum of Ornstein–Uhlenbeck processes whose correlation times are two octaves apart (Keshner, "1/f noise",
Proc. IEEE 70, 1982). A random walk has the covariance q²·min(t, t'). The averages of both covariances over the segments have a
closed form. A change of a random walk within a segment continues in all later segments. Therefore, the coefficients of a random
walk within a segment are not independent of the means of later segments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.correlation import Blocks
from planrunner.gap.evidence.spectrum import Spectrum

OCTAVES = 2.0 ** np.arange(0, 15, 2)  # s, correlation times: from a second to hours, two octaves apart


def ornstein_uhlenbeck(starts: Array, ends: Array, tau: float) -> Array:
    """Computes the covariance of the means over the intervals [start, end] of a process with unit variance and the covariance
    function exp(−|t − t'|/τ). Returns an array of shape (S, S).

    A segment of length T has the variance 2(x − 1 + e^−x)/x² with x = T/τ. Two disjoint segments have the covariance e^(−gap/τ)·Π(1
    − e^−x_i)/x_i, where gap is the time between the two segments.
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

    Flicker noise has the one-sided density B²/(π·f), and the Allan deviation √(2·ln 2/π)·B = 0.664·B (IEEE Std 952, annex C).
    Flicker noise is represented by a sum of processes of variance v whose correlation times differ by a factor r. Between the
    corner frequencies of the processes, their total density is v/(ln r·f). With v = ln r/π, this density is equal to B²/(π·f) with
    B = 1.
    """
    level = math.log(OCTAVES[1] / OCTAVES[0]) / math.pi
    total = np.zeros((len(starts), len(starts)))
    for tau in OCTAVES:
        total += level * ornstein_uhlenbeck(starts, ends, float(tau))
    return total


def random_walk(starts: Array, ends: Array) -> Array:
    """Computes the covariance of the segment means of a random walk with unit density (1/√s), shape (S, S). The walk starts from
    zero at the first start time.

    Times are counted from the first start time. The covariance of two disjoint segments is then the middle time of the earlier
    segment. The variance of a segment of length T is its start time plus T/3.
    """
    begin = starts - starts[0]
    middles = (begin + ends - starts[0]) / 2
    covariance: Array = np.minimum(middles[:, None], middles[None, :])
    np.fill_diagonal(covariance, begin + (ends - starts) / 3)
    return covariance


def random_walk_within(vectors: Array, step: float) -> tuple[Array, Array, Array]:
    """Computes the covariances of the coefficients of one segment due to a random walk with unit density.

    `vectors`: array of shape (n, m), orthonormal vectors, of which the first is constant. `step`: time between two of the n
    samples, each of which is a mean over this time, in s. Returns the covariance (m, m) of the coefficients, their covariance (m,)
    with the mean of the segment, and their covariance (m,) with the mean of any later segment. All covariances of the constant
    vector are zero, because this vector belongs to the means.

    The covariance of two samples a ≤ b of the segment is the time before the segment plus step·(a + ½) if a < b, or plus step·(a +
    ⅓) if a = b. The time before the segment cancels in all vectors except the constant vector.
    """
    count = len(vectors)
    later = np.cumsum(vectors[::-1], axis=0)[::-1]
    covariance = step * (later.T @ later - vectors.T @ vectors / 6)
    own = step * (later.T @ np.arange(count, 0, -1)) / count
    afterwards = step * (vectors.T @ (np.arange(count) + 0.5))
    covariance[0] = covariance[:, 0] = own[0] = afterwards[0] = 0.0
    return covariance, own, afterwards


@dataclass(frozen=True)
class WalkAcross:
    """Contains the covariances that a random walk causes between the segment means and the M coefficients within the segments.

    A coefficient describes a change within its segment. `own`: array of shape (M,), covariance of each coefficient with the mean of
    its own segment. `afterwards`: array of shape (M,), covariance of each coefficient with the mean of any later segment. The
    covariance with the means of earlier segments is zero. `first`: array of shape (S,), index of the first coefficient of each
    segment.
    """

    own: Array
    afterwards: Array
    first: NDArray[np.int64]

    def of(self, columns: Array) -> WalkAcross:
        """Returns the covariances after a transformation of the coefficients. `columns`: array of shape (M, 2), the transformed
        `own` and `afterwards`."""
        return WalkAcross(columns[:, 0], columns[:, 1], self.first)

    @property
    def columns(self) -> Array:
        """Returns `own` and `afterwards` as columns, shape (M, 2)."""
        return np.column_stack([self.own, self.afterwards])

    def times(self, factor: float) -> WalkAcross:
        return WalkAcross(self.own * factor, self.afterwards * factor, self.first)

    def product(self, columns: Array) -> Array:
        """Returns the product of the covariances (S, M) with columns (M, …), shape (S, …)."""
        own, afterwards = (
            np.add.reduceat((columns.T * part).T, self.first, axis=0) for part in (self.own, self.afterwards)
        )
        return np.asarray(own + np.cumsum(afterwards, axis=0) - afterwards)

    def squared(self) -> Array:
        """Returns the product of the covariances (S, M) with their transpose, shape (S, S)."""
        own, mixed, later = (
            np.add.reduceat(part, self.first) for part in (self.own**2, self.own * self.afterwards, self.afterwards**2)
        )
        before = np.cumsum(later) - later
        index = np.arange(len(before))
        found = (before + mixed)[np.minimum(index[:, None], index)]
        found[index, index] = before + own
        return np.asarray(found)

    def dense(self) -> Array:
        """Returns the covariances, shape (S, M)."""
        return self.product(np.eye(len(self.own)))


@dataclass(frozen=True)
class SlowNoise:
    """Contains the covariances of slow noise: of flicker with B = 1, and of a random walk with unit density (1/√s).

    `flicker`, `random_walk`: arrays of shape (S, S), covariances of the segment means. `walk_within`: for a random walk,
    covariances of the coefficients within each segment, s·samples; zero for the means. `walk_across`: for a random walk,
    covariances of the segment means with the coefficients, s·√samples; zero for the means.
    """

    flicker: Array
    random_walk: Array
    walk_within: Blocks
    walk_across: WalkAcross

    @classmethod
    def of(cls, observed: Observed, spectrum: Spectrum) -> SlowNoise:
        starts, ends = lasting(observed)
        size = [len(basis.frequency) for basis in spectrum.bases]
        within, across = Blocks.diagonal(size, np.zeros(len(size))), []
        known: dict[tuple[int, float], tuple[Array, Array, Array]] = {}
        for index, basis in enumerate(spectrum.bases):
            bins, step = int(observed.bin_size[index]), float(ends[index] - starts[index]) / len(basis.vectors)
            key = id(basis), round(step, 12)
            if key not in known:
                known[key] = random_walk_within(basis.vectors, step)
            covariance, own, afterwards = known[key]
            within.of_segment(index)[:] = bins * covariance
            across.append(np.sqrt(bins) * np.column_stack([own, afterwards]))
        columns = np.concatenate(across)
        walk = WalkAcross(columns[:, 0], columns[:, 1], spectrum.means)
        return cls(flicker(starts, ends), random_walk(starts, ends), within, walk)


def lasting(observed: Observed) -> tuple[Array, Array]:
    """Returns the start and end times [s] of the segments, each of shape (S,)."""
    size, twice = observed.bin_size, 2 * observed.sample_rate
    last = observed.time[observed.bounds[1:] - 1] + (size + 1) / twice
    return observed.time[observed.bounds[:-1]] - (size - 1) / twice, last


def flicker_spectrum(frequency: Array) -> Array:
    """Returns the one-sided spectral density [1/Hz] of the noise of `flicker` at frequencies [Hz] above zero."""
    return np.asarray(1 / (math.pi * frequency))

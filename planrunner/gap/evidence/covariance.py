"""Represents the covariances between the coefficients of a channel: one block for each segment, and slow noise.

Slow noise correlates the means of different segments. Otherwise, coefficients of different segments are independent. Apart from
slow noise, the covariance of all coefficients of a channel therefore consists of one block for each segment. Blocks of different
sizes are padded with the identity, so that all of them are factorised at once.

Slow noise is flicker or a random walk. Flicker is described by the exact covariances of its means over segments, and by its
spectrum within the segments. A random walk is described by the exact covariances of all coefficients, that is, of the segment means
and of the coefficients that describe the changes within the segments. Flicker is represented by a sum of Ornstein–Uhlenbeck
processes whose correlation times are two octaves apart (Keshner, "1/f noise", Proc. IEEE 70, 1982). A random walk has the
covariance q²·min(t, t'). The averages of both covariances over the segments have a closed form. A change of a random walk within a
segment continues in all later segments. Therefore, the coefficients of a random walk within a segment are not independent of the
means of later segments.

In array shapes, S is the number of segments and M is the number of coefficients of a channel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.spectrum import Spectrum

OCTAVES = 2.0 ** np.arange(0, 15, 2)  # s, correlation times from one second to hours, two octaves apart
_LEAST = 1e-3  # smallest fraction of a coefficient's variance that the other coefficients do not explain


@dataclass(frozen=True)
class Blocks:
    """Contains one matrix for each of S segments, such as the covariance of the coefficients of the segment. `size`: number of
    coefficients of each segment. `matrix`: array of shape (S, m, m), the matrices, padded with the identity to the size m of the
    largest one."""

    size: Sequence[int]
    matrix: Array

    @classmethod
    def diagonal(cls, size: Sequence[int], value: Array) -> Blocks:
        """Makes diagonal blocks with one value for each of the S segments."""
        whole = np.tile(np.eye(max(size)), (len(size), 1, 1))
        inside = np.arange(max(size)) < np.asarray(size)[:, None]
        return cls(size, whole * np.where(inside, value[:, None], 1.0)[:, None, :])

    def of_segment(self, index: int) -> Array:
        """Returns the block of one segment as a view, shape (n, n)."""
        return self.matrix[index, : self.size[index], : self.size[index]]

    @property
    def variances(self) -> Array:
        """Returns the diagonal in the order of the coefficients, shape (M,)."""
        return np.concatenate([np.diag(self.of_segment(index)) for index in range(len(self.size))])

    @property
    def correlated(self) -> bool:
        """Returns True if any block has values outside its diagonal."""
        return bool((self.matrix - self.matrix * np.eye(self.matrix.shape[1])).any())

    def times(self, value: float) -> Blocks:
        """Returns the blocks multiplied by a number."""
        return Blocks(self.size, self.matrix * value)

    def scaled(self, factors: Array) -> Blocks:
        """Returns the covariances after the coefficients have been multiplied by factors (M,)."""
        made = Blocks(self.size, self.matrix.copy())
        for index, own in enumerate(np.split(factors, np.cumsum(self.size)[:-1])):
            made.of_segment(index)[:] *= np.outer(own, own)
        return made

    def joined(self, other: Blocks) -> Blocks:
        """Returns the sum of the covariances of two independent processes with the same coefficients."""
        made = Blocks(self.size, self.matrix.copy())
        for index in range(len(self.size)):
            made.of_segment(index)[:] += other.of_segment(index)
        return made

    def plus(self, variances: Array) -> Blocks:
        """Returns the blocks after variances (M,) have been added to the diagonal."""
        made, first = Blocks(self.size, self.matrix.copy()), 0
        for index, count in enumerate(self.size):
            at = np.arange(count)
            made.matrix[index, at, at] += variances[first : first + count]
            first += count
        return made


class Correlation:
    """Contains the correlations between the M coefficients of a channel. `apart` converts standardised coefficients, which have the
    variance 1, to independent coefficients. `joined` does the inverse."""

    def __init__(self, covariance: Blocks):
        root = np.sqrt(np.diagonal(covariance.matrix, axis1=1, axis2=2))
        self._matrix = covariance.matrix / (root[:, :, None] * root[:, None, :])
        self._matrix = (1 - _LEAST) * self._matrix + _LEAST * np.eye(root.shape[1])
        inside = np.arange(root.shape[1]) < np.asarray(covariance.size)[:, None]
        self._rows: NDArray[np.int64] = np.where(inside, np.cumsum(inside).reshape(inside.shape) - 1, -1)
        self._inside, self.count = inside, int(inside.sum())
        self._factor = np.linalg.cholesky(self._matrix)
        self._inverse = np.linalg.inv(self._factor)
        self.log_det = 2 * float(np.log(np.diagonal(self._factor, axis1=1, axis2=2)).sum())

    def apart(self, columns: Array) -> Array:
        """Converts standardised coefficients (M, …) to independent ones."""
        return self._times(self._inverse, columns)

    def joined(self, columns: Array) -> Array:
        """Converts independent coefficients (M, …) to standardised ones."""
        return self._times(self._factor, columns)

    def apart_transposed(self, columns: Array) -> Array:
        """Multiplies columns (M, …) by the transpose of the matrix by which `apart` multiplies them."""
        return self._times(np.swapaxes(self._inverse, 1, 2), columns)

    def whole(self) -> Array:
        """Returns the correlation matrix (M, M)."""
        out = np.zeros((self.count, self.count))
        for rows, inside, block in zip(self._rows, self._inside, self._matrix, strict=True):
            own = rows[inside]
            out[np.ix_(own, own)] = block[: len(own), : len(own)]
        return out

    def among(self, rows: NDArray[np.bool_]) -> Correlation:
        """Returns the correlations between the rows that a mask (M,) selects. This method is used with coefficients (M, …) that are
        zero in all other rows."""
        made = Correlation.__new__(Correlation)
        made._rows, made._inside, made.count = self._rows, self._inside, self.count
        chosen = rows[self._rows] & self._inside
        both = chosen[:, :, None] & chosen[:, None, :]
        made._matrix = np.where(both, self._matrix, np.eye(self._matrix.shape[1]))
        made._factor = np.linalg.cholesky(made._matrix)
        made._inverse = np.linalg.inv(made._factor)
        made.log_det = 2 * float(np.log(np.diagonal(made._factor, axis1=1, axis2=2)).sum())
        return made

    def _times(self, matrices: Array, columns: Array) -> Array:
        flat = columns.reshape(len(columns), -1)
        padded = np.where(self._inside[:, :, None], flat[self._rows], 0.0)
        return np.asarray((matrices @ padded)[self._inside].reshape(columns.shape))


def ornstein_uhlenbeck(starts: Array, ends: Array, tau: float) -> Array:
    """Computes the covariance of the means over the intervals [start, end] of a process with unit variance and the covariance
    function exp(−|t − t'|/τ). Returns an array of shape (S, S).

    A segment of length T has the variance 2(x − 1 + e^−x)/x² with x = T/τ. Two disjoint segments have the covariance e^(−gap/τ)·Π(1
    − e^−x_i)/x_i, where gap is the time between the two segments. `starts`, `ends`: arrays of shape (S,), start and end times of
    the segments, s. `tau`: correlation time τ, s.
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
    B = 1. `starts`, `ends`: arrays of shape (S,), start and end times of the segments, s.
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
    segment. The variance of a segment of length T is its start time plus T/3. `starts`, `ends`: the same as in `flicker`.
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
        """Returns the covariances of each coefficient with the mean of its own segment (`own`) and with the mean of any later
        segment (`afterwards`) as two columns, shape (M, 2)."""
        return np.column_stack([self.own, self.afterwards])

    def times(self, factor: float) -> WalkAcross:
        return WalkAcross(self.own * factor, self.afterwards * factor, self.first)

    def product(self, columns: Array) -> Array:
        """Returns the product of the covariances (S, M) with columns (M, …), shape (S, …)."""
        own, afterwards = (
            np.add.reduceat((columns.T * part).T, self.first, axis=0) for part in (self.own, self.afterwards)
        )
        return np.asarray(own + np.cumsum(afterwards, axis=0) - afterwards)

    def transposed_product(self, columns: Array) -> Array:
        """Returns the product of the transposed covariances (M, S) with columns (S, P), shape (M, P)."""
        own = np.repeat(np.arange(len(columns)), np.diff([*self.first, len(self.own)]))
        later = np.cumsum(columns[::-1], axis=0)[::-1] - columns
        return np.asarray(self.own[:, None] * columns[own] + self.afterwards[:, None] * later[own])

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
    """Returns the one-sided spectral density [1/Hz] of the noise of `flicker` at frequencies [Hz] above zero. The result has the
    shape of `frequency`."""
    return np.asarray(1 / (math.pi * frequency))

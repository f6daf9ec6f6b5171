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
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.spectrum import Spectrum

OCTAVES = 2.0 ** np.arange(0, 15, 2)  # s, correlation times from one second to hours, two octaves apart
_LEAST = 1e-3  # smallest fraction of a coefficient's variance that the other coefficients do not explain


@dataclass(frozen=True)
class SegmentRows:
    """Describes how the M coefficients of a channel are divided among the S segments. Segments with the same number of coefficients form
    a group. `rows`: for each group of n segments with m coefficients, the indices of these coefficients, shape (n, m). `place`: for
    each segment, the index of its group, and its index in this group."""

    rows: tuple[NDArray[np.int64], ...]
    place: tuple[tuple[int, int], ...]

    @staticmethod
    @lru_cache(maxsize=8)
    def of(size: tuple[int, ...]) -> SegmentRows:
        """Makes the description for segments with these numbers of coefficients."""
        first = np.cumsum([0, *size[:-1]])
        sizes = sorted(set(size))
        members = [np.flatnonzero(np.array(size) == count) for count in sizes]
        place = [(0, 0)] * len(size)
        for group, own in enumerate(members):
            for number, segment in enumerate(own.tolist()):
                place[segment] = group, number
        rows = (first[own][:, None] + np.arange(count) for own, count in zip(members, sizes, strict=True))
        return SegmentRows(tuple(rows), tuple(place))


@dataclass(frozen=True)
class Blocks:
    """Contains one matrix for each of S segments, such as the covariance of the coefficients of the segment. `size`: number of
    coefficients of each segment. `matrices`: for each group of n segments with m coefficients (`SegmentRows`), an array of shape (n, m,
    m)."""

    size: tuple[int, ...]
    matrices: tuple[Array, ...]

    @classmethod
    def diagonal(cls, size: Sequence[int], value: Array) -> Blocks:
        """Makes diagonal blocks with one value for each of the S segments."""
        made = cls(tuple(size), tuple(np.zeros((*own.shape, own.shape[1])) for own in SegmentRows.of(tuple(size)).rows))
        return made.plus(np.repeat(value, size))

    @property
    def segment_rows(self) -> SegmentRows:
        return SegmentRows.of(self.size)

    def of_segment(self, index: int) -> Array:
        """Returns the block of one segment as a view, shape (m, m)."""
        group, number = self.segment_rows.place[index]
        return np.asarray(self.matrices[group][number])

    @property
    def variances(self) -> Array:
        """Returns the diagonal in the order of the coefficients, shape (M,)."""
        out = np.empty(sum(self.size))
        for rows, own in zip(self.segment_rows.rows, self.matrices, strict=True):
            out[rows] = np.diagonal(own, axis1=1, axis2=2)
        return out

    @property
    def correlated(self) -> bool:
        """Returns True if any block has values outside its diagonal."""
        return any(bool((own - own * np.eye(own.shape[1])).any()) for own in self.matrices)

    def times(self, value: float) -> Blocks:
        """Returns the blocks multiplied by a number."""
        return Blocks(self.size, tuple(own * value for own in self.matrices))

    def scaled(self, factors: Array) -> Blocks:
        """Returns the covariances after the coefficients have been multiplied by factors (M,)."""
        each = zip(self.matrices, (factors[rows] for rows in self.segment_rows.rows), strict=True)
        return Blocks(self.size, tuple(own * (by[:, :, None] * by[:, None, :]) for own, by in each))

    def joined(self, other: Blocks) -> Blocks:
        """Returns the sum of the covariances of two independent processes with the same coefficients."""
        return Blocks(self.size, tuple(a + b for a, b in zip(self.matrices, other.matrices, strict=True)))

    def plus(self, variances: Array) -> Blocks:
        """Returns the blocks after variances (M,) have been added to the diagonal."""
        made = Blocks(self.size, tuple(own.copy() for own in self.matrices))
        for rows, own in zip(self.segment_rows.rows, made.matrices, strict=True):
            at = np.arange(own.shape[1])
            own[:, at, at] += variances[rows]
        return made


class Correlation:
    """Contains the correlations between the M coefficients of a channel. `apart` converts standardised coefficients, which have the
    variance 1, to independent coefficients. `joined` does the inverse. `covariance`: the covariances of the coefficients. `rows`:
    array of shape (M,); if it is given, the coefficients for which it is False count as independent of all others."""

    def __init__(self, covariance: Blocks, rows: NDArray[np.bool_] | None = None):
        self._covariance, self._chosen = covariance, rows
        factors = [np.linalg.cholesky(own) for own in self._matrices()]
        self._inverse: list[Array] = [np.asarray(np.linalg.inv(own)) for own in factors]
        self.log_det = 2 * sum(float(np.log(np.diagonal(own, axis1=1, axis2=2)).sum()) for own in factors)

    def _matrices(self) -> list[Array]:
        """Returns the correlation matrices of each group of segments, shape (n, m, m)."""
        found = []
        for rows, own in zip(self._covariance.segment_rows.rows, self._covariance.matrices, strict=True):
            root, identity = np.sqrt(np.diagonal(own, axis1=1, axis2=2)), np.eye(own.shape[1])
            matrix = (1 - _LEAST) * (own / (root[:, :, None] * root[:, None, :])) + _LEAST * identity
            if self._chosen is not None:
                both = self._chosen[rows][:, :, None] & self._chosen[rows][:, None, :]
                matrix = np.where(both, matrix, identity)
            found.append(matrix)
        return found

    def apart(self, columns: Array) -> Array:
        """Converts standardised coefficients (M, …) to independent ones."""
        return self._times(self._inverse, columns)

    def joined(self, columns: Array) -> Array:
        """Converts independent coefficients (M, …) to standardised ones."""
        factors = [np.asarray(np.linalg.cholesky(own)) for own in self._matrices()]
        return self._times(factors, columns)

    def apart_transposed(self, columns: Array) -> Array:
        """Multiplies columns (M, …) by the transpose of the matrix by which `apart` multiplies them."""
        return self._times([np.swapaxes(own, 1, 2) for own in self._inverse], columns)

    def between(self, chosen: NDArray[np.int64]) -> Array:
        """Returns the correlation matrix (n, n) of the coefficients with the indices `chosen` (n,)."""
        place = np.full(sum(self._covariance.size), -1)
        place[chosen] = np.arange(len(chosen))
        out = np.zeros((len(chosen), len(chosen)))
        for rows, matrices in zip(self._covariance.segment_rows.rows, self._matrices(), strict=True):
            for at, matrix in zip(place[rows], matrices, strict=True):
                own = at >= 0
                out[np.ix_(at[own], at[own])] = matrix[np.ix_(own, own)]
        return out

    def among(self, rows: NDArray[np.bool_]) -> Correlation:
        """Returns the correlations between the rows that a mask (M,) selects. This method is used with coefficients (M, …) that are
        zero in all other rows."""
        return Correlation(self._covariance, rows)

    def _times(self, matrices: Sequence[Array], columns: Array) -> Array:
        flat = columns.reshape(len(columns), -1)
        out = np.empty(flat.shape)
        for rows, own in zip(self._covariance.segment_rows.rows, matrices, strict=True):
            out[rows] = own @ flat[rows]
        return out.reshape(columns.shape)


@dataclass(frozen=True)
class MeansCovariance:
    """Contains the covariance of the S segment means of a channel, as the sum of three parts, SI². Only their sizes are stored, because
    there are many levels of the noise. `slow`: slow noise of unit size. `independent`: array of shape (S,), variances of the
    independent noise. `flicker`, `walk`: squares of the sizes of the flicker and of the random walk."""

    slow: SlowNoise
    independent: Array
    flicker: float
    walk: float

    def whole(self) -> Array:
        """Returns the covariance, shape (S, S)."""
        out = np.diag(self.independent)
        for size, own in ((self.flicker, self.slow.flicker), (self.walk, self.slow.random_walk)):
            if size != 0:
                out += size * own
        return out

    @property
    def variances(self) -> Array:
        """Returns the variance of each mean, shape (S,)."""
        slow = self.flicker * np.diag(self.slow.flicker) + self.walk * np.diag(self.slow.random_walk)
        return np.asarray(self.independent + slow)

    def times(self, ratio: float) -> MeansCovariance:
        return MeansCovariance(self.slow, self.independent * ratio, self.flicker * ratio, self.walk * ratio)

    def towards(self, other: MeansCovariance, share: float) -> MeansCovariance:
        """Returns the covariance C + share·(C′ − C), where C is this covariance and C′ is the covariance `other`."""
        independent = self.independent + share * (other.independent - self.independent)
        flicker, walk = (
            self.flicker + share * (other.flicker - self.flicker),
            self.walk + share * (other.walk - self.walk),
        )
        return MeansCovariance(self.slow, independent, flicker, walk)


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

    def between(self, segments: NDArray[np.int64], chosen: NDArray[np.int64]) -> Array:
        """Returns the covariances of the means of some segments (s,) with the coefficients that have the indices `chosen` (n,), shape (s,
        n)."""
        owner = np.searchsorted(self.first, chosen, side="right") - 1
        later = np.where(segments[:, None] > owner, self.afterwards[chosen], 0.0)
        return np.where(segments[:, None] == owner, self.own[chosen], later)


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

"""Represents the covariances between the coefficients of a segment.

Slow noise correlates the means of different segments. Otherwise, coefficients of different segments are independent. Apart from
slow noise, the covariance of all coefficients of a channel therefore consists of one block for each segment. Blocks of different
sizes are padded with the identity, so that all of them are factorised at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array

_LEAST = 1e-3  # least variance of a coefficient, relative to its own, that the other coefficients leave


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

"""Evaluation of designs on the whitened coefficients of a channel, with the nominal parameters projected out.

The evidence of a design needs only the eigenvalues of its Gram matrix and the squared scores along the eigenvectors. Both follow from the
few rows on which a design acts: with Y its whitened rows and B an orthonormal basis of the nominal columns, the Gram matrix is YᵀY −
(BᵀY)ᵀ(BᵀY), and the score is Yᵀr, because the residual r has no component along B.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planrunner.gap.evidence.weighing import ChannelWeights

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]
Eigen = tuple[Array, Array]  # eigenvalues (n,) and squared scores (n,)
_NOTHING = 1e-6  # smallest norm of a nominal direction that is not rounding


class Left:
    """A channel under one setting of the noise, possibly without some rows of its coefficients.

    rows: (M,), the remaining rows. basis: (M, q), orthonormal, of the whitened nominal columns on them; residual: (M,); both zero
    elsewhere.
    """

    def __init__(self, weight: ChannelWeights, rows: Rows, basis: Array, residual: Array):
        self.weight, self.rows, self.basis, self.residual = weight, rows, basis, residual

    @classmethod
    def whole(cls, weight: ChannelWeights) -> Left:
        return cls(weight, np.ones(len(weight.residual), dtype=bool), weight.basis, weight.residual)

    def without(self, taken: Rows) -> Left:
        """The channel without some rows; the others then determine the nominal parameters. Rows of order 0 are whitened jointly and are
        removed together."""
        rows = self.rows & ~taken
        basis, size, _ = np.linalg.svd(self.basis * rows[:, None], full_matrices=False)
        basis = basis[:, size > _NOTHING]
        residual = self.residual * rows
        return Left(self.weight, rows, basis, residual - basis @ (basis.T @ residual))

    def whitened(self, columns: Array, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
        """For columns (n, P) in some rows (n,), zero elsewhere: the rows on which they act after whitening, and their whitened values
        there."""
        at, whitened = self.weight.whitened_rows(columns, rows)
        here = self.rows[at]
        return (at, whitened) if here.all() else (at[here], whitened[here])


def eigen(left: Left, design: Array | Rows) -> Eigen:
    """Eigenvalues and squared scores of a design: columns (M, P), or rows (M,) that are each a separate column. Empty if the design has
    no visible part."""
    if design.ndim == 1:
        return _of_rows(left, np.flatnonzero(np.logical_and(design, left.rows)))
    columns = np.asarray(design[:, design.any(axis=0)], dtype=float)
    acting = np.flatnonzero(columns.any(axis=1))
    at, whitened = left.whitened(columns[acting], acting)
    if not whitened.size:
        return np.zeros(0), np.zeros(0)
    along = left.basis[at].T @ whitened
    values, vectors = np.linalg.eigh(whitened.T @ whitened - along.T @ along)
    return _seen(values, (vectors.T @ (whitened.T @ left.residual[at])) ** 2, float((whitened**2).sum(0).max()))


def _of_rows(left: Left, at: NDArray[np.int64]) -> Eigen:
    """Rows as separate columns: their Gram matrix is diagonal except for the part that the nominal parameters absorb. Among rows of equal
    weight, this part has no more directions than there are parameters; all directions orthogonal to it are eigenvectors with a common
    eigenvalue."""
    if not len(at):
        return np.zeros(0), np.zeros(0)
    scale = left.weight.scale[at]
    levels, which = np.unique(scale, return_inverse=True)
    basis, score = left.basis[at] * scale[:, None], left.residual[at] * scale
    free: list[Eigen] = []
    diagonal, taken, scores = [], [], []
    for number, level in enumerate(levels):
        own, told = basis[which == number], score[which == number]
        if len(own) > own.shape[1]:
            directions, own = np.linalg.qr(own)
            rest = told - directions @ (told := directions.T @ told)
            count = len(rest) - len(told)
            free.append((np.full(count, level**2), np.full(count, float(rest @ rest) / count)))
        diagonal.append(np.full(len(own), level**2))
        taken.append(own)
        scores.append(told)
    held = np.concatenate(taken)
    values, vectors = np.linalg.eigh(np.diag(np.concatenate(diagonal)) - held @ held.T)
    mixed = _seen(values, (vectors.T @ np.concatenate(scores)) ** 2, float(levels[-1] ** 2))
    values, along = (np.concatenate(parts) for parts in zip(mixed, *free, strict=True))
    return values, along


def _seen(values: Array, along: Array, largest: float) -> Eigen:
    """Without directions that the nominal parameters absorb completely. largest: energy of a column before the projection."""
    seen = values > _NOTHING**2 * largest
    return values[seen], along[seen]

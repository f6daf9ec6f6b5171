"""Analyses a design matrix: determines its rank, its condition, and the terms that it cannot separate.

All results refer to columns divided by their declared magnitudes (Earth rate, g …). The raw SI columns of a good eight-position
plan differ by five orders of magnitude and would look ill-conditioned.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.kept import kept

TOLERANCE = (
    1e-9  # singular values below this times the largest count as zero; planned attitudes are exact to about 1e-15
)


@dataclass(frozen=True, slots=True)
class MatrixRank:
    """The rank and the null space of a design matrix. `singular`: singular values of the scaled matrix, largest first. `null`:
    orthonormal rows that span the null space, shape (columns − rank, columns)."""

    rank: int
    singular: Array
    null: Array

    @property
    def determinant(self) -> float:
        """Returns the determinant of the information matrix AᵀA, where A is the scaled matrix; zero if A does not have full rank."""
        return 0.0 if len(self.null) else float(np.prod(self.singular**2))

    @property
    def condition(self) -> float:
        """Returns the ratio of the largest to the smallest singular value; infinite if the matrix does not have full rank."""
        if len(self.null):
            return float("inf")
        return float(self.singular[0] / self.singular[-1])


@kept(256)
def look(scaled: Array, tolerance: float = TOLERANCE) -> MatrixRank:
    """Computes the rank and the null space of a matrix (n, p) whose columns are already scaled; n may be smaller than p."""
    p = scaled.shape[1]
    _, singular, rows = np.linalg.svd(scaled, full_matrices=len(scaled) < p)
    largest = singular[0] if len(singular) else 0.0
    rank = int(np.sum(singular > tolerance * max(largest, 1e-300)))
    return MatrixRank(rank, singular, rows[rank:p])


def combinations(null: Array, names: Sequence[str]) -> tuple[tuple[tuple[str, float], ...], ...]:
    """Describes the null space by a few short linear combinations of columns. Each combination is zero. A combination is a sequence
    of pairs: the name of a column and its weight. The combinations are found by Gauss–Jordan elimination.

    If a combination has only one name, this column is zero.
    """
    rows = null.copy()
    done = 0
    for column in range(rows.shape[1] - 1, -1, -1):
        if done == len(rows):
            break
        pivot = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[pivot, column]) < 1e-6:
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, column]
        others = np.arange(len(rows)) != done
        rows[others] -= np.outer(rows[others, column], rows[done])
        done += 1
    first = np.argmax(np.abs(rows[:done]) > 1e-6, axis=1)
    return tuple(
        tuple((name, float(weight)) for name, weight in zip(names, row, strict=True) if abs(weight) > 1e-6)
        for row in rows[:done][np.argsort(first, kind="stable")]
    )


def unidentifiable(null: Array, names: Sequence[str]) -> tuple[str, ...]:
    """Names the terms that occur in the null space, in their original order. The data do not determine any of these terms
    separately."""
    return tuple(
        name for name, weight in zip(names, np.abs(null).max(axis=0, initial=0.0), strict=True) if weight > 1e-6
    )


def explain(null: Array, names: Sequence[str]) -> str:
    """Returns a sentence that explains the null space to a quality engineer; empty if every term can be identified."""
    if not len(null):
        return ""
    sentences = []
    found = combinations(null, names)
    zero = [combination[0][0] for combination in found if len(combination) == 1]
    if zero:
        listed = " and ".join([", ".join(zero[:-1]), zero[-1]] if len(zero) > 1 else zero)
        sentences.append(
            f"the {'terms' if len(zero) > 1 else 'term'} {listed} {'are' if len(zero) > 1 else 'is'} zero in every position"
        )
    for combination in found:
        if len(combination) > 1:
            involved = [name for name, _ in combination]
            listed = ", ".join(involved[:-1]) + " and " + involved[-1]
            parts = " ".join(f"{weight:+.3g}·{name}" for name, weight in combination)
            sentences.append(
                f"{listed} cannot be separated ({parts} = 0 in every position, with each term divided by its size)"
            )
    return "; ".join(sentences)

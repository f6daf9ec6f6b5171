"""Measures the information in a set of observations by the four usual criteria of optimal design, and the efficiency of the set
relative to the best set.

A set of observations is given by rows x_i of a design matrix (n, p), whose columns are divided by their declared magnitudes. M = Σ
w_i·x_i·x_iᵀ is the information matrix in units of the inverse variance of one observation. Criterion D maximises |M|. Criterion A
minimises the trace of M⁻¹, which is the sum of the coefficients' variances. Criterion G minimises the largest variance xᵀM⁻¹x of a
predicted output over a region, and criterion I minimises the mean variance over the region. Efficiencies are per observation: if
the efficiency of a set is 80 %, the best design reaches the same value of the criterion with 0.8 times as many observations
(Atkinson, Donev & Tobias, Optimum Experimental Designs, with SAS, 2007, chapters 10 and 11).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planrunner.base.arrays import Array

SINGULAR = 1e-9
"""A singular value of the rows counts as zero if it is below this fraction of the largest singular value."""


@dataclass(frozen=True, slots=True)
class Merit:
    """The values of the criteria for a set of n observations of p terms.

    `determinant`: |M|, zero if M is singular. `trace`: trace of M⁻¹. `worst`: largest variance of a predicted output over the
    region. `mean`: average variance of a predicted output over the region. `worst` and `mean` are in units of the variance of one
    observation. `trace`, `worst` and `mean` are infinite if M is singular.
    """

    observations: int
    terms: int
    rank: int
    determinant: float
    trace: float
    worst: float
    mean: float

    @property
    def sound(self) -> bool:
        return self.rank == self.terms


@dataclass(frozen=True, slots=True)
class Efficiency:
    """Contains efficiencies relative to a reference set. For the reference set itself, each of them is 1."""

    D: float
    A: float
    G: float
    I: float  # noqa: E741 - the criterion's name


def information(rows: Array, weights: Array | None = None) -> Array:
    """Returns the information matrix M, shape (p, p), of rows (n, p). `weights`: array of shape (n,), 1 for each row by default."""
    rows = np.asarray(rows, dtype=float)
    return rows.T @ rows if weights is None else (rows * np.asarray(weights)[:, None]).T @ rows


def region_moment(region: Array) -> Array:
    """Returns the mean of x·xᵀ over the rows of a region, shape (p, p), so that the mean variance over the region is
    trace(moment·M⁻¹)."""
    return information(region) / len(region)


def variances(rows: Array, matrix: Array) -> Array:
    """Returns the variance xᵀM⁻¹x for each row x of `rows` (n, p), shape (n,). `matrix`: the information matrix M (p, p)."""
    return np.asarray(np.einsum("ij,ij->i", rows @ np.linalg.inv(matrix), rows))


def merit(rows: Array, region: Array, weights: Array | None = None, fixed: Array | None = None) -> Merit:
    """Returns the values of the criteria for a set of observations.

    `region`: rows of the points for which predictions are required. `weights`: weight of each observation, 1 by default. `fixed`:
    rows (k, p) that are always observed and that are not among `observations`.
    """
    n, p = rows.shape
    used = rows if weights is None else rows * np.sqrt(weights)[:, None]
    if fixed is not None:
        used = np.concatenate([used, fixed])
    singular = np.linalg.svd(used, compute_uv=False)
    rank = int(np.sum(singular > SINGULAR * singular[0])) if len(used) and singular[0] > 0 else 0
    if rank < p:
        return Merit(n, p, rank, 0.0, math.inf, math.inf, math.inf)
    matrix = information(used)
    felt = variances(region, matrix)
    trace = float(np.trace(np.linalg.inv(matrix)))
    return Merit(n, p, rank, float(np.prod(singular**2)), trace, float(felt.max()), float(felt.mean()))


def efficiency(of: Merit, reference: Merit) -> Efficiency:
    """Returns, for each criterion, the efficiency of a set relative to another set with the same number of terms."""
    share = of.observations / reference.observations
    root = (of.determinant / reference.determinant) ** (1 / of.terms) if reference.determinant > 0 else math.nan
    return Efficiency(
        root / share,
        reference.trace / (of.trace * share),
        reference.worst / (of.worst * share),
        reference.mean / (of.mean * share),
    )

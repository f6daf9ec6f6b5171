"""Searches for G-optimal sets, which minimise the largest variance of a predicted output over a region.

The largest variance is not differentiable where two points of the region have the same variance. A local search therefore uses the
k-norm of the variances for increasing k. The gradient of this norm is the gradient of a linear criterion tr(W·M⁻¹). As k grows, the
matrix W concentrates on the points of the region with the largest variance. In a search among listed candidates, each position in
turn is replaced by the candidate that minimises the largest variance.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.design.optimal import Region, boxed, with_slopes

Indices = NDArray[np.intp]

NORMS = (4.0, 16.0, 64.0, 256.0)


def worst(rows: Array, region: Array, fixed: Array | None = None) -> float:
    """Returns the largest variance xᵀM⁻¹x over the rows of `region` (N, p), for a set of observations with the rows `rows` (n, p);
    infinite if M is singular.

    `fixed`: array of shape (p, p), information that does not depend on the choice.
    """
    matrix = rows.T @ rows + (0.0 if fixed is None else fixed)
    if np.linalg.matrix_rank(matrix) < len(matrix) or np.linalg.cond(matrix) > 1e14:
        return math.inf
    return float(np.einsum("ij,ij->i", region @ np.linalg.inv(matrix), region).max())


def refine(over: Region, start: Array, region: Array, fixed: Array | None = None) -> Array:
    """Searches locally from `start` for settings (n, k) with a smaller largest variance over the rows of `region`. Returns these
    settings, or `start` itself if no better settings are found."""
    from scipy.optimize import minimize

    shape, best, least = start.shape, start, worst(over.rows_of(start), region, fixed)
    always = 1e-12 * np.eye(over.rows.shape[1]) + (0.0 if fixed is None else fixed)
    current = start
    for norm in NORMS:

        def value(flat: Array, norm: float = norm) -> tuple[float, Array]:
            rows, slopes = with_slopes(over.rows_of, flat.reshape(shape))
            inverse = np.linalg.inv(rows.T @ rows + always)
            variance = np.einsum("ij,ij->i", region @ inverse, region)
            top = float(variance.max())
            powers = (variance / top) ** norm
            loss = top * float(np.mean(powers)) ** (1 / norm)
            # ∂loss/∂variance, so that W = Σ w·x·xᵀ and the slope in a row x is −2·M⁻¹WM⁻¹x.
            weights = loss * powers / variance / float(np.sum(powers))
            middle = inverse @ ((region * weights[:, None]).T @ region) @ inverse
            return loss, -2.0 * np.einsum("nkp,np->nk", slopes, rows @ middle).ravel()

        done = minimize(
            value, current.ravel(), jac=True, method="L-BFGS-B", bounds=boxed(over, shape[0]), options={"maxiter": 100}
        )
        current = np.asarray(done.x).reshape(shape)
        reached = worst(over.rows_of(current), region, fixed)
        if reached < least:
            best, least = current, reached
    return best


def exchange(rows: Array, start: Indices, region: Array, repeats: bool = False, fixed: Array | None = None) -> Indices:
    """Returns the indices (n,) of the chosen candidates among `rows` (N, p). `region`: rows of the points for which predictions are
    required. `repeats`: True if a candidate may be chosen more than once. The search begins with `start`, and makes exchanges that
    reduce the largest variance until no exchange reduces it any more."""
    chosen = list(map(int, start))
    least = worst(rows[chosen], region, fixed)
    improved = True
    while improved:
        improved = False
        for place in range(len(chosen)):
            for candidate in range(len(rows)):
                if candidate in chosen and not repeats:
                    continue
                tried = [*chosen[:place], candidate, *chosen[place + 1 :]]
                reached = worst(rows[tried], region, fixed)
                if reached < least * (1 - 1e-9):
                    chosen, least, improved = tried, reached, True
    return np.sort(np.array(chosen, dtype=np.intp))

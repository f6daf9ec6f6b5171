"""Writes rows of a design matrix as polynomials of the attitude's nine direction cosines, so that a search can evaluate millions of
rows.

At rest, a sensor senses the Earth's rate and gravity. The components of these vectors are linear in the direction cosines, and
products of two components are of second degree. A polynomial of second degree is fitted to the rows that the estimator computes.
The polynomial is used only if it reproduces the estimator's rows everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from planrunner.base.arrays import Array

RowsAt = Callable[[Array], Array]

EXACT = 1e-9  # largest error, relative to the largest element
_FITTED, _TRIED = 300, 100
_UPPER = np.triu_indices(9)


def quick(rows_at: RowsAt) -> RowsAt:
    """Returns a faster function that replaces `rows_at`. Both functions compute rows (m, p) at attitudes (m, 3, 3). If the rows are
    not polynomials of second degree in the direction cosines, returns `rows_at` itself."""
    random = np.random.default_rng(0)
    attitudes = np.linalg.qr(random.normal(size=(_FITTED + _TRIED, 3, 3)))[0]
    attitudes = attitudes * np.linalg.det(attitudes)[:, None, None]
    rows = rows_at(attitudes)
    monomials = _monomials(attitudes)
    weights = np.linalg.pinv(monomials[:_FITTED], rcond=1e-10) @ rows[:_FITTED]
    off = np.abs(monomials[_FITTED:] @ weights - rows[_FITTED:]).max()
    if not off <= EXACT * max(1.0, float(np.abs(rows).max())):
        return rows_at
    return partial(_polynomial, weights)


def _polynomial(weights: Array, attitudes: Array) -> Array:
    return np.asarray(_monomials(attitudes) @ weights)


def _monomials(attitudes: Array) -> Array:
    """Returns the number 1, the nine cosines and the products of two cosines, shape (m, 55)."""
    cosines = attitudes.reshape(len(attitudes), 9)
    products = cosines[:, _UPPER[0]] * cosines[:, _UPPER[1]]
    return np.concatenate([np.ones((len(cosines), 1)), cosines, products], axis=1)

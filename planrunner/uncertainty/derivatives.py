"""Computes the derivatives of a formula by evaluating the formula itself. No gradient is written by hand.

The complex step (Squire and Trapp, SIAM Review 40, 1998, 110) uses the relation f(x + i·h) = f(x) + i·h·f′(x) + O(h²). As no
differences are computed, h can be so small that only rounding errors remain. The formula must be analytic. The formula may contain
sums, products, powers, `np.sqrt`, `np.sin`, `np.arctan` and `np.linalg.solve`. `abs`, `hypot`, `arctan2` and norms are not
analytic; use `angle_of` instead of `arctan2`, and `length` instead of norms. Comparisons must use the real part. A formula that
needs other functions is differentiated by central differences (`central`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np

from planrunner.base.arrays import Array

Formula = Callable[[Array], Array]
"""Function that computes q quantities (q, n) from n sets of p parameters (p, n). Each set is evaluated separately. Complex
parameters give complex quantities."""

_STEP = 1e-30


def jacobian(formula: Formula, at: Array) -> Array:
    """Returns the derivative ∂formula/∂x, shape (q, p), at x (p,). Calls the formula once."""
    return value_and_jacobian(formula, at)[1]


def value_and_jacobian(formula: Formula, at: Array) -> tuple[Array, Array]:
    """Computes the values of a formula at x (p,), with p > 0, and its derivative ∂formula/∂x. The values have the shape (q,), the
    derivative has the shape (q, p). Calls the formula once."""
    found = formula(cast(Array, at[:, None] + 1j * _STEP * np.eye(len(at))))
    return found.real[:, 0], np.asarray(found.imag / _STEP)


def central(function: Callable[[float], Array], step: float) -> Array:
    """Returns the derivative ∂function/∂x at x = 0, in the shape of the function's values. Calls the function twice, at ±
    `step`."""
    return np.asarray((function(step) - function(-step)) / (2 * step))


def length(vector: Array) -> Array:
    """Returns the Euclidean lengths of vectors whose components are along the first axis of the array: shape (…) for an array (k,
    …)."""
    return np.asarray(np.sqrt(np.sum(vector * vector, axis=0)))


def angle_of(across: Array, along: Array) -> Array:
    """Returns the angle [rad] in (−π, π] whose sine is proportional to `across` and whose cosine is proportional to `along`."""
    steep = np.abs(across.real) > np.abs(along.real)
    ratio = np.where(steep, along, across) / np.where(steep, across, along)
    direct = np.arctan(ratio) + np.where(along.real < 0, np.copysign(np.pi, across.real), 0.0)
    return np.asarray(np.where(steep, np.copysign(np.pi / 2, across.real) - np.arctan(ratio), direct))

"""Nominal parameters that a recording cannot separate: their columns made independent.

Gravity that never lies along an axis, one orientation only, poses in unknown orientations: then some nominal parameters have the same
columns as others, or none. What they absorb is still their common span, and no direction more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
DEPENDENT = 1e-8
"""Singular value, of columns of unit length and relative to the largest, below which a direction is no direction of its own."""


def independent(columns: Array) -> Array:
    """The columns (M, q) as they are where they are independent; else as many combinations (M, r) as span the same space."""
    size = np.linalg.norm(columns, axis=0)
    used = columns[:, size > 0] / size[size > 0]
    left, values, _ = np.linalg.svd(used, full_matrices=False)
    keep = values > DEPENDENT * values.max(initial=0.0)
    return columns if int(keep.sum()) == columns.shape[1] else left[:, keep] * float(size.max(initial=0.0))

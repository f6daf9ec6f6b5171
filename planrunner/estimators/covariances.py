"""Covariances put together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def independent(blocks: Sequence[Array]) -> Array:
    """Covariance (Σn, Σn) of quantities that fall into independent parts, from that of each part, (n, n)."""
    size = sum(len(block) for block in blocks)
    whole, start = np.zeros((size, size)), 0
    for block in blocks:
        end = start + len(block)
        whole[start:end, start:end] = block
        start = end
    return whole

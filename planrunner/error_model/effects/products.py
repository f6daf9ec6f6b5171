"""Products of two components of a vector, for effects of second degree."""

from __future__ import annotations

from planrunner.base.arrays import Array


def products(vector: Array) -> list[tuple[str, Array]]:
    """Names and values (N,) of the products of two components of a vector (N, 3): first the squares xx, yy, zz, then xy, yz, zx."""
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)]
    return [("xyz"[i] + "xyz"[j], vector[:, i] * vector[:, j]) for i, j in pairs]

"""Computes a quantity and its uncertainty from an estimate of the square of the quantity. Such an estimate is usual for a noise
coefficient or a component of variance."""

from __future__ import annotations

import math


def root_of(square: float, spread: float) -> tuple[float, float]:
    """Computes a quantity and its standard uncertainty from an estimate of its square and the standard uncertainty of this square.
    The estimate of the square may be negative.

    An interval of ± two standard uncertainties about the square is converted to an interval of the quantity. The uncertainty is
    half of the distance from the quantity to the farther end of this interval. If the square is well known, the uncertainty equals
    that of linear propagation. Otherwise, it is still finite.
    """
    square = max(0.0, square)
    value = math.sqrt(square)
    below = value - math.sqrt(max(0.0, square - 2 * spread))
    above = math.sqrt(square + 2 * spread) - value
    return value, max(below, above) / 2

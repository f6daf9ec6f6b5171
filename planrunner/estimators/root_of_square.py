"""A quantity whose square is estimated from the data, such as a noise coefficient or a component of variance, with its uncertainty."""

from __future__ import annotations

import math


def root_of(square: float, spread: float) -> tuple[float, float]:
    """The quantity and its standard uncertainty from its square's estimate, which may be below zero, and standard uncertainty.

    Half of the wider side of the interval that the square ± two standard uncertainties becomes: the linear rule where the square is well
    known, and finite where it is not.
    """
    square = max(0.0, square)
    value = math.sqrt(square)
    below = value - math.sqrt(max(0.0, square - 2 * spread))
    above = math.sqrt(square + 2 * spread) - value
    return value, max(below, above) / 2

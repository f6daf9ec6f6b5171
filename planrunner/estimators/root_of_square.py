"""A quantity whose square is estimated from the data, such as a noise coefficient or a component of variance, with its uncertainty."""

from __future__ import annotations

import math


def root_of(square: float, spread: float) -> tuple[float, float]:
    """The quantity and its standard uncertainty, from an estimate of its square, which can be negative, and the standard uncertainty of
    the square.

    The interval of the square, ± two standard uncertainties, is converted to an interval of the quantity. The uncertainty is half
    of the distance from the quantity to the farther end of this interval. The result equals that of the linear rule if the square
    is well known, and stays finite if it is not.
    """
    square = max(0.0, square)
    value = math.sqrt(square)
    below = value - math.sqrt(max(0.0, square - 2 * spread))
    above = math.sqrt(square + 2 * spread) - value
    return value, max(below, above) / 2

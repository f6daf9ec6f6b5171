"""Computes properties of a triad from the fitted matrix of its three outputs: scale factors, misalignments, and the triad's own
frame.

The response of an output to inputs along the three axes of a frame is a row of coefficients. The scale factor is the length of the
row, with the sign of the response along the output's own axis. The row divided by the scale factor is the input direction. The
components of this direction along the other axes are the misalignments. To first order, they are the angles between the input axis
and its nominal direction. The fitted matrix is therefore S·M, where S is diagonal and the rows of M have length one. A reversed
output has a negative scale factor.

In the triad's own frame (x along the first input axis, y in the plane of the first two input axes), M is lower triangular. The
rotation between the triad's own frame and the frame of the fitted matrix depends on the fixture and the housing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from planrunner.base.arrays import Array
from planrunner.uncertainty.derivatives import length

RowFormula = Callable[[Array], Array]
"""Function that computes a quantity (n,) from the coefficients (p, n) of one output."""

_FLAT = 1e-3  # volume of three unit vectors below which they count as coplanar


def scale_and_misalignments(places: Mapping[int, int], own: int) -> dict[int, RowFormula]:
    """Returns formulas that compute the scale factor and the misalignments of one output from its row of responses. The formulas
    are given by direction: for the output's own direction `own`, the formula of the scale factor; for the other directions, the
    formulas of the misalignments.

    `places`: maps a direction (0, 1, 2 for x, y, z) to the index of its coefficient in the row. If the output was never excited
    along its own direction, the formulas return the responses unchanged. For a row of zeros, the formulas give zeros.
    """
    listed = list(places.values())

    def plain(place: int) -> RowFormula:
        return lambda row: np.asarray(row[place])

    if own not in places:
        return {direction: plain(place) for direction, place in places.items()}

    def scale(row: Array) -> Array:
        return np.where(row[places[own]].real < 0, -1.0, 1.0) * length(row[listed])

    def across(place: int) -> RowFormula:
        return lambda row: np.asarray(row[place] / scale(row))

    return {direction: scale if direction == own else across(place) for direction, place in places.items()}


def own_frame(matrix: Array) -> Array:
    """Returns the rotations R from the frame of matrices A to the triads' own frames: A = L·R, where L is lower triangular. A and R
    have the shape (3, 3, n).

    The x axis of the own frame lies along the first row of the matrix, and the y axis in the plane of the first two rows. Raises
    ValueError if the rows are not linearly independent.
    """
    first, second, third = (row / length(row) for row in matrix)
    across = second - np.sum(first * second, axis=0) * first
    sine = length(across)
    if np.min(sine.real) < _FLAT:
        raise ValueError("the three input axes are not a right-handed triad")
    x, y = first, across / sine
    z = np.cross(x, y, axis=0)
    if np.min((np.sum(third * z, axis=0) * sine).real) < _FLAT:
        raise ValueError("the three input axes are not a right-handed triad")
    return np.stack([x, y, z])


def small_angles(rotation: Array) -> Array:
    """Converts small rotations (3, 3, n) to rotation vectors (3, n), rad, to first order."""
    return np.stack([rotation[1, 2], -rotation[0, 2], rotation[0, 1]])

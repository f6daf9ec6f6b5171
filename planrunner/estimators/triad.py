"""The algebra of a triad: scale factors and misalignments from the matrix that three outputs were fitted by, and the triad's own frame.

An output responds to what acts along the three axes of a frame by a row of coefficients. The row's length is the scale factor along the
output's own input direction; the row divided by it is that direction, whose components across are the misalignments, to first order
the angles by which the input axis leaves its nominal direction. So the matrix is S·M with S diagonal and rows of M of length one.

In the triad's own frame (x along the first input axis, y in the plane of the first two) M is lower triangular; the rotation between
that frame and the one in which the matrix was found is what a fixture and a housing add.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass

Array = NDArray[np.float64]

_FLAT = 1e-3  # volume of three unit vectors below which they count as lying in a plane


def scale_and_misalignments(row: Array, directions: Sequence[int], own: int) -> tuple[Array, Array]:
    """The scale factor, in the place of the direction `own`, and the misalignments, elsewhere, from a row of responses.

    row: (k,) responses to k directions (0, 1, 2 for x, y, z). Returns values (k,) and their Jacobian (k, k). An output that was never
    excited along its own direction keeps its responses as they are. Raises ValueError for a row of zeros.
    """
    if own not in directions:
        return row.copy(), np.eye(len(row))
    length = float(np.linalg.norm(row))
    if length == 0:
        raise ValueError("no response")
    along: Array = np.asarray(row / length)
    values = along.copy()
    jacobian = (np.eye(len(row)) - np.outer(along, along)) / length
    place = list(directions).index(own)
    values[place], jacobian[place] = length, along
    return np.asarray(values), np.asarray(jacobian)


@dataclass(frozen=True, slots=True)
class OwnFrame:
    """The matrix A (3, 3) as L·R. lower: L, lower triangular, with positive diagonal; rotation: R, from the frame of A to the triad's own;
    angles: (3,) of R as a rotation vector, rad; angle_gradient: (3, 9), d(angles)/d(A), row after row, for small angles."""

    lower: Array
    rotation: Array
    angles: Array
    angle_gradient: Array


def own_frame(matrix: Array) -> OwnFrame:
    """The frame with x along the first row and y in the plane of the first two. Raises ValueError where rows are not independent.

    From dA = dL·R + L·dR and dR = Ω·R with Ω skew, L⁻¹·dA·Rᵀ = L⁻¹·dL + Ω: the part above the diagonal is Ω's.
    """
    q, r = np.linalg.qr(matrix.T)
    signs = np.where(np.diag(r) < 0, -1.0, 1.0)
    lower, rotation = (r * signs[:, None]).T, (q * signs).T
    volume = float(np.prod(np.diag(lower) / np.maximum(np.linalg.norm(lower, axis=1), 1e-300)))
    if np.linalg.det(rotation) < 0 or volume < _FLAT:
        raise ValueError("the three input axes are not a right-handed triad")
    inverse = np.linalg.inv(lower)
    gradient = np.empty((3, 9))
    for k in range(9):
        change = np.zeros(9)
        change[k] = 1.0
        above = inverse @ change.reshape(3, 3) @ rotation.T
        # R = exp(−[φ]×) turns vectors into a frame that is itself turned by φ: Ω = −[dφ]×.
        gradient[:, k] = above[1, 2], -above[0, 2], above[0, 1]
    angles = np.array([rotation[1, 2], -rotation[0, 2], rotation[0, 1]])
    return OwnFrame(lower, rotation, angles, gradient)


def turned_gradient(matrix: Array, own: OwnFrame) -> tuple[Array, Array]:
    """d(A·Rᵀ)/d(A) and d(A·Rᵀ)/d(angles), shapes (9, 9) and (9, 3), row after row."""
    by_matrix = np.asarray(np.kron(np.eye(3), own.rotation), dtype=float)
    by_angles = np.empty((9, 3))
    for k in range(3):
        # dR = −[e_k]×·R, so d(Rᵀ) = Rᵀ·[e_k]×.
        by_angles[:, k] = (matrix @ own.rotation.T @ np.cross(np.eye(3)[k], np.eye(3)).T).ravel()
    return by_matrix, by_angles

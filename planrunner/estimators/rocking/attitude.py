"""Computes attitudes and tilts of a stabilised element. The module computes the tilt from the direction of gravity, and the motion
of an inertially fixed element relative to the rotating Earth.

All matrices transform vector components to another frame (v_element = C @ v_site, where the site axes are East-North-Up). R_k(a) is
the rotation of a frame by `a` about its axis k: R_z(a) = [[cos a, sin a, 0], [−sin a, cos a, 0], [0, 0, 1]]. Angles are in rad.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass

UP = np.array([0.0, 0.0, 1.0])
UPRIGHT = 1e-6  # largest difference between 1 and the cosine for which an axis counts as vertical
# For each vertical axis, the axis whose tilt is an arc sine: R_x·R_z·R_y with y up, R_z·R_y·R_x with x up, R_x·R_y·R_z with z up.
_SINE = {"xzy": (1, 2, 1), "zxy": (2, 0, 0)}


def turned(axis: int, angle: Array | float) -> Array:
    """Returns the rotation matrix R_axis(angle), shape (3, 3). For angles of shape (n,), returns an array of shape (n, 3, 3)."""
    angle = np.asarray(angle, dtype=float)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[..., axis, axis] = 1.0
    matrix[..., first, first] = matrix[..., second, second] = np.cos(angle)
    matrix[..., first, second] = np.sin(angle)
    matrix[..., second, first] = -np.sin(angle)
    return matrix


def earth_turn(earth: Array, seconds: Array) -> Array:
    """Returns the matrices R(Ω_ie·t) for the times t [s], shape (n,). The result has the shape (…, n, 3, 3). The matrices transform
    site components at time t to site components at time zero.

    `earth`: array of shape (…, 3) in rad/s, Earth rate in site axes. C(0)·R(Ω_ie·t) is the attitude of an element that is fixed in
    inertial space.
    """
    rate = np.linalg.norm(earth, axis=-1)[..., None]
    a, b, c = np.moveaxis(earth / rate, -1, 0)
    zero = np.zeros_like(a)
    cross = np.stack([zero, -c, b, c, zero, -a, -b, a, zero], axis=-1).reshape(*a.shape, 1, 3, 3)
    angle = (rate * np.asarray(seconds, dtype=float))[..., None, None]
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross))


def rotation_vector(between: Array) -> Array:
    """Computes the rotation vector θ for which exp(−[θ×]) equals `between`. Matrices of shape (…, 3, 3) give vectors of shape (…,
    3). The formula is valid for frame rotations that are clearly smaller than 180°."""
    m = between
    vector = 0.5 * np.stack(
        [m[..., 1, 2] - m[..., 2, 1], m[..., 2, 0] - m[..., 0, 2], m[..., 0, 1] - m[..., 1, 0]], axis=-1
    )
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    cosine = 0.5 * (np.trace(m, axis1=-2, axis2=-1)[..., None] - 1)
    angle = np.arctan2(sine, cosine)
    return np.asarray(vector * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0))


def turned_by(vector: Array) -> Array:
    """Computes the frame rotation exp(−[θ×]) for a rotation vector θ. Vectors of shape (…, 3) give matrices of shape (…, 3, 3). The
    function is the inverse of `rotation_vector`."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    small = np.maximum(angle, 1e-12)
    return np.asarray(np.eye(3) - np.sin(small) / small * cross + (1 - np.cos(small)) / small**2 * (cross @ cross))


def encoder_attitude(
    rings: Sequence[Array],
    directions: Sequence[Sequence[float]],
    azimuth: float,
    gimbals: Sequence[Array],
    axes: Sequence[int],
) -> Array:
    """Computes the attitude of the element from ring and gimbal angles. Returns an array of shape (n, 3, 3).

    `rings`, `gimbals`: sequences of angles, (n,) each, the outermost ring or gimbal first. `directions`: the direction that the
    axis of each ring has while all rings are at zero, before the table's `azimuth` is applied. `axes`: for each gimbal, the axis
    about which it turns, given as an axis of the part that carries this gimbal.
    """
    found = np.broadcast_to(turned(2, -azimuth), (len(rings[0]), 3, 3))
    for angle, direction in zip(rings, directions, strict=True):
        found = turned_by(np.asarray(angle)[:, None] * np.asarray(direction, dtype=float)) @ found
    for angle, axis in zip(gimbals, axes, strict=True):
        found = turned(axis, angle) @ found
    return found


@dataclass(frozen=True, slots=True)
class LevelState:
    """Describes a state of the element in which two of its axes are level.

    `nominal`: array of shape (3, 3), the planned attitude C of the element. `vertical`: the vertical axis of the element. `sign`:
    +1 if this axis points up, −1 if it points down. `sine`: the level axis whose tilt is computed by an arc sine; the
    second-to-last rotation is about this axis. `other`: the other level axis; the last rotation is about this axis: C =
    R_other·R_sine·R_vertical·nominal.
    """

    nominal: Array
    vertical: int
    sign: float
    sine: int
    other: int

    @property
    def level(self) -> tuple[int, int]:
        """Returns the two level axes in the order x, y, z."""
        return (self.sine, self.other) if self.sine < self.other else (self.other, self.sine)

    @property
    def hand(self) -> float:
        """Returns +1 if (vertical, sine, other) is a cyclic permutation of x, y, z; otherwise −1."""
        return 1.0 if self.sine == (self.vertical + 1) % 3 else -1.0

    def tilts(self, force: Array, gravity: Array | float) -> Array:
        """Computes the tilts about the level axes, shape (…, 2). The argument is the specific force [m/s^2] in element axes, shape
        (…, 3).

        If y is up: d_z = asin(f_x/g) and d_x = −atan2(f_z, f_y) for C = R_x·R_z·R_y; d_z = atan2(f_x, f_y) and d_x = −asin(f_z/g)
        for C = R_z·R_x·R_y.
        """
        force = self.sign * force
        about_sine = np.arcsin(np.clip(self.hand * force[..., self.other] / gravity, -1.0, 1.0))
        about_other = np.arctan2(-self.hand * force[..., self.sine], force[..., self.vertical])
        pair = (about_sine, about_other) if self.sine < self.other else (about_other, about_sine)
        return np.stack(pair, axis=-1)

    def attitude(self, tilts: Array, heading: Array | float) -> Array:
        """Computes the attitude C from tilts about the level axes, shape (…, 2), and a rotation `heading` about the vertical axis,
        shape (…). Returns an array of shape (…, 3, 3)."""
        about = dict(zip(self.level, np.moveaxis(tilts, -1, 0), strict=True))
        turns = (
            turned(self.other, about[self.other]) @ turned(self.sine, about[self.sine]) @ turned(self.vertical, heading)
        )
        return np.asarray(turns @ self.nominal)

    def heading(self, attitude: Array) -> Array:
        """Returns the rotation (…) about the vertical axis that is part of the attitude (…, 3, 3)."""
        turns = attitude @ self.nominal.T
        return np.arctan2(-self.hand * turns[..., self.other, self.sine], turns[..., self.other, self.other])


def level_state(nominal: Array, order: str) -> LevelState | None:
    """Returns the level state of a planned attitude; None if no axis is vertical. `order`: order of the rotations if y is up, `xzy`
    or `zxy`."""
    cosines = nominal @ UP
    vertical = int(np.argmax(np.abs(cosines)))
    if abs(cosines[vertical]) < 1 - UPRIGHT:
        return None
    sine = _SINE[order][vertical]
    return LevelState(nominal, vertical, float(np.sign(cosines[vertical])), sine, 3 - vertical - sine)

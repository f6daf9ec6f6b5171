"""Computes the motion of the base of a virtual platform: the attitude of the table's inner ring, and the acceleration of parts that
are mounted away from its centre."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.instruments.virtual.world import World

STEP = 2e-3  # s, of the second difference; its error is a tenth of a ppm at 1 Hz


def base_axes(world: World, times: Array) -> Array:
    """Returns the x, y and z axes of the base at `times`, as rows in East-North-Up, shape (n, 3, 3).

    The rings rotate every axis vector one after the other, from the innermost ring outwards. The pointing error of the table is
    applied before the innermost ring.
    """
    joints = list(zip(world.axes, world.course.follow(times), strict=True))
    carried: Array = np.broadcast_to(np.asarray(world.skew, dtype=float)[:, None], (3, times.size, 3))
    for axis, (angle, _) in reversed(joints):
        carried = turn(carried, np.asarray(axis.direction), np.broadcast_to(np.asarray(angle, float), times.shape))
    carried = turn(carried, np.array([0.0, 0.0, 1.0]), np.full(times.size, -world.site.azimuth))
    return np.ascontiguousarray(carried.transpose(1, 0, 2))


def shaking(world: World, times: Array, lever_arm: Sequence[float]) -> Array:
    """Computes the acceleration of a point in East-North-Up [m/s^2], shape (n, 3). The point is at `lever_arm` [m, in axes of the
    base] from the centre of the rings.

    The acceleration is the second difference of the position, so it contains the tangential and the centripetal part.
    """
    if world.course.still(float(times[0])) or not any(lever_arm):
        return np.zeros((times.size, 3))
    arm = np.asarray(lever_arm, dtype=float)
    before, now, after = (np.einsum("nij,i->nj", base_axes(world, times + shift), arm) for shift in (-STEP, 0.0, STEP))
    return np.asarray((before - 2 * now + after) / STEP**2)


def mean_square_rate(world: World, times: Array) -> Array:
    """Returns the square of the base's angular rate at `times` [(rad/s)²], shape (n,)."""
    squares = sum(np.square(part) for part in world.stimulus(times)[0])
    return np.array(np.broadcast_to(np.asarray(squares, dtype=float), times.shape))


def turn(vectors: Array, axis: Array, angles: Array) -> Array:
    """Rotates `vectors` (…, n, 3) actively by `angles` (n,) [rad], right-handed about the unit vector `axis` (3,) or (n, 3).

    Rodrigues' formula is evaluated component by component; for such short vectors, this is several times as fast as `numpy.cross`.
    """
    cosine, sine = np.cos(angles), np.sin(angles)
    (x, y, z), (a, b, c) = np.moveaxis(vectors, -1, 0), np.moveaxis(axis, -1, 0)
    along = (x * a + y * b + z * c) * (1 - cosine)
    turned = np.empty(vectors.shape)
    turned[..., 0] = x * cosine + (b * z - c * y) * sine + a * along
    turned[..., 1] = y * cosine + (c * x - a * z) * sine + b * along
    turned[..., 2] = z * cosine + (a * y - b * x) * sine + c * along
    return turned


def turn_by(vectors: Array, rotation: Array) -> Array:
    """Rotates `vectors` (n, 3) actively by rotation vectors [rad], of shape (n, 3), or (3,) for a common rotation."""
    rotation = np.broadcast_to(rotation, vectors.shape)
    size = np.linalg.norm(rotation, axis=1)
    axis = rotation / np.maximum(size, math.ulp(0.0))[:, None]
    return turn(vectors, np.where(size[:, None] > 0, axis, np.array([0.0, 0.0, 1.0])), size)

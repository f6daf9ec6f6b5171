"""Converts attitudes, which are the directions of the body axes in East-North-Up, between quaternion, matrix, and heading, pitch
and roll.

The x, y, z axes of the body point right, forward and up. If heading, pitch and roll are zero, these axes point east, north and up.
Heading is the angle of the y axis from true north, clockwise as seen from above. Pitch is the angle of the y axis above the
horizon. Roll is the rotation about the y axis, positive if the x axis is below the horizon. The scalar of a quaternion is its first
element. A quaternion transforms vectors from body axes to navigation axes.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array


def matrix(quaternion: Array) -> Array:
    """Converts quaternions (…, 4) to matrices (…, 3, 3) whose columns are the body axes in East-North-Up."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion(rotation: Array) -> Array:
    """Converts a rotation matrix (3, 3) to a quaternion (4,), scalar first. The largest component is computed first (Shepperd, J.
    Guidance and Control 1, 1978)."""
    r, trace = rotation, float(np.trace(rotation))
    squares = np.array([trace, r[0, 0], r[1, 1], r[2, 2]])
    k = int(np.argmax(squares))
    if k == 0:
        found = np.array([1 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    else:
        i, j, m = ((0, 1, 2), (1, 2, 0), (2, 0, 1))[k - 1]
        found = np.empty(4)
        found[0] = r[m, j] - r[j, m]
        found[1 + i] = 1 + 2 * r[i, i] - trace
        found[1 + j] = r[j, i] + r[i, j]
        found[1 + m] = r[m, i] + r[i, m]
    return np.asarray(found / np.linalg.norm(found))


def small_rotation(vector: Array) -> Array:
    """Converts a rotation vector (3,) [rad] to a rotation matrix (3, 3) by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    skew = np.array([[0, -vector[2], vector[1]], [vector[2], 0, -vector[0]], [-vector[1], vector[0], 0]])
    if angle == 0:
        return np.eye(3)
    return np.asarray(np.eye(3) + math.sin(angle) / angle * skew + 2 * (math.sin(angle / 2) / angle) ** 2 * skew @ skew)


def turned_about_up(before: Array, after: Array) -> Array:
    """Returns the angle [rad] of the right-handed rotation about the vertical that leads from one attitude to another. Both
    attitudes have the shape (…, 3, 3)."""
    change = after @ np.swapaxes(before, -1, -2)
    return np.asarray(np.arctan2(change[..., 1, 0] - change[..., 0, 1], change[..., 0, 0] + change[..., 1, 1]))


def angles(rotation: Array) -> Array:
    """Returns heading (0 … 2π), pitch and roll of an attitude [rad], shape (3,)."""
    heading = math.atan2(rotation[0, 1], rotation[1, 1]) % (2 * math.pi)
    pitch = math.atan2(rotation[2, 1], math.hypot(rotation[2, 0], rotation[2, 2]))
    roll = math.atan2(-rotation[2, 0], rotation[2, 2])
    return np.array([heading, pitch, roll])


def angle_sensitivities(rotation: Array) -> Array:
    """Returns the derivatives ∂(heading, pitch, roll)/∂φ, shape (3, 3). φ [rad] is a small rotation of an attitude C in navigation
    axes: C → (1 + φ×)·C."""
    step = 1e-6
    columns = []
    for axis in range(3):
        vector = np.zeros(3)
        vector[axis] = step
        change = angles(small_rotation(vector) @ rotation) - angles(small_rotation(-vector) @ rotation)
        columns.append((np.remainder(change + math.pi, 2 * math.pi) - math.pi) / (2 * step))
    return np.column_stack(columns)

"""Predicts the navigation errors that declared constant sensor errors cause on a turning table. There are two predictions: the
first uses the linear error equations, and the second uses harmonics.

An alignment at rest cannot observe some sensor errors. The alignment adjusts tilt and azimuth so that they compensate these errors
(`ErrorEquations.levelled`). While the sensor stays at rest, the errors therefore mostly cancel. An alignment during a cycle
compensates only the residual of the cycle. After the alignment, the errors of gyros and accelerometers rotate with the table. These
errors are the input of the equations.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.estimators.modulation.fit import largest
from planrunner.navigation.error_equations import INPUTS, SIZE, TILT, ErrorEquations
from planrunner.physics.earth import Site
from planrunner.physics.modulation import forced_velocity
from planrunner.physics.rotation_cycle import RotationCycle

STEP = 20.0  # s, step of the equations, over which their inputs are averaged
_FINE = 40  # angles in each step


def errors_over_time(
    errors: Array,
    attitude: Array,
    cycle: RotationCycle | None,
    aligned: RotationCycle | None,
    seconds: float,
    site: Site,
) -> tuple[Array, Array]:
    """Computes the position error over time. Returns the times [s], shape (n,), and the errors to the east and to the north [m],
    shape (n, 2).

    `errors`: array of shape (6,), constant errors of gyros [rad/s] and accelerometers [m/s²] along x, y, z. `attitude`: array of
    shape (3, 3), whose rows are the sensor's axes in East-North-Up at the first position. `cycle`: rotation cycle during
    navigation, None at rest. `aligned`: rotation cycle during the alignment, None at rest. `seconds`: duration of the navigation,
    s.
    """
    equations = ErrorEquations.at(site)
    level = attitude.T @ errors.reshape(2, 3).T  # columns: gyros, accelerometers, in East-North-Up
    count = max(1, round(seconds / STEP))
    mean = np.ones(count, dtype=complex)
    if cycle is not None:
        angle = cycle.angle((np.arange(count * _FINE) + 0.5) * STEP / _FINE)
        mean = np.exp(1j * angle).reshape(count, _FINE).mean(axis=1)
    driven = np.empty((count, INPUTS, 1))
    for column, first in ((0, 0), (1, 3)):
        turned = (level[0, column] + 1j * level[1, column]) * mean
        driven[:, first, 0], driven[:, first + 1, 0], driven[:, first + 2, 0] = (
            turned.real,
            turned.imag,
            level[2, column],
        )
    start = np.zeros((SIZE, 1))
    seen = level.copy()
    if aligned is not None:
        left = (level[0] + 1j * level[1]) * aligned.residual / aligned.period
        seen[0], seen[1] = left.real, left.imag
    start[TILT] = equations.levelled() @ np.concatenate([seen[:, 0], seen[:, 1]])[:, None]
    found = equations.responses(start, driven, STEP)
    return np.arange(1, count + 1) * np.float64(STEP), found[:, :2, 0]


def horizontal(errors: Array, attitude: Array) -> Array:
    """Returns the constant errors (6,) without their vertical part, which a rotation about the vertical does not modulate.
    `errors`, `attitude`: the same as in `errors_over_time`."""
    up = attitude[:, 2]
    across: Array = errors - np.concatenate([up * (part @ up) for part in (errors[:3], errors[3:])])
    return across


def periodic_amplitudes(
    errors: Array, attitude: Array, cycle: RotationCycle, orders: NDArray[np.int_], site: Site
) -> tuple[float, float]:
    """Returns the amplitudes of those parts of the velocity error [m/s] and of the position error [m] that repeat with the cycle.
    The amplitudes are computed from the harmonics `orders` of the cycle. `errors`, `attitude`: the same as in
    `errors_over_time`."""
    level = attitude.T @ errors.reshape(2, 3).T
    gyro, accelerometer = (complex(level[0, column], level[1, column]) for column in (0, 1))
    forced = {
        order: forced_velocity(cycle, gyro, accelerometer, site, order)
        for order in sorted(set(np.abs(orders).tolist()))
    }
    parts = np.array([forced[abs(order)][0 if order > 0 else 1] for order in orders.tolist()])
    positions = parts * cycle.period / (2j * math.pi * orders)
    return largest(orders, parts), largest(orders, positions)

"""Navigation of an inertial unit on a table with a vertical axis: what constant errors of its sensors make of it, integrated here.

The navigator's equations stand here in the frame of the table, in which a unit that is turned about the vertical shows its constant errors
rotated. Alignment is the one that the unit would find in a very long time: up is where the accelerometers point, east is level and across
the Earth's rate. Height is held. Units are SI with radians.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tests.worlds.felt import EARTH, GRAVITY, LATITUDE

Array = NDArray[np.float64]

_RATE = np.radians(EARTH) / 3600
_A, _E2 = 6378137.0, 6.69437999014e-3  # WGS 84
NAUTICAL_MILE = 1852.0


def radii(latitude: float) -> tuple[float, float]:
    """Of curvature in the meridian and in the prime vertical, m."""
    w = 1 - _E2 * np.sin(latitude) ** 2
    return float(_A * (1 - _E2) / w**1.5), float(_A / np.sqrt(w))


def aligned(gyro: Array, accel: Array) -> Array:
    """Columns are the table's axes, east, north and up of a level table, as a unit with these errors (3,), rad/s and m/s², takes them."""
    at = np.radians(LATITUDE)
    rate = _RATE * np.array([0.0, np.cos(at), np.sin(at)]) + gyro
    up = accel + np.array([0.0, 0.0, GRAVITY])
    up = up / np.linalg.norm(up)
    east = np.cross(rate, up)
    east = east / np.linalg.norm(east)
    return np.stack([east, np.cross(up, east), up])


def navigated(gyro: Array, accel: Array, angle: Callable[[Array], Array], seconds: float, step: float) -> Array:
    """Errors of a navigation at multiples of `step` [s]: time [s], east, north [m], east and north velocity [m/s], (5, n).

    gyro: (3,), rad/s; accel: (3,), m/s², in the unit's axes, which are the table's at the angle zero. angle: of the table about up, rad, at
    some times. Runge and Kutta's fourth order with the mean errors of each step.
    """
    site = np.radians(LATITUDE)
    steps = round(seconds / step)
    inner = (np.arange(steps * 20) + 0.5) * step / 20
    turned = angle(inner).reshape(steps, 20)
    cosine, sine = np.cos(turned).mean(axis=1), np.sin(turned).mean(axis=1)
    earth = _RATE * np.array([0.0, np.cos(site), np.sin(site)])

    def slope(state: Array, rate: Array, force: Array) -> Array:
        c, (ve, vn), latitude = state[:9].reshape(3, 3), state[9:11], state[11]
        m, n = radii(latitude)
        omega = _RATE * np.array([0.0, np.cos(latitude), np.sin(latitude)])
        carried = np.array([-vn / m, ve / n, ve * np.tan(latitude) / n])
        w = rate - c.T @ (omega + carried)
        across = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        turning = 2 * omega + carried
        f = c @ force
        return np.concatenate(
            [
                (c @ across).ravel(),
                [f[0] + turning[2] * vn, f[1] - turning[2] * ve, vn / m, ve / (n * np.cos(latitude))],
            ]
        )

    state = np.concatenate([aligned(gyro, accel).ravel(), [0.0, 0.0, site, 0.0]])
    found = np.zeros((5, steps + 1))
    m, n = radii(site)
    for k in range(steps):
        turn = np.array([[cosine[k], -sine[k], 0], [sine[k], cosine[k], 0], [0, 0, 1]])
        rate, force = earth + turn @ gyro, turn @ accel + np.array([0.0, 0.0, GRAVITY])
        a = slope(state, rate, force)
        b = slope(state + step / 2 * a, rate, force)
        c = slope(state + step / 2 * b, rate, force)
        d = slope(state + step * c, rate, force)
        state = state + step / 6 * (a + 2 * b + 2 * c + d)
        east, north = state[12] * n * np.cos(site), (state[11] - site) * m
        found[:, k + 1] = [(k + 1) * step, east, north, state[9], state[10]]
    return found


def figures(course: Array) -> dict[str, float]:
    """What a report gives of such errors."""
    time, radial, speed = course[0], np.hypot(course[1], course[2]), np.hypot(course[3], course[4])
    return {
        "east_error": float(course[1, -1]),
        "north_error": float(course[2, -1]),
        "east_velocity_error": float(course[3, -1]),
        "north_velocity_error": float(course[4, -1]),
        "radial_error": float(radial[-1]),
        "largest_radial_error": float(radial.max()),
        "rms_radial_error": float(np.sqrt(np.mean(radial[1:] ** 2))),
        "largest_velocity_error": float(speed.max()),
        "rms_velocity_error": float(np.sqrt(np.mean(speed[1:] ** 2))),
        "radial_error_rate": float(time @ radial / (time @ time) * 3600 / NAUTICAL_MILE),
    }

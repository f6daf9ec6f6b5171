"""Navigation of an inertial unit on a table with a vertical axis: what constant errors of its sensors make of it, integrated here.

The navigator's equations stand here in the frame of the table, in which a unit that is turned about the vertical shows its constant errors
rotated. Alignment is the one that the unit would find in a very long time: up is where the accelerometers point, east is level and across
the Earth's rate. Height is held. Units are SI with radians.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.worlds.felt import EARTH, GRAVITY, LATITUDE

Array = NDArray[np.float64]

_RATE = np.radians(EARTH) / 3600
_A, _E2 = 6378137.0, 6.69437999014e-3  # WGS 84
NAUTICAL_MILE = 1852.0


@njit(cache=True)
def radii(latitude: float) -> tuple[float, float]:
    """Of curvature in the meridian and in the prime vertical, m."""
    w = 1 - _E2 * np.sin(latitude) ** 2
    return _A * (1 - _E2) / w**1.5, _A / np.sqrt(w)


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
    state = np.concatenate([aligned(gyro, accel).ravel(), [0.0, 0.0, site, 0.0]])
    found = _integrated(state, gyro, accel, cosine, sine, step)
    m, n = radii(site)
    east, north = found[3] * n * np.cos(site), (found[2] - site) * m
    return np.stack([step * np.arange(steps + 1), east, north, found[0], found[1]])


@njit(cache=True)
def _integrated(state: Array, gyro: Array, accel: Array, cosine: Array, sine: Array, step: float) -> Array:
    """East and north velocity, latitude and longitude at multiples of `step`, (4, n). state: (13,), attitude by rows and these four;
    cosine, sine: (n − 1,), of the table's angle, their means over each step."""
    site = state[11]
    found = np.empty((4, len(cosine) + 1))
    found[:, 0] = state[9:]
    for k in range(len(cosine)):
        turn = np.array([[cosine[k], -sine[k], 0.0], [sine[k], cosine[k], 0.0], [0.0, 0.0, 1.0]])
        rate = _RATE * np.array([0.0, np.cos(site), np.sin(site)]) + turn @ gyro
        force = turn @ accel + np.array([0.0, 0.0, GRAVITY])
        a = _slope(state, rate, force)
        b = _slope(state + step / 2 * a, rate, force)
        c = _slope(state + step / 2 * b, rate, force)
        d = _slope(state + step * c, rate, force)
        state = state + step / 6 * (a + 2 * b + 2 * c + d)
        found[:, k + 1] = state[9:]
    return found


@njit(cache=True)
def _slope(state: Array, rate: Array, force: Array) -> Array:
    c, latitude, ve, vn = state[:9].copy().reshape(3, 3), state[11], state[9], state[10]
    m, n = radii(latitude)
    omega = _RATE * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    carried = np.array([-vn / m, ve / n, ve * np.tan(latitude) / n])
    w = rate - c.T @ (omega + carried)
    across = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    turning = 2 * omega + carried
    f = c @ force
    out = np.empty(13)
    out[:9] = (c @ across).ravel()
    out[9:] = f[0] + turning[2] * vn, f[1] - turning[2] * ve, vn / m, ve / (n * np.cos(latitude))
    return out


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

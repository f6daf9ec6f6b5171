"""Increments of a unit at rest with constant errors, made without anything from the navigation layer, and runs over them."""

from __future__ import annotations

from typing import Any

import numpy as np

from planrunner.navigation import attitude
from planrunner.navigation.mechanisation import Navigator

Array = np.ndarray

EARTH_RATE = 7.292115e-5  # rad/s
DEG_H = np.pi / 180 / 3600  # rad/s
MICRO_G = 9.80665e-6  # m/s^2


def turn(axis: str, degrees: float) -> Array:
    """Body axes as columns in East-North-Up after a right-handed turn about one of them."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def at_rest(
    latitude: float,
    gravity: float,
    rotation: Array,
    dt: float,
    gyro: Array | tuple[float, ...] = (0.0, 0.0, 0.0),
    accelerometer: Array | tuple[float, ...] = (0.0, 0.0, 0.0),
    rate: float = EARTH_RATE,
) -> Array:
    """One sample's increments (6,): at rest they are the same for every sample. Errors in body axes, rad/s and m/s²."""
    earth = rate * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    omega = rotation.T @ earth + np.asarray(gyro)
    force = rotation.T @ np.array([0.0, 0.0, gravity]) + np.asarray(accelerometer)
    return np.concatenate([omega, force]) * dt


def navigator(latitude: float, rotation: Array, **options: Any) -> Navigator:
    given = {"earth_rate": EARTH_RATE, **options}
    return Navigator(attitude.quaternion(rotation), np.zeros(3), (latitude, 0.0, 0.0), **given)


def stand(unit: Navigator, sample: Array, dt: float, seconds: float) -> tuple[Array, Array]:
    """Errors of a unit that stands still: times (m,) of the knots and east, north position error [m], east, north velocity error, (4, m).
    Blocks are of one hour at most."""
    start = unit.position
    north, east = _radii(start[0])
    total, done, pieces = round(seconds / dt), 0, []
    while done < total:
        count = min(total - done, round(3600 / dt))
        knots = unit.advance(np.repeat(sample[:, None], count, axis=1), np.full(count, dt))
        pieces.append(
            np.vstack(
                [
                    (knots.longitude - start[1]) * east * np.cos(start[0]),
                    (knots.latitude - start[0]) * north,
                    knots.velocity[:, 0],
                    knots.velocity[:, 1],
                ]
            )
        )
        done += count
    found = np.hstack(pieces)
    return unit.every * dt * np.arange(1, found.shape[1] + 1), found


def _radii(latitude: float) -> tuple[float, float]:
    """Radii of WGS-84 from its axes: b²a²/(a²cos² + b²sin²)^(3/2) and a²/sqrt(a²cos² + b²sin²)."""
    a, b = 6378137.0, 6356752.314245
    w = (a * np.cos(latitude)) ** 2 + (b * np.sin(latitude)) ** 2
    return (a * b) ** 2 / w**1.5, a**2 / np.sqrt(w)

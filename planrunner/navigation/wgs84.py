"""Computes the radii of curvature and the normal gravity of the ellipsoid WGS-84.

Constants and formulas follow NGA.STND.0036 (World Geodetic System 1984, version 1.0.0, 2014), sections 3.4 and 4.2. Gravity above
the ellipsoid is computed from the second-order series of that document, in the direction of the normal of the ellipsoid. The
component of gravity perpendicular to this normal, at most 8·10⁻⁹ m/s² for each metre of height, is neglected.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from planrunner.base.arrays import Array

SEMI_MAJOR_AXIS = 6378137.0  # m
FLATTENING = 1 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)
GRAVITY_AT_EQUATOR = 9.7803253359  # m/s^2
GRAVITY_AT_POLE = 9.8321849379  # m/s^2
SOMIGLIANA = (1 - FLATTENING) * GRAVITY_AT_POLE / GRAVITY_AT_EQUATOR - 1
ROTATION_RATIO = 0.00344978650684  # ω²·a²·b/GM


def radii(latitude: ArrayLike) -> tuple[Array, Array]:
    """Returns the radii of curvature [m] at a latitude [rad]: in the meridian (for motion to the north) and in the prime vertical
    (for motion to the east)."""
    w = 1 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2
    prime_vertical = SEMI_MAJOR_AXIS / np.sqrt(w)
    return np.asarray(prime_vertical * (1 - ECCENTRICITY_SQUARED) / w), np.asarray(prime_vertical)


def normal_gravity(latitude: ArrayLike, height: ArrayLike = 0.0) -> Array:
    """Returns normal gravity [m/s^2] at a latitude [rad] and a height above the ellipsoid [m], positive downwards."""
    s = np.sin(latitude) ** 2
    h = np.asarray(height, dtype=float) / SEMI_MAJOR_AXIS
    surface = GRAVITY_AT_EQUATOR * (1 + SOMIGLIANA * s) / np.sqrt(1 - ECCENTRICITY_SQUARED * s)
    return np.asarray(surface * (1 - 2 * (1 + FLATTENING + ROTATION_RATIO - 2 * FLATTENING * s) * h + 3 * h * h))


def separation(
    latitude: ArrayLike, longitude: ArrayLike, to_latitude: ArrayLike, to_longitude: ArrayLike, height: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """Returns the distances [m] to the east and to the north from positions [rad] to other positions [rad] at the same height [m].
    The distances are arcs of the parallel and of the meridian at the middle latitude, and are correct to third order."""
    middle = (np.asarray(latitude) + np.asarray(to_latitude)) / 2
    north, east = radii(middle)
    turn = np.remainder(np.asarray(to_longitude) - np.asarray(longitude) + np.pi, 2 * np.pi) - np.pi
    return (
        np.asarray((east + np.asarray(height)) * np.cos(middle) * turn),
        np.asarray((north + np.asarray(height)) * (np.asarray(to_latitude) - np.asarray(latitude))),
    )

"""The Earth under a simulated carrier: the WGS 84 ellipsoid and its normal gravity (NIMA TR8350.2, 2000).

The length of the meridian follows from Helmert's series in the third flattening n; the omitted terms are of the order n⁵, 0.4 µm.
Only the simulator uses these formulas. Navigation has its own formulas, and tests compare the two.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Latitude = Any  # float or Array, rad

SEMI_MAJOR = 6378137.0  # m
FLATTENING = 1 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)
MEAN_RADIUS = 6371008.7714  # m, (2a + b)/3
_GRAVITY_EQUATOR, _GRAVITY_POLE = 9.7803253359, 9.8321849378  # m/s^2
_SOMIGLIANA = (1 - FLATTENING) * _GRAVITY_POLE / _GRAVITY_EQUATOR - 1
_CENTRIFUGAL = 0.00344978650684  # ω²a²b/GM

_N = FLATTENING / (2 - FLATTENING)
_ARC = SEMI_MAJOR / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64)  # m/rad of rectifying latitude
_FORWARD = (-3 / 2 * _N + 9 / 16 * _N**3, 15 / 16 * _N**2 - 15 / 32 * _N**4, -35 / 48 * _N**3, 315 / 512 * _N**4)
_INVERSE = (
    3 / 2 * _N - 27 / 32 * _N**3,
    21 / 16 * _N**2 - 55 / 32 * _N**4,
    151 / 96 * _N**3,
    1097 / 512 * _N**4,
)


def meridian_radius(latitude: Latitude) -> Any:
    """Returns the radius of curvature M [m] in the meridian."""
    return SEMI_MAJOR * (1 - ECCENTRICITY_SQUARED) / (1 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2) ** 1.5


def meridian_radius_slope(latitude: Latitude) -> Any:
    """Returns the derivative dM/dφ [m/rad] of the radius of curvature in the meridian."""
    sine = np.sin(latitude)
    slope = 3 * ECCENTRICITY_SQUARED * sine * np.cos(latitude) / (1 - ECCENTRICITY_SQUARED * sine**2)
    return meridian_radius(latitude) * slope


def normal_radius(latitude: Latitude) -> Any:
    """Returns the radius of curvature N [m] in the prime vertical."""
    return SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)


def meridian_arc(latitude: Latitude) -> Any:
    """Returns the length [m] of the meridian from the equator to a latitude."""
    return _ARC * (latitude + sum(c * np.sin(2 * k * latitude) for k, c in enumerate(_FORWARD, start=1)))


def latitude_at_arc(arc: Any) -> Any:
    """Returns the latitude [rad] at the distance `arc` [m] from the equator along the meridian."""
    rectifying = arc / _ARC
    return rectifying + sum(c * np.sin(2 * k * rectifying) for k, c in enumerate(_INVERSE, start=1))


def isometric_latitude(latitude: Latitude) -> Any:
    """Returns the isometric latitude ψ, for which dψ = M/(N·cos φ)·dφ. Along a line of constant heading χ, the longitude increases
    by tan χ·dψ."""
    eccentricity = np.sqrt(ECCENTRICITY_SQUARED)
    sine = np.sin(latitude)
    return np.arctanh(sine) - eccentricity * np.arctanh(eccentricity * sine)


def normal_gravity(latitude: Latitude, height: float) -> Any:
    """Returns the normal gravity [m/s^2] at `height` [m] above the ellipsoid, by Somigliana's formula and TR8350.2 (4-3). The
    normal gravity is the component along the normal of the ellipsoid. The component towards north, 8·10⁻⁹ m/s² per metre of height,
    is neglected."""
    squared = np.sin(latitude) ** 2
    surface = _GRAVITY_EQUATOR * (1 + _SOMIGLIANA * squared) / np.sqrt(1 - ECCENTRICITY_SQUARED * squared)
    first = 1 + FLATTENING + _CENTRIFUGAL - 2 * FLATTENING * squared
    return surface * (1 - 2 * first * height / SEMI_MAJOR + 3 * (height / SEMI_MAJOR) ** 2)

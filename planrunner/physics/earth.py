"""The Earth as a test site feels it: rotation and gravity in East-North-Up axes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass

EARTH_RATE = math.radians(15.041067) / 3600  # rad/s, sidereal rotation 15.041067 deg/h


@dataclass(frozen=True, slots=True)
class Site:
    """Site of the bench. latitude, azimuth: rad; gravity: m/s^2.

    latitude: astronomic, of the plumb line: at rest an accelerometer shows the plumb line, so the angle between the Earth's axis and what
    stands level follows from it. geodetic_latitude: rad, of the ellipsoid, for positions; None where it is taken for the same. They differ
    by the deviation of the vertical (Torge and Müller, Geodesy, 4th ed., 6.1).
    longitude: rad, east positive; height: m above the ellipsoid; both only matter where positions are navigated.
    azimuth: of the table's reference direction, from true north, positive clockwise seen from above (towards east). Orientation
    words in plans mean true directions; the table's joint angles take the azimuth into account.
    magnetic_field: of the Earth, in true East-North-Up, in whatever unit the bench names; None where it is not known.
    """

    latitude: float
    gravity: float = 9.80665
    azimuth: float = 0.0
    earth_rate: float = EARTH_RATE
    longitude: float = 0.0
    height: float = 0.0
    magnetic_field: tuple[float, float, float] | None = None
    geodetic_latitude: float | None = None

    @property
    def on_ellipsoid(self) -> Site:
        """The site with the geodetic latitude as its latitude, for navigation on the ellipsoid."""
        return self if self.geodetic_latitude is None else replace(self, latitude=self.geodetic_latitude)

    @property
    def earth_rate_enu(self) -> NDArray[np.float64]:
        """Earth rotation in ENU, shape (3,), rad/s."""
        return self.earth_rate * np.array([0.0, math.cos(self.latitude), math.sin(self.latitude)])

    @property
    def specific_force_enu(self) -> NDArray[np.float64]:
        """Specific force at rest in ENU, shape (3,), m/s^2: an axis pointing up reads +g."""
        return np.array([0.0, 0.0, self.gravity])

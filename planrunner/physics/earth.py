"""The Earth at a test site: rotation and gravity in East-North-Up axes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.plan.units import STANDARD_GRAVITY

EARTH_RATE = math.radians(15.041067) / 3600  # rad/s, sidereal rotation 15.041067 deg/h


@dataclass(frozen=True, slots=True)
class Site:
    """Site of the bench. latitude, azimuth: rad; gravity: m/s^2.

    latitude: astronomic, defined by the plumb line. An accelerometer at rest measures along the plumb line, so this latitude gives
    the angle between the Earth's axis and a level surface. geodetic_latitude: rad, on the ellipsoid, for positions; None if both
    latitudes are treated as equal. The two latitudes differ by the deviation of the vertical (Torge and Müller, Geodesy, 4th ed.,
    6.1). longitude: rad, east positive; height: m above the ellipsoid. Longitude and height are used only if positions are
    navigated. azimuth: from true north to the table's reference direction, positive clockwise seen from above (towards east).
    Orientation words in plans mean true directions; the joint angles of the table allow for the azimuth. magnetic_field: the
    Earth's field in true East-North-Up, in the unit that the bench names; None if it is not known.
    """

    latitude: float
    gravity: float = STANDARD_GRAVITY
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

"""Describes the Earth at a test site: its rotation and gravity in East-North-Up axes."""

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
    """The site of a bench.

    `latitude`: astronomic latitude, rad, which the plumb line defines. An accelerometer at rest measures along the plumb line, so
    this latitude determines the angle between the Earth's axis and a level surface. `gravity`: magnitude of gravity, m/s^2.
    `azimuth`: angle from true north to the reference direction of the table, rad, positive clockwise as seen from above (towards
    east). Words for orientations in plans mean true directions; the azimuth is taken into account in the joint angles of the table.
    `geodetic_latitude`: latitude on the ellipsoid, rad, used for positions; None if the two latitudes are treated as equal. The
    difference between the two latitudes is the deviation of the vertical (Torge and Müller, Geodesy, 4th ed., 6.1). `longitude`:
    longitude, rad, positive to the east. `height`: height above the ellipsoid, m. Longitude and height are used only for
    navigation. `earth_rate`: rotation rate of the Earth, rad/s. `magnetic_field`: the Earth's magnetic field in true East-North-Up,
    in the unit that the bench file states; None if unknown.
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
        """Returns a copy whose latitude is the geodetic latitude, for navigation on the ellipsoid."""
        return self if self.geodetic_latitude is None else replace(self, latitude=self.geodetic_latitude)

    @property
    def earth_rate_enu(self) -> NDArray[np.float64]:
        """Returns the Earth's rotation rate (3,) in East-North-Up, rad/s."""
        return self.earth_rate * np.array([0.0, math.cos(self.latitude), math.sin(self.latitude)])

    @property
    def specific_force_enu(self) -> NDArray[np.float64]:
        """Returns the specific force at rest in East-North-Up, m/s^2, shape (3,); an accelerometer axis that points up reads +g."""
        return np.array([0.0, 0.0, self.gravity])

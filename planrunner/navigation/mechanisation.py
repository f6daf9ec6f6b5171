"""Defines a strapdown navigator: its state, and the update of this state with blocks of increments. The arithmetic is in the module
`kernel`."""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.navigation import attitude
from planrunner.navigation.wgs84 import SEMI_MAJOR_AXIS, normal_gravity
from planrunner.physics.earth import Site

LOOP_TIME = 100.0  # s; time constant of the damped vertical channel


@dataclass(frozen=True, slots=True)
class Knots:
    """Contains the output of the navigator at m times (knots).

    `attitude`: array of shape (m, 4), quaternions. `velocity`: array of shape (m, 3) in m/s, east, north, up. `latitude`,
    `longitude`: arrays of shape (m,) in rad. `height`: array of shape (m,) in m.
    """

    attitude: Array
    velocity: Array
    latitude: Array
    longitude: Array
    height: Array


def loop_gains() -> Array:
    """Returns the gains of the third-order vertical loop that place all three poles at 1/`LOOP_TIME` (Widnall and Sinha, J.
    Guidance and Control 3, 1980). The term 2·g/R compensates for the instability of the free channel."""
    g = float(normal_gravity(0.0))
    return np.array([3 / LOOP_TIME, 3 / LOOP_TIME**2 + 2 * g / SEMI_MAJOR_AXIS, 1 / LOOP_TIME**3])


class Navigator:
    """Computes attitude, velocity and position by integrating increments. The memory that is needed and the result do not depend on
    the size of the blocks."""

    def __init__(
        self,
        quaternion: Array,
        velocity: Array,
        position: tuple[float, float, float],
        *,
        vertical: str = "held",
        gravity_factor: float = 1.0,
        earth_rate: float = Site(0.0).earth_rate,
        every: int = 1,
        last: Array | None = None,
    ):
        """`quaternion`: array of shape (4,), scalar first, from body axes to East-North-Up. `velocity`: array of shape (3,) in m/s,
        initial velocity east, north and up. `position`: initial latitude and longitude [rad] and height [m]. `vertical`: `held`,
        `damped` or `free`; `held` means that height and vertical velocity keep their values. `gravity_factor`: factor on normal
        gravity. `earth_rate`: rotation rate of the Earth, rad/s. `every`: number of steps between two output points (knots).
        `last`: array of shape (6,), the increments of the interval before the first step, for coning and sculling; None means
        zeros."""
        from planrunner.navigation import kernel

        self._kernel = kernel
        self.state = np.zeros(kernel.STATE)
        self.state[:4] = quaternion
        self.state[kernel.VELOCITY : kernel.VELOCITY + 3] = velocity
        self.state[kernel.LATITUDE : kernel.HEIGHT + 1] = position
        if last is not None:
            self.state[kernel.LAST_ANGLE : kernel.STEPS] = last
        self.every = every
        self._held = vertical == "held"
        self._gains = loop_gains() if vertical == "damped" else np.zeros(3)
        self._earth = np.array([earth_rate, gravity_factor])
        self._height = np.array([position[2]])

    def advance(self, increments: Array, interval: Array, reference_height: Array | None = None) -> Knots:
        """Processes n increments; returns the output points (knots) within them.

        `increments`: array of shape (6, n), increments of angle [rad] about the body axes x, y, z, and of velocity [m/s] along
        these axes. `interval`: array of shape (n,), length of the interval of each increment, s. `reference_height`: array of shape
        (n,) or (1,) in m, used by the damped vertical channel; by default the initial height.
        """
        knots = np.empty((interval.size // self.every + 1, self._kernel.KNOT))
        aiding = self._height if reference_height is None else reference_height
        made = self._kernel.advance(
            self.state,
            np.ascontiguousarray(increments),
            np.ascontiguousarray(interval),
            np.ascontiguousarray(aiding),
            self._earth,
            self._gains,
            self._held,
            self.every,
            knots,
        )
        rows = knots[:made]
        return Knots(rows[:, :4], rows[:, 4:7], rows[:, 7], rows[:, 8], rows[:, 9])

    @property
    def steps(self) -> int:
        return int(self.state[self._kernel.STEPS])

    @property
    def quaternion(self) -> Array:
        return self.state[:4].copy()

    @property
    def rotation(self) -> Array:
        """Returns the body axes as columns in East-North-Up, shape (3, 3)."""
        return attitude.matrix(self.state[:4])

    @property
    def velocity(self) -> Array:
        return self.state[self._kernel.VELOCITY : self._kernel.VELOCITY + 3].copy()

    @property
    def position(self) -> tuple[float, float, float]:
        """Returns latitude [rad], longitude [rad] and height [m]."""
        latitude, longitude, height = self.state[self._kernel.LATITUDE : self._kernel.HEIGHT + 1].tolist()
        return latitude, longitude, height

    @property
    def last(self) -> Array:
        """Returns the most recent increments, (6,)."""
        return self.state[self._kernel.LAST_ANGLE : self._kernel.STEPS].copy()

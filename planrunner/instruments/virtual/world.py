"""Simulates the surroundings of the sensor: attitude of the table, temperatures, and input of the sensor at any time.

The surroundings depend only on the last command and the time since this command, not on the number of queries. A resumed run is
therefore bit-identical to an uninterrupted run. The virtual table and the virtual chamber change this state; the virtual sensor
reads it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, field

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json, JsonObject
from planrunner.instruments.interfaces import Clock, Surroundings
from planrunner.instruments.virtual import courses, thermal
from planrunner.instruments.virtual.added import Added
from planrunner.instruments.virtual.courses import Course, Standing, Stretch, Value
from planrunner.instruments.virtual.track import Track
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis

Components = tuple[Value, Value, Value]
ROOM = 298.15  # K
_SHORT = 1e-3  # s; a lag that is too short to have an effect


@dataclass(slots=True)
class World:
    """The state of the virtual bench.

    `axes`: axes of the table, the outermost first; empty if there is no table. `skew`: array of shape (3, 3), small rotation from
    the platform of the table to the axes of the sensor; it is the pointing error of the table at the commanded orientation.
    `steady_at`: time [s] at which the commanded motion has been reached. `track`: track of the carrier that moves the bench over
    the Earth; None if the bench does not move. `added`: effects that are added to the declared errors of the sensor.
    """

    clock: Clock
    site: Site
    seed: int = 0
    real_time: bool = False
    axes: tuple[TableAxis, ...] = ()
    course: Course = field(default_factory=lambda: Standing(()))
    steady_at: float = 0.0
    skew: Array = field(default_factory=lambda: np.eye(3))
    lags: thermal.Lags = field(default_factory=lambda: thermal.Lags(1.0, _SHORT, _SHORT))
    command: thermal.Command = field(default_factory=lambda: thermal.Command.resting(ROOM))
    track: Track | None = None
    added: Added | None = None

    @classmethod
    def of(cls, surroundings: Surroundings) -> World:
        """Returns the world that all drivers of a bench share; the first call makes it."""
        if isinstance(surroundings.world, World):
            return surroundings.world
        world = cls(surroundings.clock, surroundings.site, surroundings.seed, surroundings.real_time)
        surroundings.world = world
        return world

    def now(self) -> float:
        return self.clock.now()

    # -- motion --------------------------------------------------------------------------------------------------------

    def joints(self, time: float) -> tuple[Array, Array]:
        """Returns the joint angles [rad] and rates [rad/s] at one time as two arrays with one element for each axis."""
        followed = self.course.follow(np.array([time]))
        angles, rates = zip(*followed, strict=True) if followed else ((), ())
        return np.array([float(np.ravel(v)[0]) for v in angles]), np.array([float(np.ravel(v)[0]) for v in rates])

    def stretches(self, begin: float, end: float) -> list[Stretch]:
        """Returns the intervals between two times within which the stimulus of the sensor is smooth."""
        stretches = self.course.stretches(begin, end)
        track = self.track
        return stretches if track is None else [part for item in stretches for part in track.stretches(item)]

    def stimulus(self, times: Array) -> tuple[Components, Components]:
        """Returns the inertial rate [rad/s] and the specific force [m/s^2] along the axes of the sensor at `times`; floats if
        nothing moves.

        Vectors of the site are transformed from axis to axis, beginning with the outermost axis: v ← R(−q)·v. Each joint adds its
        own rate along its axis.
        """
        rate, force = (self._towards_the_table(vector) for vector in self._of_the_bench(times))
        for axis, (angle, turning) in zip(self.axes, self.course.follow(times), strict=True):
            force = _turned(axis.direction, angle, force)
            x, y, z = _turned(axis.direction, angle, rate)
            a, b, c = axis.direction
            rate = (x + a * turning, y + b * turning, z + c * turning)
        return self._skewed(rate), self._skewed(force)

    def _of_the_bench(self, times: Array) -> tuple[Components, Components]:
        """Returns the inertial rate and the specific force of the bench itself, in its East-North-Up axes."""
        if self.track is not None:
            return self.track.felt(times, self.site.earth_rate)
        (a, b, c), (x, y, z) = self.site.earth_rate_enu.tolist(), self.site.specific_force_enu.tolist()
        return (a, b, c), (x, y, z)

    def _towards_the_table(self, v: Components) -> Components:
        return _turned((0.0, 0.0, 1.0), -self.site.azimuth, v)

    def _skewed(self, v: Components) -> Components:
        e = self.skew
        x, y, z = (e[i, 0] * v[0] + e[i, 1] * v[1] + e[i, 2] * v[2] for i in range(3))
        return x, y, z

    # -- position ------------------------------------------------------------------------------------------------------

    def position(self, times: Array) -> tuple[Value, Value, Value, Value, Value]:
        """Returns geodetic latitude and longitude [rad], height [m], and velocity east and north [m/s] at `times`; floats if the
        bench does not move."""
        if self.track is None:
            return self.site.on_ellipsoid.latitude, self.site.longitude, self.site.height, 0.0, 0.0
        place = self.track.place(times)
        return place.latitude, place.longitude, self.track.height, *self.track.velocity(place)

    # -- temperature ---------------------------------------------------------------------------------------------------

    def air(self, times: Array) -> Array:
        """Returns the temperature [K] of the air in the chamber at `times` (n,), s, shape (n,)."""
        return thermal.temperatures(self.command, self.lags, times)[1]

    def sensor(self, times: Array) -> Array:
        """Returns the temperature [K] of the sensor at `times` (n,), s, shape (n,)."""
        return thermal.temperatures(self.command, self.lags, times)[2]

    def head_for(self, kelvin: float) -> None:
        """Starts a change of the setpoint to the temperature `kelvin`."""
        now = self.now()
        setpoint, air, sensor = (float(v[0]) for v in thermal.temperatures(self.command, self.lags, np.array([now])))
        self.command = thermal.Command(now, setpoint, air, sensor, kelvin)

    # -- resuming ------------------------------------------------------------------------------------------------------

    def motion_state(self) -> JsonObject:
        return {"course": courses.to_json(self.course), "steady_at": self.steady_at, "skew": self.skew.tolist()}

    def restore_motion(self, state: Mapping[str, Json]) -> None:
        self.course = courses.from_json(state["course"])
        self.steady_at = float(state["steady_at"])
        self.skew = np.array(state["skew"], dtype=float)

    def thermal_state(self) -> dict[str, float]:
        return asdict(self.command)

    def restore_thermal(self, state: Mapping[str, Json]) -> None:
        self.command = thermal.Command(**{name: float(value) for name, value in state.items()})


def _turned(axis: tuple[float, float, float], angle: Value, v: Components) -> Components:
    """Returns the components of a vector in a frame that is rotated by `angle` about `axis` (Rodrigues' formula with −angle)."""
    if isinstance(angle, float) and angle == 0.0:
        return v
    c, s = (np.cos(angle), np.sin(angle)) if isinstance(angle, np.ndarray) else (math.cos(angle), math.sin(angle))
    a, b, d = axis
    along = (1 - c) * (a * v[0] + b * v[1] + d * v[2])
    return (
        c * v[0] - s * (b * v[2] - d * v[1]) + along * a,
        c * v[1] - s * (d * v[0] - a * v[2]) + along * b,
        c * v[2] - s * (a * v[1] - b * v[0]) + along * d,
    )

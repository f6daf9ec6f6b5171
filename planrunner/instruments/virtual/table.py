"""The virtual position/rate table: one to three axes with limits, a pointing error at every orientation and a rate
error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.instruments.models import TableModel
from planrunner.instruments.table_keys import TableKeys
from planrunner.instruments.virtual import courses
from planrunner.instruments.virtual.world import World
from planrunner.physics.kinematics import (
    TableAxis,
    Unreachable,
    joint_angles,
    joint_directions,
    rotation_about,
    spin_axis,
)
from planrunner.plan.kinds import QuantityOf, key
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.plan.schedule import Cycle, Motion, Rest, Rock, Spin

Array = NDArray[np.float64]


class VirtualTableParameters(TableKeys):
    """A simulated table."""

    position_error: Quantity = key(
        QuantityOf("angle", "not negative"),
        "Standard deviation, about each sensor axis, of the pointing error that is simulated; the same at the same orientation.",
        "2 arcsec",
        parse_quantity("0 arcsec"),
    )
    rate_error: Quantity = key(
        QuantityOf("ratio", "not negative"),
        "Relative standard deviation of the rate error that is simulated; the same at the same rate.",
        "5 ppm",
        parse_quantity("0 ppm"),
    )


class VirtualTable:
    """A simulated table in the virtual world."""

    role = "table"
    Parameters = VirtualTableParameters

    def __init__(self, parameters: VirtualTableParameters, world: World):
        self.parameters = parameters
        self.world = world
        self.axes = self.model(parameters).axes
        world.axes = self.axes
        world.course = courses.Standing((0.0,) * len(self.axes))

    @classmethod
    def model(cls, parameters: VirtualTableParameters) -> TableModel:
        return parameters.model()

    @classmethod
    def connect(cls, parameters: VirtualTableParameters, surroundings: Surroundings) -> VirtualTable:
        return cls(parameters, World.of(surroundings))

    # -- what it does ----------------------------------------------------------------------------------------------

    def orient(self, attitude: Array) -> float:
        now = self.world.now()
        angles, rates = self.world.joints(now)
        if np.any(rates != 0.0):
            raise InstrumentError("the table is still moving; end its motion before a new orientation")
        try:
            target = joint_angles(self.axes, attitude, angles, self.world.site.azimuth)
        except Unreachable as error:
            raise InstrumentError(f"the table cannot take this orientation: {error}") from None
        course = courses.travel(self.axes, now, angles.tolist(), target.tolist())
        self.world.skew = self.pointing_error(attitude)
        return self._set_course(course, course.arrival)

    def holding(self) -> bool:
        # A clock that adds up sleeps may stop short of the time by a rounding.
        return self.world.now() >= self.world.steady_at - 1e-6

    def begin_motion(self, motion: Motion, seconds: float) -> float:
        now = self.world.now()
        angles = tuple(self.world.joints(now)[0].tolist())
        match motion:
            case Rest():
                return 0.0
            case Spin():
                return self._spin(motion, now, angles)
            case Rock():
                return self._rock(motion, now, angles)
            case Cycle():
                self._within("the cycle's turns", motion.rate, None, self.axes[0])
                turns = tuple(move.turn for move in motion.moves)
                joint = 0
                acceleration = self.axes[joint].max_acceleration
                cycling = courses.Cycling(now, angles, joint, turns, motion.rate, acceleration, motion.stop)
                return self._set_course(cycling, now)

    def end_motion(self) -> float:
        now = self.world.now()
        course = self.world.course
        if course.still(now) or isinstance(course, courses.Standing):
            return 0.0
        angles, rates = self.world.joints(now)
        if isinstance(course, courses.Spinning):
            rate = float(rates[course.joint])
            slowing = courses.Spinning(now, tuple(angles.tolist()), course.joint, rate, 0.0, course.acceleration)
            return self._set_course(slowing, slowing.steady)
        if isinstance(course, courses.Rocking):
            home: tuple[float, ...] = course.angles
        else:
            home = tuple(angles.tolist())
        travel = courses.travel(self.axes, now, angles.tolist(), home)
        return self._set_course(travel, travel.arrival)

    def read(self) -> Mapping[str, float]:
        angles = self.world.joints(self.world.now())[0]
        return {f"{axis.name}_deg": math.degrees(angle) for axis, angle in zip(self.axes, angles, strict=True)}

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": "planrunner", "model": f"virtual {len(self.axes)}-axis table"}

    def make_safe(self) -> None:
        self.end_motion()

    def close(self) -> None:
        """Nothing is held open."""

    def checkpoint(self) -> Mapping[str, Any]:
        return self.world.motion_state()

    def restore(self, state: Mapping[str, Any]) -> None:
        self.world.restore_motion(state)

    # -- how it does it --------------------------------------------------------------------------------------------

    def _set_course(self, course: courses.Course, steady_at: float) -> float:
        self.world.course = course
        self.world.steady_at = steady_at
        return max(0.0, steady_at - self.world.now())

    def _spin(self, motion: Spin, now: float, angles: tuple[float, ...]) -> float:
        azimuth = self.world.site.azimuth
        try:
            joint = spin_axis(self.axes, angles, motion.about, azimuth)
        except Unreachable as error:
            raise InstrumentError(f"the table cannot spin about this direction: {error}") from None
        axis = self.axes[joint]
        self._within("the rate", motion.rate, None, axis)
        along = float(joint_directions(self.axes, angles, azimuth)[joint] @ np.asarray(motion.about))
        rate = math.copysign(1.0, along) * motion.rate * (1 + self.rate_error(motion.rate))
        first = self.world.joints(now)[1][joint]
        spinning = courses.Spinning(now, angles, joint, float(first), rate, axis.max_acceleration)
        return self._set_course(spinning, spinning.steady)

    def _rock(self, motion: Rock, now: float, angles: tuple[float, ...]) -> float:
        if len(motion.phases) > len(self.axes):
            raise InstrumentError(f"{len(motion.phases)} rings are to rock, the table has {len(self.axes)}")
        circular = 2 * math.pi * motion.frequency
        for axis, angle, _ in zip(self.axes, angles, motion.phases, strict=False):
            self._within("rocking", motion.amplitude * circular, motion.amplitude * circular**2, axis)
            if not axis.lowest <= angle - motion.amplitude <= angle + motion.amplitude <= axis.highest:
                raise InstrumentError(f"rocking would carry the axis '{axis.name}' beyond its limits")
        record = now + motion.lead_in
        rocking = courses.Rocking(
            record + motion.steady, angles, motion.amplitude, motion.frequency, motion.phases, motion.duration
        )
        return self._set_course(rocking, record)

    def _within(self, what: str, rate: float, acceleration: float | None, axis: TableAxis) -> None:
        if abs(rate) > axis.max_rate * (1 + 1e-9):
            limit = f"{math.degrees(axis.max_rate):g} deg/s"
            message = f"{what} needs {math.degrees(abs(rate)):g} deg/s of the axis '{axis.name}', which reaches {limit}"
            raise InstrumentError(message)
        if acceleration is not None and acceleration > axis.max_acceleration * (1 + 1e-9):
            limit = f"{math.degrees(axis.max_acceleration):g} deg/s^2"
            needed = f"{math.degrees(acceleration):g} deg/s^2"
            raise InstrumentError(f"{what} needs {needed} of the axis '{axis.name}', which reaches {limit}")

    def pointing_error(self, attitude: Array) -> Array:
        """A small rotation that depends on the seed and the commanded attitude alone."""
        size = self.parameters.position_error.value
        if size == 0.0:
            return np.eye(3)
        vector = size * self._drawn(np.rint(np.ravel(attitude) * 1e6).astype(np.int64), 3)
        angle = float(np.linalg.norm(vector))
        return rotation_about(tuple(vector / angle), angle)

    def rate_error(self, rate: float) -> float:
        """The relative error of a rate [rad/s]; it depends on the seed and the rate alone."""
        size = self.parameters.rate_error.value
        return size * float(self._drawn(np.rint(np.array([rate]) * 1e9).astype(np.int64), 1)[0]) if size else 0.0

    def _drawn(self, state: NDArray[np.int64], count: int) -> Array:
        words = np.frombuffer(state.tobytes(), dtype=np.uint32).tolist()
        return np.random.default_rng([self.world.seed, *words]).standard_normal(count)

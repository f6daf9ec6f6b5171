"""Simulates a position/rate table with one to three axes and their limits. The table has a pointing error at every orientation, and
a rate error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.documents import Json
from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.instruments.models import TableModel
from planrunner.instruments.table_keys import TableKeys
from planrunner.instruments.virtual import courses
from planrunner.physics.kinematics import Unreachable, joint_angles, rotation_about
from planrunner.physics.table_motion import Excess, SpinCourse, cycle_excess, rock_excess, spin_excess
from planrunner.plan.kinds import QuantityOf, key
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.plan.schedule import Cycle, Motion, RecordedMotion, Rest, Rock, Spin

if TYPE_CHECKING:
    from planrunner.instruments.virtual.world import World

CLOCK_ROUNDING = 1e-6  # s; a clock that adds up sleeps may stop short of a time by a rounding


class VirtualTableParameters(TableKeys):
    """Declares the bench-file keys of a simulated table."""

    position_error: Quantity = key(
        QuantityOf("angle", "not negative"),
        "Standard deviation, about each sensor axis, of the simulated pointing error; the error is the same whenever the orientation is "
        "the same.",
        "2 arcsec",
        default=parse_quantity("0 arcsec"),
    )
    rate_error: Quantity = key(
        QuantityOf("ratio", "not negative"),
        "Relative standard deviation of the simulated rate error; the error is the same whenever the rate is the same.",
        "5 ppm",
        default=parse_quantity("0 ppm"),
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
        from planrunner.instruments.virtual.world import World  # a check needs only the model

        return cls(parameters, World.of(surroundings))

    # -- what it does ----------------------------------------------------------------------------------------------

    def orient(self, attitude: Array) -> float:
        now = self.world.now()
        if not self.world.course.still(now + CLOCK_ROUNDING):
            raise InstrumentError("the table is still moving; its motion must end before a new orientation")
        angles, _ = self.world.joints(now)
        try:
            target = joint_angles(self.axes, attitude, angles, self.world.site.azimuth)
        except Unreachable as error:
            raise InstrumentError(f"the table cannot take this orientation: {error}") from None
        course = courses.travel(self.axes, now, angles.tolist(), target.tolist())
        self.world.skew = self.pointing_error(attitude)
        return self._set_course(course, course.arrival)

    def holding(self) -> bool:
        return self.world.now() >= self.world.steady_at - CLOCK_ROUNDING

    def begin_motion(self, motion: Motion, seconds: float) -> float:
        now = self.world.now()
        angles = tuple(self.world.joints(now)[0].tolist())
        match motion:
            case Rest() | RecordedMotion():
                return 0.0
            case Spin():
                return self._spin(motion, seconds, now, angles)
            case Rock():
                return self._rock(motion, now, angles)
            case Cycle():
                joint = 0
                _refuse(cycle_excess(self.axes[joint], angles[joint], motion))
                turns = tuple(move.turn for move in motion.moves)
                acceleration = self.axes[joint].max_acceleration
                cycling = courses.Cycling(now, angles, joint, turns, motion.rate, acceleration, motion.stop)
                return self._set_course(cycling, now)

    def end_motion(self) -> float:
        now = self.world.now()
        course = self.world.course
        if course.still(now) or isinstance(course, courses.Standing):
            return 0.0
        if isinstance(course, courses.Rocking):
            if now <= course.begins:
                return self._set_course(courses.Standing(course.angles), now)
            ending = course.ended(now)
            return self._set_course(ending, ending.over)
        angles, rates = self.world.joints(now)
        if isinstance(course, courses.Spinning | courses.Cycling):
            rate = float(rates[course.joint])
            slowing = courses.Spinning(now, tuple(angles.tolist()), course.joint, rate, 0.0, course.acceleration)
            return self._set_course(slowing, slowing.steady)
        travel = courses.travel(self.axes, now, angles.tolist(), angles.tolist())
        return self._set_course(travel, travel.arrival)

    def read(self) -> Mapping[str, float]:
        angles = self.world.joints(self.world.now())[0]
        return {f"{axis.name}_deg": math.degrees(angle) for axis, angle in zip(self.axes, angles, strict=True)}

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": "planrunner", "model": f"virtual {len(self.axes)}-axis table"}

    def make_safe(self) -> None:
        self.end_motion()

    def close(self) -> None:
        """Does nothing, because there are no open resources."""

    def checkpoint(self) -> Mapping[str, Json]:
        return self.world.motion_state()

    def restore(self, state: Mapping[str, Json]) -> None:
        self.world.restore_motion(state)

    # -- how it does it --------------------------------------------------------------------------------------------

    def _set_course(self, course: courses.Course, steady_at: float) -> float:
        self.world.course = course
        self.world.steady_at = steady_at
        return max(0.0, steady_at - self.world.now())

    def _spin(self, motion: Spin, seconds: float, now: float, angles: tuple[float, ...]) -> float:
        try:
            course = SpinCourse.of(motion, self.axes, angles, self.world.site.azimuth)
        except Unreachable as error:
            raise InstrumentError(f"the table cannot spin about this direction: {error}") from None
        _refuse(spin_excess(self.axes, angles, course, seconds))
        rate = course.rate * (1 + self.rate_error(motion.rate))
        first = self.world.joints(now)[1][course.joint]
        acceleration = self.axes[course.joint].max_acceleration
        spinning = courses.Spinning(now, angles, course.joint, float(first), rate, acceleration)
        return self._set_course(spinning, spinning.steady)

    def _rock(self, motion: Rock, now: float, angles: tuple[float, ...]) -> float:
        _refuse(rock_excess(self.axes, angles, motion))
        record = now + motion.lead_in
        rocking = courses.Rocking(
            record + motion.steady, angles, motion.amplitude, motion.frequency, motion.phases, motion.duration
        )
        return self._set_course(rocking, record)

    def pointing_error(self, attitude: Array) -> Array:
        """Returns a small random rotation (3, 3), which depends only on the seed and the commanded attitude."""
        size = self.parameters.position_error.value
        if size == 0.0:
            return np.eye(3)
        vector = size * self._drawn(np.rint(np.ravel(attitude) * 1e6).astype(np.int64), 3)
        angle = float(np.linalg.norm(vector))
        return rotation_about(tuple(vector / angle), angle)

    def rate_error(self, rate: float) -> float:
        """Returns the relative error of a commanded rate [rad/s]. The error depends only on the seed and the rate."""
        size = self.parameters.rate_error.value
        return size * float(self._drawn(np.rint(np.array([rate]) * 1e9).astype(np.int64), 1)[0]) if size else 0.0

    def _drawn(self, state: NDArray[np.int64], count: int) -> Array:
        words = np.frombuffer(state.tobytes(), dtype=np.uint32).tolist()
        return np.random.default_rng([self.world.seed, *words]).standard_normal(count)


def _refuse(excess: Sequence[Excess]) -> None:
    if excess:
        raise InstrumentError("; ".join(one.message for one in excess))

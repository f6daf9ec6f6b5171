"""Contains the functions that all real tables share: converting attitudes to axis positions, performing spins, rocking and cycles,
checking whether a state has been reached, and bringing the table to its safe state.

A separate file for each controller implements `AxisCommands`; this file does not depend on a manufacturer. Whether a state has been
reached is decided from the controller's measurements, never from the elapsed time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from planrunner.base.arrays import Array
from planrunner.instruments.interfaces import Clock, Condition, InstrumentError, OwnLimits, Surroundings
from planrunner.instruments.models import TableModel
from planrunner.instruments.tables.axis_commands import AxisBounds, AxisCommands, Sine
from planrunner.instruments.tables.timed_motion import TimedMotion, turns_of
from planrunner.instruments.tables.wired_axes import WiredTableKeys, counted
from planrunner.instruments.wire.links import Commanded, CommandedDriver, LinkKeys
from planrunner.physics.kinematics import (
    TableAxis,
    Unreachable,
    joint_angles,
    spin_up_time,
    transition_time,
)
from planrunner.physics.table_motion import Excess, SpinCourse, cycle_excess, rock_excess, spin_excess
from planrunner.plan.schedule import Cycle, Motion, RecordedMotion, Rest, Rock, Segment, Spin

STOPPED = math.radians(0.1)
"""Rate below which an axis may be switched off, rad/s."""
POLL = 0.05
"""Time between two queries of a table that is being stopped, s."""


class LinkedTableKeys(LinkKeys, WiredTableKeys):
    """Declares the bench-file keys of a real table, including the keys of the link to its controller."""


K = TypeVar("K", bound=LinkedTableKeys)


@dataclass(frozen=True, slots=True)
class Aim:
    """Contains the last commands to the axes, by index of the axis: joint angles [rad] of the axes that hold a position, and rates
    [rad/s] of the axes that turn. Every new command makes a new `Aim`, even if it has the same values."""

    positions: Mapping[int, float] = field(default_factory=dict)
    rates: Mapping[int, float] = field(default_factory=dict)


class AxisTable(Commanded[AxisCommands]):
    """A real table, controlled through its `AxisCommands`."""

    def __init__(self, commands: AxisCommands, keys: WiredTableKeys, clock: Clock, azimuth: float):
        super().__init__(commands)
        self.keys, self.clock, self.azimuth = keys, clock, azimuth
        self.axes: tuple[TableAxis, ...] = keys.model().axes
        self.counted = counted(keys)
        self._aim = Aim()
        self._reached: Aim | None = None
        self._rocking: Rock | None = None
        self._home: tuple[float, ...] = ()
        self._timed = TimedMotion(clock)
        self._ready = self._limited = False

    def limit(self, limits: OwnLimits) -> Sequence[str]:
        told: list[str] = []
        error = min(self.keys.tracking_error.value, limits.position_error or math.inf)
        self.axes = tuple(
            replace(
                axis,
                max_rate=min(axis.max_rate, limits.rate or math.inf),
                max_acceleration=min(axis.max_acceleration, limits.acceleration or math.inf),
            )
            for axis in self.keys.model().axes
        )
        for axis, counted_ in zip(self.axes, self.counted, strict=True):
            ends = sorted(counted_.reading(end) for end in (axis.lowest, axis.highest))
            bounds = AxisBounds(
                math.degrees(axis.max_rate),
                math.degrees(axis.max_acceleration),
                math.degrees(error),
                *(end if math.isfinite(end) else None for end in ends),
            )
            told += self.commands.limit(counted_.number, bounds)
        self._limited = True
        self._timed.patience = limits.silence or math.inf
        return told

    def foresee(self, segments: Sequence[Segment]) -> None:
        for segment in segments:
            motion = segment.motion
            if isinstance(motion, Cycle):
                _refuse(cycle_excess(self.axes[0], None, motion), f"'{segment.label}': ")
            if isinstance(motion, Rock):
                self._check_rock(motion, None, f"'{segment.label}': ")

    # -- moving --------------------------------------------------------------------------------------------------------

    def orient(self, attitude: Array) -> float:
        self._make_ready()
        joints, rates = self._measured()
        if np.any(np.abs(rates) > STOPPED):
            raise InstrumentError("the table is still moving; its motion must end before a new orientation")
        try:
            target = joint_angles(self.axes, attitude, joints, self.azimuth)
        except Unreachable as error:
            raise InstrumentError(f"the table cannot take this orientation: {error}") from None
        self._stand(target, joints)
        return transition_time(self.axes, joints, target)

    def begin_motion(self, motion: Motion, seconds: float) -> float:
        if isinstance(motion, Rest | RecordedMotion):
            return 0.0
        self._make_ready()
        if isinstance(motion, Spin):
            return self._spin(motion, seconds)
        return self._rock(motion) if isinstance(motion, Rock) else self._cycle(motion)

    def end_motion(self) -> float:
        """Brings the table to rest. If an axis is turning within a cycle, it stops where it is. If its turn is already complete, it
        moves to the end position of the turn."""
        self._timed.call_off()
        if self._rocking is not None:
            return self._end_rocking()
        _, rates = self._measured()
        aim = self._aim
        turning = [index for index, rate in enumerate(rates) if abs(rate) > STOPPED]
        told = {**aim.rates, **aim.positions}
        if any(index not in told for index in turning):  # nobody here set it going, as after a crash
            self.commands.stop()
        for index in aim.rates:
            self._turn(index, 0.0, aim.positions)
        return max(spin_up_time(axis, float(rate)) for axis, rate in zip(self.axes, rates, strict=True))

    def holding(self) -> bool:
        faults, errors = self._observed()
        if faults:
            raise InstrumentError("the table: " + "; ".join(faults))
        return self._within(errors)

    # -- measurements --------------------------------------------------------------------------------------------------

    def watch(self) -> Condition:
        """Returns the current condition of the table. Deviations from a commanded state are reported only after the state has been
        reached once."""
        faults, errors = self._observed()
        return Condition(errors if self._reached is self._aim else {}, faults)

    def _observed(self) -> tuple[tuple[str, ...], dict[str, float]]:
        """Returns the faults of the table, and the largest deviations of the axes from their last commands [rad, rad/s]. Returns no
        deviations if the commands changed during the query."""
        self._timed.looked_at()
        aim, rocking = self._aim, self._rocking  # another thread may be changing them
        faults = [*self.commands.faults(), *([self._timed.broken] if self._timed.broken else [])]
        joints, rates = self._measured()
        if rocking is not None:
            reach = rocking.amplitude + self.keys.tracking_error.value
            away = max(abs(self._off(index, joints, home)) for index, home in enumerate(self._home))
            if away > reach:
                faults.append(f"an axis is {math.degrees(away):.4g} deg from its centre of rocking")
            return tuple(faults), {}
        errors = self._errors(aim, joints, rates)
        return tuple(faults), errors if self._aim is aim else {}

    def _errors(self, aim: Aim, joints: Array, rates: Array) -> dict[str, float]:
        errors = {"rate_error": max(abs(float(rate) - aim.rates.get(index, 0.0)) for index, rate in enumerate(rates))}
        if aim.positions:
            errors["position_error"] = max(
                abs(self._off(index, joints, target)) for index, target in aim.positions.items()
            )
        if self._within(errors):
            self._reached = aim
        return errors

    def _within(self, errors: Mapping[str, float]) -> bool:
        return (
            errors.get("position_error", 0.0) <= self.keys.position_tolerance.value
            and errors.get("rate_error", 0.0) <= self.keys.rate_tolerance.value
        )

    def read(self) -> Mapping[str, float]:
        joints, _ = self._measured()
        return {f"{axis.name}_deg": math.degrees(joint) for axis, joint in zip(self.axes, joints, strict=True)}

    # -- the safe state ------------------------------------------------------------------------------------------------

    def make_safe(self) -> None:
        """Stops every axis, and then switches the axes off. Raises `InstrumentError` if an axis does not stop; such an axis is also
        switched off."""
        self._timed.call_off()
        self._aim, self._rocking, self._ready = Aim(), None, False
        try:
            trouble = self._stop_and_switch_off()
        except InstrumentError:  # a connection that was lost unnoticed is opened anew
            trouble = self._stop_and_switch_off()
        if trouble:
            raise InstrumentError(trouble)

    def close(self) -> None:
        self._timed.call_off()
        super().close()

    # -- how it does it ------------------------------------------------------------------------------------------------

    def _make_ready(self) -> None:
        if not self._ready:
            self._timed.broken = ""
            if not self._limited:
                self.limit(OwnLimits())
            self.commands.energise()
            self._ready = True

    def _measured(self) -> tuple[Array, Array]:
        """Returns the measured joint angles [rad] and rates [rad/s] as two arrays with one element for each axis."""
        states = [self.commands.state(axis.number) for axis in self.counted]
        joints = [axis.joint(state.position) for axis, state in zip(self.counted, states, strict=True)]
        rates = [axis.sense * math.radians(state.rate) for axis, state in zip(self.counted, states, strict=True)]
        return np.array(joints), np.array(rates)

    def _off(self, index: int, joints: Array, target: float) -> float:
        off = float(joints[index]) - target
        return math.remainder(off, 2 * math.pi) if self.axes[index].continuous else off

    def _stand(self, joints: Sequence[float] | Array, here: Sequence[float] | Array) -> None:
        self._aim, self._rocking = Aim({index: float(joint) for index, joint in enumerate(joints)}), None
        self.commands.go_to(self._readings(joints), self._readings(here))

    def _readings(self, joints: Sequence[float] | Array) -> dict[int, float]:
        return {axis.number: axis.reading(float(joint)) for axis, joint in zip(self.counted, joints, strict=True)}

    def _spin(self, motion: Spin, seconds: float) -> float:
        joints, rates = self._measured()
        try:
            course = SpinCourse.of(motion, self.axes, joints, self.azimuth)
        except Unreachable as error:
            raise InstrumentError(f"the table cannot spin about this direction: {error}") from None
        _refuse(spin_excess(self.axes, joints, course, seconds))
        self._rocking = None
        self._turn(course.joint, course.rate, {other: float(joint) for other, joint in enumerate(joints)})
        return spin_up_time(self.axes[course.joint], course.rate - float(rates[course.joint]))

    def _turn(self, index: int, rate: float, standing: Mapping[int, float]) -> None:
        """Starts to turn the axis `index` at a constant rate. `standing`: joint angles [rad] by index of the axis; the other axes
        hold these angles."""
        self._aim = Aim({other: joint for other, joint in standing.items() if other != index}, {index: rate})
        axis = self.counted[index]
        self.commands.turn(axis.number, axis.sense * math.degrees(rate))

    def _rock(self, motion: Rock) -> float:
        joints, _ = self._measured()
        self._check_rock(motion, joints)
        self._aim = Aim()
        self._home, self._rocking = tuple(float(joint) for joint in joints), motion
        record = self.clock.now() + motion.lead_in
        end = record + motion.steady + motion.duration
        if motion.delay:
            self._timed.begin(
                "rocking could not be started, nor stopped", lambda: self._rock_between(record + motion.delay, end)
            )
            return motion.lead_in
        self.commands.rock(self._sines(motion, motion.amplitude))
        if math.isfinite(motion.duration):
            self._timed.begin("rocking could not be stopped", lambda: self._rock_until(end))
        return motion.lead_in

    def _sines(self, motion: Rock, amplitude: float) -> dict[int, Sine]:
        return {
            axis.number: Sine(axis.sense * math.degrees(amplitude), motion.frequency, math.degrees(phase))
            for axis, phase in zip(self.counted, motion.phases, strict=False)
        }

    def _check_rock(self, motion: Rock, joints: Array | None, where: str = "") -> None:
        if not self.commands.rocks:
            raise InstrumentError(f"{where}the table has no rocking motion")
        _refuse(rock_excess(self.axes, joints, motion), where)

    def _end_rocking(self) -> float:
        assert self._rocking is not None
        rocking, home = self._rocking, self._home
        self.commands.rock(self._sines(rocking, 0.0))
        self._stand(home, home)
        return 1 / rocking.frequency

    def _rock_between(self, begin: float, end: float) -> None:
        """Rocks from the time `begin` to the time `end` [s by the bench's clock]. The function is used if the rocking begins only
        after the start of the recording. If `end` is infinite, the rocking continues until the motion is ended."""
        rocking = self._rocking
        assert rocking is not None
        self._timed.until(begin)
        self.commands.rock(self._sines(rocking, rocking.amplitude))
        if math.isfinite(end):
            self._rock_until(end)

    def _rock_until(self, end: float) -> None:
        """Ends the rocking at the time `end`, while the segment continues."""
        self._timed.until(end)
        self._end_rocking()

    def _cycle(self, motion: Cycle) -> float:
        """Performs stops and turns of the outermost axis. The first stop starts at once."""
        joints, _ = self._measured()
        joints[0] = self._aim.positions.get(0, joints[0])
        _refuse(cycle_excess(self.axes[0], float(joints[0]), motion))
        self._stand(joints, joints)
        self._timed.begin("the cycle could not continue", lambda: self._turns(motion, joints, self.clock.now()))
        return 0.0

    def _turns(self, motion: Cycle, home: Array, begun: float) -> None:
        """Performs each turn with a rate command, because with a position command, the axis would choose the shorter way. During
        the stop that follows, a position command removes the remaining deviation. `home`: joint angles at the start of the cycle,
        rad. `begun`: time at which the cycle began, s."""
        standing = {index: float(joint) for index, joint in enumerate(home)}
        for turn in turns_of(motion, self.axes[0].max_acceleration):
            self._timed.until(begun + turn.begins)
            self._turn(0, turn.rate, standing)
            self._timed.until(begun + turn.brakes)
            self._turn(0, 0.0, standing)
            self._timed.until(begun + turn.ends)
            standing[0] = float(home[0]) + turn.target
            self._lead_in(list(standing.values()), begun + turn.ends + motion.stop)

    def _lead_in(self, joints: Sequence[float], end: float) -> None:
        while abs(self._measured()[1][0]) > STOPPED:
            self._wait_before(end)
        self._stand(joints, self._measured()[0])
        while not self._within(self._errors(self._aim, *self._measured())):
            self._wait_before(end)

    def _wait_before(self, end: float) -> None:
        if self.clock.now() >= end:
            raise InstrumentError(
                f"the axis '{self.axes[0].name}' is not at its position when the stop ends: make the stop longer, "
                "and check max_acceleration and position_tolerance in the bench file"
            )
        self._timed.until(self.clock.now() + POLL)

    def _stop_and_switch_off(self) -> str:
        """Stops every axis and switches the axes off; returns a message if the table still turns, otherwise an empty text."""
        self.commands.stop()
        slowest = max(axis.max_rate / axis.max_acceleration for axis in self.axes)
        deadline = self.clock.now() + slowest + 2.0
        while (fastest := float(np.max(np.abs(self._measured()[1])))) > STOPPED and self.clock.now() < deadline:
            self.clock.sleep(POLL)
        self.commands.switch_off()
        if fastest <= STOPPED:
            return ""
        turning = f"{math.degrees(fastest):.4g} deg/s"
        return f"the table still turns at {turning} after it was stopped: press its emergency stop"


def _refuse(excess: Sequence[Excess], where: str = "") -> None:
    """Raises `InstrumentError` if a motion exceeds a limit of the table. `where`: text with which the message begins."""
    if excess:
        raise InstrumentError(where + "; ".join(one.message for one in excess))


class TableDriver(CommandedDriver[K, AxisCommands]):
    """Base class for drivers of real tables.

    K is the record with the keys of the table. Derived drivers define `Parameters` and `commands_of`."""

    role = "table"

    @classmethod
    def model(cls, parameters: K) -> TableModel:
        return parameters.model()

    @classmethod
    def connect(cls, parameters: K, surroundings: Surroundings) -> AxisTable:
        commands = cls.identified(parameters)
        return AxisTable(commands, parameters, surroundings.clock, surroundings.site.azimuth)

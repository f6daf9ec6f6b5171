"""What every real table does, whoever made it: attitudes to axis positions, spins, rocking, whether a state is held, the safe state.

How a controller is told stands in a file of its own, as an `AxisCommands`; this file knows no vendor. States are judged by what the
controller measures, never by the time that went by.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from planrunner.instruments.interfaces import Array, Clock, Condition, InstrumentError, OwnLimits, Surroundings
from planrunner.instruments.tables.wired_axes import WiredTableKeys, counted
from planrunner.physics.kinematics import (
    TableAxis,
    Unreachable,
    joint_angles,
    joint_directions,
    spin_axis,
    spin_up_time,
    transition_time,
)
from planrunner.plan.schedule import Cycle, Motion, Rest, Rock, Segment, Spin

STOPPED = math.radians(0.1)
"""rad/s below which an axis may be switched off."""
POLL = 0.05
"""s between two looks at a table that is being stopped."""
LOOK = 0.005
"""s, of the wall, between two looks at the clock while it rocks."""


@dataclass(frozen=True, slots=True)
class AxisState:
    """What the controller measures: degrees and deg/s, as it counts."""

    position: float
    rate: float


@dataclass(frozen=True, slots=True)
class AxisBounds:
    """What an axis shall keep to by itself, as the controller counts: deg/s, deg/s², deg; lowest and highest None without stops."""

    rate: float
    acceleration: float
    tracking_error: float
    lowest: float | None = None
    highest: float | None = None


@dataclass(frozen=True, slots=True)
class Sine:
    """amplitude·sin(2π·frequency·t + phase) about the position that is held: deg, Hz, deg."""

    amplitude: float
    frequency: float
    phase: float


class AxisCommands(Protocol):
    """How a controller is told. Axes go by the controller's numbers, angles are its degrees. Every failure is an `InstrumentError`."""

    rocks: bool
    """Whether it has a sine motion of its own."""

    def identify(self) -> Mapping[str, str]: ...
    def limit(self, axis: int, bounds: AxisBounds) -> Sequence[str]:
        """Set what the axis keeps to by itself; a line for each limit that is set now."""

    def energise(self) -> None:
        """Make the axes ready to move. Called before the first move, and after `switch_off`."""

    def go_to(self, positions: Mapping[int, float], here: Mapping[int, float]) -> None:
        """Go to positions and stand there. here: where the axes are now, so that one which is only entering its position mode holds
        there first."""

    def turn(self, axis: int, rate: float) -> None: ...
    def rock(self, sines: Mapping[int, Sine]) -> None: ...
    def state(self, axis: int) -> AxisState: ...
    def faults(self) -> Sequence[str]:
        """Why it cannot go on, in words; empty while all is well."""

    def stop(self) -> None:
        """Bring every axis to rest, controlled."""

    def switch_off(self) -> None: ...
    def remarks(self) -> Sequence[str]: ...
    def close(self) -> None: ...


class AxisTable:
    """A real table behind its `AxisCommands`."""

    def __init__(self, commands: AxisCommands, keys: WiredTableKeys, clock: Clock, azimuth: float):
        self.commands, self.keys, self.clock, self.azimuth = commands, keys, clock, azimuth
        self.axes: tuple[TableAxis, ...] = keys.model().axes
        self.counted = counted(keys)
        self._positions: dict[int, float] = {}  # of the axes that shall stand, joint angles [rad]
        self._rates: dict[int, float] = {}  # of the axes that shall turn, rad/s
        self._rocking: Rock | None = None
        self._home: tuple[float, ...] = ()
        self._rocked: threading.Thread | None = None
        self._called_off = threading.Event()
        self._broken = ""
        self._ready = self._limited = self._reached = False

    @classmethod
    def connect(cls, commands: AxisCommands, keys: WiredTableKeys, surroundings: Surroundings) -> AxisTable:
        """Ask who it is; lets go of the link when that fails. What is wrong with it does not keep it from being made safe."""
        try:
            commands.identify()
        except BaseException:
            commands.close()
            raise
        return cls(commands, keys, surroundings.clock, surroundings.site.azimuth)

    # -- who it is and what it keeps to --------------------------------------------------------------------------------

    def identify(self) -> Mapping[str, str]:
        return self.commands.identify()

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
        return told

    def foresee(self, segments: Sequence[Segment]) -> None:
        for segment in segments:
            motion = segment.motion
            if isinstance(motion, Cycle):
                raise InstrumentError(f"'{segment.label}': the table has no cycle of turns and stops")
            if isinstance(motion, Rock):
                self._check_rock(motion, f"'{segment.label}': ")

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
        if isinstance(motion, Rest):
            return 0.0
        self._make_ready()
        if isinstance(motion, Spin):
            return self._spin(motion)
        if isinstance(motion, Rock):
            return self._rock(motion)
        raise InstrumentError("the table has no cycle of turns and stops")

    def end_motion(self) -> float:
        self._call_off()
        if self._rocking is not None:
            return self._end_rocking()
        _, rates = self._measured()
        turning = [index for index, rate in enumerate(rates) if abs(rate) > STOPPED]
        if any(index not in self._rates for index in turning):  # nobody here set it going, as after a crash
            self.commands.stop()
        for index in self._rates:
            self.commands.turn(self.counted[index].number, 0.0)
            self._rates[index] = 0.0
            self._reached = False
        return max(spin_up_time(axis, float(rate)) for axis, rate in zip(self.axes, rates, strict=True))

    def holding(self) -> bool:
        faults, errors = self._observed()
        if faults:
            raise InstrumentError("the table: " + "; ".join(faults))
        return self._within(errors)

    # -- what it sees of itself ----------------------------------------------------------------------------------------

    def watch(self) -> Condition:
        """On the way to a state there is no error from it yet: errors are told from when it was reached first."""
        faults, errors = self._observed()
        return Condition(errors if self._reached else {}, faults)

    def _observed(self) -> tuple[tuple[str, ...], dict[str, float]]:
        """Faults, and how far the axes are from what they were told last [rad, rad/s]."""
        faults = [*self.commands.faults(), *([self._broken] if self._broken else [])]
        joints, rates = self._measured()
        rocking = self._rocking  # another thread may be ending it
        if rocking is not None:
            reach = rocking.amplitude + self.keys.tracking_error.value
            away = max(abs(self._off(index, joints, home)) for index, home in enumerate(self._home))
            if away > reach:
                faults.append(f"an axis is {math.degrees(away):.4g} deg from where it rocks about")
            return tuple(faults), {}
        errors = {"rate_error": max(abs(float(rate) - self._rates.get(index, 0.0)) for index, rate in enumerate(rates))}
        if self._positions:
            errors["position_error"] = max(
                abs(self._off(index, joints, target)) for index, target in self._positions.items()
            )
        self._reached = self._reached or self._within(errors)
        return tuple(faults), errors

    def _within(self, errors: Mapping[str, float]) -> bool:
        return (
            errors.get("position_error", 0.0) <= self.keys.position_tolerance.value
            and errors.get("rate_error", 0.0) <= self.keys.rate_tolerance.value
        )

    def read(self) -> Mapping[str, float]:
        joints, _ = self._measured()
        return {f"{axis.name}_deg": math.degrees(joint) for axis, joint in zip(self.axes, joints, strict=True)}

    def remarks(self) -> Sequence[str]:
        return self.commands.remarks()

    # -- the safe state ------------------------------------------------------------------------------------------------

    def make_safe(self) -> None:
        """Stop every axis, then switch off. An axis that does not stop is switched off nevertheless, and told."""
        self._call_off()
        self._forget()
        self._ready = False
        try:
            trouble = self._stop_and_switch_off()
        except InstrumentError:  # a connection that was lost unnoticed is opened anew
            trouble = self._stop_and_switch_off()
        if trouble:
            raise InstrumentError(trouble)

    def close(self) -> None:
        self._call_off()
        self.commands.close()

    # -- how it does it ------------------------------------------------------------------------------------------------

    def _forget(self) -> None:
        self._positions, self._rates, self._rocking, self._reached = {}, {}, None, False

    def _make_ready(self) -> None:
        if not self._ready:
            self._broken = ""
            if not self._limited:
                self.limit(OwnLimits())
            self.commands.energise()
            self._ready = True

    def _measured(self) -> tuple[Array, Array]:
        """Joint angles [rad] and rates [rad/s]."""
        states = [self.commands.state(axis.number) for axis in self.counted]
        joints = [axis.joint(state.position) for axis, state in zip(self.counted, states, strict=True)]
        rates = [axis.sense * math.radians(state.rate) for axis, state in zip(self.counted, states, strict=True)]
        return np.array(joints), np.array(rates)

    def _off(self, index: int, joints: Array, target: float) -> float:
        off = float(joints[index]) - target
        return math.remainder(off, 2 * math.pi) if self.axes[index].continuous else off

    def _stand(self, joints: Sequence[float] | Array, here: Sequence[float] | Array) -> None:
        self._forget()
        self._positions = {index: float(joint) for index, joint in enumerate(joints)}
        self.commands.go_to(self._readings(joints), self._readings(here))

    def _readings(self, joints: Sequence[float] | Array) -> dict[int, float]:
        return {axis.number: axis.reading(float(joint)) for axis, joint in zip(self.counted, joints, strict=True)}

    def _spin(self, motion: Spin) -> float:
        joints, rates = self._measured()
        try:
            index = spin_axis(self.axes, joints, motion.about, self.azimuth)
        except Unreachable as error:
            raise InstrumentError(f"the table cannot spin about this direction: {error}") from None
        axis, counted_ = self.axes[index], self.counted[index]
        if abs(motion.rate) > axis.max_rate * (1 + 1e-9):
            reached = f"{math.degrees(axis.max_rate):g} deg/s"
            raise InstrumentError(
                f"the axis '{axis.name}' reaches {reached}, not {math.degrees(abs(motion.rate)):g} deg/s"
            )
        along = float(joint_directions(self.axes, joints, self.azimuth)[index] @ np.asarray(motion.about))
        rate = math.copysign(1.0, along) * motion.rate
        self._forget()
        self._positions = {other: float(joint) for other, joint in enumerate(joints) if other != index}
        self._rates = {index: rate}
        self.commands.turn(counted_.number, counted_.sense * math.degrees(rate))
        return spin_up_time(axis, rate - float(rates[index]))

    def _rock(self, motion: Rock) -> float:
        self._check_rock(motion)
        joints, _ = self._measured()
        for axis, joint, _ in zip(self.axes, joints, motion.phases, strict=False):
            if not axis.lowest <= joint - motion.amplitude <= joint + motion.amplitude <= axis.highest:
                raise InstrumentError(f"rocking would carry the axis '{axis.name}' beyond its limits")
        self._forget()
        self._rocking, self._home = motion, tuple(float(joint) for joint in joints)
        self.commands.rock(self._sines(motion, motion.amplitude))
        steady = 1 / motion.frequency
        if math.isfinite(motion.duration):
            end = self.clock.now() + steady + motion.duration
            self._called_off.clear()
            self._rocked = threading.Thread(target=self._rock_until, args=(end,), daemon=True)
            self._rocked.start()
        return steady

    def _sines(self, motion: Rock, amplitude: float) -> dict[int, Sine]:
        return {
            axis.number: Sine(axis.sense * math.degrees(amplitude), motion.frequency, math.degrees(phase))
            for axis, phase in zip(self.counted, motion.phases, strict=False)
        }

    def _check_rock(self, motion: Rock, where: str = "") -> None:
        if not self.commands.rocks:
            raise InstrumentError(f"{where}the table has no rocking motion")
        if len(motion.phases) > len(self.axes):
            raise InstrumentError(f"{where}{len(motion.phases)} rings are to rock, the table has {len(self.axes)}")
        circular = 2 * math.pi * motion.frequency
        for axis, _ in zip(self.axes, motion.phases, strict=False):
            rate, acceleration = motion.amplitude * circular, motion.amplitude * circular**2
            if rate > axis.max_rate * (1 + 1e-9) or acceleration > axis.max_acceleration * (1 + 1e-9):
                needed = f"{math.degrees(rate):.4g} deg/s and {math.degrees(acceleration):.4g} deg/s^2"
                raise InstrumentError(f"{where}rocking needs {needed} of the axis '{axis.name}', more than it reaches")

    def _end_rocking(self) -> float:
        assert self._rocking is not None
        rocking, home = self._rocking, self._home
        self.commands.rock(self._sines(rocking, 0.0))
        self._stand(home, home)
        return 1 / rocking.frequency

    def _rock_until(self, end: float) -> None:
        """The duration of the rocking is over while the segment goes on; on a thread of its own, by the bench's clock."""
        while self.clock.now() < end:
            if self._called_off.wait(LOOK):
                return
        try:
            self._end_rocking()
        except InstrumentError as error:
            self._broken = f"rocking could not be ended: {error}"

    def _call_off(self) -> None:
        """The rocking is no longer ended by itself."""
        self._called_off.set()
        thread, self._rocked = self._rocked, None
        if thread is not None:
            thread.join()

    def _stop_and_switch_off(self) -> str:
        """What is wrong with the table now, or nothing."""
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

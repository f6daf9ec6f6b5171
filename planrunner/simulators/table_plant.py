"""Simulates the mechanics of a table: axes that turn, move and rock within limits, an interlock, and faults that end a motion.

The mechanics are independent of any protocol. Angles are in rad, rates in rad/s, accelerations in rad/s^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from planrunner.physics.kinematics import TableAxis, attitude
from planrunner.simulators.joint_paths import JointPaths, Path, Swing
from planrunner.simulators.live_world import LiveWorld

TURN = 2 * math.pi
_GRANTED = 1 + 1e-9


@dataclass(slots=True)
class Axis:
    """One axis, with the values that its controller has stored.

    `model`: the limits of the axis itself. `lowest`, `highest`: limits of the angles that can be demanded, rad; demands beyond them
    are limited. `trip`: rate [rad/s] above which the axis is switched off. `tracking`: following error [rad] above which the axis
    is switched off. `aim`: the angle that was demanded last. `faults`: faults that have ended the motion of the axis and have not
    been reset.
    """

    model: TableAxis
    lowest: float
    highest: float
    trip: float
    tracking: float = math.inf
    powered: bool = False
    aim: float = 0.0
    centre: float = 0.0
    limited: str = ""
    faults: tuple[str, ...] = ()


class TablePlant:
    """Simulates the axes of the virtual table in a live world."""

    def __init__(self, live: LiveWorld):
        assert live.table is not None  # a simulated table is only made where the virtual bench has one
        self.live = live
        self.table = table = live.table
        self.paths = JointPaths([Path.standing(0.0) for _ in table.axes])
        self.interlock_fault = False
        self.interlock_open = False
        live.world.course = self.paths
        self.axes = [
            Axis(model, max(model.lowest, -1e6 * TURN), min(model.highest, 1e6 * TURN), 1.1 * model.max_rate)
            for model in table.axes
        ]

    # -- measurements --------------------------------------------------------------------------------------------------

    def state(self, index: int) -> tuple[float, float, float]:
        """Returns the present angle, rate and acceleration of an axis. The call also checks the limits: an axis that exceeds its
        trip rate is switched off."""
        found = self.paths.paths[index].state(self.live.now())
        axis = self.axes[index]
        if abs(found[1]) > axis.trip * _GRANTED and not axis.faults:
            self.fail(index, "over-rate")
        return found

    def arrived(self, index: int) -> bool:
        return self.live.now() >= self.paths.paths[index].arrival

    # -- commands ------------------------------------------------------------------------------------------------------

    def go(self, index: int, angle: float, rate: float, acceleration: float) -> None:
        """Moves an axis to an angle. A continuous axis turns the shorter way. `rate`, `acceleration`: largest rate and acceleration
        of the move, rad/s and rad/s²."""
        axis, now = self.axes[index], self.live.before_change()
        if axis.model.continuous:
            here = self.paths.paths[index].state(now)[0]
            angle = here + math.remainder(angle - here, TURN)
        axis.limited = "position" if not axis.lowest <= angle <= axis.highest else ""
        angle = min(max(angle, axis.lowest), axis.highest)
        axis.aim = axis.centre = angle
        path = self.paths.paths[index]
        self.paths.paths[index] = path.go(now, angle, *self._within(axis, rate, acceleration))
        self._point()

    def turn(self, index: int, rate: float, fastest: float, acceleration: float) -> None:
        """Changes the rate of an axis to `rate` [rad/s], which is limited to `fastest` [rad/s]."""
        axis, now = self.axes[index], self.live.before_change()
        fastest, acceleration = self._within(axis, fastest, acceleration)
        axis.limited = "rate" if abs(rate) > fastest * _GRANTED else ""
        rate = math.copysign(min(abs(rate), fastest), rate)
        rate *= 1 + self.table.rate_error(abs(rate))
        self.paths.paths[index] = self.paths.paths[index].turn(now, rate, acceleration)

    def swing(
        self, index: int, amplitude: float, frequency: float, phase: float, rate: float, acceleration: float
    ) -> None:
        """Starts a sine about the last commanded angle of the axis. If several axes perform sines of the same frequency, their
        phases count from the same moment. `amplitude`, `phase`: rad. `frequency`: Hz. `rate`, `acceleration`: largest rate and
        acceleration, rad/s and rad/s²; they limit the amplitude."""
        axis, now = self.axes[index], self.live.before_change()
        path = self.paths.paths[index]
        swinging = [p for p in (path.current(now) for path in self.paths.paths) if isinstance(p, Swing)]
        zero = next((p.zero for p in swinging if p.frequency == frequency), now)
        circular = TURN * frequency
        rate, acceleration = self._within(axis, rate, acceleration)
        most = min(rate / circular, acceleration / circular**2)
        axis.limited = "rate" if amplitude > most * _GRANTED else ""
        self.paths.paths[index] = path.swing(now, min(amplitude, most), frequency, phase, zero, axis.centre)

    def stop(self, index: int, acceleration: float | None = None) -> None:
        """Brings an axis to rest. The angle at which it comes to rest depends on the deceleration."""
        now = self.live.before_change()
        axis, path = self.axes[index], self.paths.paths[index]
        self.paths.paths[index] = path.turn(now, 0.0, acceleration or axis.model.max_acceleration)
        axis.aim = axis.centre = self.paths.paths[index].pieces[-1].at(self.paths.paths[index].arrival)[0]

    # -- faults --------------------------------------------------------------------------------------------------------

    def fail(self, index: int, fault: str) -> None:
        """Causes a fault of an axis (`over-rate`, `tracking error` or `axis fault`). The axis brakes and accepts no demand until
        the fault is reset."""
        axis = self.axes[index]
        axis.faults = (*axis.faults, fault)
        self.stop(index)
        axis.powered = False

    def open_interlock(self, is_open: bool = True) -> None:
        """Opens the interlock chain of doors and buttons. Every axis brakes, and the interlock fault stays set until it is reset."""
        self.interlock_open = is_open
        if is_open:
            self.interlock_fault = True
            for index, axis in enumerate(self.axes):
                if axis.powered:
                    self.stop(index)
                axis.powered = False

    def reset(self) -> None:
        """Clears all faults. If the interlock is still open, its fault is set again at once."""
        self.interlock_fault = self.interlock_open
        for axis in self.axes:
            axis.faults = ()

    # -- how it does it ------------------------------------------------------------------------------------------------

    def _within(self, axis: Axis, rate: float, acceleration: float) -> tuple[float, float]:
        return min(rate, axis.model.max_rate), min(acceleration, axis.model.max_acceleration)

    def _point(self) -> None:
        """Applies the pointing error that belongs to the last commanded orientation."""
        world = self.live.world
        aims = [axis.aim for axis in self.axes]
        world.skew = self.table.pointing_error(attitude(world.axes, aims, world.site.azimuth))

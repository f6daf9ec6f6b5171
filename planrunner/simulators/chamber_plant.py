"""Simulates the air in a chamber. The air follows a ramped setpoint or, if the chamber is off, drifts to the temperature of the
room.

Temperatures are in K, ramps in K/s. As disturbances, the air can stay at one temperature or overshoot. The chamber can raise an
alarm, which stops it until the alarm is cleared.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planrunner.simulators.live_world import LiveWorld

FULL_RAMP = 0.0  # K/s; the value that means the largest rate


class ChamberPlant:
    """Simulates the air of the virtual chamber in a live world.

    `alarms`: numbers of the active alarms. `lowest`, `highest`: limits of the measured temperature, K. If the temperature leaves
    this range, the chamber switches itself off with the alarm `OVER` (too warm) or `UNDER` (too cold)."""

    OVER, UNDER = 5, 4

    def __init__(self, live: LiveWorld):
        assert live.chamber is not None  # a simulated chamber is only made where the virtual bench has one
        self.live = live
        self.model = live.chamber.model(live.chamber.parameters)
        self.setpoint = self.model.ambient
        self.ramp = FULL_RAMP
        self.running = False
        self.lowest, self.highest = self.model.lowest, self.model.highest
        self.alarms: tuple[int, ...] = ()
        self.stuck = False
        self.overshoot = 0.0

    def air(self) -> float:
        """Returns the measured temperature of the air. The call also checks the limits of the chamber."""
        found = float(self.live.world.air(np.array([self.live.now()]))[0])
        slack = self.model.tolerance
        if self.running and not self.lowest - slack <= found <= self.highest + slack:
            self.alarm(self.OVER if found > self.highest else self.UNDER)
        return found

    def regulate(self, setpoint: float | None = None) -> None:
        """Starts the chamber with a new setpoint or with the present one."""
        self.setpoint = self.setpoint if setpoint is None else setpoint
        self.running = not self.alarms
        self._drive()

    def set_only(self, setpoint: float) -> None:
        """Accepts a new setpoint. If the chamber runs, the setpoint takes effect at once."""
        self.setpoint = setpoint
        self._drive()

    def set_ramp(self, ramp: float) -> None:
        """Sets the rate [K/s] of all further changes of the setpoint; 0 means the largest rate."""
        self.ramp = ramp
        self._drive()

    def stop(self) -> None:
        self.running = False
        self._drive()

    def alarm(self, number: int) -> None:
        """Raises an alarm, with which the chamber switches itself off."""
        self.alarms = (*self.alarms, number)
        self.stop()

    def clear(self) -> None:
        self.alarms = ()

    def disturb(self, *, stuck: bool | None = None, overshoot: float | None = None) -> None:
        """Starts or ends disturbances. If an argument is None, the corresponding disturbance does not change.

        `stuck`: True if the air keeps its temperature regardless of commands. `overshoot`: difference by which the air exceeds
        every setpoint, K."""
        self.stuck = self.stuck if stuck is None else stuck
        self.overshoot = self.overshoot if overshoot is None else overshoot
        self._drive()

    def _drive(self) -> None:
        """Passes the present target to the air of the virtual world."""
        now = self.live.before_change()
        world = self.live.world
        air = float(world.air(np.array([now]))[0])
        target = self.setpoint + self.overshoot if self.running else self.model.ambient
        fastest = self.model.ramp
        if self.stuck:
            target = air
        elif target == world.command.target and self._ramp(fastest) == world.lags.ramp:
            return
        world.head_for(target)
        if self.stuck:
            world.command = replace(world.command, setpoint=target)
        world.lags = replace(world.lags, ramp=self._ramp(fastest))

    def _ramp(self, fastest: float) -> float:
        return min(self.ramp, fastest) if self.running and self.ramp > 0 else fastest

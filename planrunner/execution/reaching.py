"""Getting the bench into a segment's state and out of it again: temperature, orientation, motion, settling.

Commands return at once with the seconds they are expected to take; these are slept on the bench's clock, then the
instrument is asked until it holds, up to a time-out. Temperature is set only when it changes, orientation only when
it changes or after a motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import (
    Array,
    HasModes,
    HoldsOrientation,
    HoldsTemperature,
    InstrumentError,
    Moves,
)
from planrunner.plan.schedule import Rest, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS


class StoppedAtOnceError(Exception):
    """The operator wants the run to end now."""


@dataclass(frozen=True, slots=True)
class Patience:
    """How long an instrument may take beyond what it expected, s, and how often it is asked."""

    table: float = 60.0
    chamber: float = 1800.0
    poll: float = 0.1


class Reaching:
    """Knows what was last commanded, so that nothing is moved without need."""

    def __init__(self, bench: Any, stop: StopRequest, patience: Patience, say: Callable[[str], None]):
        self._clock = bench.clock
        self._stop = stop
        self._patience = patience
        self._say = say
        self._chamber = bench.chamber
        self._table = bench.table
        self._can_orient = isinstance(bench.table, HoldsOrientation)
        self._sensor = bench.sensor
        self._can_move = isinstance(bench.table, Moves)
        self._can_heat = isinstance(bench.chamber, HoldsTemperature)
        self.temperature: float | None = None
        self.attitude: Array | None = None
        self.mode: str | None = None
        self.soak_again = True
        """At first, and after a break, nobody knows how long the sensor has been at its temperature."""
        self.moving_perhaps = False
        """After a break nobody knows whether the table stands still."""

    def forget(self) -> None:
        """What was commanded no longer holds: the bench was made safe."""
        self.temperature, self.attitude, self.mode = None, None, None
        self.soak_again = self.moving_perhaps = True

    def reach(self, segment: Segment) -> None:
        """Bring the bench to the segment's state, settled. Raises `InstrumentError` and `StoppedAtOnceError`."""
        self._reach_temperature(segment)
        self._orient(segment)
        self._enter_mode(segment)
        motion, dwell = segment.motion, segment.dwell or 0.0
        if isinstance(motion, Rest) or self._table is None:
            self._settle(segment)
        elif isinstance(motion, Spin):
            self._begin_motion(segment, segment.settle + dwell)
            self._settle(segment)
        else:  # a profile is recorded from its beginning
            self._settle(segment)
            self._begin_motion(segment, dwell)
        if segment.ramp_to is not None and self._chamber is not None:
            self._set_temperature(segment.ramp_to)
            self.temperature = None

    def come_to_rest(self, segment: Segment) -> None:
        """End the segment's motion."""
        if not isinstance(segment.motion, Rest) and self._table is not None:
            self._stop_table()

    def _stop_table(self) -> None:
        self._say("coming to rest")
        self._wait(
            self._table.end_motion(), self._holds_orientation, "the table does not come to rest", self._patience.table
        )

    def pause(self, seconds: float) -> None:
        """Sleep on the bench's clock; raises `StoppedAtOnceError` when that was asked for."""
        if seconds > 0:
            self._clock.sleep(seconds)
        if self._stop.at_once:
            raise StoppedAtOnceError

    def _settle(self, segment: Segment) -> None:
        if segment.settle > 0:
            self._say("settling")
            self.pause(segment.settle)

    def _reach_temperature(self, segment: Segment) -> None:
        kelvin = segment.temperature
        if kelvin is None or self._chamber is None or kelvin == self.temperature:
            return
        self._say("reaching the temperature")
        self.temperature = None
        expected = self._set_temperature(kelvin)
        what = f"the chamber does not reach {kelvin - ZERO_CELSIUS:.1f} degC"
        self._wait(expected, self._chamber.at_temperature, what, self._patience.chamber)
        if segment.soak > 0 and (expected > 0 or self.soak_again):
            self._say("soaking")
            self.pause(segment.soak)
        self.temperature, self.soak_again = kelvin, False

    def _enter_mode(self, segment: Segment) -> None:
        if segment.mode is None or segment.mode == self.mode or not isinstance(self._sensor, HasModes):
            return
        self._say(f"entering the mode {segment.mode}")
        self.mode = None
        self.pause(self._sensor.set_mode(segment.mode))
        self.mode = segment.mode

    def _set_temperature(self, kelvin: float) -> float:
        if not self._can_heat:
            raise InstrumentError(
                "the chamber's driver cannot set a temperature: use another driver or leave temperature out"
            )
        return float(self._chamber.set_temperature(kelvin))

    def _orient(self, segment: Segment) -> None:
        attitude = segment.attitude
        if attitude is None or self._table is None or attitude is self.attitude:
            return
        if self.attitude is not None and np.array_equal(attitude, self.attitude):
            return
        if not self._can_orient:
            raise InstrumentError("the table's driver cannot take an orientation: use another driver")
        self._stand_still()
        self._say("moving the table")
        self.attitude = None
        expected = self._table.orient(attitude)
        self._wait(
            expected, self._table.holding, f"the table does not hold '{segment.orientation}'", self._patience.table
        )
        self.attitude = attitude

    def _begin_motion(self, segment: Segment, seconds: float) -> None:
        if not self._can_move:
            raise InstrumentError(
                f"the table's driver cannot carry out the motion of '{segment.label}': use another driver"
            )
        self._stand_still()
        self._say("starting the motion")
        self.attitude = None
        expected = self._table.begin_motion(segment.motion, seconds)
        what = f"the motion of '{segment.label}' does not become steady"
        self._wait(expected, self._holds_orientation, what, self._patience.table)

    def _stand_still(self) -> None:
        if self.moving_perhaps and self._can_move:
            self._stop_table()
        self.moving_perhaps = False

    def _holds_orientation(self) -> bool:
        return bool(self._table.holding()) if self._can_orient else True

    def _wait(self, expected: float, holding: Callable[[], bool], what: str, patience: float) -> None:
        if not 0 <= expected < math.inf:
            raise InstrumentError(f"{what}: its driver expects {expected} s, which is not a time")
        self.pause(expected)
        if holding():
            return
        deadline = self._clock.now() + patience
        while not holding():
            if self._clock.now() >= deadline:
                raise InstrumentError(
                    f"{what}, {expected + patience:.0f} s after the command; {expected:.0f} s were expected. "
                    "Look at its display, cables, interlocks and limits, then resume the run"
                )
            self.pause(self._patience.poll)

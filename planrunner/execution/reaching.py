"""Brings the bench to the state of a segment and to rest again: temperature, orientation, motion, settling.

Commands return at once with their expected duration. After the expected time on the bench's clock, the instrument is queried until
it has reached the state, up to a time-out. If the plan names quantities to settle and instruments measure them, settling ends when
they have settled. Temperature is set only when it changes, orientation only when it changes or after a motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from planrunner.base.arrays import Array
from planrunner.execution.connected_bench import ConnectedBench
from planrunner.execution.lookout import EVERY, Lookout
from planrunner.execution.readings import outside, readings_of, unread
from planrunner.instruments.interfaces import (
    HasModes,
    HoldsOrientation,
    HoldsTemperature,
    Instrument,
    InstrumentError,
    Moves,
)
from planrunner.plan.schedule import Rest, Segment, Spin, Stability
from planrunner.plan.units import ZERO_CELSIUS


@dataclass(frozen=True, slots=True)
class Patience:
    """Time limits for instruments: how long [s] an instrument may take beyond its expected duration, and the interval [s] between
    queries."""

    table: float = 60.0
    chamber: float = 1800.0
    poll: float = 0.1


class Reaching:
    """Brings the bench to the states of the segments. The object remembers the last commands, so that nothing is moved
    unnecessarily."""

    def __init__(self, bench: ConnectedBench, lookout: Lookout, patience: Patience, say: Callable[[str], None]):
        self._bench = bench
        self._clock = bench.clock
        self._lookout = lookout
        self._patience = patience
        self._say = say
        self._chamber = bench.chamber
        self._table = bench.table
        self._sensor = bench.sensor
        # Asked once: what a class can do does not change, and asking takes longer than a short step.
        self._orients = bench.table if isinstance(bench.table, HoldsOrientation) else None
        self.temperature: float | None = None
        self.attitude: Array | None = None
        self.mode: str | None = None
        self.mode_since: float | None = None
        """Time of the mode command on the bench's clock, s; None after an interruption."""
        self.soak_again = True
        """False at first and after an interruption, when the time of the sensor at its temperature is unknown."""
        self.moving_perhaps = False
        """False after an interruption, when the table may be moving."""

    def forget(self) -> None:
        """Forgets the last commands, because the bench was made safe."""
        self.temperature, self.attitude, self.mode, self.mode_since = None, None, None, None
        self.soak_again = self.moving_perhaps = True

    def reach(self, segment: Segment) -> None:
        """Brings the bench to the segment's state and waits until it has settled. Raises `InstrumentError` and
        `StoppedAtOnceError`."""
        self._reach_temperature(segment)
        self._orient(segment)
        self._enter_mode(segment)
        motion, dwell = segment.motion, segment.dwell or 0.0
        if isinstance(motion, Rest) or self._table is None:
            self._settle(segment)
        elif isinstance(motion, Spin):
            settling = segment.stable.patience if segment.stable and self._lookout.sees else segment.settle
            self._begin_motion(segment, settling + dwell)
            self._settle(segment)
        else:  # a temperature profile is recorded from its beginning
            self._settle(segment)
            self._begin_motion(segment, dwell)
        if segment.ramp_to is not None and self._chamber is not None:
            _heater(self._chamber).set_temperature(segment.ramp_to)
            self.temperature = None

    def come_to_rest(self, segment: Segment) -> None:
        """Ends the segment's motion."""
        if not isinstance(segment.motion, Rest) and isinstance(self._table, Moves):
            self._stop(self._table)

    def _stop(self, table: Moves) -> None:
        self._say("coming to rest")
        expected = table.end_motion()
        self._wait(expected, self._holds_orientation, "the table does not come to rest", self._patience.table)

    def pause(self, seconds: float) -> None:
        """Sleeps on the bench's clock and supervises the bench. Raises the errors of `Lookout.look`."""
        self._lookout.pause(seconds)

    def _settle(self, segment: Segment) -> None:
        if segment.settle > 0:
            self._say("settling")
            self._wait_until_settled(segment, segment.settle, segment.stable)

    def _wait_until_settled(self, segment: Segment, seconds: float, stability: Stability | None) -> None:
        """Waits for a fixed time. If the plan names quantities to settle and instruments measure them, waits instead until these
        quantities have stayed within their limits for that time."""
        if stability is None or not self._lookout.sees:
            self.pause(seconds)
            return
        momentary = {name: limit for name, limit in stability.limits.items() if name != "temperature_drift"}
        readings = readings_of(self._bench, segment, stability.duration)
        begun = within_since = self._clock.now()
        while True:
            self._lookout.look(fresh=True)
            now = self._clock.now()
            values = readings.take(now, self._lookout.conditions)
            if unread(momentary, values) or outside(momentary, values):
                within_since = now
            wrong = unread(stability.limits, values) + outside(stability.limits, values)
            if not wrong and now - within_since >= stability.duration:
                return
            if now - begun >= stability.patience:
                raise InstrumentError(_unsettled(segment, stability, wrong))
            self.pause(min(EVERY, stability.duration / 5))

    def _reach_temperature(self, segment: Segment) -> None:
        kelvin = segment.temperature
        if kelvin is None or self._chamber is None or kelvin == self.temperature:
            return
        self._say("reaching the temperature")
        self.temperature = None
        chamber = _heater(self._chamber)
        expected = float(chamber.set_temperature(kelvin))
        what = f"the chamber does not reach {kelvin - ZERO_CELSIUS:.1f} degC"
        self._wait(expected, chamber.at_temperature, what, self._patience.chamber)
        if segment.soak > 0 and (expected > 0 or self.soak_again):
            self._say("soaking")
            self._wait_until_settled(segment, segment.soak, segment.soaked)
        self.temperature, self.soak_again = kelvin, False

    def _enter_mode(self, segment: Segment) -> None:
        if segment.mode is None or segment.mode == self.mode or not isinstance(self._sensor, HasModes):
            return
        self._say(f"entering the mode {segment.mode}")
        self.mode = None
        self.mode_since = self._clock.now()
        self.pause(self._sensor.set_mode(segment.mode))
        self.mode = segment.mode

    def _orient(self, segment: Segment) -> None:
        attitude = segment.attitude
        if attitude is None or self._table is None or attitude is self.attitude:
            return
        if self.attitude is not None and (attitude == self.attitude).all():
            return
        table = self._orients
        if table is None:
            raise InstrumentError("the table's driver cannot take an orientation: use another driver")
        self._stand_still()
        self._say("moving the table")
        self.attitude = None
        expected = table.orient(attitude)
        self._wait(expected, table.holding, f"the table does not hold '{segment.orientation}'", self._patience.table)
        self.attitude = attitude

    def _begin_motion(self, segment: Segment, seconds: float) -> None:
        if not isinstance(self._table, Moves):
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
        if self.moving_perhaps and isinstance(self._table, Moves):
            self._stop(self._table)
        self.moving_perhaps = False

    def _holds_orientation(self) -> bool:
        return self._orients is None or bool(self._orients.holding())

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
                    "Check its display, cables, interlocks and limits, then resume the run"
                )
            self.pause(self._patience.poll)


def _heater(chamber: Instrument) -> HoldsTemperature:
    """The chamber as an instrument that can set a temperature. Raises `InstrumentError` if it cannot."""
    if not isinstance(chamber, HoldsTemperature):
        raise InstrumentError(
            "the chamber's driver cannot set a temperature: use another driver or leave temperature out"
        )
    return chamber


def _unsettled(segment: Segment, stability: Stability, wrong: list[str]) -> str:
    why = "; ".join(wrong) or f"the readings do not stay within their limits for {stability.duration:g} s"
    return (
        f"'{segment.label}' has not settled within {stability.patience:g} s: {why}. Check the instruments and their "
        f"surroundings, or allow more time or wider limits in the plan, then resume the run"
    )

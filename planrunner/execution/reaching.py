"""Brings the bench to the state of a segment, checks while the segment is recorded that the bench holds this state, and brings the
bench to rest.

A command returns at once, and gives the time that its execution is expected to take. After this time on the bench's clock, the
instrument is queried until it has reached the state, or until a time-out. A plan can name quantities that must settle. If
instruments measure these quantities, planrunner waits until all of them have settled; otherwise, it waits for a fixed time. The
temperature is set only when it changes; the orientation is set only when it changes, or after a motion.

Readings of the instruments, under the names that plans use, decide whether a quantity has settled before a segment is recorded. The
same readings decide whether the temperature stays within its limits while the segment is recorded.

On a simulated bench, the state reached is stored with every segment, so that the run can continue after a crash (`Continuity`). On
a real bench, nothing is stored, because the state of real instruments cannot be restored from data. After an interruption, nothing
is assumed about the state of the instruments.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from planrunner.archive.resuming import ResumePoint
from planrunner.base.arrays import Array
from planrunner.base.documents import JsonObject
from planrunner.execution.connected_bench import ConnectedBench
from planrunner.execution.lookout import EVERY, Lookout
from planrunner.instruments.interfaces import (
    Condition,
    FrameCounts,
    HasModes,
    HoldsOrientation,
    HoldsTemperature,
    Instrument,
    InstrumentError,
    Moves,
    Resumable,
)
from planrunner.plan.schedule import Rest, Segment, Spin, Stability, Watch
from planrunner.plan.units import ZERO_CELSIUS


@dataclass(frozen=True, slots=True)
class Patience:
    """Time limits for instruments: the time [s] that an instrument may take beyond the expected duration of a command, and the
    interval [s] between queries."""

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
        """True if the next segment needs its soak even if the setpoint does not change. This is the case at the start and after an
        interruption, because it is then unknown how long the sensor has been at its temperature."""
        self.moving_perhaps = False
        """True after an interruption, because the table may then be moving and must be stopped before the next move."""

    def forget(self) -> None:
        """Forgets the last commands, because the bench was made safe."""
        self.temperature, self.attitude, self.mode, self.mode_since = None, None, None, None
        self.soak_again = self.moving_perhaps = True

    def reach(self, segment: Segment) -> None:
        """Brings the bench to the segment's state and waits until it has settled. Raises `InstrumentError` if the state cannot be
        reached, and `StoppedAtOnceError` if the operator requested an immediate stop."""
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
        """Waits until the quantities that must settle have stayed within their limits for the required time. If the plan names no
        such quantities, or if no instrument measures them, waits for `seconds` instead."""
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


class Continuity:
    """Reads and restores the states from which a run can continue after a crash: the states of the bench's simulated instruments,
    and the last commands (held in `reaching`)."""

    def __init__(self, bench: ConnectedBench, reaching: Reaching):
        self._bench = bench
        self._reaching = reaching
        self._resumable = {name: item for name, item in bench.instruments.items() if isinstance(item, Resumable)}

    def states(self) -> JsonObject:
        """Returns the states of the simulated instruments and of the executor as JSON data; empty on a real bench."""
        if not self._resumable:
            return {}
        reaching, attitude = self._reaching, self._reaching.attitude
        executor = {
            "temperature": reaching.temperature,
            "attitude": None if attitude is None else attitude.tolist(),
            "soak_again": reaching.soak_again,
            "mode": reaching.mode,
            "mode_since": reaching.mode_since,
            "moving_perhaps": reaching.moving_perhaps,
        }
        return {
            "executor": executor,
            "instruments": {name: item.checkpoint() for name, item in self._resumable.items()},
        }

    def states_if_known(self) -> JsonObject:
        """Does the same as `states` after a failure. The result is empty if a driver that has failed does not know its state."""
        self._reaching.forget()
        try:
            return self.states()
        except BaseException:  # a driver that has failed may not know its state
            return {}

    def restore(self, point: ResumePoint) -> None:
        """Restores the states that were stored before the run was interrupted."""
        self._bench.clock.set(point.clock)
        self._reaching.forget()
        # Simulated instruments get back their exact state; without an acknowledged segment they start anew.
        simulated_table = isinstance(self._bench.table, Resumable)
        simulated_chamber = isinstance(self._bench.chamber, Resumable)
        self._reaching.moving_perhaps = not simulated_table
        if not point.states:
            return
        executor, instruments = point.states["executor"], point.states["instruments"]
        for name, item in self._resumable.items():
            if name in instruments:
                item.restore(instruments[name])
        if simulated_table:
            attitude = executor["attitude"]
            self._reaching.attitude = None if attitude is None else np.array(attitude, dtype=np.float64)
            self._reaching.moving_perhaps = executor["moving_perhaps"]
        if isinstance(self._bench.sensor, Resumable):
            self._reaching.mode = executor["mode"]
            self._reaching.mode_since = executor.get("mode_since")
        if simulated_chamber:
            self._reaching.temperature, self._reaching.soak_again = executor["temperature"], executor["soak_again"]


def _heater(chamber: Instrument) -> HoldsTemperature:
    """Returns the chamber as an instrument that can set a temperature. Raises `InstrumentError` if the driver of the chamber cannot
    set a temperature."""
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


DRIFT_OVER = 60.0
"""Time over which the drift of a temperature is measured while a segment is recorded, s."""
SHOWN = {
    "position_error": ("arcsec", 180 * 3600 / math.pi),
    "rate_error": ("deg/s", 180 / math.pi),
    "temperature_error": ("K", 1.0),
    "temperature_drift": ("K/min", 60.0),
}


@dataclass(slots=True)
class Readings:
    """Collects the readings while the bench is in one state.

    `over`: time [s] over which a drift is measured. `chamber`: name of the instrument whose temperature is compared with `setpoint`
    [K]. `drifting`: names of the instruments whose temperature must not drift.
    """

    over: float
    chamber: str | None = None
    setpoint: float | None = None
    drifting: tuple[str, ...] = ()
    _courses: dict[str, deque[tuple[float, float]]] = field(default_factory=dict)

    def take(self, now: float, conditions: Mapping[str, Condition]) -> dict[str, float]:
        """Maps each known reading to its current value in SI units. If several instruments report the same reading, the worst value
        is taken."""
        found: dict[str, float] = {}
        for name, condition in conditions.items():
            for reading in ("position_error", "rate_error"):
                if reading in condition.values:
                    found[reading] = max(found.get(reading, 0.0), abs(condition.values[reading]))
            kelvin = condition.values.get("temperature")
            if kelvin is None:
                continue
            if name == self.chamber and self.setpoint is not None:
                found["temperature_error"] = abs(kelvin - self.setpoint)
            drift = self._drift(name, now, kelvin) if name in self.drifting else None
            if drift is not None:
                found["temperature_drift"] = max(found.get("temperature_drift", 0.0), drift)
        return found

    def _drift(self, name: str, now: float, kelvin: float) -> float | None:
        """Returns the drift |dT/dt| [K/s], which is the slope of a straight line fitted to the temperatures of the last `over`
        seconds; None before this time has passed."""
        course = self._courses.setdefault(name, deque())
        course.append((now, kelvin))
        while course and now - course[0][0] > self.over * (1 + 1e-9) and now - course[1][0] >= self.over:
            course.popleft()
        if now - course[0][0] < self.over * (1 - 1e-9):
            return None
        time, temperature = np.array(course).T
        time = time - time.mean()
        return float(abs(time @ temperature) / (time @ time))


def readings_of(bench: ConnectedBench, segment: Segment, over: float) -> Readings:
    """Returns the readings that apply to the state of a segment. If the temperature follows a profile, its deviation from a
    setpoint and its drift are not read. `over`: time over which a drift is measured, s."""
    if segment.ramp_to is not None:
        return Readings(over)
    names = {id(item): name for name, item in bench.instruments.items()}
    held = [names[id(item)] for item in (bench.chamber, bench.sensor) if id(item) in names]
    return Readings(over, names.get(id(bench.chamber)), segment.temperature, tuple(held))


def outside(limits: Mapping[str, float], values: Mapping[str, float]) -> list[str]:
    """Returns a text for each reading that exceeds its limit. A limit without a known reading is ignored. `values`: maps each known
    reading to its value."""
    return [
        f"{_shown(name, values[name])} is more than the {_amount(name, limit)} that the plan allows"
        for name, limit in limits.items()
        if name in values and values[name] > limit
    ]


def unread(limits: Mapping[str, float], values: Iterable[str]) -> list[str]:
    """Returns a text for each limit whose quantity no instrument has reported."""
    return [f"no instrument reports the {name.replace('_', ' ')}" for name in limits if name not in values]


def frames_outside(watch: Watch, counts: FrameCounts) -> list[str]:
    """Returns a text for each fraction of lost or corrupt frames that exceeds its limit. Frames dropped by the computer count as
    lost."""
    whole = counts.received + counts.lost + counts.corrupt + counts.overflowed
    shares = {
        "lost": (watch.lost, counts.lost + counts.overflowed),
        "corrupt": (watch.corrupt, counts.corrupt),
    }
    return [
        f"{count} of {whole} frames were {name} ({count / whole:.3g}), more than the {limit:.3g} that the plan allows"
        for name, (limit, count) in shares.items()
        if limit is not None and whole and count > limit * whole
    ]


def _shown(name: str, value: float) -> str:
    return f"{name.replace('_', ' ')} {_amount(name, value)}"


def _amount(name: str, value: float) -> str:
    unit, factor = SHOWN[name]
    return f"{value * factor:.4g} {unit}"


class LimitPassedError(Exception):
    """The error for a limit of the plan that was exceeded while a segment was recorded. The message names the limit."""


class Holding:
    """One attempt to record a segment, from the beginning of its dwell."""

    def __init__(
        self, bench: ConnectedBench, lookout: Lookout, segment: Segment, counts: Callable[[], FrameCounts] | None = None
    ):
        """`counts`: the frame counter of the sensor; None if it has none."""
        self._clock, self._lookout = bench.clock, lookout
        self._counts = counts
        self._watch = segment.watch or Watch()
        self._readings = readings_of(bench, segment, DRIFT_OVER)
        self._moves = segment.ramp_to is not None
        self._looks = lookout.looks
        self._begun = False
        self._seen: set[str] = set()

    def check(self, fresh: bool = False) -> None:
        """Checks the bench if a check is due, or immediately on request. Raises `LimitPassedError` and the errors of
        `Lookout.look`. `fresh`: True for an immediate check."""
        self._lookout.look(fresh=fresh or not self._begun)
        self._begun = True
        if self._looks == self._lookout.looks:
            return
        self._looks = self._lookout.looks
        conditions = self._lookout.conditions
        values = self._readings.take(self._clock.now(), conditions)
        self._seen.update(values)
        passed = outside(self._watch.limits, values)
        if self._watch.doubts:
            passed += [
                f"'{name}' marks its samples as doubtful ({doubt})"
                for name, now in conditions.items()
                for doubt in now.doubts
            ]
        if passed:
            raise LimitPassedError("; ".join(passed))

    def finish(self) -> FrameCounts | None:
        """Returns the frame counts of the sensor (None if it does not count frames), after a last check that finds failures up to
        the end of the dwell. Raises the errors of `check`, and `LimitPassedError` if too many frames are lost or corrupt."""
        self.check(fresh=True)
        counts = self.counts()
        passed = [] if counts is None else frames_outside(self._watch, counts)
        if passed:
            raise LimitPassedError("; ".join(passed))
        return counts

    def counts(self) -> FrameCounts | None:
        return None if self._counts is None else self._counts()

    def unjudged(self) -> list[str]:
        """Returns a text for each limit whose quantity had no reading during the dwell; empty on a bench without readings."""
        if not self._looks or self._moves:
            return []
        return unread(self._watch.limits, self._seen)

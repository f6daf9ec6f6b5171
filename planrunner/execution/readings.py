"""Readings of the current state under the names used in plans: for settling before a segment is recorded, and for limits while it
is recorded."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from planrunner.execution.connected_bench import ConnectedBench
from planrunner.execution.lookout import Lookout
from planrunner.instruments.interfaces import Condition, FrameCounts
from planrunner.plan.schedule import Segment, Watch

DRIFT_OVER = 60.0
"""Seconds over which the drift of a temperature is measured while a segment records."""
SHOWN = {
    "position_error": ("arcsec", 180 * 3600 / math.pi),
    "rate_error": ("deg/s", 180 / math.pi),
    "temperature_error": ("K", 1.0),
    "temperature_drift": ("K/min", 60.0),
}


@dataclass(slots=True)
class Readings:
    """Collects the readings while the bench is in one state. over: time [s] over which a drift is measured. chamber: name of the
    instrument whose temperature is compared with `setpoint` [K]. drifting: names of the instruments whose temperature must not
    drift."""

    over: float
    chamber: str | None = None
    setpoint: float | None = None
    drifting: tuple[str, ...] = ()
    _courses: dict[str, deque[tuple[float, float]]] = field(default_factory=dict)

    def take(self, now: float, conditions: Mapping[str, Condition]) -> dict[str, float]:
        """Maps each known reading to its current value in SI units. If several instruments report the same reading, the worst value
        counts."""
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
        """The drift |dT/dt| [K/s] from a straight line fitted to the temperatures of the last `over` seconds; None before that time
        has passed."""
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
    """The readings that apply to the state of a segment. If the temperature follows a profile, its deviation and its drift are not
    read."""
    if segment.ramp_to is not None:
        return Readings(over)
    names = {id(item): name for name, item in bench.instruments.items()}
    held = [names[id(item)] for item in (bench.chamber, bench.sensor) if id(item) in names]
    return Readings(over, names.get(id(bench.chamber)), segment.temperature, tuple(held))


def outside(limits: Mapping[str, float], values: Mapping[str, float]) -> list[str]:
    """A text for each reading that exceeds its limit; limits without a known reading are omitted."""
    return [
        f"{_shown(name, values[name])} is more than the {_amount(name, limit)} that the plan allows"
        for name, limit in limits.items()
        if name in values and values[name] > limit
    ]


def unread(limits: Mapping[str, float], values: Iterable[str]) -> list[str]:
    """A text for each limit whose quantity no instrument has reported."""
    return [f"no instrument reports the {name.replace('_', ' ')}" for name in limits if name not in values]


def frames_outside(watch: Watch, counts: FrameCounts) -> list[str]:
    """A text for each fraction of lost or corrupt frames that exceeds its limit. Frames dropped by the computer count as lost."""
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
        """counts: the frame counter of the sensor; None if it has none."""
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
        `Lookout.look`."""
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
        """Returns the frame counts of the sensor, after a last check that finds failures up to the end of the dwell. Raises the
        errors of `check`, and `LimitPassedError` if too many frames are lost or corrupt."""
        self.check(fresh=True)
        counts = self.counts()
        passed = [] if counts is None else frames_outside(self._watch, counts)
        if passed:
            raise LimitPassedError("; ".join(passed))
        return counts

    def counts(self) -> FrameCounts | None:
        return None if self._counts is None else self._counts()

    def unjudged(self) -> list[str]:
        """A text for each limit whose quantity had no reading during the dwell; empty on a bench without readings."""
        if not self._looks or self._moves:
            return []
        return unread(self._watch.limits, self._seen)

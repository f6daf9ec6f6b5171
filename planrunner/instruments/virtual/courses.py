"""Describes motions of virtual tables. Each implementation of `Course` describes one kind of motion, and computes the joint angles
and rates at given times.

A motion can be stored as JSON data, so that a resumed run starts with the table in the same state. The angles of joints at rest are
plain floats, so no arrays are computed if nothing moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from typing import ClassVar, Protocol

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json, JsonObject
from planrunner.physics.kinematics import TableAxis, move_time

Value = float | Array
TURN = 2 * math.pi


@dataclass(frozen=True, slots=True)
class Stretch:
    """Describes a time interval [s] within which the motion of a table is smooth. `pace`: the largest rate of change, rad/s, of the
    phases of the sines in the motion; 0 if nothing moves."""

    begin: float
    end: float
    pace: float


class Course(Protocol):
    """A motion of a table. `kind`: name of the kind of motion in JSON data."""

    kind: ClassVar[str]

    def follow(self, times: Array) -> list[tuple[Value, Value]]:
        """Returns the angle [rad] and the rate [rad/s] of every joint at `times` [s since the start of the run]."""

    def still(self, start: float) -> bool:
        """Returns True if nothing moves after the time `start`."""

    def stretches(self, begin: float, end: float) -> list[Stretch]:
        """Returns the intervals of smooth motion between two times, in order."""


@dataclass(frozen=True, slots=True)
class Standing:
    """A motion in which every joint stays at rest."""

    kind: ClassVar[str] = "standing"
    angles: tuple[float, ...]

    def follow(self, times: Array) -> list[tuple[Value, Value]]:
        return [(angle, 0.0) for angle in self.angles]

    def still(self, start: float) -> bool:
        return True

    def stretches(self, begin: float, end: float) -> list[Stretch]:
        return [Stretch(begin, end, 0.0)]


@dataclass(frozen=True, slots=True)
class Travelling:
    """A motion that takes the joints from rest to rest. Every joint has its own trapezoidal rate profile."""

    kind: ClassVar[str] = "travelling"
    begin: float
    start: tuple[float, ...]
    end: tuple[float, ...]
    rates: tuple[float, ...]
    accelerations: tuple[float, ...]

    @property
    def arrival(self) -> float:
        joints = zip(self.start, self.end, self.rates, self.accelerations, strict=True)
        return self.begin + max(move_time(end - start, rate, acc) for start, end, rate, acc in joints)

    def follow(self, times: Array) -> list[tuple[Value, Value]]:
        joints = zip(self.start, self.end, self.rates, self.accelerations, strict=True)
        moved = [(start, trapezoid(times - self.begin, end - start, rate, acc)) for start, end, rate, acc in joints]
        return [(start + angle, rate) for start, (angle, rate) in moved]

    def still(self, start: float) -> bool:
        return start >= self.arrival

    def stretches(self, begin: float, end: float) -> list[Stretch]:
        breaks = [self.begin]
        pace = 0.0
        for start, stop, rate, acceleration in zip(self.start, self.end, self.rates, self.accelerations, strict=True):
            up, total = profile(stop - start, rate, acceleration)
            breaks += [self.begin + up, self.begin + total - up, self.begin + total]
            pace += min(rate, up * acceleration) + math.sqrt(acceleration)
        return _cut(begin, end, breaks, lambda time: pace if self.begin < time < self.arrival else 0.0)


@dataclass(frozen=True, slots=True)
class Spinning:
    """A motion in which one joint changes from one rate to another with constant acceleration and then keeps the new rate; the
    other joints are at rest."""

    kind: ClassVar[str] = "spinning"
    begin: float
    angles: tuple[float, ...]
    joint: int
    first_rate: float
    rate: float
    acceleration: float

    @property
    def steady(self) -> float:
        return self.begin + abs(self.rate - self.first_rate) / self.acceleration

    def follow(self, times: Array) -> list[tuple[Value, Value]]:
        joints: list[tuple[Value, Value]] = [(angle, 0.0) for angle in self.angles]
        elapsed = times - self.begin
        change = self.steady - self.begin
        in_change = np.minimum(elapsed, change)
        gain = math.copysign(self.acceleration, self.rate - self.first_rate)
        angle = self.angles[self.joint] + (self.first_rate + 0.5 * gain * in_change) * in_change
        angle += self.rate * (elapsed - in_change)
        rate = np.where(elapsed >= change, self.rate, self.first_rate + gain * in_change)
        joints[self.joint] = (angle, rate)
        return joints

    def still(self, start: float) -> bool:
        return self.rate == 0.0 and start >= self.steady

    def stretches(self, begin: float, end: float) -> list[Stretch]:
        changing = max(abs(self.first_rate), abs(self.rate)) + math.sqrt(self.acceleration)
        return _cut(begin, end, [self.steady], lambda time: changing if time < self.steady else abs(self.rate))


@dataclass(frozen=True, slots=True)
class Rocking:
    """A motion in which joints rock sinusoidally about `angles`. At the time `steady`, the sines have the phases `phases`. The
    rocking fades in during one rocking period before `steady`. It fades out during one rocking period after `steady` + `duration`,
    so that no joint jumps."""

    kind: ClassVar[str] = "rocking"
    steady: float
    angles: tuple[float, ...]
    amplitude: float
    frequency: float
    phases: tuple[float, ...]
    duration: float

    def follow(self, times: Array) -> list[tuple[Value, Value]]:
        elapsed = times - self.steady
        period = 1 / self.frequency
        envelope_in, slope_in = _fade(elapsed + period, period)
        envelope, slope = envelope_in, slope_in
        if math.isfinite(self.duration):
            envelope_out, slope_out = _fade(elapsed - self.duration, period)
            envelope, slope = envelope_in - envelope_out, slope_in - slope_out
        joints: list[tuple[Value, Value]] = [(angle, 0.0) for angle in self.angles]
        circular = TURN * self.frequency
        for joint, phase in enumerate(self.phases):
            sine, cosine = np.sin(circular * elapsed + phase), np.cos(circular * elapsed + phase)
            angle = self.angles[joint] + self.amplitude * envelope * sine
            joints[joint] = (angle, self.amplitude * (slope * sine + envelope * circular * cosine))
        return joints

    def still(self, start: float) -> bool:
        return start >= self.over

    def stretches(self, begin: float, end: float) -> list[Stretch]:
        # The pace includes the sine, its fading, and the joints that carry one another. If the rocking fades out
        # while it is still fading in, both rates may add up.
        circular = TURN * self.frequency
        pace = circular * (2 + 2 * self.amplitude * len(self.phases))
        breaks = [self.steady - 1 / self.frequency, self.steady, self.steady + self.duration, self.over]
        return _cut(begin, end, breaks, lambda time: pace if breaks[0] < time < self.over else 0.0)

    @property
    def over(self) -> float:
        """Returns the time at which the joints are at rest again [s since the start of the run]."""
        return self.steady + self.duration + 1 / self.frequency

    @property
    def begins(self) -> float:
        """Returns the time at which the joints begin to move [s since the start of the run]."""
        return self.steady - 1 / self.frequency

    def ended(self, now: float) -> Rocking:
        """Returns the same rocking, except that it begins to fade out at the time `now` or earlier. The rocking must have begun
        before `now`."""
        return replace(self, duration=min(self.duration, now - self.steady))


@dataclass(frozen=True, slots=True)
class Cycling:
    """A motion in which one joint repeats a sequence of stops and turns. The rate of each turn has a trapezoidal profile."""

    kind: ClassVar[str] = "cycling"
    begin: float
    angles: tuple[float, ...]
    joint: int
    turns: tuple[float, ...]
    rate: float
    acceleration: float
    stop: float

    def follow(self, times: Array) -> list[tuple[Value, Value]]:
        begins, reached, turns = self._schedule()
        cycles, within = np.divmod(times - self.begin, begins[-1])
        index = np.clip(np.searchsorted(begins, within, side="right") - 1, 0, len(self.turns) - 1)
        turning = within - begins[index] - self.stop
        turn, rate = trapezoid(turning, turns[index], self.rate, self.acceleration)
        joints: list[tuple[Value, Value]] = [(angle, 0.0) for angle in self.angles]
        joints[self.joint] = (self.angles[self.joint] + cycles * reached[-1] + reached[index] + turn, rate)
        return joints

    def _schedule(self) -> tuple[Array, Array, Array]:
        """Returns, for one cycle of n turns: the times [s] at which each stop begins, and the end of the cycle; the angles [rad] at
        these times; and the turns [rad]. The first two arrays have the shape (n + 1,), the last one (n,)."""
        lasting = [self.stop + move_time(turn, self.rate, self.acceleration) for turn in self.turns]
        turns = np.array(self.turns)
        return np.concatenate(([0.0], np.cumsum(lasting))), np.concatenate(([0.0], np.cumsum(turns))), turns

    def still(self, start: float) -> bool:
        return False

    def stretches(self, begin: float, end: float) -> list[Stretch]:
        lasting, _, _ = self._schedule()
        profiles = [profile(turn, self.rate, self.acceleration) for turn in self.turns]
        found: list[Stretch] = []
        cycle = math.floor((begin - self.begin) / lasting[-1])
        while (zero := self.begin + cycle * lasting[-1]) < end:
            for since, (up, total) in zip(lasting, profiles, strict=False):
                stop, turn = zero + since, zero + since + self.stop
                ramping = self.acceleration * up + math.sqrt(self.acceleration)
                found += [
                    Stretch(stop, turn, 0.0),
                    Stretch(turn, turn + up, ramping),
                    Stretch(turn + up, turn + total - up, self.acceleration * up),
                    Stretch(turn + total - up, turn + total, ramping),
                ]
            cycle += 1
        clipped = (Stretch(max(item.begin, begin), min(item.end, end), item.pace) for item in found)
        return [item for item in clipped if item.begin < item.end]


def _cut(begin: float, end: float, breaks: Sequence[float], pace: Callable[[float], float]) -> list[Stretch]:
    """Returns the intervals of smooth motion between two times, divided at the given breaks. `pace`: function that returns, for the
    time in the middle of an interval, the largest rate of change of the phases."""
    times = [begin, *sorted(time for time in set(breaks) if begin < time < end), end]
    return [Stretch(first, last, pace((first + last) / 2)) for first, last in pairwise(times)]


def profile(distance: float, max_rate: float, acceleration: float) -> tuple[float, float]:
    """Returns the time [s] of the acceleration phase, and the total time [s], of a move from rest to rest over `distance` [rad].
    `max_rate`, `acceleration`: rad/s and rad/s²."""
    up = min(max_rate, math.sqrt(abs(distance) * acceleration)) / acceleration
    return up, move_time(distance, max_rate, acceleration)


def trapezoid(elapsed: Array, distance: Value, max_rate: float, acceleration: float) -> tuple[Array, Array]:
    """Computes the angle [rad] and the rate [rad/s] of a move from rest to rest, at the times `elapsed` [s]. Before and after the
    move, angle and rate are constant. `distance`: length of the move, rad, which may be negative. `max_rate`, `acceleration`: rad/s
    and rad/s². The results have the shape of `elapsed`."""
    size, sign = np.abs(distance), np.sign(distance)
    peak = np.minimum(max_rate, np.sqrt(size * acceleration))
    up = peak / acceleration
    total = up + np.divide(size, peak, out=np.zeros(np.shape(peak)), where=peak > 0)
    time = np.clip(elapsed, 0.0, total)
    rising, falling = np.minimum(time, up), np.maximum(time - (total - up), 0.0)
    steady = time - rising - falling
    angle = 0.5 * acceleration * rising**2 + peak * steady + (peak - 0.5 * acceleration * falling) * falling
    rate = acceleration * (rising - falling)
    return sign * angle, sign * rate


def _fade(elapsed: Array, period: float) -> tuple[Array, Array]:
    """Returns a smooth step from 0 to 1 (half a cosine wave), and its slope [1/s]. Both have the shape of `elapsed`. `elapsed`:
    times since the start of the step, s. `period`: duration of the step, s."""
    phase = np.clip(elapsed / period, 0.0, 1.0) * math.pi
    return 0.5 * (1 - np.cos(phase)), 0.5 * math.pi / period * np.sin(phase)


StatedCourse = Standing | Travelling | Spinning | Rocking | Cycling
_KINDS: Mapping[str, Callable[..., Course]] = {
    kind.kind: kind for kind in (Standing, Travelling, Spinning, Rocking, Cycling)
}


def to_json(course: Course) -> JsonObject:
    """Converts a motion to JSON data. An infinite duration becomes null."""
    assert isinstance(course, StatedCourse)
    state = {name: None if value == math.inf else value for name, value in asdict(course).items()}
    return {"kind": course.kind, **state}


def from_json(state: Mapping[str, Json]) -> Course:
    """Converts the JSON data of `to_json` back to a motion."""
    values = {name: value for name, value in state.items() if name != "kind"}
    made = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    course: Course = _KINDS[state["kind"]](**{name: math.inf if v is None else v for name, v in made.items()})
    return course


def travel(axes: Sequence[TableAxis], begin: float, start: Sequence[float], end: Sequence[float]) -> Travelling:
    """Returns the motion from the joint angles `start` to the joint angles `end` [rad], which begins at the time `begin` [s]. Every
    joint moves with the largest rate and acceleration of its axis."""
    rates, accelerations = tuple(a.max_rate for a in axes), tuple(a.max_acceleration for a in axes)
    return Travelling(begin, tuple(map(float, start)), tuple(map(float, end)), rates, accelerations)

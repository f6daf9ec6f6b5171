"""Courses: the joint angles and rates of a virtual table over time, one small class a kind of motion.

A course answers for any time after it began, for arrays of times, and can be written down as JSON data and read back,
so that a run that is resumed finds the table where it was. Joints that stand still are plain floats, so that whoever
follows the course need not compute with arrays where nothing moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from planrunner.physics.kinematics import TableAxis, move_time

Array = NDArray[np.float64]
Value = float | Array
TURN = 2 * math.pi


class Course(Protocol):
    kind: ClassVar[str]

    def follow(self, times: Array) -> list[tuple[Value, Value]]:
        """(angle [rad], rate [rad/s]) of every joint at `times` [s since the run began]."""

    def still(self, start: float) -> bool:
        """Whether nothing moves from `start` on."""


@dataclass(frozen=True, slots=True)
class Standing:
    """At rest."""

    kind: ClassVar[str] = "standing"
    angles: tuple[float, ...]

    def follow(self, times: Array) -> list[tuple[Value, Value]]:
        return [(angle, 0.0) for angle in self.angles]

    def still(self, start: float) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class Travelling:
    """From rest to rest, every joint with its own trapezoidal rate profile."""

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


@dataclass(frozen=True, slots=True)
class Spinning:
    """One joint changes from one rate to another at constant acceleration, then keeps it; the others stand."""

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


@dataclass(frozen=True, slots=True)
class Rocking:
    """Joints rock sinusoidally about `angles`: phase zero at `steady`, faded in over one period before it and out
    over one after `duration`, so that no joint jumps."""

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
        return start >= self.steady + self.duration + 1 / self.frequency


@dataclass(frozen=True, slots=True)
class Cycling:
    """One joint repeats stops and turns: stop, turn, stop, turn …; turns have trapezoidal rate profiles."""

    kind: ClassVar[str] = "cycling"
    begin: float
    angles: tuple[float, ...]
    joint: int
    turns: tuple[float, ...]
    rate: float
    acceleration: float
    stop: float

    def follow(self, times: Array) -> list[tuple[Value, Value]]:
        lasting = np.array([self.stop + move_time(turn, self.rate, self.acceleration) for turn in self.turns])
        begins = np.concatenate(([0.0], np.cumsum(lasting)))
        reached = np.concatenate(([0.0], np.cumsum(self.turns)))
        cycles, within = np.divmod(times - self.begin, begins[-1])
        index = np.clip(np.searchsorted(begins, within, side="right") - 1, 0, len(self.turns) - 1)
        turning = within - begins[index] - self.stop
        turn, rate = trapezoid(turning, np.array(self.turns)[index], self.rate, self.acceleration)
        joints: list[tuple[Value, Value]] = [(angle, 0.0) for angle in self.angles]
        joints[self.joint] = (self.angles[self.joint] + cycles * reached[-1] + reached[index] + turn, rate)
        return joints

    def still(self, start: float) -> bool:
        return False


def trapezoid(elapsed: Array, distance: Value, max_rate: float, acceleration: float) -> tuple[Array, Array]:
    """Angle and rate at `elapsed` s of a rest-to-rest move over `distance` [rad, either sign]; held before and
    after.
    """
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
    """A smooth step from 0 to 1 over one period (half a cosine) and its slope."""
    phase = np.clip(elapsed / period, 0.0, 1.0) * math.pi
    return 0.5 * (1 - np.cos(phase)), 0.5 * math.pi / period * np.sin(phase)


_KINDS: Mapping[str, Any] = {kind.kind: kind for kind in (Standing, Travelling, Spinning, Rocking, Cycling)}


def to_json(course: Any) -> dict[str, Any]:
    """The course as JSON data; an endless duration is written as null."""
    state = {name: None if value == math.inf else value for name, value in asdict(course).items()}
    return {"kind": course.kind, **state}


def from_json(state: Mapping[str, Any]) -> Course:
    values = {name: value for name, value in state.items() if name != "kind"}
    made = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    course: Course = _KINDS[state["kind"]](**{name: math.inf if v is None else v for name, v in made.items()})
    return course


def travel(axes: Sequence[TableAxis], begin: float, start: Sequence[float], end: Sequence[float]) -> Travelling:
    rates, accelerations = tuple(a.max_rate for a in axes), tuple(a.max_acceleration for a in axes)
    return Travelling(begin, tuple(map(float, start)), tuple(map(float, end)), rates, accelerations)

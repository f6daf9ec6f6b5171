"""Describes the motion of each joint of a simulated table by pieces of constant acceleration and by sines. The table's controller
commands this motion.

The virtual table moves all its joints with one command. A table with a controller is commanded axis by axis, and a command may
arrive while the axis moves. A path keeps the pieces of the last seconds, so that a sensor that is read a little later still
measures the past motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar, TypeVar

import numpy as np

from planrunner.base.arrays import Array
from planrunner.instruments.virtual.courses import Stretch, Value

Numbers = TypeVar("Numbers", float, Array)
"""A number, or an array of them."""
TURN = 2 * math.pi
_KEPT = 10.0  # s for which pieces that are over are kept


@dataclass(frozen=True, slots=True)
class Glide:
    """Describes a piece of constant acceleration that begins at the time `begin` [s]. `angle` [rad] and `rate` [rad/s] are the
    values at that time."""

    begin: float
    angle: float
    rate: float = 0.0
    acceleration: float = 0.0

    def at(self, times: Numbers) -> tuple[Numbers, Numbers]:
        since = times - self.begin
        return self.angle + (self.rate + 0.5 * self.acceleration * since) * since, self.rate + self.acceleration * since

    def pace(self, end: float) -> float:
        if self.acceleration == 0.0:
            return abs(self.rate)
        fastest = max(abs(self.rate), abs(self.rate + self.acceleration * (end - self.begin)))
        return fastest + math.sqrt(abs(self.acceleration))


@dataclass(frozen=True, slots=True)
class Swing:
    """A sine about the angle `centre`. During its first period, the amplitude [rad] changes gradually from `before` to `amplitude`.
    `zero`: time at which the sine had the phase `phase` [rad], s. `frequency`: frequency of the sine, Hz."""

    begin: float
    centre: float
    before: float
    amplitude: float
    frequency: float
    phase: float
    zero: float

    def at(self, times: Numbers) -> tuple[Numbers, Numbers]:
        circular = TURN * self.frequency
        faded = np.clip((times - self.begin) * self.frequency, 0.0, 1.0)
        step = self.amplitude - self.before
        size = self.before + step * (faded - np.sin(TURN * faded) / TURN)
        growth = step * self.frequency * (1 - np.cos(TURN * faded))
        turned = circular * (times - self.zero) + self.phase
        return self.centre + size * np.sin(turned), growth * np.sin(turned) + circular * size * np.cos(turned)

    def pace(self, end: float) -> float:
        return TURN * self.frequency * (2 + 2 * max(self.before, self.amplitude))

    def faded(self) -> float:
        """Returns the time [s] from which the amplitude is constant."""
        return self.begin + 1 / self.frequency


PathPiece = Glide | Swing


@dataclass(frozen=True, slots=True)
class Path:
    """Contains the pieces of one joint's motion in chronological order. The last piece has no end. `arrival`: time at which the commanded
    state is reached, s."""

    pieces: tuple[PathPiece, ...]
    arrival: float = 0.0

    @classmethod
    def standing(cls, angle: float) -> Path:
        return cls((Glide(0.0, angle),))

    def then(self, now: float, pieces: Sequence[PathPiece], arrival: float) -> Path:
        """Returns the path in which new pieces begin at the time `now`."""
        past = [piece for piece in self.pieces if piece.begin < now]
        ends = [*(piece.begin for piece in past[1:]), now]
        kept = [piece for piece, end in zip(past, ends, strict=False) if end > now - _KEPT]
        return Path((*kept, *pieces), arrival)

    def state(self, time: float) -> tuple[float, float, float]:
        """Returns the angle [rad], the rate [rad/s] and the acceleration [rad/s^2] at one time."""
        piece = self.current(time)
        angle, rate = piece.at(time)
        acceleration = piece.acceleration if isinstance(piece, Glide) else (piece.at(time + 1e-4)[1] - rate) / 1e-4
        return float(angle), float(rate), float(acceleration)

    def current(self, time: float) -> PathPiece:
        return next((piece for piece in reversed(self.pieces) if piece.begin <= time), self.pieces[0])

    def follow(self, times: Array) -> tuple[Value, Value]:
        """Returns the angle [rad] and the rate [rad/s] at `times`; floats if the joint is at rest at all these times."""
        first, last = self.current(float(times[0])), self.current(float(times[-1]))
        if first is last:
            if isinstance(first, Glide) and first.rate == first.acceleration == 0.0:
                return first.angle, 0.0
            angle, rate = first.at(times)
            return angle, np.broadcast_to(rate, times.shape)
        begins = np.array([piece.begin for piece in self.pieces])
        which = np.maximum(np.searchsorted(begins, times, side="right") - 1, 0)
        angles, rates = np.empty(times.shape), np.empty(times.shape)
        for index in np.unique(which):
            chosen = which == index
            angles[chosen], rates[chosen] = self.pieces[index].at(times[chosen])
        return angles, rates

    # -- commands ----------------------------------------------------------------------------------------------------

    def turn(self, now: float, rate: float, acceleration: float) -> Path:
        """Returns the path that, from the time `now` [s] on, changes to a new rate [rad/s] with the given acceleration [rad/s²]."""
        angle, first, _ = self.state(now)
        change = (rate - first) / acceleration
        ramp = Glide(now, angle, first, math.copysign(acceleration, change))
        there = now + abs(change)
        return self.then(now, (ramp, Glide(there, ramp.at(there)[0], rate)), there)

    def go(self, now: float, target: float, rate: float, acceleration: float) -> Path:
        """Returns the path that comes to rest and then moves to an angle. For this move, the joint accelerates, turns at `rate` at
        most, and decelerates. `now`: time of the command, s. `target`: the angle, rad."""
        _, first, _ = self.state(now)
        path = self.turn(now, 0.0, acceleration) if first != 0.0 else self
        start = max(now, path.arrival) if first != 0.0 else now
        angle = path.state(start)[0]
        distance, way = abs(target - angle), math.copysign(1.0, target - angle)
        top = min(rate, math.sqrt(distance * acceleration))
        if distance == 0.0:
            return path.then(start, (Glide(start, target),), start)
        ramping = top / acceleration
        steady = distance / top - ramping
        up = Glide(start, angle, 0.0, way * acceleration)
        level = Glide(start + ramping, angle + way * top * ramping / 2, way * top)
        slow = Glide(level.begin + steady, target - way * top * ramping / 2, way * top, -way * acceleration)
        rest = Glide(slow.begin + ramping, target)
        return path.then(start, (up, level, slow, rest), rest.begin)

    def swing(self, now: float, amplitude: float, frequency: float, phase: float, zero: float, about: float) -> Path:
        """Returns the path that starts, at the time `now`, a sine about the angle `about` [rad]. If the joint already performs the
        same sine with another amplitude, the amplitude changes gradually. Otherwise the sine starts with amplitude zero. The other
        arguments are described in `Swing`."""
        piece = self.current(now)
        same = isinstance(piece, Swing) and (piece.frequency, piece.phase, piece.zero) == (frequency, phase, zero)
        before = piece.amplitude if isinstance(piece, Swing) and same else 0.0
        swing = Swing(now, about, before, amplitude, frequency, phase, zero)
        return self.then(now, (swing,), swing.faded())


@dataclass(slots=True)
class JointPaths:
    """Describes the motion of a simulated table in which every joint follows its own path."""

    kind: ClassVar[str] = "joint paths"
    paths: list[Path] = field(default_factory=list)

    def follow(self, times: Array) -> list[tuple[Value, Value]]:
        return [path.follow(times) for path in self.paths]

    def still(self, start: float) -> bool:
        rest = (path.pieces[-1] for path in self.paths)
        ended = all(isinstance(last, Glide) and last.rate == last.acceleration == 0.0 for last in rest)
        return ended and all(path.pieces[-1].begin <= start for path in self.paths)

    def stretches(self, begin: float, end: float) -> list[Stretch]:
        breaks = {piece.begin for path in self.paths for piece in path.pieces}
        breaks |= {piece.faded() for path in self.paths for piece in path.pieces if isinstance(piece, Swing)}
        times = [begin, *sorted(time for time in breaks if begin < time < end), end]
        found = []
        for first, last in pairwise(times):
            middle = (first + last) / 2
            found.append(Stretch(first, last, sum(path.current(middle).pace(last) for path in self.paths)))
        return found

"""Describes the angles at which a table may be: its planned joint angles, and their possible deviations after a motion. Determines
the consequences for the next orientation.

The angle at which a motion ends is known only approximately: the computer ends the motion with some delay, and the rate has an
error. If two ways to the next orientation take almost equally long, the deviation of the angle decides which way the table takes.
In this case, both ways are possible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.physics.kinematics import TURN, Angles, TableAxis, quickest_ends, quickest_move

STOPS_LATE = 0.1
"""Largest difference between the actual and the planned end of a motion, s. This is the time that the executor may wait between two
queries of the table."""
RATE_ERROR = 1e-3
"""Largest relative difference between an actual and a planned rate."""
MOST = 16
"""Maximum number of additional positions of the table that planning considers. More positions occur only if two ways to the next
orientation take almost equally long after several motions in succession."""
_SAME = 1e-6  # rad; joint angles nearer than this are the same
_STEP = math.pi / 4  # rad; angles at which the choice is tried are at most this far apart


@dataclass(frozen=True, slots=True)
class TableState:
    """Contains the state of the table: joint angles [rad], the outermost joint first, and the time [s] to come to rest.

    `roughly`: index of the joint whose angle is known only approximately after a motion; None if every joint is at its commanded
    angle. `below`, `above`: largest negative and largest positive deviation [rad] of each joint from `joints`; empty if the angles
    are exact. `others`: other joint angles at which the table may be instead of `joints`.
    """

    joints: Array
    stopping: float = 0.0
    roughly: int | None = None
    below: Angles = ()
    above: Angles = ()
    others: tuple[Array, ...] = ()

    def still(self) -> TableState:
        """Returns the same state of the table, except that the table is at rest."""
        return replace(self, stopping=0.0) if self.stopping else self

    def starts(self) -> list[Array]:
        """Returns the joint angles at which the table may be when the next motion begins, the planned angles first."""
        centres = [self.joints, *self.others]
        grids = {grid.tobytes(): grid for grid in map(self._around, centres)}
        return centres + [start for grid in grids.values() for start in grid]

    def _around(self, centre: Array) -> Array:
        """Returns joint angles (n, joints) [rad] at which the table may be instead of `centre`. The joint angles are spaced so
        closely that every possible choice between two ways to an orientation occurs.

        If a continuous joint may be at any angle, the returned angles do not depend on the planned angle. The moves from these
        angles are then computed only once.
        """
        if not self._inexact:
            return np.empty((0, len(centre)))
        ranges = [_tried(*bounds) for bounds in zip(centre.tolist(), self.below, self.above, strict=True)]
        return np.array(list(product(*ranges)))

    @property
    def _inexact(self) -> bool:
        return any(self.below) or any(self.above)

    def ended(
        self, axes: Sequence[TableAxis], joint: int, angle: float, misses: tuple[float, float], stopping: float
    ) -> TableState:
        """Returns the state after a motion that turns a joint by `angle` [rad]. `misses`: largest negative and positive deviation
        [rad] of the angle at the end of the motion. `stopping`: time to come to rest, s."""
        turn = np.zeros(len(self.joints))
        turn[joint] = angle
        low, high = list(self.below or (0.0,) * len(axes)), list(self.above or (0.0,) * len(axes))
        low[joint] += misses[0]
        high[joint] += misses[1]
        joints = self.joints + turn
        if axes[joint].continuous:
            joints[joint] = math.remainder(joints[joint], TURN)
            low[joint], high[joint] = max(low[joint], -math.pi), min(high[joint], math.pi)
        roughly = joint if self.roughly is None else min(joint, self.roughly)
        others = tuple(other + turn for other in self.others)
        return TableState(joints, stopping, roughly, tuple(low), tuple(high), others)

    def oriented(self, axes: Sequence[TableAxis], attitude: Array, azimuth: float) -> tuple[TableState, float]:
        """Returns the state after the move to an attitude, and the time [s] of the move from the planned angles. The attitude has
        the shape (3, 3).

        Raises `Unreachable`, with the reason, if the attitude cannot be reached from one or more of the angles at which the table
        may be. `azimuth`: azimuth of the site, rad.
        """
        target, seconds = quickest_move(axes, attitude, self.joints, azimuth)
        if not (self._inexact or self.others) or (len(axes) == 1 and axes[0].continuous):
            return TableState(target), seconds
        below, above = np.zeros(len(target)), np.zeros(len(target))
        reached = [target]

        def keep(ends: Array) -> None:
            for known in reached:
                ends = ends[_furthest(_apart(axes, ends, known)) > _SAME]
            while len(ends) and len(reached) <= MOST:
                reached.append(ends[0])
                ends = ends[_furthest(_apart(axes, ends, ends[0])) > _SAME]

        for centre in (self.joints, *self.others):
            planned = quickest_move(axes, attitude, centre, azimuth)[0]
            keep(planned[np.newaxis])
            starts = self._around(centre)
            ends = quickest_ends(axes, attitude, starts, azimuth)
            off = _apart(axes, ends, planned)
            # The same way, whose end may depend on the start.
            same = _furthest(off) <= _furthest(_apart(axes, starts, centre)) + _SAME
            below = np.vstack([below, off[same]]).min(axis=0)
            above = np.vstack([above, off[same]]).max(axis=0)
            keep(ends[~same])
        loose = [index for index in range(len(target)) if max(-below[index], above[index]) > _SAME]
        roughly = loose[0] if loose else None
        if roughly is None:
            return TableState(target, others=tuple(reached[1:])), seconds
        low, high = tuple(below.tolist()), tuple(above.tolist())
        return TableState(target, 0.0, roughly, low, high, tuple(reached[1:])), seconds


def spin_misses(rate: float, angle: float, sooner: float) -> tuple[float, float]:
    """Returns the largest negative and the largest positive deviation [rad] from the planned end of a spin at `rate` [rad/s]
    through `angle` [rad].

    `sooner`: time [s] by which the spin may end early, because its settling depends on measurements.
    """
    missed = abs(rate) * STOPS_LATE + abs(angle) * RATE_ERROR
    early = abs(rate) * sooner
    return (-missed - early, missed) if rate > 0 else (-missed, missed + early)


def _tried(centre: float, low: float, high: float) -> list[float]:
    """Returns the angles [rad] to try, from `centre + low` to `centre + high`, at most `_STEP` apart."""
    if low == 0.0 and high == 0.0:
        return [centre]
    if low <= -math.pi and high >= math.pi:  # only a continuous joint has such a range
        return [step * _STEP for step in range(-3, 5)]
    steps = max(1, math.ceil((high - low) / _STEP))
    return sorted({centre, *(centre + low + (high - low) * step / steps for step in range(steps + 1))})


def _apart(axes: Sequence[TableAxis], first: Array, second: Array) -> Array:
    """Returns the differences between pairs of joint angles [rad], shape (n, joints). For a continuous axis, whole turns are
    subtracted. `first`, `second`: arrays of shape (n, joints), or (joints,) for the same angles in all pairs."""
    off = first - second
    turns = np.array([TURN if axis.continuous else 0.0 for axis in axes])
    return np.asarray(off - turns * np.round(off / TURN))


def _furthest(off: Array) -> Array:
    """Returns the largest absolute value in each row of `off`, shape (n,). `off`: array of shape (n, joints), the differences that
    `_apart` returns."""
    return np.asarray(np.abs(off).max(axis=1))

"""Encoders of a virtual platform's gimbals and of the rings of the table that rocks it, each with errors of its own.

A ring of a rocking table that comes to rest stands off by a return error, a new one each time; while it moves, its reading lags; and over
minutes its servo wanders. A gimbal's multi-speed resolver errs with a period of a fraction of a turn.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.instruments.virtual.courses import Course, Rocking

Array = NDArray[np.float64]


@dataclass(slots=True)
class RingEncoders:
    """The table's rings as their encoders show them during one recording.

    before, after: (k,) rad, by how much each ring stands off its reading until and after it has moved. lag: s. wander: rad/√s.
    """

    before: Array
    after: Array
    lag: float
    wander: float
    wandered: Array

    @classmethod
    def drawn(
        cls, rings: int, return_error: float, lag: float, wander: float, draw: np.random.Generator
    ) -> RingEncoders:
        before, after = return_error * draw.standard_normal((2, rings))
        return cls(before, after, lag, wander, np.zeros(rings))

    def read(self, course: Course, times: Array, step: float, draw: np.random.Generator) -> list[Array]:
        """Indicated angles [rad] of each ring, outermost first, at `times`, `step` s apart."""
        over = course.over if isinstance(course, Rocking) else math.inf
        readings = []
        for k, (angle, rate) in enumerate(course.follow(times)):
            wandering = self.wandered[k] + np.cumsum(self.wander * math.sqrt(step) * draw.standard_normal(times.size))
            self.wandered[k] = wandering[-1]
            off = np.where(times >= over, self.after[k], self.before[k]) + wandering
            readings.append(angle - off - self.lag * rate)
        return readings


def gimbal_angles(base: Array, element: Array) -> tuple[Array, Array, Array]:
    """Outer, middle and inner gimbal angle [rad], each (n,), from the axes of base and element as rows, both (n, 3, 3).

    The outer gimbal turns about the base's x axis, the middle one about its own y, the inner one, which carries the element, about its
    own z.
    """
    between = np.einsum("nij,nkj->nik", element, base)
    outer = np.arctan2(-between[:, 2, 1], between[:, 2, 2])
    middle = np.arcsin(np.clip(between[:, 2, 0], -1.0, 1.0))
    inner = np.arctan2(-between[:, 1, 0], between[:, 0, 0])
    return outer, middle, inner


def resolver(angle: Array, error: float, speeds: int, phase: float) -> Array:
    """What a resolver with `speeds` electrical turns a turn makes of an angle [rad]; error: amplitude [rad]."""
    return angle + error * np.sin(speeds * angle + phase)

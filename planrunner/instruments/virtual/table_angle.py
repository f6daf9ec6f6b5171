"""The angle by which the virtual table has turned within a segment, at given times and averaged over sampling intervals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from planrunner.base.arrays import Array
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.virtual.courses import Rocking, Spinning
from planrunner.physics.table_motion import about_one_axis
from planrunner.plan.schedule import Rock, Segment, Spin

if TYPE_CHECKING:
    from planrunner.instruments.virtual.world import World


def turned(world: World, segment: Segment, times: Array) -> tuple[Array, Array]:
    """Angle [rad] and rate [rad/s] of the table about the axis of the segment's motion, (n,) each. The angle counts from the time
    when the orientation was reached.

    Rocking is included if only the outermost axis rocks.
    """
    course, motion = world.course, segment.motion
    if isinstance(motion, Spin) and isinstance(course, Spinning):
        joint, sense = course.joint, math.copysign(1.0, motion.rate) * math.copysign(1.0, course.rate)
    elif isinstance(motion, Rock) and isinstance(course, Rocking):
        joint, sense = 0, 1.0
        if not about_one_axis(motion):
            raise InstrumentError(f"'{segment.label}' rocks several rings, so there is no table angle about one axis")
    else:
        return np.zeros(len(times)), np.zeros(len(times))
    angle, rate = (np.broadcast_to(value, times.shape) for value in course.follow(times)[joint])
    return sense * (angle - course.angles[joint]), sense * rate


def mean_angle(world: World, segment: Segment, times: Array, interval: float) -> Array:
    """Mean angle [rad] over sampling intervals that end at `times`. The outputs are means over the same intervals."""
    places, weights = np.polynomial.legendre.leggauss(3)
    total = np.zeros(len(times))
    for place, weight in zip(places, weights, strict=True):
        total += weight / 2 * turned(world, segment, times + (place - 1) / 2 * interval)[0]
    return total

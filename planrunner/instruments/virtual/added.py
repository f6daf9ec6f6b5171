"""What a simulation adds to a virtual sensor beyond its declared errors: the door through which effects come in.

The virtual sensor says what is happening at its samples and what it would give without noise; whoever stands in `World.added` changes
that, and its noise. The sensor knows nothing of effects, and an effect nothing of the sensor's error model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from planrunner.dataclass import dataclass
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.virtual.courses import Rocking, Spinning
from planrunner.physics.table_motion import about_one_axis
from planrunner.plan.schedule import Rock, Segment, Spin

if TYPE_CHECKING:
    from planrunner.instruments.virtual.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Moments:
    """What is happening at some samples. time: (n,), s since the run began, of the middle of each sampling interval; power_on: s, of the
    same clock. angle: (n,), rad, by which the table has turned since the orientation was taken; rate: rad/s; kelvin: of the sensor."""

    segment: Segment
    time: Array
    power_on: float
    sample_rate: float
    angle: Array
    rate: Array
    kelvin: Array


@dataclass(frozen=True, slots=True)
class Gives:
    """One output of the sensor. unit: of the output; white: N, unit·√s; step: of one sample, unit."""

    unit: str
    white: float
    step: float


class Added(Protocol):
    def levels(self, moments: Moments, levels: Mapping[str, Array], gives: Mapping[str, Gives]) -> Mapping[str, Array]:
        """The outputs without noise, each (n,) in its unit, with what is added."""

    def noise(self, output: str, gives: Gives) -> Gives:
        """The noise of an output with what is added."""


def turned(world: World, segment: Segment, times: Array) -> tuple[Array, Array]:
    """Angle [rad] and rate [rad/s] of the table about what the segment turns about, since the orientation was taken, (n,) each.

    Rocking counts where the outermost axis alone rocks.
    """
    course, motion = world.course, segment.motion
    if isinstance(motion, Spin) and isinstance(course, Spinning):
        joint, sense = course.joint, math.copysign(1.0, motion.rate) * math.copysign(1.0, course.rate)
    elif isinstance(motion, Rock) and isinstance(course, Rocking):
        joint, sense = 0, 1.0
        if not about_one_axis(motion):
            raise InstrumentError(f"'{segment.label}' rocks several rings: that is no angle about one axis")
    else:
        return np.zeros(len(times)), np.zeros(len(times))
    angle, rate = (np.broadcast_to(value, times.shape) for value in course.follow(times)[joint])
    return sense * (angle - course.angles[joint]), sense * rate


def mean_angle(world: World, segment: Segment, times: Array, interval: float) -> Array:
    """Mean angle [rad] over sampling intervals that end at `times`: like the outputs, which are means too."""
    places, weights = np.polynomial.legendre.leggauss(3)
    total = np.zeros(len(times))
    for place, weight in zip(places, weights, strict=True):
        total += weight / 2 * turned(world, segment, times + (place - 1) / 2 * interval)[0]
    return total

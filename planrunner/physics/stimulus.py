"""Computes the stimulus, which is the input of a sensor, at samples or averaged over segments.

Arrays are in SI units and in the sensor's own axes; at rest, an axis that points up reads +g. Means over segments are computed in
closed form from the planned attitude and motion, the Earth's rotation, and gravity at the site.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Rest, Segment, Spin


class StimulusError(ValueError):
    """Reports that the input of the sensor cannot be derived from the plan. The message states the segment and the reason."""


@dataclass(frozen=True, slots=True)
class Stimulus:
    """Contains the input of the sensor at n times, or averaged over n segments.

    `omega`: array of shape (n, 3) in rad/s, angular rate relative to inertial space, along the sensor's x, y, z axes.
    `specific_force`: array of shape (n, 3) in m/s^2, along the same axes. `temperature`: array of shape (n,) in K, NaN where it is
    unknown. `time`: array of shape (n,) in s; for a segment, the middle of the dwell. `table_rate`: array of shape (n,), rate of
    the table, rad/s. `table_angle`: array of shape (n,), angle by which the table has turned since the start of the dwell, rad.
    `moving`: array of shape (n,), True if the attitude changed during averaging. In this case, the mean of a product differs from
    the product of the means.
    """

    omega: Array
    specific_force: Array
    temperature: Array
    time: Array
    table_rate: Array
    table_angle: Array
    moving: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.time)


def segment_means(segments: Sequence[Segment], site: Site, durations: Sequence[float | None] | None = None) -> Stimulus:
    """Returns the mean stimulus over the dwell of each segment.

    `durations`: recorded durations of the dwells, s; by default the planned dwells. A segment with a spin starts at its planned
    attitude. The mean of such a segment is taken over the angle that it covers or, if its duration is unknown, over whole turns.
    Raises `StimulusError` if an attitude is unknown, or if a segment has a motion other than a spin (for example, rocking or a
    cycle), because a mean then does not represent the stimulus.
    """
    return Poses.of(segments, durations).felt(site)


@dataclass(frozen=True, slots=True)
class Poses:
    """Contains the attitudes and rotations of n segments. From these, the mean stimulus at any site can be computed.

    `attitude`: array of shape (n, 3, 3), attitude at the start of each segment. `mean`: array of shape (n, 3, 3), transforms a
    vector that is fixed at the site to its mean over the segment, in the sensor's axes. `spin`: array of shape (n, 3), mean
    rotation rate of the table in the sensor's axes, rad/s. `table_rate`, `table_angle`, `temperature`, `time`: these quantities
    have the same meaning as in `Stimulus`.
    """

    attitude: Array
    mean: Array
    spin: Array
    table_rate: Array
    table_angle: Array
    temperature: Array
    time: Array

    @classmethod
    def of(cls, segments: Sequence[Segment], durations: Sequence[float | None] | None = None) -> Poses:
        """Makes the poses of segments; the arguments are those of `segment_means`. Raises `StimulusError` in the same cases."""
        n = len(segments)
        attitude = np.array([_attitude(segment) for segment in segments], dtype=float).reshape(n, 3, 3)
        mean, spin, rate, angle = attitude, np.zeros((n, 3)), np.zeros(n), np.zeros(n)
        lasting = [segment.dwell for segment in segments] if durations is None else durations
        temperature = np.array([_temperature(segment) for segment in segments])
        time = np.array([segment.start + (own or 0.0) / 2 for segment, own in zip(segments, lasting, strict=True)])
        for row, (segment, seconds) in enumerate(zip(segments, lasting, strict=True)):
            motion = segment.motion
            if isinstance(motion, Spin):
                mean = mean.copy() if mean is attitude else mean
                turned, axis = None if seconds is None else motion.rate * seconds, _unit(motion.about)
                mean[row] = attitude[row] @ mean_while_turning(axis, turned)
                spin[row] = attitude[row] @ (motion.rate * axis)
                rate[row], angle[row] = motion.rate, (turned or 0.0) / 2
            elif not isinstance(motion, Rest):
                kind = type(motion).__name__.lower()
                message = f"segment '{segment.label}' moves ({kind}): its mean is not a static observation; choose segments at rest"
                raise StimulusError(message)
        return cls(attitude, mean, spin, rate, angle, temperature, time)

    @property
    def arrays(self) -> tuple[Array, ...]:
        """Returns all arrays in the order of the attributes."""
        return self.attitude, self.mean, self.spin, self.table_rate, self.table_angle, self.temperature, self.time

    @property
    def timeless(self) -> Poses:
        """Returns the same poses without temperature and time."""
        unknown = np.full(len(self.time), np.nan)
        return Poses(self.attitude, self.mean, self.spin, self.table_rate, self.table_angle, unknown, unknown)

    def felt(self, site: Site) -> Stimulus:
        """Returns the mean stimulus of each segment at a site."""
        return Stimulus(
            self.mean @ site.earth_rate_enu + self.spin,
            self.mean @ site.specific_force_enu,
            self.temperature,
            self.time,
            self.table_rate,
            self.table_angle,
            self.table_rate != 0,
        )


def mean_while_turning(axis: Array, turned: float | None) -> Array:
    """Returns the matrix (3, 3) that transforms a vector fixed at the site to its mean in rotating axes. These axes rotate with the
    table about the unit vector `axis`, by the angle `turned` [rad].

    Let p be the part of the vector along the axis, q the other part, and r = axis × vector. At the angle θ, the vector in these
    axes is p + q·cos θ − r·sin θ; its mean over 0 … Θ is p + q·sin Θ/Θ − r·(1 − cos Θ)/Θ. Over whole turns, for which `turned` is
    None, only p remains.
    """
    along = np.outer(axis, axis)
    if turned is None:
        return along
    x, y, z = axis.tolist()
    side = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    half = turned / 2
    mean_cos = float(np.sinc(turned / np.pi))
    mean_sin = float(np.sin(half) * np.sinc(half / np.pi))
    return np.asarray(along + (np.eye(3) - along) * mean_cos - side * mean_sin)


def _attitude(segment: Segment) -> Array:
    if segment.attitude is None:
        raise StimulusError(
            f"the orientation of segment '{segment.label}' is unknown, so the stimulus of the sensor is unknown; "
            "give its orientation or use an estimator that does not need it"
        )
    return segment.attitude


def _temperature(segment: Segment) -> float:
    """Returns the planned temperature of a segment [K]: for a ramp, the mean temperature; NaN if the temperature is unknown."""
    kelvin, ramp_to = segment.temperature, segment.ramp_to
    if kelvin is None:
        return math.nan
    return kelvin if ramp_to is None else (kelvin + ramp_to) / 2


def _unit(direction: Sequence[float]) -> Array:
    vector = np.asarray(direction, dtype=float)
    unit: Array = vector / np.linalg.norm(vector)
    return unit

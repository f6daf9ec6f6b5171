"""Computes the motion of a sensor from channels of the recording, if no plan commands this motion. The plan names these channels."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.observation.refusals import ObservationError
from planrunner.physics.earth import Site
from planrunner.physics.moved_body import BodyMotion, by_attitude, by_force, by_rates, slope
from planrunner.plan.schedule import RecordedMotion

_AVERAGED = 10  # samples of an angle or an attitude, by default
_GAP = 3.0  # times the median interval: a longer one is a gap, next to which there are no differences
_SUPPOSED = 100.0  # deg/s
_UNIT = 0.05  # deviation of the norm of a quaternion from 1


@dataclass(frozen=True, slots=True, eq=False)
class MotionShown:
    """A motion that recorded channels show.

    `table`: angle, rate and acceleration of an axis with an encoder, an array of shape (n,) each; zero without an encoder.
    `course`: the motion if channels other than an encoder show it; None if an encoder shows it. `averaging`: number of consecutive
    samples that are averaged. `usable`: array of shape (n,), True for samples with neighbours on both sides. `differences`: True if
    the rate at a sample is computed from the difference between its two neighbours.
    """

    table: Mapping[str, Array]
    course: BodyMotion | None
    averaging: int
    usable: NDArray[np.bool_]
    differences: bool = False

    def as_shown(self, values: Array) -> Array:
        """Averages outputs (n, k) in the same way as the motion. If rates are computed from differences, the outputs are averaged
        by Simpson's rule over the interval of each difference. A fast motion is then attenuated in the outputs as it is in the
        reference."""
        if not self.differences:
            return values
        found = values.copy()
        found[1:-1] = (values[:-2] + 4 * values[1:-1] + values[2:]) / 6
        return found


def recorded_course(
    motion: RecordedMotion, attitude: Array | None, site: Site, time: Array, shown: Mapping[str, Array]
) -> MotionShown:
    """Computes the motion at n samples from recorded channels.

    `attitude`: attitude of the sensor at the first sample of the segment. `time`: array of shape (n,) in s. `shown`: the values
    (n,) of each channel, SI.

    Raises `ObservationError` if the motion cannot be computed from these channels.
    """
    step = float(np.median(np.diff(time)))
    size = max(1, round(motion.averaging / step)) if motion.averaging else 1
    if not motion.averaging and (motion.angle or motion.attitude):
        size = _AVERAGED
    near = np.diff(time) < _GAP * step
    usable = np.append(near, True) & np.append(True, near)
    zero = np.zeros(len(time))
    still = {"angle": zero, "rate": zero, "acceleration": zero}
    force = _stacked(motion.forces, shown)
    if motion.angle or motion.attitude:
        usable[[0, -1]] = False
    if motion.angle:
        if attitude is None:
            message = (
                "the orientation at angle zero is unknown, so the input of the sensor cannot be computed from the angle"
            )
            raise ObservationError(message, "state the `orientation` of the segment, or give `rates`")
        angle = np.unwrap(shown[motion.angle])
        rate = slope(time, angle)
        return MotionShown({"angle": angle, "rate": rate, "acceleration": slope(time, rate)}, None, size, usable, True)
    quaternions, rates = _stacked(motion.attitude, shown), _stacked(motion.rates, shown)
    if quaternions is not None:
        norm = np.linalg.norm(quaternions, axis=1)
        if np.abs(norm - 1).max() > _UNIT:
            message = f"the norm of the attitude quaternion goes from {norm.min():.3g} to {norm.max():.3g}, not 1"
            raise ObservationError(message, "check the channels of `attitude` in the plan, and their columns")
        course = by_attitude(time, quaternions, site, force)
    elif rates is not None:
        course = by_rates(time, rates, attitude, site, force)
    else:
        assert force is not None
        course = by_force(force)
    return MotionShown(still, course, size, usable, bool(motion.attitude))


def supposed_course(time: Array, site: Site) -> MotionShown:
    """Returns an assumed motion about all axes, for a segment that has not been recorded yet. The motion is chosen such that every
    effect can act. Numbers that are reported must not depend on this motion."""
    since = time - time[0]
    rates = np.radians(_SUPPOSED) * np.sin(2 * np.pi * np.outer(since, np.array([0.3, 0.5, 0.7])))
    zero = np.zeros(len(time))
    course = by_rates(time, rates, np.eye(3), site)
    return MotionShown({"angle": zero, "rate": zero, "acceleration": zero}, course, 1, zero == 0)


def _stacked(names: tuple[str, ...], shown: Mapping[str, Array]) -> Array | None:
    """Returns the named channels as columns (n, k); None if no channels are named."""
    return np.column_stack([shown[name] for name in names]) if names else None

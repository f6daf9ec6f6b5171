"""Stimulus: the input to the sensor, for samples or as means over segments.

Arrays are SI-coherent and in the sensor's own axes; an axis pointing up at rest reads +g. Means over segments follow in closed form from
the planned attitude and motion, the Earth's rotation, and gravity at the site.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import cross
from planrunner.plan.schedule import Rest, Segment, Spin

Array = NDArray[np.float64]


class StimulusError(ValueError):
    """The input of the sensor cannot be derived from the plan. The message gives the segment and the reason."""


@dataclass(frozen=True, slots=True)
class Stimulus:
    """The input to the sensor at n moments, or averaged over n segments.

    omega: shape (n, 3), rad/s, angular rate relative to inertial space on the sensor's x, y, z. specific_force: (n, 3), m/s^2. temperature:
    (n,), K, NaN where not known. time: (n,), s, the middle of a segment. table_rate: (n,), rad/s. table_angle: (n,), rad turned since the
    dwell began. moving: (n,), whether the attitude changed while averaging; the mean of a product then differs from the product of the
    means.
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
    """The mean stimulus of each segment's dwell.

    durations: s, as recorded; if absent, the planned dwells. A spinning segment begins at its planned attitude, and its mean is taken over
    the turns that it covers; if the duration is not known, over whole turns. Raises `StimulusError` for an unknown attitude, and for
    rocking and indexing, where a mean does not represent the stimulus.
    """
    return Poses.of(segments, durations).felt(site)


@dataclass(frozen=True, slots=True)
class Poses:
    """Attitude and spin of n segments. They give the mean stimulus at any site, also for a sensor that is mounted differently from the
    plan.

    attitude: (n, 3, 3). spins: row, motion and turned angle [rad] of the segments that spin; the angle is None for whole turns.
    temperature, time: as in `Stimulus`.
    """

    attitude: Array
    spins: tuple[tuple[int, Spin, float | None], ...]
    temperature: Array
    time: Array

    @classmethod
    def of(cls, segments: Sequence[Segment], durations: Sequence[float | None] | None = None) -> Poses:
        """See `segment_means`. Raises `StimulusError`."""
        n = len(segments)
        lasting = [segment.dwell for segment in segments] if durations is None else durations
        attitude, temperature, time = np.empty((n, 3, 3)), np.full(n, np.nan), np.empty(n)
        spins: list[tuple[int, Spin, float | None]] = []
        for row, (segment, seconds) in enumerate(zip(segments, lasting, strict=True)):
            attitude[row] = _attitude(segment)
            motion, kelvin, ramp_to = segment.motion, segment.temperature, segment.ramp_to
            if isinstance(motion, Spin):
                spins.append((row, motion, None if seconds is None else motion.rate * seconds))
            elif not isinstance(motion, Rest):
                kind = type(motion).__name__.lower()
                message = f"segment '{segment.label}' moves ({kind}): its mean is no static observation; choose segments at rest"
                raise StimulusError(message)
            if kelvin is not None:
                temperature[row] = kelvin if ramp_to is None else (kelvin + ramp_to) / 2
            time[row] = segment.start + (seconds or 0.0) / 2
        return cls(attitude, tuple(spins), temperature, time)

    def felt(self, site: Site, turn: Array | None = None, axis_too: bool = True) -> Stimulus:
        """The mean stimulus at a site. turn: rotation (3, 3) in East-North-Up from the planned attitude of the sensor to the actual one;
        axis_too: also rotates the axes of spins."""
        n = len(self.time)
        attitude = self.attitude if turn is None else self.attitude @ turn.T
        rates, angle = np.zeros(n), np.zeros(n)
        earth_rate, at_rest = site.earth_rate_enu, site.specific_force_enu
        omega, force = attitude @ earth_rate, attitude @ at_rest
        for row, motion, turned in self.spins:
            axis = _unit(motion.about) if turn is None or not axis_too else turn @ _unit(motion.about)
            whole, by = turned is None, turned or 0.0
            omega[row] = attitude[row] @ (mean_while_turning(earth_rate, axis, by, whole) + motion.rate * axis)
            force[row] = attitude[row] @ mean_while_turning(at_rest, axis, by, whole)
            rates[row], angle[row] = motion.rate, by / 2
        return Stimulus(omega, force, self.temperature, self.time, rates, angle, rates != 0)


def mean_while_turning(vector: Array, axis: Array, turned: float, whole_turns: bool = False) -> Array:
    """The mean of a site-fixed vector, shape (3,), in axes that turn with the table about `axis` by `turned` rad.

    With p the part along the axis, q the rest and r = axis × vector, the vector in these axes is p + q·cos θ − r·sin θ at angle θ; its mean
    over 0 … Θ is p + q·sin Θ/Θ − r·(1 − cos Θ)/Θ. Over whole turns only p is left.
    """
    along = (vector @ axis) * axis
    if whole_turns:
        return along
    across, side = vector - along, cross(axis, vector)
    half = turned / 2
    mean_cos = float(np.sinc(turned / np.pi))
    mean_sin = float(np.sin(half) * np.sinc(half / np.pi))
    return along + across * mean_cos - side * mean_sin


def _attitude(segment: Segment) -> Array:
    if segment.attitude is None:
        raise StimulusError(
            f"the orientation of segment '{segment.label}' is unknown, so what the sensor felt is not known; "
            "give its orientation or use an estimator that does not need it"
        )
    return segment.attitude


def _unit(direction: Sequence[float]) -> Array:
    vector = np.asarray(direction, dtype=float)
    unit: Array = vector / np.linalg.norm(vector)
    return unit

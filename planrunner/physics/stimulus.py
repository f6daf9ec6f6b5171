"""Stimulus: what the sensor felt, for samples or for segment means.

Arrays are SI-coherent and in the sensor's own axes; an axis pointing up at rest reads +g. Segment means follow in closed form from the
planned attitude and motion, the Earth's rotation and gravity at the site.
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
    """What the sensor felt at n moments, or on average over n segments.

    omega: shape (n, 3), rad/s, angular rate relative to inertial space on the sensor's x, y, z. specific_force: (n, 3), m/s^2.
    temperature: (n,), K, NaN where not known. time: (n,), s, the middle of a segment. table_rate: (n,), rad/s.
    table_angle: (n,), rad turned since the dwell began. moving: (n,), whether the attitude changed while averaging, so that a
    product of two means is not the mean of the product.
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

    durations: s, of what was really recorded; the planned dwells without it. A spinning segment begins at its planned attitude, and
    its mean is taken over the turns that it covers; where the duration is not known, over whole turns. Raises `StimulusError` for an
    unknown attitude and for rocking or indexing, whose mean says little of what was felt.
    """
    return Poses.of(segments, durations).felt(site)


@dataclass(frozen=True, slots=True)
class Poses:
    """How n segments stand and spin: their mean stimulus follows from it at any site, also for a sensor that stands otherwise than planned.

    attitude: (n, 3, 3). spins: row, motion and turned angle [rad] of those that spin, None over whole turns. temperature, time: as in
    `Stimulus`.
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
        """The mean stimulus at a site. turn: rotation (3, 3), East-North-Up, by which the sensor stands turned against what was planned;
        axis_too: the axes of spins as well."""
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
    """The mean of a site-fixed vector, shape (3,), as seen in site axes that turn with the table about `axis` by `turned` rad.

    With p the part along the axis, q the rest and r = axis × vector, the table sees p + q·cos θ − r·sin θ at angle θ; its mean over
    0 … Θ is p + q·sin Θ/Θ − r·(1 − cos Θ)/Θ. Over whole turns only p is left.
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

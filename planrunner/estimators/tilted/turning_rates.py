"""Computes the mean input of the axes of a fixture over each segment, in the fixture's frame. The input includes the Earth's
rotation.

When the recording begins, the table has already turned by an angle. This angle is rate × spin-up time / 2 (constant acceleration),
plus rate × settling time. If a recording covers whole turns, this angle has no effect.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.estimators.interface import EstimationError
from planrunner.instruments.models import TableModel
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import Unreachable, joint_angles, rotation_about, spin_axis
from planrunner.physics.stimulus import StimulusError, segment_means
from planrunner.plan.schedule import Segment, Spin

WHOLE = 1e-3  # largest deviation of a dwell from whole turns, in turns


def as_recording_begins(segments: Sequence[Segment], site: Site, table: TableModel | None) -> tuple[Segment, ...]:
    """Returns the segments with the attitude that they have at the start of the recording."""
    known: dict[object, float] = {}
    return tuple(_carried(segment, site, table, known) for segment in segments)


def mean_rates(segments: Sequence[Segment], site: Site, durations: Sequence[float | None]) -> Array:
    """Returns the mean angular rate relative to inertial space, in the fixture's frame [rad/s], shape (n, 3). The segments must
    have the attitudes that they have at the start of the recording.

    `durations`: recorded durations of the segments, s. Raises `EstimationError` for an unknown orientation.
    """
    try:
        return segment_means(segments, site, durations).omega
    except StimulusError as error:
        raise EstimationError(f"{error}; or write `earth_rate: ignored`") from None


def recorded_seconds(recorded: RecordedSegment) -> float | None:
    """Returns the duration [s] over which the mean of a segment is taken. Each sample represents one sample interval. With fewer
    than two samples, returns the planned dwell, which is None if it is not known."""
    return recorded.statistics.duration if recorded.statistics.count > 1 else recorded.segment.dwell


def part_turns(
    segments: Sequence[Segment], durations: Sequence[float | None], intervals: Sequence[float]
) -> list[tuple[str, float]]:
    """Returns, for each spin that does not cover whole turns, its label and the number of its turns. `intervals`: time between
    samples of each segment, s; a dwell may differ from whole turns by one such interval. `durations`: recorded durations of the
    segments, s."""
    found = []
    for segment, seconds, interval in zip(segments, durations, intervals, strict=True):
        if not isinstance(segment.motion, Spin) or seconds is None:
            continue
        turns = abs(segment.rate) * seconds / (2 * math.pi)
        allowed = WHOLE + abs(segment.rate) * interval / (2 * math.pi)
        if round(turns) < 1 or abs(turns - round(turns)) > allowed:
            found.append((segment.label, turns))
    return found


def _carried(segment: Segment, site: Site, table: TableModel | None, known: dict[object, float]) -> Segment:
    motion = segment.motion
    if segment.attitude is None or not isinstance(motion, Spin):
        return segment
    key = (segment.attitude.tobytes(), motion.about)
    if key not in known:
        known[key] = _acceleration(segment.attitude, motion, site, table)
    about = np.asarray(motion.about, dtype=float)
    turned = motion.rate * (segment.settle + abs(motion.rate) / known[key] / 2)
    turn = rotation_about(tuple(about / np.linalg.norm(about)), math.fmod(turned, 2 * math.pi))
    return replace(segment, attitude=np.asarray(segment.attitude @ turn.T))


def _acceleration(attitude: Array, motion: Spin, site: Site, table: TableModel | None) -> float:
    """Returns the acceleration [rad/s²] of the spinning axis; infinite if the table is not known."""
    if table is None:
        return math.inf
    try:
        joints = joint_angles(table.axes, attitude, np.zeros(len(table.axes)), site.azimuth)
        return table.axes[spin_axis(table.axes, joints, motion.about, site.azimuth)].max_acceleration
    except Unreachable:
        return math.inf

"""Mean input of the axes of a fixture over each segment, which includes the Earth's rotation, in the fixture's frame.

When recording begins, the table has turned during spin-up and settling, by half of rate × spin-up time (the acceleration is
constant) plus rate × settling time. For whole turns, this angle makes no difference.
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

WHOLE = 1e-3  # of a turn, by which a dwell in whole turns may miss


def as_recording_begins(segments: Sequence[Segment], site: Site, table: TableModel | None) -> tuple[Segment, ...]:
    """The segments with their attitude at the beginning of the recording."""
    known: dict[object, float] = {}
    return tuple(_carried(segment, site, table, known) for segment in segments)


def mean_rates(segments: Sequence[Segment], site: Site, durations: Sequence[float | None]) -> Array:
    """Mean angular rate relative to inertial space in the fixture's frame, (n, 3), rad/s. The segments have their attitudes at the
    beginning of the recording.

    durations: recorded durations, s. Raises `EstimationError` for an unknown orientation.
    """
    try:
        return segment_means(segments, site, durations).omega
    except StimulusError as error:
        raise EstimationError(f"{error}; or write `earth_rate: ignored`") from None


def recorded_seconds(recorded: RecordedSegment) -> float | None:
    """The duration [s] over which the mean of a segment is formed. Each sample represents one interval."""
    return recorded.statistics.duration if recorded.statistics.count > 1 else recorded.segment.dwell


def part_turns(
    segments: Sequence[Segment], durations: Sequence[float | None], intervals: Sequence[float]
) -> list[tuple[str, float]]:
    """Label and number of turns of each spin that does not cover whole turns. intervals: time between samples, s; a dwell may
    differ from whole turns by one interval."""
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
    """Acceleration of the spinning axis [rad/s²]; infinite if the table is not known."""
    if table is None:
        return math.inf
    try:
        joints = joint_angles(table.axes, attitude, np.zeros(len(table.axes)), site.azimuth)
        return table.axes[spin_axis(table.axes, joints, motion.about, site.azimuth)].max_acceleration
    except Unreachable:
        return math.inf

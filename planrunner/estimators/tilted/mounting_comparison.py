"""Compares one tilted mounting of all axes with a separate mounting of each axis, by the duration of the test and by the
uncertainty.

A tilted axis is at the angle θ from the rotation axis and senses the rate times cos θ. An axis along the rotation axis senses the
whole rate, so noise has a relative effect that is smaller by the factor cos θ. A small misalignment δ causes a relative error of 1
− cos δ for an axis along the rotation axis, and of δ·tan θ for the tilted axis. Each separate mounting needs the same schedule,
including its temperature cycle, and additional time for the mounting itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.said import Said, said
from planrunner.estimators.tables import Role, Table, TableColumn, by_columns
from planrunner.estimators.tilted.mounted_axes import MountedAxes
from planrunner.plan.schedule import Segment


def scheduled_seconds(segments: Sequence[Segment], seconds: Sequence[float | None]) -> float:
    """Returns the planned time [s] from the first move to the end of the last segment. If the plan does not state a dwell, its
    recorded length is used.

    `seconds`: recorded durations of the segments, s. If the schedule has no times, because a recording is played back, the sum of
    the dwells is returned.
    """
    lasting = [segment.dwell or own or 0.0 for segment, own in zip(segments, seconds, strict=True)]
    waiting = [segment.transition + segment.waiting for segment in segments]
    planned = segments[-1].start + lasting[-1] - (segments[0].start - waiting[0])
    return max(planned, sum(lasting) + sum(waiting))


def comparison_table(axes: MountedAxes, noise: Array, angle: Array) -> Table:
    """Makes the table that compares the two kinds of mounting. `noise`: array of shape (m,), relative standard uncertainty of K due
    to the noise within the segments. `angle`: array of shape (m,), standard uncertainty of the axis's angle θ, rad.

    In a separate mounting, the axis is assumed to be tilted about each of two directions by a random angle with the standard
    deviation `angle`. If the total tilt is δ, then 1 − cos δ has the expectation angle² and the standard deviation angle².
    """
    cosine, tangent = np.abs(np.cos(axes.angles)), np.abs(np.tan(axes.angles))
    tilted, alone = tangent * angle, np.sqrt(2) * angle**2
    shown = {
        "tilted: noise": noise,
        "tilted: angle": tilted,
        "tilted: both": np.hypot(noise, tilted),
        "one per axis: noise": noise * cosine,
        "one per axis: tilt": alone,
        "one per axis: both": np.hypot(noise * cosine, alone),
    }
    return by_columns(
        "Standard uncertainty of K in one tilted mounting, and in one mounting per axis",
        (TableColumn("axis"), axes.names),
        (TableColumn("angle", Role.NUMBER, "deg"), [f"{np.degrees(one):.4f}" for one in axes.angles]),
        *((TableColumn(title, Role.VALUE, "ppm"), 1e6 * values) for title, values in shown.items()),
    )


def time_note(seconds: float, mountings: int, remounting: float) -> Said:
    one, many = seconds + remounting, mountings * (seconds + remounting)
    return said(
        "Test time: {one} in one tilted mounting ({scheduled} as scheduled, {remounting} for mounting). With one axis at a "
        "time, the whole test would be run in each of {mountings} mountings, which would take {many} in total.",
        one=_hours(one),
        scheduled=_hours(seconds),
        remounting=_hours(remounting),
        many=_hours(many),
        mountings=mountings,
    )


def _hours(seconds: float) -> Said:
    if seconds >= 3600:
        return said("{hours:.3g} h", hours=seconds / 3600)
    return said("{minutes:.3g} min", minutes=seconds / 60)

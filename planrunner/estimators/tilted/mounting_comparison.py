"""Comparison of one tilted mounting with one mounting per axis: duration of the test, and uncertainty.

An axis along the rotation axis senses the whole rate, so noise has a smaller effect on it, by the factor cos θ. If it is misaligned by
a small δ, its relative error is only 1 − cos δ, while that of the tilted axis is δ·tan θ. Each mounting takes the same schedule,
including its temperature cycle, and additional time for mounting.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.said import Said, said
from planrunner.estimators.tables import Cell, Role, Table, TableColumn
from planrunner.estimators.tilted.mounted_axes import MountedAxes
from planrunner.plan.schedule import Segment


def scheduled_seconds(segments: Sequence[Segment], seconds: Sequence[float | None]) -> float:
    """Planned time from the first move to the end of the last segment. Dwells of unknown length count with their recorded length.

    seconds: recorded durations. If the schedule has no times (a recording that is played back), the sum of the dwells is returned.
    """
    lasting = [segment.dwell or own or 0.0 for segment, own in zip(segments, seconds, strict=True)]
    waiting = [segment.transition + segment.soak + segment.settle for segment in segments]
    planned = segments[-1].start + lasting[-1] - (segments[0].start - waiting[0])
    return max(planned, sum(lasting) + sum(waiting))


def comparison_table(axes: MountedAxes, noise: Array, angle: Array) -> Table:
    """Table of the comparison. noise: (m,), relative standard uncertainty of K from the noise within the segments; angle: (m,),
    standard uncertainty of θ, rad.

    In a separate mounting, the axis may be tilted by `angle` about either of two directions: 1 − cos δ has the mean angle² and the standard
    deviation angle².
    """
    rows: list[tuple[Cell, ...]] = []
    for k, name in enumerate(axes.names):
        cosine, tangent = abs(np.cos(axes.angles[k])), abs(np.tan(axes.angles[k]))
        tilted, alone = tangent * angle[k], np.sqrt(2) * angle[k] ** 2
        cells = (
            noise[k],
            tilted,
            np.hypot(noise[k], tilted),
            noise[k] * cosine,
            alone,
            np.hypot(noise[k] * cosine, alone),
        )
        rows.append((name, f"{np.degrees(axes.angles[k]):.4f}", *(float(cell * 1e6) for cell in cells)))
    columns = (
        TableColumn("axis"),
        TableColumn("angle", Role.NUMBER, "deg"),
        TableColumn("tilted: noise", Role.VALUE, "ppm"),
        TableColumn("tilted: angle", Role.VALUE, "ppm"),
        TableColumn("tilted: both", Role.VALUE, "ppm"),
        TableColumn("one per axis: noise", Role.VALUE, "ppm"),
        TableColumn("one per axis: tilt", Role.VALUE, "ppm"),
        TableColumn("one per axis: both", Role.VALUE, "ppm"),
    )
    return Table("Standard uncertainty of K in one tilted mounting, and in one mounting per axis", columns, tuple(rows))


def time_note(seconds: float, mountings: int, remounting: float) -> Said:
    one, many = seconds + remounting, mountings * (seconds + remounting)
    return said(
        "Test time: {one} in one tilted mounting ({scheduled} as scheduled, {remounting} for mounting). With one axis at a "
        "time, it would be {many}, in {mountings} mountings, each with a temperature cycle.",
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

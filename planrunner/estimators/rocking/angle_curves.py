"""Computes curves of the drift angle over each whole run, for readers. The results do not depend on these curves: the estimator
computes the drift from two time windows only.

Accelerometer samples are averaged over bins of whole rocking periods, so that the rocking cancels. One pass over the samples gives
a few hundred numbers per run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.rocking.influences import Runs
from planrunner.estimators.rocking.parameters import RockingDriftParameters
from planrunner.estimators.rocking.solution import ReducedRun, RockingConditions, drift_angles
from planrunner.estimators.rocking.statistics import AXES
from planrunner.estimators.rocking.windows import scale
from planrunner.estimators.tables import Plot
from planrunner.plan.schedule import Rock

POINTS = 200
"""Maximum number of points of a curve. A curve has fewer points if the run has fewer rocking periods."""
PLACES = ("static 1", "dynamic 1", "dynamic 2", "static 2")
ARCSEC = math.radians(1 / 3600)


@dataclass(frozen=True, slots=True)
class StateCurves:
    """Contains the curves of one level state, averaged over the quadruples of runs in this state. `time`: array of shape (n,), s
    since the start of a record. `angles`: array of shape (4, n, 2) in rad, angles about the two `level` axes in the runs static 1,
    dynamic 1, dynamic 2 and static 2; NaN if samples are missing. The mean angle in the first window is zero."""

    name: str
    level: tuple[int, int]
    quadruples: int
    time: Array
    angles: Array


def drift_curves(
    runs: Runs, recorded: Sequence[RecordedSegment], conditions: RockingConditions, parameters: RockingDriftParameters
) -> list[StateCurves]:
    """Computes the curves of each level state. `recorded`: all chosen segments, to which the runs refer by index. Raises
    `EstimationError` for channels that are missing."""
    every = [reduced.run for state in runs for four in state for reduced in four]
    lasting = min(recorded[run.place].statistics.end - recorded[run.place].statistics.start for run in every)
    periods = [run.segment.motion.period for run in every if isinstance(run.segment.motion, Rock)]
    width = max(periods) * max(1, math.ceil(lasting / POINTS / max(periods)))
    count = max(1, math.floor(lasting / width + 1e-9))
    time: Array = width * (np.arange(count, dtype=np.float64) + 0.5)
    found = []
    for state in runs:
        angles = np.zeros((len(PLACES), count, 2))
        for four in state:
            for place, reduced in enumerate(four):
                item = recorded[reduced.run.place]
                angles[place] += _curve(reduced, item, conditions, parameters, width, count) / len(state)
        first = state[0][0].run
        name = first.segment.orientation or first.label
        found.append(StateCurves(name, first.state.level, len(state), time, angles))
    return found


def _curve(
    reduced: ReducedRun,
    recorded: RecordedSegment,
    conditions: RockingConditions,
    parameters: RockingDriftParameters,
    width: float,
    count: int,
) -> Array:
    """Returns the drift angles [rad] of one run, computed from means over bins of `width` [s], minus the mean drift angles in the
    first window, shape (count, 2)."""
    channels = parameters.accelerometers
    scales = np.array([scale(recorded, name) for name in channels])
    totals, counts = np.zeros((count, 4)), np.zeros(count)
    for block in recorded.blocks(channels):
        since = block.time - recorded.statistics.start
        values = np.column_stack([since, *(block.channels[name] for name in channels)])
        place = np.floor(since / width + 1e-9).astype(np.int64)
        sound = np.isfinite(values).all(axis=1) & (place >= 0) & (place < count)
        np.add.at(totals, place[sound], values[sound])
        np.add.at(counts, place[sound], 1.0)
    with np.errstate(invalid="ignore"):
        means = totals / counts[:, None]
    first = drift_angles(reduced, conditions, reduced.first.time, reduced.first.readings).mean(axis=0)
    angles: Array = drift_angles(reduced, conditions, means[:, 0], means[:, 1:] * scales) - first
    return angles


def curve_plots(curves: Sequence[StateCurves]) -> list[Plot]:
    """Makes one plot of the curves for each state and level axis."""
    return [
        Plot(
            f"Drift angle about {AXES[axis]} (state: {state.name})"
            + (f", mean of {state.quadruples} quadruples" if state.quadruples > 1 else ""),
            "time since the record began, s",
            "angle relative to inertial space, arcsec",
            tuple(state.time.tolist()),
            {
                name: tuple((angles[:, place] / ARCSEC).tolist())
                for name, angles in zip(PLACES, state.angles, strict=True)
            },
            lines=True,
        )
        for state in curves
        for place, axis in enumerate(state.level)
    ]

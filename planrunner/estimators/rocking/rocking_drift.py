"""Estimates the rocking drift of an inertial platform. The estimator uses the direction of gravity from the accelerometers and, for
comparison, the gimbal angles.

The base rocks while the stabilised element should keep its attitude in inertial space. If the element drifts, the direction of
gravity changes relative to the element. Before each run, the element is caged (fixed to the base); a run then consists of 10 min of
navigation after the release. Four runs form a quadruple: static, dynamic, dynamic, static. Quadruples are recorded in several
states; from one state to the next, the base is turned by 90°. The steps for each run are: (1) apply a low-pass filter, (2) correct
for the installation angles, (3) compute the tilts, (4) compute the change of the tilts from a window at t0 to a window at t1, (5)
subtract the change that an inertially fixed element would show. In step (6), the static runs are subtracted from the dynamic runs.
The module `windows` reads samples, `solution` performs steps 2 to 5, and `statistics` performs step 6 and makes the random pairs of
runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.said import Said, counted, said
from planrunner.estimators.interface import (
    Coefficient,
    Design,
    DesignRequest,
    Estimate,
    EstimateRequest,
    EstimationError,
    Foresight,
    UnfitDataError,
    Unpredicted,
)
from planrunner.estimators.rocking.angle_curves import curve_plots, drift_curves
from planrunner.estimators.rocking.checks import count_in_words, count_seconds, remarks, span
from planrunner.estimators.rocking.influences import (
    DEG_PER_HOUR,
    conditions_of,
    drifts_of,
    expected_scatter,
    influences_of,
)
from planrunner.estimators.rocking.parameters import RockingDriftParameters
from planrunner.estimators.rocking.report import (
    before_rocking_table,
    comparison,
    leak_note,
    method_error,
    pair_plots,
    quadruple_table,
    run_table,
    sentence,
)
from planrunner.estimators.rocking.runs import Quadruple, Run, by_state, find_runs, quadruples
from planrunner.estimators.rocking.solution import ReducedRun, expected_run, reduce_run
from planrunner.estimators.rocking.statistics import (
    AXES,
    WEIGHTS,
    CombinedDrifts,
    Pairings,
    StateDrifts,
    combine,
    implausible,
    pair,
)
from planrunner.estimators.rocking.windows import Windows
from planrunner.plan.schedule import Rock

UNIT = "deg/h"


class RockingDrift:
    """Implements the estimator `rocking_drift`."""

    summary = (
        "Drift of a platform while its base rocks, determined from gravity as measured by its accelerometers, "
        "and compared with the drift from the gimbal angles"
    )
    Parameters = RockingDriftParameters

    def design(self, request: DesignRequest[RockingDriftParameters]) -> Design:
        """Returns remarks on the plan. Raises `EstimationError` for segments that are not a rocking test."""
        parameters = request.parameters
        runs = find_runs(request.segments, parameters.rotation_order)
        found = remarks(request, runs)
        notes = []
        count = count_seconds(request, parameters)
        if count is not None:
            name, size, seconds = count
            notes.append(f"{name}: {count_in_words(size, seconds, parameters, request.site.gravity)}.")
        return Design((), notes=tuple(notes), remarks=tuple(found))

    def foresee(self, request: DesignRequest[RockingDriftParameters]) -> Foresight:
        """Predicts the drifts from declared effects that differ from run to run: accelerometer errors, drift, azimuth and ring
        errors. Samples are not simulated. Effects that all runs have in common cancel almost completely and are left out of the
        prediction."""
        runs = find_runs(request.segments, request.parameters.rotation_order)
        return _foreseen(request, by_state(quadruples(runs)), span(runs))

    def estimate(self, request: EstimateRequest[RockingDriftParameters]) -> Estimate:
        """Applies steps 1 to 6 with both methods. Raises `EstimationError` for unsuitable data."""
        parameters = request.parameters
        recorded = request.segments
        runs = find_runs([item.segment for item in request.segments], parameters.rotation_order)
        groups = by_state(quadruples(runs))
        windows = _windows([recorded[run.place] for run in runs], parameters)
        encoders, doubt = _encoders(request)
        conditions = conditions_of(request.site, parameters)
        reduced = [
            [
                [reduce_run(run, recorded[run.place], request, windows, encoders) for run in quadruple.runs]
                for quadruple in group
            ]
            for group in groups
        ]
        states = [
            StateDrifts(
                group[0].runs[0].segment.orientation,
                group[0].runs[0].state.level,
                tuple(group),
                np.array([[drifts_of(run, conditions) for run in four] for four in mine]),
            )
            for group, mine in zip(groups, reduced, strict=True)
        ]
        combined = combine(states)
        pairings = pair(states, parameters.pairings, parameters.pairing_seed) if encoders else []
        seconds = reduced[0][0][0].seconds
        earth_rate = request.site.earth_rate * DEG_PER_HOUR
        ring_error = math.sqrt(2) * request.setup.table.position_uncertainty if request.setup.table else 0.0
        curves = drift_curves(reduced, recorded, conditions, parameters)
        coefficients = tuple(_coefficient(combined, m) for m in range(len(combined.axes)))
        return Estimate(
            name=request.name,
            estimator="rocking_drift",
            coefficients=coefficients,
            covariance=combined.covariance,
            headline=tuple(item.name for item in coefficients),
            settings=_settings(parameters, windows, states),
            tables=(
                *((comparison(pairings),) if pairings else ()),
                quadruple_table(states),
                method_error(request, seconds),
                run_table(states),
                *before_rocking_table(reduced, conditions),
            ),
            plots=(*pair_plots(pairings), *curve_plots(curves)),
            notes=_notes(request, states, pairings, seconds),
            warnings=(
                *((doubt,) if doubt else ()),
                *implausible(states, earth_rate, ring_error / seconds * DEG_PER_HOUR),
            ),
            segments=tuple(run.label for run in runs),
            extra=_extra(states, pairings, reduced),
            influences=influences_of(reduced, combined, conditions, request),
        )


def _windows(recorded: Sequence[RecordedSegment], parameters: RockingDriftParameters) -> Windows:
    """Returns the positions of the windows, which are the same for all runs. By default, the second window is at the end of the
    shortest run. The plan may state another start of the window."""
    for item in recorded:
        if item.truncated:
            raise UnfitDataError(f"'{item.label}' was cut short: repeat its quadruple")
    planned = [item.segment.dwell for item in recorded if item.segment.dwell is not None]
    rates = [(item.statistics.count + item.statistics.rejected - 1) for item in recorded]
    if min(rates) < 1:
        raise UnfitDataError("a run has no samples")
    lasting = [item.statistics.end - item.statistics.start for item in recorded]
    end = min([*planned, *(seconds * (1 + 1 / n) for seconds, n in zip(lasting, rates, strict=True))])
    if planned and end < min(planned) - 1.0:
        short = recorded[int(np.argmin(lasting))]
        raise UnfitDataError(
            f"'{short.label}' lasts {min(lasting):.1f} s; {min(planned):g} s were planned: repeat its quadruple"
        )
    second = parameters.second(end)
    windows = Windows(parameters.release.value, second, parameters.window.value, parameters.cutoff.value, end)
    if second + windows.length > end + 1e-6:
        raise EstimationError(
            f"the second window ends at {second + windows.length:g} s, after the end of the shortest "
            f"record at {end:g} s: make "
            "`second_window` begin earlier"
        )
    if windows.second < windows.first + windows.length:
        raise EstimationError(
            f"the runs last {end:g} s: too short for a window at {windows.first:g} s and one at the end"
        )
    if 1 / windows.cutoff > windows.second - windows.first:
        raise EstimationError(
            f"a filter with a cutoff of {windows.cutoff:g} Hz averages over {1 / windows.cutoff:.3g} s, which is "
            "longer than the time between the windows: "
            "raise `cutoff`"
        )
    return windows


def _encoders(request: EstimateRequest[RockingDriftParameters]) -> tuple[bool, Said | None]:
    """Returns two values: True if ring and gimbal angles can be used, and a warning with the reason if they cannot."""
    parameters = request.parameters
    names = (*parameters.rings, *parameters.gimbals)
    missing = [name for name in names if any(name not in item.units for item in request.segments)]
    if missing:
        why = said("the recording has no channel '{channel}'", channel=missing[0])
    elif request.setup.table is None:
        why = said("the bench has no table with readable rings")
    elif len(request.setup.table.axes) != len(parameters.rings):
        why = said(
            "the table has {axes} axes, but `rings` names {rings} channels",
            axes=len(request.setup.table.axes),
            rings=len(parameters.rings),
        )
    else:
        return True, None
    if parameters.azimuth == "encoders":
        raise EstimationError(f"the azimuth comes from encoders, but {why}: write `azimuth: nominal`, or record them")
    return False, said("Without the gimbal-angle method: {why}.", why=why)


def _coefficient(combined: CombinedDrifts, m: int) -> Coefficient:
    name, words = _name(combined.axes[m], combined.by_gimbals[m])
    spread = math.sqrt(max(float(combined.covariance[m, m]), 0.0))
    return Coefficient(name, float(combined.values[m]), UNIT, spread, combined.degrees_of_freedom[m], words)


def _settings(parameters: RockingDriftParameters, windows: Windows, states: Sequence[StateDrifts]) -> dict[str, object]:
    return {
        "basis": "repeats",
        "t0": f"{windows.first:g} s",
        "t1": f"{windows.second:g} s",
        "window": f"{windows.length:g} s",
        "cutoff": f"{windows.cutoff:g} Hz",
        "azimuth": parameters.azimuth,
        "rotation order": {state.name: _order(state.quadruples[0].runs[0]) for state in states},
    }


def _order(run: Run) -> str:
    state = run.state
    return "·".join(f"R_{AXES[axis]}" for axis in (state.other, state.sine, state.vertical))


def _notes(
    request: EstimateRequest[RockingDriftParameters],
    states: Sequence[StateDrifts],
    pairings: Sequence[Pairings],
    seconds: float,
) -> tuple[Said, ...]:
    notes = [sentence(pairings)] if pairings else []
    rocking = next(run.segment for run in states[0].quadruples[0].runs if run.dynamic)
    if isinstance(rocking.motion, Rock) and math.isfinite(rocking.motion.duration):
        first = request.parameters.release.value + request.parameters.window.value / 2
        begins, ends = rocking.motion.steady, rocking.motion.steady + rocking.motion.duration
        rocked = min(ends, first + seconds) - max(begins, first)
        notes.append(
            said(
                "The rocking drift is the mean over the {seconds:g} s from t0 to t1; the base rocked for {rocked:g} s of this time.",
                seconds=seconds,
                rocked=rocked,
            )
        )
    notes.append(leak_note(request, seconds))
    if any(len(state.quadruples) == 1 for state in states):
        notes.append(
            said(
                "Some states have only one quadruple. Their uncertainty is based on the differences between the two "
                "static runs and between the two dynamic runs, and has one degree of freedom. Use `repeat` to "
                "record more quadruples for a narrower interval."
            )
        )
    missing = [AXES[axis] for axis in range(3) if all(axis not in state.level for state in states)]
    if missing:
        notes.append(
            counted(
                "The axis {axes} is level in no state, so gravity does not show a drift about it.",
                "The axes {axes} are level in no state, so gravity does not show a drift about them.",
                count=len(missing),
                axes=tuple(missing),
            )
        )
    return tuple(notes)


def _extra(
    states: Sequence[StateDrifts], pairings: Sequence[Pairings], reduced: Sequence[Sequence[Sequence[ReducedRun]]]
) -> dict[str, object]:
    return {
        "seconds": reduced[0][0][0].seconds,
        "rocking": {state.name: state.rocking.tolist() for state in states},
        "pairings": {
            AXES[pairs.axis]: {
                "pairs": len(pairs.accelerometers),
                "standard_deviation": pairs.deviations[0],
                "gimbal_standard_deviation": pairs.deviations[1],
                "smaller": pairs.smaller,
            }
            for pairs in pairings
        },
    }


def _foreseen(
    request: DesignRequest[RockingDriftParameters], groups: Sequence[Sequence[Quadruple]], dwell: float | None
) -> Foresight:
    """Predicts the results of a rocking test. `dwell`: dwell of the shortest run, s; None if it is not known."""
    parameters, table = request.parameters, request.setup.table
    recorded = all(request.sensor.output(name) is not None for name in (*parameters.rings, *parameters.gimbals))
    encoders = recorded and table is not None and len(table.axes) == len(parameters.rings)
    columns = 4 if encoders else 2
    conditions = conditions_of(request.site, parameters)
    states = []
    for group in groups:
        expected = np.zeros((columns, columns))
        if dwell is not None:
            times = parameters.release.value, parameters.second(dwell)
            for run, weight in zip(group[0].runs, WEIGHTS, strict=True):
                fixed = expected_run(run, times, conditions, encoders)
                expected += weight**2 * expected_scatter(fixed, conditions, request)
        first = group[0].runs[0]
        drifts = np.zeros((len(group), 4, columns))
        states.append(StateDrifts(first.segment.orientation, first.state.level, tuple(group), drifts, expected))
    combined = combine(states)
    coefficients = tuple(_coefficient(combined, m) for m in range(len(combined.axes)))
    if dwell is not None:
        return Foresight(coefficients)
    why = "the plan does not give the length of the runs"
    return Foresight(unpredicted=tuple(Unpredicted(one.name, UNIT, why, one.description) for one in coefficients))


def _name(axis: int, by_gimbals: bool) -> tuple[str, Said]:
    """Returns the name and the description of the drift about an axis. `by_gimbals`: True if the drift is computed from the
    gimbals."""
    letter = AXES[axis]
    if by_gimbals:
        return f"gimbal_drift_{letter}", said("rocking drift about {axis}, from gimbal and ring angles", axis=letter)
    return f"drift_{letter}", said("rocking drift about {axis}", axis=letter)

"""Makes the tables, plots and sentences of the report on a rocking test. The report compares the two methods, and states the limits
of the gravity method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from planrunner.base.said import Said, said
from planrunner.estimators.interface import EstimateRequest
from planrunner.estimators.rocking.checks import ARCSEC
from planrunner.estimators.rocking.influences import DEG_PER_HOUR, Runs, azimuth_uncertainty, resolution
from planrunner.estimators.rocking.parameters import RockingDriftParameters
from planrunner.estimators.rocking.solution import RockingConditions, accelerometer_drift, drift_before_rocking
from planrunner.estimators.rocking.statistics import AXES, Pairings, StateDrifts
from planrunner.estimators.tables import Plot, Role, Table, TableColumn, by_columns
from planrunner.plan.units import STANDARD_GRAVITY

CLAIMED = 0.70
STATED_STABILITY = 1e-5 * STANDARD_GRAVITY  # m/s^2, for the figures that are commonly quoted
COMMON_TIMES = (540.0, 900.0)  # s


_BY_METHOD = (
    TableColumn("drift from accelerometers", Role.VALUE, "deg/h"),
    TableColumn("drift from gimbal angles", Role.VALUE, "deg/h"),
)


def comparison(pairings: Sequence[Pairings]) -> Table:
    ours, theirs = zip(*(pairs.deviations for pairs in pairings), strict=True)
    ratios = [
        f"{other / own:.1f}" if own > 0 and math.isfinite(other) else ""
        for own, other in zip(ours, theirs, strict=True)
    ]
    smaller = [float(pairs.smaller) for pairs in pairings]
    return by_columns(
        "Comparison of the two methods over random pairings of a static and a dynamic run",
        (TableColumn("axis"), [AXES[pairs.axis] for pairs in pairings]),
        (TableColumn("pairs", Role.COUNT), [len(pairs.accelerometers) for pairs in pairings]),
        (TableColumn("standard deviation, accelerometers", Role.VALUE, "deg/h"), map(_figure, ours)),
        (TableColumn("standard deviation, gimbal angles", Role.VALUE, "deg/h"), map(_figure, theirs)),
        (TableColumn("ratio", Role.VALUE), ratios),
        (TableColumn("share of pairings in which the accelerometers give the smaller drift", Role.SHARE), smaller),
    )


def sentence(pairings: Sequence[Pairings]) -> Said:
    """Writes a sentence that compares the two methods over all random pairs of runs."""
    better = [AXES[pairs.axis] for pairs in pairings if pairs.deviations[0] < pairs.deviations[1]]
    worse = [AXES[pairs.axis] for pairs in pairings if AXES[pairs.axis] not in better]
    all_pairs = sum(len(pairs.accelerometers) for pairs in pairings)
    smaller = sum(pairs.smaller * len(pairs.accelerometers) for pairs in pairings) / all_pairs
    few = [AXES[pairs.axis] for pairs in pairings if pairs.smaller <= CLAIMED]
    if not worse:
        where = said("on every axis ({axes})", axes=tuple(better))
    elif better:
        where = said("on {axes}, not on {others}", axes=tuple(better), others=tuple(worse))
    else:
        where = said("on none of the axes ({others})", others=tuple(worse))
    claim = said("not more than 70 % on {axes}", axes=tuple(few)) if few else said("more than 70 % on every axis")
    return said(
        "Over {pairs} random pairings of a static and a dynamic run, the accelerometer method has the smaller standard deviation "
        "{where}. In {share:.0f} % of the pairings ({claim}), the drift from the accelerometers is smaller in magnitude than the "
        "drift from the gimbal angles.",
        pairs=all_pairs,
        where=where,
        share=100 * smaller,
        claim=claim,
    )


def quadruple_table(states: Sequence[StateDrifts]) -> Table:
    """Makes a table of the rocking drift (step 6) of each quadruple of runs."""
    rows = []
    encoders = states[0].drifts.shape[2] == 4
    for state in states:
        for quadruple, values in zip(state.quadruples, state.rocking, strict=True):
            for place, axis in enumerate(state.level):
                row = [quadruple.name, AXES[axis], _figure(values[place])]
                rows.append((*row, _figure(values[place + 2])) if encoders else tuple(row))
    columns = (TableColumn("quadruple"), TableColumn("axis"), *_BY_METHOD[: 2 if encoders else 1])
    return Table("Rocking drift of each quadruple of runs (static, dynamic, dynamic, static)", columns, tuple(rows))


def run_table(states: Sequence[StateDrifts]) -> Table:
    """Makes a table of the drift (step 5) of each run."""
    rows = []
    encoders = states[0].drifts.shape[2] == 4
    for state in states:
        names = [AXES[axis] for axis in state.level]
        for quadruple, drifts in zip(state.quadruples, state.drifts, strict=True):
            for run, values in zip(quadruple.runs, drifts, strict=True):
                shown = [", ".join(f"{name} {_figure(v)}" for name, v in zip(names, values[:2], strict=True))]
                if encoders:
                    shown.append(", ".join(f"{name} {_figure(v)}" for name, v in zip(names, values[2:], strict=True)))
                rows.append((run.label, *shown))
    columns = (TableColumn("run"), *(replace(one, role=Role.LABEL) for one in _BY_METHOD[: 2 if encoders else 1]))
    return Table("Drift of each run relative to inertial space", columns, tuple(rows))


def before_rocking_table(runs: Runs, conditions: RockingConditions) -> list[Table]:
    """Makes a table that compares, for dynamic runs, the drift before rocking begins with the drift of the complete run. The table
    is empty if no record contains a time before rocking."""
    rows = []
    for reduced in (run for state in runs for four in state for run in four):
        before = drift_before_rocking(reduced, conditions)
        if before is None:
            continue
        whole = accelerometer_drift(reduced, conditions)
        for place, axis in enumerate(reduced.run.state.level):
            figures = [_figure(float(drift[place]) * DEG_PER_HOUR) for drift in (before, whole)]
            rows.append((reduced.run.label, AXES[axis], *figures))
    columns = (
        TableColumn("run"),
        TableColumn("axis"),
        TableColumn("before the rocking", Role.VALUE, "deg/h"),
        TableColumn("from t0 to t1", Role.VALUE, "deg/h"),
    )
    return [Table("Static drift before the rocking, by accelerometers", columns, tuple(rows))] if rows else []


def method_error(request: EstimateRequest[RockingDriftParameters], seconds: float) -> Table:
    """Makes a table of the possible errors [deg/h] that the gravity method causes in the drift of one run. `seconds`: time between
    the windows, s."""
    parameters = request.parameters
    gravity = request.site.gravity
    rows = [
        (f"accelerometer stability of 10 µg over {time:g} s", _figure(STATED_STABILITY / gravity / time * DEG_PER_HOUR))
        for time in COMMON_TIMES
    ]
    stability = parameters.accelerometer_stability
    if stability is not None:
        shown = f"accelerometer stability of {stability} (plan) over {seconds:g} s"
        rows.append((shown, _figure(stability.value / gravity / seconds * DEG_PER_HOUR)))
    count = resolution(request, parameters)
    if count:
        shown = f"one count of the accelerometers, {count / STANDARD_GRAVITY * 1e6:.3g} µg, over {seconds:g} s"
        rows.append((shown, _figure(count / gravity / seconds * DEG_PER_HOUR)))
    level = math.cos(request.site.latitude) * request.site.earth_rate * DEG_PER_HOUR
    whole = request.site.earth_rate * DEG_PER_HOUR
    rows.append(
        ("Effect of the Earth rate with an unmodelled azimuth error of 0.1 deg", _figure(level * math.radians(0.1)))
    )
    azimuth = azimuth_uncertainty(request)
    if azimuth is not None:
        size = azimuth.standard_uncertainty
        rows.append(
            (
                f"Effect of the Earth rate with the stated azimuth uncertainty of {size / ARCSEC:.3g} arcsec",
                _figure(level * size),
            )
        )
    rows.append(("Effect of the Earth rate with an attitude error of 6.9 arcsec", _figure(whole * 6.9 * ARCSEC)))
    return Table(
        "Method error of one run", (TableColumn("source"), TableColumn("size", Role.VALUE, "deg/h")), tuple(rows)
    )


def pair_plots(pairings: Sequence[Pairings]) -> list[Plot]:
    """Makes one plot for each axis. The plot shows the absolute values of the drifts by both methods in ascending order."""
    return [
        Plot(
            f"Rocking drift about {AXES[pairs.axis]} over random pairings",
            "share of the pairs with a smaller drift, %",
            "size of the rocking drift, deg/h",
            tuple(100 * (number + 0.5) / len(pairs.gimbals) for number in range(len(pairs.gimbals))),
            {
                "by gimbal angles": tuple(sorted(map(abs, pairs.gimbals.tolist()))),
                "by accelerometers": tuple(sorted(map(abs, pairs.accelerometers.tolist()))),
            },
            lines=True,
        )
        for pairs in pairings
    ]


def leak_note(request: EstimateRequest[RockingDriftParameters], seconds: float) -> Said:
    """Writes a note on the drift about the vertical axis. The note states which fraction of such a drift appears as a drift about a
    level axis. `seconds`: time between the windows, s."""
    tilt = math.cos(request.site.latitude) * request.site.earth_rate * seconds
    return said(
        "By the second window, the element has tilted by {tilt:.2f} deg relative to the site: up to {share:.1f} % of the "
        "rocking drift about the vertical axis appears as drift about a level axis.",
        tilt=math.degrees(tilt),
        share=100 * math.sin(tilt),
    )


def _figure(value: float) -> str:
    digits = 4 if abs(value) >= 0.001 or value == 0 else 5
    return f"{value:.{digits}f}" if math.isfinite(value) else ""

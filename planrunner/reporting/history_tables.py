"""Makes tables, sentences and a plot of text characters for the commands `runs`, `history` and `compare`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime

from planrunner.base.findings import count_of
from planrunner.estimators.tables import Role, Shown, Table, TableColumn, table_of
from planrunner.instruments.models import DataOrigin
from planrunner.night.history.agreement import ParticipantAgreement
from planrunner.night.history.check_standard import ControlState, ControlTest
from planrunner.night.history.comparison import RunComparison
from planrunner.night.history.control_charts import EWMA_WIDTH, SHEWHART
from planrunner.night.history.drift import HORIZON, LEAST, LEAST_SPAN
from planrunner.night.history.gauge import GaugeStudy, VarianceComponent
from planrunner.night.history.rows import RunRow
from planrunner.night.history.trend import DAY, Trend
from planrunner.reporting import words
from planrunner.reporting.verdict import stamp
from planrunner.uncertainty.homogeneity import SIGNIFICANT

_NOT_MEASURED: tuple[DataOrigin, ...] = ("simulated", "replayed")
HEIGHT, WIDTH = 13, 72
"""Numbers of rows and columns of the plot on the terminal."""


def runs_table(runs: Sequence[RunRow]) -> Table:
    columns: tuple[Shown[RunRow], ...] = (
        Shown(TableColumn("run"), lambda run: run.folder),
        Shown(TableColumn("made (UTC)"), _made),
        Shown(TableColumn("device"), lambda run: run.device),
        Shown(TableColumn("bench"), lambda run: run.bench),
        Shown(TableColumn("operator"), lambda run: run.operator),
        Shown(TableColumn("plan"), lambda run: run.plan),
        Shown(TableColumn("verdict"), lambda run: run.verdict),
        Shown(TableColumn("state"), lambda run: run.state),
    )
    return table_of("Runs", columns, runs)


def _made(run: RunRow) -> str:
    """Returns the time at which a run was made, to the minute."""
    return run.created[:16].replace("T", " ")


def points_table(found: Trend) -> Table:
    """Returns a table with one row for each value of the coefficient and its result in the control charts."""
    runs = [point.run for point in found.points]
    columns: tuple[Shown[int], ...] = (
        Shown(TableColumn("made (UTC)"), lambda k: _made(runs[k])),
        Shown(TableColumn("bench"), lambda k: runs[k].bench),
        Shown(TableColumn("operator"), lambda k: runs[k].operator),
        Shown(TableColumn("value", Role.VALUE, found.unit), lambda k: found.values[k]),
        Shown(TableColumn("u", Role.STANDARD_UNCERTAINTY, found.unit), lambda k: found.standard_uncertainties[k]),
        Shown(TableColumn("verdict"), lambda k: runs[k].verdict),
        Shown(TableColumn("alarms"), lambda k: ", ".join(alarms(found, k))),
        Shown(TableColumn("run"), lambda k: runs[k].folder),
    )
    title = f"{found.quantity} of {found.device}"
    return (
        table_of(title, columns, range(len(runs))) if runs else Table(title, tuple(one.column for one in columns), ())
    )


def alarms(found: Trend, k: int) -> list[str]:
    """Returns the names of the charts in which value k is outside the limits."""
    charts = found.charts
    if charts is None:
        return []
    named = {
        "Shewhart": charts.shewhart,
        "EWMA": charts.ewma,
        "CUSUM up": charts.cusum_up,
        "CUSUM down": charts.cusum_down,
    }
    return [name for name, chart in named.items() if chart.alarms[k]]


def control_table(state: ControlState) -> Table:
    """Returns a table about the control of a check standard. Each coefficient has one row for each comparison of its newest value
    with limits, or a single row if there are no limits."""
    titles = (
        "coefficient", "unit", "newest value", "u", "values", "compared with", "centre", "lower limit", "upper limit", "outside"
    )  # fmt: skip
    rows = []
    for one in state.coefficients:
        value, u = one.trend.values[-1], one.trend.standard_uncertainties[-1]
        head = one.quantity, one.trend.unit, words.number(value), words.number(u, 2), str(len(one.trend.values))
        for limits in one.limits:  # EWMA and CUSUM belong to the chart of the Shewhart limits
            about_reference = limits.test is ControlTest.REFERENCE
            outside = [test.value for test in one.failed if (test is ControlTest.REFERENCE) == about_reference]
            numbers = map(words.number, (limits.centre, limits.lower, limits.upper))
            rows.append((*head, limits.test.value, *numbers, ", ".join(outside)))
        if not one.limits:
            rows.append((*head, *["—"] * 4, ""))
    return Table(f"Check standard {state.device} of bench {state.bench}", tuple(map(TableColumn, titles)), tuple(rows))


def agreement_table(title: str, found: Sequence[ParticipantAgreement], unit: str) -> Table:
    columns: tuple[Shown[ParticipantAgreement], ...] = (
        Shown(TableColumn(title), lambda one: one.name),
        Shown(TableColumn("runs", Role.COUNT), lambda one: float(one.runs)),
        Shown(TableColumn("mean", Role.VALUE, unit), lambda one: one.value),
        Shown(TableColumn("u", Role.STANDARD_UNCERTAINTY, unit), lambda one: one.standard_uncertainty),
        Shown(TableColumn("mean of the others", Role.NUMBER, unit), lambda one: one.reference),
        Shown(TableColumn("E_n"), lambda one: f"{one.en:.2f}"),
        Shown(TableColumn("agreement"), lambda one: "yes" if one.agrees else "NO"),
    )
    return table_of(f"Agreement of {title} (ISO 13528: |E_n| ≤ 1)", columns, found)


def comparison_table(found: RunComparison) -> Table:
    """Returns a table with one row for each coefficient and one column for each run."""
    columns = [TableColumn("coefficient"), TableColumn("unit")]
    for number in range(1, len(found.runs) + 1):
        columns.append(TableColumn(f"run {number}"))
    columns += [TableColumn("largest |E_n|"), TableColumn("scatter/u"), TableColumn("p")]
    rows = []
    for one in found.coefficients:
        cells = [
            "—" if pair is None else f"{words.number(pair[0])} ± {words.number(2 * pair[1], 2)}" for pair in one.values
        ]
        en = "—" if one.largest_en is None else f"{one.largest_en:.2f}"
        scatter = ("—", "—") if one.scatter is None else (f"{one.scatter.ratio:.2f}", f"{one.scatter.chance:.1g}")
        rows.append((one.quantity, one.unit, *cells, en, *scatter))
    return Table("Coefficients with expanded uncertainties (k = 2)", tuple(columns), tuple(rows))


def scatter_sentence(found: RunComparison) -> str:
    """Returns a sentence about the scatter from run to run; empty if no coefficient has an uncertainty in two runs."""
    if not any(one.scatter is not None for one in found.coefficients):
        return ""
    more = found.scattered
    if not more:
        return "The runs scatter no more than the stated uncertainties allow (scatter/u: Birge ratio; p: probability by chance)."
    listed = ", ".join(f"{one.quantity} ({one.scatter.ratio:.2g} times)" for one in more if one.scatter is not None)
    said = f"The runs scatter more than their standard uncertainties allow: {listed}."
    differ = [
        what
        for what, names in (
            ("device", {run.device for run in found.runs}),
            ("bench", {run.bench for run in found.runs}),
            ("laboratory", {run.laboratory for run in found.runs}),
        )
        if len(names) > 1
    ]
    if differ:
        return f"{said} The runs do not have the same {' and '.join(differ)}: the differences may be real."
    return f"{said} The stated uncertainties are too small for repeats."


def gauge_table(found: GaugeStudy, unit: str) -> Table:
    """Returns a table of the components of variance: their standard deviations with intervals, and their shares of the total
    variance."""
    total = found.components[-1].variance
    columns: tuple[Shown[VarianceComponent], ...] = (
        Shown(TableColumn("component"), lambda one: one.name),
        Shown(TableColumn("standard deviation", Role.NUMBER, unit), lambda one: one.standard_deviation),
        Shown(TableColumn("95 % from", Role.NUMBER, unit), lambda one: one.lower**0.5),
        Shown(TableColumn("to", Role.NUMBER, unit), lambda one: one.upper**0.5),
        Shown(TableColumn("share of variance", Role.SHARE), lambda one: one.variance / total if total else 0.0),
    )
    return table_of("Gauge R&R", columns, found.components)


def sentences(found: Trend) -> list[str]:
    """Describes the history in sentences."""
    unit = words.behind_number(found.unit)
    said = list(_stamps(found))
    charts = found.charts
    if charts is None:
        said.append("There are too few values, or values without uncertainty, for control charts.")
    else:
        centre = charts.centre
        said.append(
            f"Mean of the first {centre.values} values: {words.number(centre.mean)}{unit} "
            f"(u = {words.number(centre.standard_uncertainty, 2)}{unit}); "
            f"scatter from run to run beyond the stated uncertainties: {words.number(centre.between, 2)}{unit}."
        )
        if found.scatter is not None:
            significant = found.scatter.chance < SIGNIFICANT
            about = "more than the uncertainties allow" if significant else "consistent with the uncertainties"
            said.append(
                f"All {found.scatter.repeats} values scatter {words.number(found.scatter.ratio, 2)} times as much as their standard "
                f"uncertainties state (p = {found.scatter.chance:.1g}): {about}."
            )
        now = alarms(found, len(found.points) - 1)
        outside = f"outside the limits of {', '.join(now)}" if now else "within all control limits"
        said.append(f"The newest value is {outside} (Shewhart ±{SHEWHART:g} σ, EWMA ±{EWMA_WIDTH:g} σ, CUSUM).")
    for change in found.changes:
        before, after = found.points[change.index - 1].run, found.points[change.index].run
        said.append(
            f"The level changed by {words.number(change.step, 3)}{unit} (u = {words.number(change.standard_uncertainty, 2)}{unit}, "
            f"p = {change.p:.1g}) between {before.created[:10]} and {after.created[:10]}."
        )
        if change.causes:
            listed = "; ".join(f"{one.words}: {one.before or 'none'} → {one.after or 'none'}" for one in change.causes)
            said.append(f"At the same time these changed: {listed}.")
        else:
            said.append("No recorded circumstance changed at the same time.")
    said += _drift(found, unit)
    if found.left_out:
        said.append(
            f"Left out: {count_of(len(found.left_out), 'run')} with a value of another dimension, or one that is not finite."
        )
    return said


def _stamps(found: Trend) -> Iterator[str]:
    """Returns notes on the runs whose samples were not measured in the run itself, for example simulated samples."""
    origins = [point.run.origin for point in found.points]
    for origin in _NOT_MEASURED:
        mark = stamp(origin)
        if mark is not None and origin in origins:
            yield f"{mark.word} ({origins.count(origin)} of {len(origins)} runs): {mark.about}"


def _drift(found: Trend, unit: str) -> list[str]:
    line = found.drift
    if line is None:
        return _no_drift(found)
    slope, u = (words.number(x * 365.25, 3) for x in (line.slope, 2 * line.slope_uncertainty))
    significant = "" if line.significant else ", which is not significant"
    since = f" since {found.points[found.changes[-1].index].run.created[:10]}" if found.changes else ""
    said = [f"Drift{since}: {slope} ± {u}{unit} per year (k = 2){significant}."]
    due = found.next_calibration
    on = f"more than {HORIZON / 365.25:.0f} years after the last run" if due is None else due.date().isoformat()
    what = (
        "the drift exceeds the expanded uncertainty of a value"
        if found.tolerance is None
        else f"drift and expanded uncertainty reach {words.number(found.tolerance)}{unit}"
    )
    said.append(f"Next calibration (ILAC-G24 method 2), when {what}: {on}.")
    return said


def _no_drift(found: Trend) -> list[str]:
    """States why the drift cannot be computed, and what is needed to compute it."""
    if len(found.points) < 2:
        return []
    runs = [point.run for point in found.points[found.changes[-1].index if found.changes else 0 :]]
    span = _seconds(runs[-1]) - _seconds(runs[0])
    if len(runs) >= LEAST and span >= LEAST_SPAN * DAY:
        return ["The values have no uncertainty, so no drift can be determined."]
    where = " since the last change" if found.changes else ""
    within = f" within {words.duration(span)}" if span > 0 else ""
    what = "too few values" if len(runs) < LEAST else "too short a span"
    return [
        f"No drift and no date of the next calibration: {what}{where} ({len(runs)} run{'s' if len(runs) > 1 else ''}{within}). At least "
        f"{LEAST} runs over at least {LEAST_SPAN:g} day are needed."
    ]


def plot_lines(found: Trend) -> list[str]:
    """Returns the values over time as a plot of text characters: `●` marks a value, `○` marks a value with an alarm, `─` marks the
    mean, and `┄` marks the Shewhart limits of the newest value."""
    if len(found.values) < 2:
        return []
    times = [_seconds(point.run) for point in found.points]
    charts = found.charts
    marks = (
        []
        if charts is None
        else [charts.centre.mean, float(charts.shewhart.lower[-1]), float(charts.shewhart.upper[-1])]
    )
    low, high = min([*found.values, *marks]), max([*found.values, *marks])
    span, length = (high - low) or 1.0, (times[-1] - times[0]) or 1.0

    def row(value: float) -> int:
        return round((high - value) / span * (HEIGHT - 1))

    grid = [[" "] * WIDTH for _ in range(HEIGHT)]
    for value, sign in zip(marks, "─┄┄", strict=False):
        grid[row(value)] = [sign] * WIDTH
    for k, (time, value) in enumerate(zip(times, found.values, strict=True)):
        grid[row(value)][round((time - times[0]) / length * (WIDTH - 1))] = "○" if alarms(found, k) else "●"
    labels = {0: words.number(high, 5), HEIGHT - 1: words.number(low, 5)}
    if charts is not None:
        labels.setdefault(row(charts.centre.mean), words.number(charts.centre.mean, 5))
    wide = max(map(len, labels.values()))
    lines = [f"{labels.get(number, ''):>{wide}} │{''.join(cells)}" for number, cells in enumerate(grid)]
    first, last = found.points[0].run.created[:10], found.points[-1].run.created[:10]
    return [*lines, f"{'':>{wide}} └{'─' * WIDTH}", f"{'':>{wide}}  {first}{last:>{WIDTH - len(first)}}"]


def _seconds(run: RunRow) -> float:
    return datetime.fromisoformat(run.created).timestamp()

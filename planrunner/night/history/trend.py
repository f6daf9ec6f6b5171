"""Computes the history of one coefficient of one device. The history contains control charts, changes of level with candidates for
their causes, the drift and the date of the next calibration, and the agreement of benches and laboratories."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json, JsonObject
from planrunner.night.history.agreement import ParticipantAgreement, agreement
from planrunner.night.history.change_points import ChangePoint, causes, change_points, steps_fit_better
from planrunner.night.history.control_charts import Chart, ControlCharts, control_charts
from planrunner.night.history.drift import HORIZON, DriftLine, days_left, drift_line
from planrunner.night.history.rows import Circumstance, HistoryPoint
from planrunner.plan.units import UnknownUnitError, convert
from planrunner.uncertainty.homogeneity import Homogeneity, homogeneity

HISTORY_FORMAT = 1
DAY = 86400.0


@dataclass(frozen=True)
class Trend:
    """The history of a coefficient.

    `points`: the points of the runs whose value can be used, the oldest first. `values`, `standard_uncertainties`: arrays of shape
    (n,), values and standard uncertainties in `unit`, which is the unit of the newest run. `left_out`: folders of runs whose value
    cannot be used, because it has another dimension, is missing, or has no finite uncertainty. `charts`, `drift`: control charts
    and drift line; None if there are too few values. `tolerance`: the permissible deviation, which determines when the next
    calibration is due; None if it is not stated. `scatter`: scatter of all values, compared with their uncertainties; None if fewer
    than two values have an uncertainty.
    """

    device: str
    quantity: str
    unit: str
    points: tuple[HistoryPoint, ...]
    values: tuple[float, ...]
    standard_uncertainties: tuple[float, ...]
    left_out: tuple[str, ...]
    charts: ControlCharts | None
    changes: tuple[ChangePoint, ...]
    drift: DriftLine | None
    tolerance: float | None
    benches: tuple[ParticipantAgreement, ...]
    laboratories: tuple[ParticipantAgreement, ...]
    scatter: Homogeneity | None = None

    @property
    def next_calibration(self) -> datetime | None:
        """Returns the date of the next calibration; None if there is no drift line or if the date is later than `HORIZON` days
        after the last run."""
        if self.drift is None:
            return None
        left = days_left(self.drift, self.tolerance)
        return None if left >= HORIZON else moment(self.points[-1]) + timedelta(days=left)

    def to_json(self) -> JsonObject:
        """Returns JSON data according to schemas/history.schema.json."""
        charts, drift, due = self.charts, self.drift, self.next_calibration
        return {
            "planrunner_history": HISTORY_FORMAT,
            "device": self.device,
            "quantity": self.quantity,
            "unit": self.unit,
            "points": [self._point(k) for k in range(len(self.points))],
            "left_out": list(self.left_out),
            "centre": None
            if charts is None
            else {
                "mean": charts.centre.mean,
                "standard_uncertainty": charts.centre.standard_uncertainty,
                "between_runs": charts.centre.between,
                "values": charts.centre.values,
            },
            "scatter": None if self.scatter is None else self.scatter.to_json(),
            "out_of_control": None if charts is None else charts.out_of_control,
            "changes": [self._change(one) for one in self.changes],
            "drift": None
            if drift is None
            else {
                "per_year": drift.slope * 365.25,
                "standard_uncertainty": drift.slope_uncertainty * 365.25,
                "significant": drift.significant,
                "tolerance": self.tolerance,
                "next_calibration": None if due is None else due.isoformat(timespec="seconds"),
            },
            "benches": [_participant(one) for one in self.benches],
            "laboratories": [_participant(one) for one in self.laboratories],
        }

    def _point(self, k: int) -> JsonObject:
        point, charts = self.points[k], self.charts
        limits = [
            {"lower": _finite(one.lower), "upper": _finite(one.upper), "verdict": one.verdict} for one in point.limits
        ]
        found = {
            "folder": point.run.folder,
            "created": point.run.created,
            "bench": point.run.bench,
            "operator": point.run.operator,
            "verdict": point.run.verdict,
            "value": self.values[k],
            "standard_uncertainty": self.standard_uncertainties[k],
            "limits": limits,
        }
        if charts is not None:
            named = {
                "shewhart": charts.shewhart,
                "ewma": charts.ewma,
                "cusum_up": charts.cusum_up,
                "cusum_down": charts.cusum_down,
            }
            found["charts"] = {name: _of_chart(chart, k) for name, chart in named.items()}
        return found

    def _change(self, one: ChangePoint) -> JsonObject:
        return {
            "last_before": self.points[one.index - 1].run.folder,
            "first_after": self.points[one.index].run.folder,
            "step": one.step,
            "standard_uncertainty": one.standard_uncertainty,
            "p": one.p,
            "causes": [
                {
                    "kind": cause.kind.value,
                    "name": cause.name,
                    "before": cause.before,
                    "after": cause.after,
                    "shared": cause.shared,
                }
                for cause in one.causes
            ],
        }


def trend(device: str, quantity: str, found: Sequence[HistoryPoint], tolerance: float | None = None) -> Trend:
    """Makes the history of a coefficient from the values of a device, the oldest first. `tolerance`: permissible deviation in the
    unit of the newest run."""
    unit = found[-1].coefficient.unit if found else ""
    points: list[HistoryPoint] = []
    values: list[float] = []
    u: list[float] = []
    left_out: list[str] = []
    for point in found:
        one = _in_unit(point, unit, values[0] if values else None)
        if one is None:
            left_out.append(point.run.folder)
        else:
            points.append(point)
            values.append(one[0])
            u.append(one[1])
    charts = control_charts(values, u) if len(values) > 1 else None
    changes: tuple[ChangePoint, ...] = ()
    drift = None
    if charts is not None:
        held = [point.run.circumstances for point in points]
        days = np.array([moment(point).timestamp() / DAY for point in points])
        x, s = np.array(values), np.array(u)
        steps = change_points(x, charts.sigma)
        if steps and steps_fit_better(x, charts.sigma, days, steps):
            changes = tuple(_explained(one, held) for one in steps)
        since = changes[-1].index if changes else 0
        drift = drift_line(days[since:], x[since:], s[since:], charts.centre.between)
    return Trend(
        device,
        quantity,
        unit,
        tuple(points),
        tuple(values),
        tuple(u),
        tuple(left_out),
        charts,
        changes,
        drift,
        tolerance,
        agreement(_grouped([point.run.bench for point in points], values, u)),
        agreement(_grouped([point.run.laboratory for point in points], values, u)),
        homogeneity(values, u, [point.coefficient.degrees_of_freedom for point in points]),
    )


def moment(point: HistoryPoint) -> datetime:
    return datetime.fromisoformat(point.run.created)


def _explained(one: ChangePoint, held: Sequence[Sequence[Circumstance]]) -> ChangePoint:
    return ChangePoint(one.index, one.step, one.standard_uncertainty, one.p, one.begin, one.end, causes(one, held))


def _in_unit(point: HistoryPoint, unit: str, first: float | None) -> tuple[float, float] | None:
    """Converts a value and its uncertainty to another unit. Returns None if this is not possible, or if the value or its
    uncertainty is not finite. A circular value is shifted by whole turns so that it is nearest to the first value."""
    one = point.coefficient
    try:
        value, u, period = one.value, one.standard_uncertainty, one.period
        if one.unit != unit:
            zero = convert(0.0, one.unit, unit)
            value, u, period = (convert(x, one.unit, unit) for x in (value, u, period))
            u, period = u - zero, period - zero
    except (UnknownUnitError, ValueError):
        return None
    if not (math.isfinite(value) and math.isfinite(u) and u >= 0):
        return None
    if first is not None and math.isfinite(period) and period > 0:
        value += period * round((first - value) / period)
    return value, u


def _grouped(
    names: Sequence[str], values: Sequence[float], u: Sequence[float]
) -> Mapping[str, list[tuple[float, float]]]:
    groups: dict[str, list[tuple[float, float]]] = {}
    for name, value, s in zip(names, values, u, strict=True):
        if name:
            groups.setdefault(name, []).append((value, s))
    return groups


def _of_chart(chart: Chart, k: int) -> JsonObject:
    return {
        "statistic": float(chart.statistic[k]),
        "lower": float(chart.lower[k]),
        "upper": float(chart.upper[k]),
        "alarm": bool(chart.alarms[k]),
    }


def _participant(one: ParticipantAgreement) -> JsonObject:
    return {
        "name": one.name,
        "runs": one.runs,
        "value": one.value,
        "standard_uncertainty": one.standard_uncertainty,
        "reference": one.reference,
        "reference_uncertainty": one.reference_uncertainty,
        "en": _finite(one.en),
    }


def _finite(value: float) -> Json:
    return value if math.isfinite(value) else None

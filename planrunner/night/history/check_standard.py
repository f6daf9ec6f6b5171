"""Determines whether the check standard of a bench is in control.

A new value x of the check standard with the stated standard uncertainty u is compared with

- a reference value R with the standard uncertainty u_R, if the bench file states one: |x − R| ≤ 3·√(u² + u_R² + τ²);
- the first values of the check standard, if there are enough of them, in the charts of `control_charts`; the mean and τ of these
  charts come from the first values.

τ is the stated repeatability or, if none is stated, the scatter of the first values. A tested value never contributes to its own
limits. The method follows the NIST/SEMATECH e-Handbook of Statistical Methods, 2.2.2. The values of a check standard are charted
about an accepted value: in a Shewhart chart and, to detect small changes, as an exponentially weighted moving average. The limits
come from earlier data. SOP 17 (NISTIR 7383) describes the same method, with action limits at three standard deviations, and with a
test against the reference value. In this module, the stated uncertainty of each value also widens the limits for this value
(docs/decisions/0045). The comparison with a reference uses no moving average, because the uncertainty u_R is common to all values
and averaging would not reduce this uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from enum import Enum

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import JsonObject
from planrunner.bench.check_standard import CheckedCoefficient, CheckStandardRule
from planrunner.bench.model import Bench
from planrunner.night.history.control_charts import (
    Centre,
    ControlCharts,
    between_runs,
    charts_about,
    control_charts,
    shewhart,
)
from planrunner.night.history.index import Index, literal
from planrunner.night.history.rows import FaultRow, HistoryPoint, RecordedAs, RunFilter, RunRow
from planrunner.night.history.trend import Trend, trend
from planrunner.night.words import spell_out
from planrunner.plan.units import UnknownUnitError, unit

CHECK_STANDARD_FORMAT = 1


class ControlStanding(Enum):
    """Lists the possible states of a check standard, such as in control and out of control."""

    IN_CONTROL = "in control"
    OUT_OF_CONTROL = "out of control"
    TOO_OLD = "too old"
    MISSING = "missing"
    NOT_ESTABLISHED = "not established"
    """There is no reference value, and there are too few values for limits."""
    NOT_DETERMINED = "not determined"
    """The archive contains a damaged run that is, or may be, a newer run of the check standard."""


class ControlTest(Enum):
    """Lists the kinds of comparison in which a value of a check standard is tested."""

    REFERENCE = "reference"
    SHEWHART = "Shewhart"
    EWMA = "EWMA"
    CUSUM = "CUSUM"


@dataclass(frozen=True)
class ControlLimits:
    """Contains the limits of the newest value in a comparison that tests each value alone. This is the comparison with a reference
    value, or the Shewhart chart."""

    test: ControlTest
    centre: float
    lower: float
    upper: float


@dataclass(frozen=True)
class CoefficientControl:
    """Contains the state of a coefficient of the check standard.

    `trend`: history of the coefficient, the newest value last. `limits`: limits of the newest value in each possible comparison.
    `charts`: control charts of this history; None if there are too few values. `failed`: comparisons in which the newest value is
    outside the limits. `missing`: number of earlier values that are still needed for limits.
    """

    quantity: str
    trend: Trend
    limits: tuple[ControlLimits, ...]
    charts: ControlCharts | None
    failed: tuple[ControlTest, ...]
    missing: int

    def words(self) -> str:
        """States the newest value and its limits in words."""
        value = f"{self.quantity} is {self.trend.values[-1]:.6g} {self.trend.unit}"
        if not self.limits:
            return f"{value}, and {self.missing} more values are needed for limits"
        about = ", ".join(
            f"{'outside' if one.test in self.failed else 'within'} {one.centre:.6g} ± {one.upper - one.centre:.2g} ({one.test.value})"
            for one in self.limits
        )
        slow = [one.value for one in self.failed if one in (ControlTest.EWMA, ControlTest.CUSUM)]
        return f"{value}, {about}" + (f", and outside the limits of {' and '.join(slow)}" if slow else "")

    def to_json(self) -> JsonObject:
        return {
            "quantity": self.quantity,
            "unit": self.trend.unit,
            "value": self.trend.values[-1],
            "standard_uncertainty": self.trend.standard_uncertainties[-1],
            "values": len(self.trend.values),
            "limits": [
                {"test": one.test.value, "centre": one.centre, "lower": one.lower, "upper": one.upper}
                for one in self.limits
            ],
            "failed": [one.value for one in self.failed],
            "missing": self.missing,
        }


@dataclass(frozen=True)
class ControlState:
    """Contains the state of a bench's check standard at one moment.

    `run`: newest run of the check standard; None if there is none. `reasons`: reasons why the check standard is not in control, in
    words. `damaged`: unreadable runs of the archive that measured the check standard, or may have measured it. `left_out`: folders
    that are not used, because their bench cannot be determined.
    """

    bench: str
    device: str
    standing: ControlStanding
    run: RunRow | None = None
    coefficients: tuple[CoefficientControl, ...] = ()
    reasons: tuple[str, ...] = ()
    damaged: tuple[FaultRow, ...] = ()
    left_out: tuple[FaultRow, ...] = ()

    @property
    def in_control(self) -> bool:
        return self.standing is ControlStanding.IN_CONTROL

    def words(self) -> str:
        """Returns the state in one line."""
        head = f"the check standard {self.device} of bench '{self.bench}' is {self.standing.value}"
        return f"{head}: {'; '.join(self.reasons)}" if self.reasons else head

    def to_json(self) -> JsonObject:
        """Returns JSON data according to schemas/check-standard.schema.json."""
        return {
            "planrunner_check_standard": CHECK_STANDARD_FORMAT,
            "bench": self.bench,
            "device": self.device,
            "standing": self.standing.value,
            "run": None if self.run is None else self.run.folder,
            "created": None if self.run is None else self.run.created,
            "coefficients": [one.to_json() for one in self.coefficients],
            "reasons": list(self.reasons),
            "damaged": [{"folder": fault.folder, "message": fault.message} for fault in self.damaged],
            "left_out": [{"folder": fault.folder, "message": fault.message} for fault in self.left_out],
        }


def state_in(index: Index, bench: Bench, now: datetime) -> ControlState | None:
    """Returns the state of the check standard of a bench at a moment, according to an index; None if the bench has no check
    standard."""
    rule = bench.check_standard
    if rule is None:
        return None
    wanted = RunFilter(
        device=literal(rule.device), plan=literal(rule.plan_name), bench=literal(bench.name), since=rule.since or ""
    )
    points = {quantity: index.points(quantity, wanted) for quantity in rule.coefficients}
    return judge(rule, bench.name, index.runs(wanted), points, now, index.faults())


def judge(
    rule: CheckStandardRule,
    bench: str,
    runs: Sequence[RunRow],
    points: Mapping[str, Sequence[HistoryPoint]],
    now: datetime,
    damaged: Sequence[FaultRow] = (),
) -> ControlState:
    """Determines the state of the check standard of a bench at one moment.

    `runs`: runs of the check standard on this bench, the newest first. `points`: maps each coefficient to its values in these runs,
    the oldest first. `damaged`: runs of the archive that cannot be read. A damaged run that was recorded on another bench, or with
    another plan or device, is not considered.
    """
    unreadable = tuple(fault for fault in damaged if fault.recorded is None)
    own = RecordedAs(bench, rule.plan_name, rule.device)
    damaged = tuple(fault for fault in damaged if fault.recorded == own)
    left_out = unreadable if rule.unreadable == "warn" else ()
    lost = [f"the run {fault.folder}, one of its runs, is damaged" for fault in damaged]
    if rule.unreadable == "refuse":
        lost += [f"the folder {fault.folder} cannot be read, and may be one of its runs" for fault in unreadable]
        damaged = (*damaged, *unreadable)
    newest = next((run for run in runs if run.state == "sealed"), None)
    if newest is None:
        reason = f"no finished run of the plan '{rule.plan_name}' with this device on this bench is in the archive"
        return ControlState(bench, rule.device, ControlStanding.MISSING, None, (), (reason, *lost), damaged, left_out)
    found: list[CoefficientControl] = []
    wrong: list[str] = []
    unknown: list[str] = []
    if newest.verdict == "fail":
        wrong.append("a limit of its own plan failed, or an estimate could not be made")
    for quantity, about in rule.coefficients.items():
        held = trend(rule.device, quantity, [one for one in points.get(quantity, ()) if one.run.state == "sealed"])
        if not held.points or held.points[-1].run.folder != newest.folder:
            wrong.append(f"its newest run gave no usable value of {quantity}")
            continue
        try:
            one = _control(quantity, held, about, rule.values)
        except UnknownUnitError as error:
            wrong.append(f"{quantity}: {error}")
            continue
        found.append(one)
        if one.failed:
            wrong.append(one.words())
        elif not one.limits:
            unknown.append(one.words())
    old = list(_age(newest, rule, now))
    standing = next(
        (
            state
            for state, reasons in (
                (ControlStanding.OUT_OF_CONTROL, wrong),
                (ControlStanding.NOT_DETERMINED, lost),
                (ControlStanding.TOO_OLD, old),
                (ControlStanding.NOT_ESTABLISHED, unknown),
            )
            if reasons
        ),
        ControlStanding.IN_CONTROL,
    )
    reasons = (*wrong, *lost, *old, *unknown)
    return ControlState(bench, rule.device, standing, newest, tuple(found), reasons, damaged, left_out)


def _age(run: RunRow, rule: CheckStandardRule, now: datetime) -> Iterator[str]:
    age = (now - datetime.fromisoformat(run.created)).total_seconds()
    if age > rule.max_age.value:
        yield f"its newest run is {spell_out(age)} old, at most {spell_out(rule.max_age.value)} is permitted"


def _control(quantity: str, held: Trend, about: CheckedCoefficient, enough: int) -> CoefficientControl:
    """Compares the newest value of a history with its limits. Raises `UnknownUnitError` if a stated quantity has another dimension."""
    x, u = np.array(held.values), np.array(held.standard_uncertainties)
    own = unit(held.unit)

    def stated(value: float, text: str) -> float:
        if unit(text).dimension != own.dimension:
            raise UnknownUnitError(f"the bench file states {text}, but the run gives {held.unit}")
        return own.from_si(value)

    earlier = min(enough, len(x) - 1)
    tau = between_runs(x[:earlier], u[:earlier])
    if about.repeatability is not None:
        tau = stated(about.repeatability.value, about.repeatability.unit.text) - own.from_si(0.0)
    charts = None
    if earlier == enough:
        charts = control_charts(held.values, held.standard_uncertainties, earlier)
        if charts is not None and about.repeatability is not None:
            centre = Centre(charts.centre.mean, charts.centre.standard_uncertainty, tau, earlier)
            charts = charts_about(x, u, centre)
    failed = []
    limits: list[ControlLimits] = []
    if charts is not None:
        lower, upper = float(charts.shewhart.lower[-1]), float(charts.shewhart.upper[-1])
        limits.append(ControlLimits(ControlTest.SHEWHART, charts.centre.mean, lower, upper))
        named = {
            ControlTest.SHEWHART: (charts.shewhart,),
            ControlTest.EWMA: (charts.ewma,),
            ControlTest.CUSUM: (charts.cusum_up, charts.cusum_down),
        }
        failed += [test for test, both in named.items() if any(bool(chart.alarms[-1]) for chart in both)]
    if about.reference is not None:
        R = stated(about.reference.value, about.reference.unit.text)
        u_R = about.reference.standard_uncertainty / own.factor
        sigma = math.sqrt(float(u[-1]) ** 2 + u_R**2 + tau**2)
        chart = shewhart(x[-1:], R, np.array([sigma]))
        limits.insert(0, ControlLimits(ControlTest.REFERENCE, R, float(chart.lower[0]), float(chart.upper[0])))
        failed += [ControlTest.REFERENCE] if chart.alarms[0] else []
    missing = 0 if limits else max(1, enough - (len(x) - 1))
    return CoefficientControl(quantity, held, tuple(limits), charts, tuple(failed), missing)

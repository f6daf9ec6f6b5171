"""Models coefficients or outputs as functions of temperature. The model is a polynomial or a spline; its order is chosen by the
error of held-out values.

The module `points` collects values, and `curve` fits curves and chooses their order. If both rising and falling temperature are
recorded, the curve is the mean of both directions, and the difference between the directions is fitted together with the curve
(`branches`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, counted, said
from planrunner.estimators import least_squares, rank
from planrunner.estimators.derived import independent
from planrunner.estimators.drift_order import COUPLED
from planrunner.estimators.interface import (
    Coefficient,
    CoefficientRole,
    Design,
    DesignRequest,
    EstimateRequest,
    EstimationError,
    Foresight,
    Unpredicted,
)
from planrunner.estimators.method import Method, Quantities, Words, by_expectation
from planrunner.estimators.open_flicker import no_flicker_declared
from planrunner.estimators.tables import Plot, Role, Table, TableColumn, by_columns, known
from planrunner.estimators.temperature.branches import Difference, difference_of
from planrunner.estimators.temperature.curve import CurveFit, OverTemperature, curve, fit_curve, groups_of
from planrunner.estimators.temperature.parameters import TemperatureModelParameters, remarks
from planrunner.estimators.temperature.points import Points, from_channels, from_estimates, given_by_temperature
from planrunner.estimators.thermometer_counts import thermometer_counts
from planrunner.estimators.unstated_flicker import FlickerEvidence, UnstatedFlicker
from planrunner.observation.drift import NONE, ORDERS, DriftCourse, in_time
from planrunner.observation.flicker import of_unit_size
from planrunner.plan.units import ZERO_CELSIUS
from planrunner.uncertainty.conditions import StatedCondition, influences_on
from planrunner.uncertainty.decision import expanded_uncertainty
from planrunner.uncertainty.influences import Influence

_SHOWN = 9  # temperatures of the table of predictions
_DRAWN = 61
_RESIDUALS = 2  # fewest residuals that remain after the difference between rising and falling temperature is fitted
_SENSES = {1: "rising", -1: "falling", 0: ""}
_SEPARABLE = 1e-3  # smallest fraction of a drift that the model must not reproduce; less results from the bins of ramps
_MANY = 1e6  # degrees of freedom; the plural is the same for all larger numbers, and for infinity
_WIDEST = 150.0  # K; a width written in degC is converted to a larger value


@dataclass(frozen=True)
class Loop:
    """Contains the differences between the values at rising and at falling temperature, for n temperatures.

    `celsius`: array of shape (n,), temperatures, degC. `width`: array of shape (n,), value at rising temperature minus value at
    falling temperature, in the value's unit. `uncertainty`: array of shape (n,), standard uncertainty of `width`. `freedom`: array
    of shape (n,), degrees of freedom of this uncertainty.
    """

    celsius: Array
    width: Array
    uncertainty: Array
    freedom: Array

    @property
    def largest(self) -> int:
        """Returns the index of the largest difference."""
        return int(np.argmax(np.abs(self.width)))


@dataclass(frozen=True, slots=True)
class HiddenDrift:
    """Describes a linear drift in time that would remain unnoticed because of the order of the temperatures. `power`: index of the
    coefficient that the drift affects most; for a polynomial, the index is the power of the temperature. `growth`: factor by which
    the standard uncertainty of this coefficient grows if the drift is fitted, infinite if the drift cannot be separated from the
    coefficient."""

    power: int
    growth: float


@dataclass(frozen=True, slots=True)
class Modelled:
    """Contains one quantity and its fitted curve. If both directions of temperature are recorded, it also contains the hysteresis
    loop. `drift`: the drift functions (powers of the time) that are fitted together with curve and loop. `hidden`: a drift that is
    not fitted and would remain unnoticed."""

    points: Points
    fit: CurveFit
    difference: Difference | None
    drift: tuple[DriftCourse, ...] = ()
    hidden: HiddenDrift | None = None

    def loop(self, celsius: Array) -> Loop | None:
        """Returns the hysteresis loop at the temperatures `celsius` (n,), degC; None if only one direction of temperature is
        recorded."""
        if self.difference is None or self.fit.beside_spread is None:
            return None
        rows = self.difference.width(celsius)
        rows = np.pad(rows, ((0, 0), (0, len(self.fit.beside) - rows.shape[1])))
        return Loop(celsius, rows @ self.fit.beside, *self.fit.beside_spread.of(rows))

    @property
    def beside(self) -> Array:
        """Returns the columns that are fitted together with the curve, shape (n, q): first the columns of the difference between
        the directions, then the columns of the drift."""
        return _beside(self.points, self.difference, self.drift)

    @property
    def ends(self) -> tuple[float, float]:
        """Returns the lowest and the highest temperature [degC] of the range that rising and falling branches both cover."""
        assert self.difference is not None
        return self.difference.low, self.difference.high

    @property
    def widest(self) -> tuple[float, float, float, float] | None:
        """Returns the largest difference between the directions, its standard uncertainty, its degrees of freedom, and the
        temperature [degC] at which it occurs; None if only one direction of temperature is recorded."""
        loop = None if self.difference is None else self.loop(np.linspace(*self.ends, _DRAWN))
        if loop is None:
            return None
        k = loop.largest
        return abs(float(loop.width[k])), float(loop.uncertainty[k]), float(loop.freedom[k]), float(loop.celsius[k])


@dataclass(frozen=True, slots=True, kw_only=True)
class Curves(Quantities):
    """The fitted curves of all quantities."""

    models: tuple[Modelled, ...]


class TemperatureModel(Method[TemperatureModelParameters, Curves]):
    """Implements the estimator `temperature_model`."""

    name = "temperature_model"
    summary = "Coefficients or outputs as functions of temperature: a polynomial or a spline, whose order is chosen by cross-validation"
    Parameters = TemperatureModelParameters

    def design(self, request: DesignRequest[TemperatureModelParameters]) -> Design:
        """Checks that there are enough planned temperatures, and that the requested coefficients exist. Raises `EstimationError` for
        contradictory keys."""
        parameters = request.parameters
        _one_source(parameters, bool(request.uses))
        return Design((), remarks=remarks(request))

    def foresee(self, request: DesignRequest[TemperatureModelParameters]) -> Foresight:
        """Predicts the curves from expected values if the plan states their order. If the plan does not state the order, the
        prediction contains the coefficients of all possible orders without uncertainties. Coefficients from ramps also have no
        uncertainties, because only a recording shows the temperatures of a ramp."""
        parameters = request.parameters
        ramps = parameters.temperature_channel is not None
        if parameters.order is not None and not ramps:
            seen = by_expectation(self, request)
            if seen.known:
                return seen
        units = _planned_units(request)
        why = (
            "the order is chosen from the data"
            if parameters.order is None
            else "only a recording shows the temperatures"
        )
        highest = parameters.highest_order if parameters.order is None else parameters.order
        found = []
        for name, text in units.items():
            for k in range(highest + 1):
                label, own = _label(parameters.form, name, text, k)
                found.append(Unpredicted(label, own, why))
            if ramps:
                found.append(Unpredicted(f"hysteresis_{name}", text, why, role=CoefficientRole.MAXIMUM))
        return Foresight(unpredicted=tuple(found))

    def quantities(self, request: EstimateRequest[TemperatureModelParameters]) -> Curves:
        """Fits a curve to the values of every quantity. Raises `EstimationError` if the plan or the data are not suitable."""
        parameters = request.parameters
        _one_source(parameters, bool(request.uses))
        if parameters.channels:
            width = parameters.bin.value
            thermometer, span = parameters.temperature_channel, parameters.drift_span.value
            inputs = request.setup.inputs
            found = from_channels(request.segments, parameters.channels, thermometer, width, inputs, span)
        else:
            found = from_estimates(request.uses, parameters.coefficients)
        models = tuple(_model(points, parameters) for points in found)
        coefficients, covariance = _coefficients(models)
        return Curves(
            coefficients=coefficients,
            covariance=covariance,
            influences=_influences(request, models),
            unstated=_unstated(models),
            extra={"curves": {one.points.name: _plain(one) for one in models}},
            models=models,
        )

    def words(self, request: EstimateRequest[TemperatureModelParameters], found: Curves) -> Words:
        """Makes tables and plots of the curves, and explains how the orders of the curves were chosen."""
        parameters = request.parameters
        models = found.models
        return Words(
            headline=tuple(item.name for item in found.coefficients),
            settings={
                "form": parameters.form,
                "order": {one.points.name: one.fit.curve.order for one in models},
                "rule": parameters.rule if parameters.order is None else "given",
                "folds": parameters.folds,
                "uncertainty": parameters.uncertainty,
            },
            tables=tuple(table for one in models for table in _tables(one)),
            plots=tuple(plot for one in models for plot in _plots(one)),
            notes=tuple(dict.fromkeys(note for one in models for note in _notes(one, parameters))),
            warnings=tuple(warning for one in models for warning in _warnings(one)),
            segments=tuple(recorded.label for recorded in request.segments),
        )


def _planned_units(request: DesignRequest[TemperatureModelParameters]) -> dict[str, str]:
    """Returns the units of the quantities to be modelled, by the name of the quantity; empty if the quantities are not known."""
    parameters = request.parameters
    if parameters.channels:
        outputs = [request.sensor.output(name) for name in parameters.channels]
        return {output.name: output.unit for output in outputs if output is not None}
    if not all(used.expected for used in request.uses.values()):
        return {}
    given = [given_by_temperature(used.expected[0]) for used in request.uses.values()]
    patterns = parameters.coefficients
    return {
        name: str(data["unit"])
        for own in given
        for name, data in own.items()
        if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)
    }


def _one_source(parameters: TemperatureModelParameters, uses: bool) -> None:
    if parameters.channels and uses:
        raise EstimationError(
            "both `channels` and `uses` are given: model either channels or other estimates' coefficients"
        )
    if not parameters.channels and not uses:
        raise EstimationError("nothing to model: name `channels`, or estimates in `uses`")
    if parameters.coefficients and not uses:
        raise EstimationError("`coefficients` selects from other estimates: name these in `uses`")
    if parameters.temperature_channel and not parameters.channels:
        raise EstimationError(
            "`temperature_channel` is only for `channels`; the temperature of a coefficient is known from its estimate"
        )
    if parameters.bin.value > _WIDEST:
        shown = parameters.bin.unit.from_si(parameters.bin.value)
        raise EstimationError(f"`bin` is a difference of temperatures: write it in K, for example {shown:g} K")
    if parameters.form == "spline" and parameters.order == 0:
        raise EstimationError("a spline has at least two knots: `order: 1` is a straight line")


def _model(points: Points, parameters: TemperatureModelParameters) -> Modelled:
    scatter = parameters.uncertainty == "residual" and not points.expected
    if not scatter and not points.known:
        raise EstimationError(f"'{points.name}' does not have an uncertainty everywhere: write `uncertainty: residual`")
    group = groups_of(points.temperature, parameters.bin.value)
    highest = parameters.highest_order if parameters.order is None else parameters.order
    difference = _difference(points, parameters, min(highest, int(group.max())))
    drift, reference = _drift(points, parameters.drift), parameters.reference.value - ZERO_CELSIUS
    beside = _beside(points, difference, drift)
    apart = difference is not None or points.along
    values = OverTemperature(
        points.temperature,
        points.value,
        points.sigma,
        group,
        points.series,
        points.ramp if apart else np.full_like(points.ramp, -1),
        points.direction,
        beside,
        points.covariance,
    )
    tried = curve(parameters.form, min(highest, int(group.max())), reference, points.temperature)
    model = np.hstack([tried.columns(points.temperature), beside[:, : beside.shape[1] - len(drift)]])
    if not _separable(model, drift):
        raise EstimationError(
            f"'{points.name}': in this order of the temperatures, a drift ({drift[-1].name}) cannot be separated from the curve "
            "or from the difference between rising and falling temperature",
            "record the temperatures in the opposite order too, and a second cycle; if this is not possible, "
            "write `drift: none`",
            "drift",
        )
    try:
        fit = fit_curve(
            parameters.form,
            parameters.order,
            parameters.highest_order,
            reference,
            values,
            parameters.folds,
            parameters.rule,
            scatter,
        )
    except EstimationError as error:
        raise EstimationError(f"'{points.name}': {error}") from None
    hidden = _hidden(points, values, fit) if parameters.drift is None and not points.expected else None
    return Modelled(points, fit, difference, drift, hidden)


def _beside(points: Points, difference: Difference | None, drift: Sequence[DriftCourse]) -> Array:
    """Returns the columns for the difference between the directions and for the drift, shape (n, q). These columns are fitted
    together with a curve."""
    parts = [np.zeros((len(points.value), 0)), *(one.columns for one in drift)]
    if difference is not None:
        parts.insert(0, difference.columns(points.temperature, points.direction))
    return np.hstack(parts)


def _drift(points: Points, asked: str | None) -> tuple[DriftCourse, ...]:
    """Returns the drift functions (powers of the time) for which the plan asks. Raises `EstimationError` for values without known
    times."""
    if asked is None or asked == NONE:
        return ()
    if not len(points.time):
        message = (
            f"'{points.name}': the estimates in `uses` do not give the times of their data, so no drift can be fitted"
        )
        raise EstimationError(message, "leave `drift` out", "drift")
    return in_time(points.time, points.time, 1 / points.sigma**2)[: 1 + ORDERS.index(asked)]


def _separable(columns: Array, courses: Sequence[DriftCourse]) -> bool:
    """Returns True if the drift functions, added one after the other, are independent of the columns (n, q) of the curve and of the
    difference between the directions."""
    size = np.sqrt(np.mean(columns**2, axis=0))
    base = columns / np.where(size > 0, size, 1.0)
    for course in courses:
        part = np.linalg.svd(base, full_matrices=False)[0][:, : rank.look(base).rank]
        left = course.columns - part @ (part.T @ course.columns)
        if np.linalg.norm(left) < _SEPARABLE * np.linalg.norm(course.columns):
            return False
        base = np.hstack([base, course.columns / np.sqrt(np.mean(course.columns**2))])
    return True


def _hidden(points: Points, values: OverTemperature, fit: CurveFit) -> HiddenDrift | None:
    """Examines a linear drift. Returns this drift if fitting it would multiply the standard uncertainty of a coefficient of the
    curve by `COUPLED` or more; otherwise, returns None."""
    if not len(points.time) or not np.ptp(points.time):
        return None
    [course, *_] = in_time(points.time, points.time, 1 / points.sigma**2)
    columns = np.hstack([fit.curve.columns(points.temperature), values.beside])
    whole, p = np.hstack([columns, course.columns]), fit.curve.order + 1
    gained = np.linalg.lstsq(columns, course.columns, rcond=None)[0][:p, 0]
    before = least_squares.fit(columns, points.value, values.sigma, covariance=values.covariance).cofactor
    spreads = np.sqrt(np.diag(before)[:p])
    if len(whole) < whole.shape[1] or not _separable(columns, [course]):
        return HiddenDrift(int(np.argmax(np.abs(gained) / spreads)), float("inf"))
    after = least_squares.fit(whole, points.value, values.sigma, covariance=values.covariance).cofactor
    growth = np.sqrt(np.diag(after)[:p]) / spreads
    return HiddenDrift(int(growth.argmax()), float(growth.max())) if growth.max() >= COUPLED else None


def _difference(points: Points, parameters: TemperatureModelParameters, highest: int) -> Difference | None:
    """Returns the form of the difference between the directions (the hysteresis loop); None if too few temperatures were reached in
    both directions. The number of its coefficients is limited so that at least two residuals remain after a curve of order
    `highest` and the ramps have been fitted as well."""
    ramps = len(np.unique(points.ramp[points.ramp >= 0]))
    left = len(points.value) - (highest + 1) - max(0, ramps - 2) - _RESIDUALS
    width = parameters.bin.value
    return difference_of(points.temperature, points.direction, parameters.highest_order, width, left)


def _coefficients(models: Sequence[Modelled]) -> tuple[tuple[Coefficient, ...], Array]:
    """Returns the m coefficients of all curves and the hysteresis along ramps, with their covariance (m, m). The curves are treated
    as independent of each other."""
    rows: list[Coefficient] = []
    blocks: list[Array] = []
    for one in models:
        made, name, text = one.fit.curve, one.points.name, one.points.unit
        for k, (value, u, freedom) in enumerate(zip(one.fit.coefficients, *one.fit.uncertainties(), strict=True)):
            label, own = _label(made.form, name, text, k)
            if made.form == "spline":
                words = said("{name} at {temperature:.6g} degC", name=name, temperature=made.knots[k])
            elif k == 0:
                words = said("{name} at {temperature:.6g} degC", name=name, temperature=made.reference)
            else:
                words = said(
                    "{name}: coefficient of (T − {temperature:.6g} degC)^{power}",
                    name=name,
                    temperature=made.reference,
                    power=k,
                )
            rows.append(Coefficient(label, float(value), own, float(u), float(freedom), words))
        blocks.append(one.fit.covariance)
        if one.widest is not None:
            largest, u, freedom, celsius = one.widest
            words = said(
                "{name}: largest difference between rising and falling temperature, at {temperature:.4g} degC",
                name=name,
                temperature=celsius,
            )
            rows.append(
                Coefficient(f"hysteresis_{name}", largest, text, u, freedom, words, role=CoefficientRole.MAXIMUM)
            )
            blocks.append(np.array([[u**2]]))
    return tuple(rows), independent(blocks)


def _influences(
    request: EstimateRequest[TemperatureModelParameters], models: Sequence[Modelled]
) -> tuple[Influence, ...]:
    """Returns the influences of errors of the temperatures. An error that all temperatures have in common shifts every curve along
    the temperature axis and does not change the difference between ramps. Without the sensor's own thermometer, this is the error
    of the chamber's temperature. With the thermometer, it follows from the counts of the thermometer, and held temperatures also
    have separate rounding errors."""

    def coefficients(warmer: float) -> Array:
        return np.concatenate(
            [np.append(one.fit.warmer(warmer), [0.0] * (one.difference is not None)) for one in models]
        )

    thermometer = request.parameters.temperature_channel
    counts = thermometer_counts(request.segments, thermometer, request.sensor)
    own = None if counts is None else counts.offset
    common = request.setup.inputs.get("temperature") if thermometer is None else own
    found = () if common is None else influences_on(coefficients, [StatedCondition.single(common, lambda by: by)])
    if counts is None:
        return found
    rows = {one.label: row for one, row in zip(request.segments, counts.groups, strict=True)}
    moved = np.concatenate([_rounded(one, rows) for one in models])
    return (*found, Influence(counts.rounding, moved, request.parameters.uncertainty == "residual", counts.parts))


def _rounded(one: Modelled, groups: Mapping[str, Array]) -> Array:
    """Returns the derivatives of the results of one quantity with respect to r rounding errors of the temperature, shape (m, r). Only
    values at held temperatures have such errors: along a ramp, rounding errors average out. `groups`: for the label of each segment,
    an array of shape (r,) that is 1 for the errors of the segment."""
    points, step = one.points, 1e-3
    rows = np.array([groups[label] for label in points.labels]) * (points.ramp < 0)[:, None]
    sides = [one.fit.curve.columns(points.temperature + by) @ one.fit.coefficients for by in (step, -step)]
    moved = -one.fit.gains @ (((sides[0] - sides[1]) / (2 * step))[:, None] * rows)
    return np.vstack([moved, np.zeros((int(one.difference is not None), moved.shape[1]))])


def _unstated(models: Sequence[Modelled]) -> tuple[UnstatedFlicker, ...]:
    """Returns how flicker affects the coefficients, for channels for which the bench file states no flicker. The flicker shifts the
    curves. The effect of the flicker on the hysteresis is not computed, because the hysteresis is the largest of several values."""
    counts = [len(one.fit.coefficients) + (one.widest is not None) for one in models]
    found, first = [], 0
    for one, count in zip(models, counts, strict=True):
        points, root = one.points, one.points.unstated
        if root is not None:
            moved = np.zeros((sum(counts), root.shape[1]))
            moved[first : first + len(one.fit.coefficients)] = one.fit.gains @ root
            evidence = FlickerEvidence(
                np.hstack([one.fit.curve.columns(points.temperature), one.beside]),
                points.value,
                points.uncertainty,
                points.freedom,
                root,
                np.zeros(len(points.value)),
                np.zeros((len(points.value), 0)),
            )
            influence = Influence(of_unit_size(points.name, points.unit), moved)
            found.append(UnstatedFlicker(points.name, influence, evidence))
        first += count
    return tuple(found)


def _label(form: str, name: str, text: str, k: int) -> tuple[str, str]:
    """Returns the name and the unit of the k-th coefficient of a curve. `text`: unit of the values of the curve."""
    return (f"{name}_knot_{k + 1}", text) if form == "spline" else (f"{name}_T{k}", _per_kelvin(text, k))


def _per_kelvin(text: str, power: int) -> str:
    return text if power == 0 else f"{text}/K" if power == 1 else f"{text}/K^{power}"


def _tables(one: Modelled) -> list[Table]:
    name, text, points, fit = one.points.name, one.points.unit, one.points, one.fit
    found = []
    if fit.errors:
        held = by_columns(
            f"Held-out error of {name}",
            (TableColumn("order", Role.COUNT), [item.order for item in fit.errors]),
            (TableColumn("held-out mean square", Role.VALUE, f"({text})²"), [float(item.error) for item in fit.errors]),
            (
                TableColumn("u of the mean square", Role.STANDARD_UNCERTAINTY, f"({text})²"),
                [float(item.standard_error) for item in fit.errors],
            ),
            (TableColumn("root mean square", Role.VALUE, text), [float(item.error**0.5) for item in fit.errors]),
            (TableColumn(""), ["chosen" if item.order == fit.curve.order else "" for item in fit.errors]),
        )
        found.append(held)
    measured = by_columns(
        f"{name} over temperature",
        (TableColumn("from"), points.labels),
        (TableColumn("temperature", Role.NUMBER, "degC"), points.temperature),
        (TableColumn("sense"), [_SENSES[sense] for sense in points.direction.tolist()]),
        (TableColumn(name, Role.VALUE, text), points.value),
        (TableColumn("u", Role.STANDARD_UNCERTAINTY, text), known(points.uncertainty)),
        (TableColumn("residual", Role.VALUE, text), points.value - _fitted(one)),
    )
    grid = np.linspace(points.temperature.min(), points.temperature.max(), _SHOWN)
    values, u, freedom = fit.predict(grid)
    curve = by_columns(
        f"Curve of {name}",
        (TableColumn("temperature", Role.NUMBER, "degC"), grid),
        (TableColumn("curve", Role.VALUE, text), values),
        (TableColumn("u", Role.STANDARD_UNCERTAINTY, text), u),
        (TableColumn("U 95 %", Role.EXPANDED_UNCERTAINTY, text), _expanded(u, freedom)),
    )
    return [*found, measured, curve, *_loop_table(one)]


def _loop_table(one: Modelled) -> list[Table]:
    """Returns a table of the values on both branches of the loop at several temperatures, and of their difference."""
    loop = None if one.difference is None else one.loop(np.linspace(*one.ends, _SHOWN))
    if loop is None:
        return []
    text, middle, half = one.points.unit, one.fit.predict(loop.celsius)[0], loop.width / 2
    table = by_columns(
        f"Hysteresis of {one.points.name}",
        (TableColumn("temperature", Role.NUMBER, "degC"), loop.celsius),
        (TableColumn("rising", Role.VALUE, text), middle + half),
        (TableColumn("falling", Role.VALUE, text), middle - half),
        (TableColumn("difference", Role.VALUE, text), loop.width),
        (TableColumn("u", Role.STANDARD_UNCERTAINTY, text), loop.uncertainty),
        (TableColumn("U 95 %", Role.EXPANDED_UNCERTAINTY, text), _expanded(loop.uncertainty, loop.freedom)),
        (TableColumn("degrees of freedom", Role.DEGREES_OF_FREEDOM), loop.freedom),
    )
    return [table]


def _fitted(one: Modelled) -> Array:
    """Returns the fitted values at the n points, shape (n,). At each point, the value is on the branch (rising or falling) to which
    the point belongs."""
    own = one.beside
    return np.asarray(one.fit.predict(one.points.temperature)[0] + own @ one.fit.beside[: own.shape[1]])


def _expanded(u: Array, freedom: Array) -> Array:
    """Returns the expanded uncertainties (n,) at 95 %, from standard uncertainties (n,) and degrees of freedom (n,)."""
    return np.array([expanded_uncertainty(float(own), float(nu)) for own, nu in zip(u, freedom, strict=True)])


def _plots(one: Modelled) -> list[Plot]:
    name, text, points, fit = one.points.name, one.points.unit, one.points, one.fit
    order = np.argsort(points.temperature, kind="stable")
    residual = points.value - _fitted(one)
    grid = np.linspace(points.temperature.min(), points.temperature.max(), _DRAWN)
    values, u, freedom = fit.predict(grid)
    wide = _expanded(u, freedom)
    courses = {"curve": values, "curve − U 95 %": values - wide, "curve + U 95 %": values + wide}
    loop = one.loop(grid)
    if loop is not None:
        courses |= {"rising": values + loop.width / 2, "falling": values - loop.width / 2}
    spread = {"residual": tuple(points.uncertainty[order].tolist())} if points.known else {}
    return [
        Plot(
            f"{name} over temperature",
            "temperature [degC]",
            f"{name} [{text}]",
            tuple(grid.tolist()),
            {label: tuple(course.tolist()) for label, course in courses.items()},
            lines=True,
        ),
        Plot(
            f"Residuals of {name}",
            "temperature [degC]",
            f"residual [{text}]",
            tuple(points.temperature[order].tolist()),
            {"residual": tuple(residual[order].tolist())},
            spread,
        ),
    ]


def _notes(one: Modelled, parameters: TemperatureModelParameters) -> list[Said]:
    name, fit = one.points.name, one.fit
    found = []
    if fit.errors:
        held = (
            said("each temperature in turn")
            if parameters.folds == 0
            else said("each of {count} adjoining ranges in turn", count=parameters.folds)
        )
        by = (
            said("the simplest curve within one standard error of the smallest held-out error")
            if parameters.rule == "one_standard_error"
            else said("the smallest held-out error")
        )
        found.append(
            said(
                "{name}: of the orders {orders}, order {order} was chosen. The criterion is {rule}. To "
                "compute the held-out errors, {left_out} is left out.",
                name=name,
                order=fit.curve.order,
                orders=tuple(str(item.order) for item in fit.errors),
                rule=by,
                left_out=held,
            )
        )
        if fit.fullest is not None:
            found.append(
                said(
                    "{name}: the order was chosen from the data, and the uncertainties take this choice into account: they combine "
                    "the uncertainties of the curve of order {order} (the highest order tried) with its difference from the "
                    "chosen curve. If physics gives the order, state it in `order` for narrower intervals.",
                    name=name,
                    order=fit.fullest.curve.order,
                )
            )
    low, high = one.points.temperature.min(), one.points.temperature.max()
    found.append(
        said(
            "{name}: the curve is determined from {low:.4g} to {high:.4g} degC; beyond this range it is an "
            "extrapolation.",
            name=name,
            low=low,
            high=high,
        )
    )
    if not parameters.channels:
        found.append(
            said(
                "Some influences, such as the angle of a fixture, are common to the values at all temperatures. The "
                "uncertainties of these values include them, but the uncertainties of this curve do not."
            )
        )
    elif one.points.covariance is not None:
        found.append(
            said(
                "{name}: because of the declared bias instability, values at neighbouring times are correlated; "
                "the weights and the uncertainties include this correlation.",
                name=name,
            )
        )
    elif one.points.unstated is None:
        found.append(no_flicker_declared([name]))
    if parameters.uncertainty == "residual":
        freedom = float(fit.uncertainties()[1].min())
        found.append(
            counted(
                "{name}: the uncertainty is based on the scatter about the curve, with {freedom:.0f} degree of freedom.",
                "{name}: the uncertainty is based on the scatter about the curve, with {freedom:.0f} degrees of freedom.",
                count=round(min(freedom, _MANY)),
                name=name,
                freedom=freedom,
            )
        )
    q = len(one.drift)
    if q and fit.beside_spread is not None:
        amplitude, u = float(fit.beside[-q]), float(np.sqrt(fit.beside_spread.covariance[-q, -q]))
        found.append(
            said(
                "{name}: a drift in time ({drift}) is fitted together with the curve; its linear part is {amplitude:.3g} ± {u:.2g} "
                "{unit}/h (standard uncertainty).",
                name=name,
                drift=one.drift[-1].name,
                amplitude=amplitude,
                u=u,
                unit=one.points.unit,
            )
        )
    if one.widest is not None:
        found.append(
            said(
                "{name}: the curve is the mean of rising and falling temperature. Each branch differs from this "
                "curve by up to {distance:.3g} {unit}; the uncertainty of the curve does not include this difference.",
                name=name,
                distance=one.widest[0] / 2,
                unit=one.points.unit,
            )
        )
    for way, ramps in zip((said("offsets"), said("slopes")), fit.ramps, strict=False):
        found.append(
            counted(
                "{name}: ramps in the same direction differ by {way} with a standard deviation of {deviation:.3g} {unit} "
                "({freedom} degree of freedom; variance ratio F = {ratio:.3g} to noise, probability of a larger ratio by "
                "chance {chance:.2g}). All uncertainties of the curve include this.",
                "{name}: ramps in the same direction differ by {way} with a standard deviation of {deviation:.3g} {unit} "
                "({freedom} degrees of freedom; variance ratio F = {ratio:.3g} to noise, probability of a larger ratio by "
                "chance {chance:.2g}). All uncertainties of the curve include this.",
                count=ramps.degrees_of_freedom,
                name=name,
                way=way,
                deviation=ramps.size,
                unit=one.points.unit,
                freedom=ramps.degrees_of_freedom,
                ratio=ramps.ratio,
                chance=ramps.probability,
            )
        )
    if fit.correlation > 1:
        found.append(
            said(
                "{name}: consecutive values along the ramps are correlated; the variances are {factor:.3g} times those of "
                "independent values, and the degrees of freedom are smaller by the same factor.",
                name=name,
                factor=fit.correlation,
            )
        )
    return found


def _warnings(one: Modelled) -> list[Said]:
    fit, points = one.fit, one.points
    found = []
    if fit.errors and fit.curve.order == fit.errors[-1].order and len(fit.errors) > 1:
        found.append(
            said(
                "{name}: the chosen order is the highest that was tried; raise `highest_order` or add temperatures.",
                name=points.name,
            )
        )
    if one.difference is not None and not fit.ramps and not points.expected:
        found.append(
            said(
                "{name}: rising and falling temperature were each recorded only once, so the change of the "
                "hysteresis from cycle to cycle is unknown; the uncertainties do not include it. Record a "
                "second cycle.",
                name=points.name,
            )
        )
    if one.hidden is not None:
        label, _ = _label(fit.curve.form, points.name, points.unit, one.hidden.power)
        size = (
            said(
                "if the drift were fitted together with the curve, the standard uncertainty would be {growth:.2g} "
                "times as large",
                growth=one.hidden.growth,
            )
            if np.isfinite(one.hidden.growth)
            else said("no fit to these temperatures can separate the two")
        )
        found.append(
            said(
                "{name}: in this order of the temperatures, a linear drift in time is hard to distinguish from "
                "{coefficient}: {size}. No uncertainty includes such a drift. Record the temperatures in the "
                "opposite order too, or write `drift: none` if the output does not drift.",
                name=points.name,
                coefficient=label,
                size=size,
            )
        )
    return found


def _plain(one: Modelled) -> Mapping[str, object]:
    made = one.fit.curve
    return {
        "form": made.form,
        "reference_degC": made.reference,
        "knots_degC": made.knots.tolist(),
        "coefficients": one.fit.coefficients.tolist(),
        "covariance": one.fit.covariance.tolist(),
        "unit": one.points.unit,
    }

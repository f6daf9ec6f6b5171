"""Fits a straight line F = K·ω + F0 to outputs at several rates. The fit gives the scale factor and the bias, and the nonlinearity
and the asymmetry (terms of IEEE 952 and 1431).

Any output may be fitted. For a cross-axis output, the slope gives its misalignment with respect to the rotation axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import said
from planrunner.error_model.observed import axis_of
from planrunner.estimators import least_squares
from planrunner.estimators.basis_judgement import judge, planned_basis, require_basis
from planrunner.estimators.declared_axes import AxisResponse, contradictions
from planrunner.estimators.drift_order import planned_drift
from planrunner.estimators.expected import planned_blocks
from planrunner.estimators.fit_tables import drift_tables, mean_and_residual, residual_plot
from planrunner.estimators.full_scale import beyond_full_scale, not_turned, shares_by_name
from planrunner.estimators.interface import (
    Coefficient,
    CoefficientRole,
    Design,
    DesignRequest,
    EstimateRequest,
    EstimationError,
)
from planrunner.estimators.method import Method, Quantities, Words
from planrunner.estimators.outputs_fit import OutputsFit, coefficients_by_noise, fit_outputs, uncertainty_basis
from planrunner.estimators.resolution_influences import resolution_influences
from planrunner.estimators.stated_errors import common_rate, rate_errors
from planrunner.estimators.tables import Role, Table, TableColumn, by_columns
from planrunner.estimators.tilted.rate_lines import asymmetry, line_through, rate_and_output, slope_unit
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.observation.drift import drift, drift_of, thermometer
from planrunner.observation.flicker import drift_span, flicker_errors, unstated_flicker
from planrunner.observation.observations import Observations, observe
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, QuantityOf, Record, Text, key, optional
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Cycle, Rock, Segment, Spin
from planrunner.plan.units import Unit, unit
from planrunner.uncertainty.conditions import StatedCondition, influences_on
from planrunner.uncertainty.derivatives import jacobian
from planrunner.uncertainty.influences import Influence

TERMS = ("offset", "rate")


class ScaleFactorParameters(Record):
    """Declares the plan keys of the estimator `scale_factor`."""

    outputs: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=1, single=True),
        "Channels to fit, each with its own line.",
        ["gyro_z"],
        default_factory=tuple,
    )
    rate_unit: str = key(
        Text("", "a unit of angular rate"), "Unit of the table's rate in the results.", "deg/s", default="deg/s"
    )
    rate_uncertainty: Quantity | None = optional(
        QuantityOf("ratio", "not negative"),
        "Relative standard uncertainty of the table's rate, common to all rates.",
        "50 ppm",
    )
    weights: str = key(
        Choice(("noise", "equal")),
        "Weights of the rates. `noise`: each rate is weighted by the noise of its segment, so an unsteady rate has less weight; "
        "`equal`: all rates have the same weight, as in ordinary least squares.",
        "noise",
        default="noise",
    )
    uncertainty: str = uncertainty_basis("rates about the line")
    drift_span: Quantity = drift_span()
    drift: tuple[str, ...] = drift()
    temperature_channel: str | None = thermometer()


@dataclass(frozen=True, slots=True, kw_only=True)
class LineQuantities(Quantities):
    """The fitted lines of all outputs. `rates`: array of shape (n,) in rad/s, rates of the segments. `common`: True if the plan
    states an error that all rates have in common."""

    observations: Observations
    rates: Array
    fit: OutputsFit
    common: bool


class ScaleFactor(Method[ScaleFactorParameters, LineQuantities]):
    """Implements the estimator `scale_factor`."""

    name = "scale_factor"
    summary = "Scale factor, bias, nonlinearity and asymmetry from recordings at known rates"
    Parameters = ScaleFactorParameters

    def design(self, request: DesignRequest[ScaleFactorParameters]) -> Design:
        """Checks, for each output, whether the planned rates determine a line. Raises `EstimationError` if the plan is not
        suitable."""
        rates = _rates(request.segments)
        matrix, magnitudes = line_through(rates)
        names = request.parameters.outputs or tuple(output.name for output in request.sensor.outputs)
        blocks = planned_blocks(request, names, TERMS, matrix, magnitudes)
        named = request.parameters.outputs or tuple(block.output for block in blocks if _is_rate(request, block.output))
        shares = shares_by_name(request.segments, request.setup.mounting, named)
        remarks = (
            *beyond_full_scale(request, named, shares),
            *not_turned(request, named, shares),
            *planned_basis(request, blocks, request.parameters.uncertainty),
            *planned_drift(request, blocks),
        )
        return Design(blocks, remarks=remarks)

    def quantities(self, request: EstimateRequest[ScaleFactorParameters]) -> LineQuantities:
        """Fits a line through the means of each output. Raises `EstimationError` if the plan or the data are not suitable."""
        parameters = request.parameters
        if not request.segments:
            raise EstimationError("no recorded segments are chosen: check the labels in `segments`")
        outputs = parameters.outputs or request.segments[0].statistics.channels
        observations = observe(request.segments, outputs, request.sensor)
        rates = _rates([recorded.segment for recorded in request.segments])
        if not np.ptp(rates):
            raise EstimationError(
                f"{request.name}: all segments have the same rate, so a line cannot be distinguished from a constant"
            )
        matrix, magnitudes = line_through(rates)
        slopes = coefficients_by_noise(matrix, observations, magnitudes, TERMS)[:, 1]
        effects = (
            *flicker_errors(observations, request.setup.inputs, parameters.drift_span.value),
            *_held(request, slopes, rates),
        )
        equal = parameters.weights == "equal"
        drift = drift_of(
            parameters.drift, parameters.temperature_channel, observations, request.segments, request.segments
        )
        basis = parameters.uncertainty
        fit = fit_outputs(
            matrix,
            observations,
            magnitudes,
            TERMS,
            basis,
            equal=equal,
            effects=effects,
            drift=drift,
            unstated=unstated_flicker(observations, request.setup.inputs, parameters.drift_span.value),
        )
        require_basis(fit, parameters.uncertainty, request.name)
        return _found(request, observations, rates, fit)

    def words(self, request: EstimateRequest[ScaleFactorParameters], found: LineQuantities) -> Words:
        """Makes the tables and plots of the means and residuals against the rate."""
        parameters = request.parameters
        observations, rates, fit = found.observations, found.rates, found.fit
        rate = rate_and_output(parameters.rate_unit, observations.units[0])[0]
        shown = tuple(float(value / rate.factor) for value in rates)
        judged = judge(fit, parameters.uncertainty)
        notes, warnings = list(judged.texts), list(judged.warnings)
        warnings += contradictions(_rows(request, found))
        if len(rates) and not (np.any(rates > 0) and np.any(rates < 0)):
            notes.append(
                said(
                    "All rates have the same sign, so asymmetry cannot be determined, and F0 includes any offset "
                    "that depends on the sense of rotation."
                )
            )
        if not (found.common or request.setup.inputs.get("table rate")):
            notes.append(
                said("The table's rate is treated as exact; state `rate_uncertainty` to include its uncertainty.")
            )
        return Words(
            headline=tuple(item.name for item in found.coefficients),
            settings={
                "uncertainty": parameters.uncertainty,
                "weights": parameters.weights,
                "rate_uncertainty": parameters.rate_uncertainty.value if parameters.rate_uncertainty else 0.0,
            },
            tables=(_table(observations, shown, fit, rate), *drift_tables([fit], parameters.uncertainty)),
            plots=(residual_plot(observations, fit, "Residuals from the straight line", f"rate [{rate.text}]", shown),),
            notes=tuple(notes),
            warnings=tuple(warnings),
            segments=observations.labels,
        )


_ALIKE = 1e-6  # difference of shares that counts as rounding
_ALONG = 0.5  # smallest fraction of the rate along an axis for which the slope is a scale factor, not a misalignment


def _rows(request: EstimateRequest[ScaleFactorParameters], found: LineQuantities) -> list[AxisResponse]:
    """Returns the responses of outputs whose unit is a rate, if their input axis is near the axis about which all segments turn."""
    segments = [one.segment for one in request.segments if isinstance(one.segment.motion, Spin)]
    shares = shares_by_name(segments, request.setup.mounting, found.observations.channels)
    rows = []
    for k, (name, text) in enumerate(zip(found.observations.channels, found.observations.units, strict=True)):
        share, own, axis = shares[:, k], unit(text), axis_of(name)
        if axis is None or own.dimension != unit("rad/s").dimension or not share.size or np.ptp(share) > _ALIKE:
            continue
        if abs(share[0]) >= _ALONG:
            rows.append(
                AxisResponse(name, axis, own, {axis: float(found.fit.coefficients[k, 1] * own.factor / share[0])})
            )
    return rows


def _is_rate(request: DesignRequest[ScaleFactorParameters], name: str) -> bool:
    output = request.sensor.output(name)
    return output is not None and unit(output.unit).dimension == unit("rad/s").dimension


def _rates(segments: Sequence[Segment]) -> Array:
    for segment in segments:
        if isinstance(segment.motion, Rock | Cycle):
            kind = type(segment.motion).__name__.lower()
            raise EstimationError(
                f"segment '{segment.label}' has no constant rate ({kind}): leave it out of `segments`"
            )
    return np.array([segment.rate for segment in segments], dtype=float)


def _found(
    request: EstimateRequest[ScaleFactorParameters], observations: Observations, rates: Array, fit: OutputsFit
) -> LineQuantities:
    parameters = request.parameters
    basis = parameters.uncertainty
    m = len(observations.channels)
    scale, coefficients = np.ones(2 * m), []
    units = [rate_and_output(parameters.rate_unit, text) for text in observations.units]
    slopes = [slope_unit(*pair) for pair in units]
    scale[1::2] = [factor for _, factor in slopes]
    covariance = fit.covariance(basis) * np.outer(scale, scale)
    freedom = fit.degrees_of_freedom(np.eye(2 * m), basis)
    spreads = np.sqrt(np.diag(covariance))
    metrics: list[tuple[Coefficient, int, Array]] = []
    for k, name in enumerate(observations.channels):
        words = (
            said("{output}: offset at zero rate", output=name),
            said("{output}: scale factor relative to the table's rate", output=name),
        )
        for j, (letter, its_unit) in enumerate((("F0", units[k][1].text), ("K", slopes[k][0]))):
            at = 2 * k + j
            value, u, dof = float(fit.coefficients[k, j] * scale[at]), float(spreads[at]), float(freedom[at])
            coefficients.append(Coefficient(f"{letter}_{name}", value, its_unit, u, dof, words[j]))
        metrics += [(item, k, answers) for item, answers in _metrics(name, rates, observations, k, fit, basis)]
    functionals = np.zeros((2 * m + len(metrics), m, len(rates)))
    for k in range(m):
        functionals[2 * k : 2 * k + 2, k] = fit.gains[k] * scale[2 * k : 2 * k + 2, None]
    for row, (_, k, answers) in enumerate(metrics, start=2 * m):
        functionals[row, k] = answers
    coefficients += [item for item, _, _ in metrics]
    full = np.zeros((2 * m + len(metrics), 2 * m + len(metrics)))
    full[: 2 * m, : 2 * m] = covariance
    full[range(2 * m, len(full)), range(2 * m, len(full))] = [item.standard_uncertainty**2 for item, _, _ in metrics]
    stated = _common(request, functionals, fit.coefficients, rates)
    recorded = resolution_influences(request, observations.channels, functionals)
    return LineQuantities(
        coefficients=tuple(coefficients),
        covariance=full,
        influences=(*stated, *recorded, *fit.influences(basis, functionals)),
        unstated=fit.unstated_flicker(functionals),
        observations=observations,
        rates=rates,
        fit=fit,
        common=bool(stated),
    )


def _held(request: EstimateRequest[ScaleFactorParameters], slopes: Array, rates: Array) -> tuple[CorrelatedError, ...]:
    """Returns the errors of the outputs due to the stated error of each commanded rate. `slopes`: array of shape (m,), slopes of
    the outputs."""
    stated = request.setup.inputs.get("table rate")
    return rate_errors(stated, np.outer(slopes, rates), rates) if stated else ()


def _common(
    request: EstimateRequest[ScaleFactorParameters], functionals: Array, coefficients: Array, rates: Array
) -> tuple[Influence, ...]:
    """Returns the influence of an error that all rates have in common and that the plan states, such as an error of the table's
    clock. This error changes the slope and causes no scatter.

    `functionals`: array of shape (q, m, n), ∂coefficient/∂(mean of output k over segment n). `coefficients`: array of shape (m, 2),
    coefficients of the lines.
    """
    common = common_rate(request.name, request.parameters.rate_uncertainty)
    if not common.standard_uncertainty:
        return ()

    def answered(moved: Array) -> Array:
        """Returns, up to an additive constant, the coefficients that the fit would give if the rates were `moved` (n,), in rad/s.
        The outputs themselves stay the same. A change of the expected outputs therefore has the same effect on the fit as the
        opposite change of the recorded outputs."""
        return np.asarray(-np.einsum("qmn,mn->q", functionals, coefficients @ line_through(moved)[0].T))

    return influences_on(answered, [StatedCondition.single(common, lambda by: rates * (1 + by))])


def _metrics(
    name: str, rates: Array, observations: Observations, k: int, fit: OutputsFit, basis: str
) -> list[tuple[Coefficient, Array]]:
    """Returns further coefficients of one output, each with its sensitivities (n,) to the means of the output.

    The nonlinearity [ppm] is the largest residual divided by the largest output. The asymmetry [ppm] is 2·(K₊ − K₋)/(K₊ + K₋),
    where K₊ and K₋ are the slopes of two half-lines that meet at zero rate. The asymmetry requires rates of both signs and three
    different rates."""
    one, (matrix, _) = fit.fits[k], line_through(rates)
    observed = fit.observed(k, basis)
    factor = float(fit.variance_factors[k]) if basis == "residual" else 1.0
    worst = int(np.argmax(np.abs(one.residuals)))
    full_scale = float(np.abs(observations.mean[:, k]).max()) or (math.nan if observations.expected else 0.0)
    by_residuals = basis == "residual" and not fit.by_noise[k]
    freedom = float(fit.freedom) if by_residuals else fit.noises[k].degrees_of_freedom
    found = []
    if full_scale != 0 and fit.freedom:
        value = abs(float(one.residuals[worst])) / full_scale * 1e6
        words = said("{output}: largest residual, divided by the largest output", output=name)
        residual = (np.arange(len(rates)) == worst) - fit.columns[worst] @ fit.all_gains[k]
        noise = fit.spreads[k] ** 2 if basis == "residual" else fit.noises[k].sigma ** 2
        beside = (
            residual @ (observed - np.diag(noise)) @ residual
        )  # the part of the effects that the line does not absorb
        u = math.sqrt(factor * float(noise[worst] + beside)) / full_scale * 1e6
        answers = 1e6 / full_scale * np.sign(one.residuals[worst]) * residual
        maximum = CoefficientRole.MAXIMUM
        found.append((Coefficient(f"nonlinearity_{name}", value, "ppm", u, freedom, words, role=maximum), answers))
    responds = np.ptp(observations.mean[:, k]) > 0 or observations.expected
    if responds and np.any(rates > 0) and np.any(rates < 0) and np.unique(rates).size >= 3:
        drifts = fit.columns[:, matrix.shape[1] :]
        halves = np.column_stack([np.ones(len(rates)), np.maximum(rates, 0), np.minimum(rates, 0), drifts])
        mixed = fit.observed(k, "residual")
        names = ("offset", "rate forward", "rate backward", *fit.drift.names)
        half = least_squares.fit(halves, observations.mean[:, k], names=names, covariance=mixed)
        if observations.expected:
            half = replace(half, chi_squared=float(half.degrees_of_freedom))
        slopes = half.coefficients[1:3]
        gradient = 1e6 * jacobian(lambda both: asymmetry(both[:1], both[1:]), slopes)[0]
        left = half.variance_factor if by_residuals and half.degrees_of_freedom else factor
        own = float(half.degrees_of_freedom or freedom) if by_residuals else freedom
        answers = gradient @ (half.cofactor @ np.linalg.solve(mixed, halves).T)[1:3]
        u = math.sqrt(max(0.0, float(answers @ observed @ answers) * left))
        value = 1e6 * float(asymmetry(*slopes))
        words = said(
            "{output}: difference between the scale factors at positive and negative rates, divided by their mean",
            output=name,
        )
        found.append((Coefficient(f"asymmetry_{name}", value, "ppm", u, own, words), answers))
    return found


def _table(observations: Observations, rates: Sequence[float], fit: OutputsFit, rate: Unit) -> Table:
    return by_columns(
        "Means and residuals per rate",
        (TableColumn("segment"), observations.labels),
        (TableColumn("rate", Role.NUMBER, rate.text), rates),
        *(column for k in range(len(fit.fits)) for column in mean_and_residual(observations, fit, k)),
    )

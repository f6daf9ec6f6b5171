"""Computes Allan deviations of outputs at rest, and fits the noise coefficients of IEEE Std 952 to the Allan variance: quantisation
Q, angle random walk N, bias instability B, and rate random walk K.

The module `phase` reads samples and treats gaps; `kernel` computes sums; `confidence` computes degrees of freedom and intervals;
`fit` computes the coefficients; `lines` subtracts periodic disturbances.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.findings import closest
from planrunner.base.said import Said, counted, said
from planrunner.estimators.allan.confidence import NAMES
from planrunner.estimators.allan.described_range import DescribedRange, described_range
from planrunner.estimators.allan.fit import FLAT, TERMS, expected_covariance, model_matrix
from planrunner.estimators.allan.lines import SpectralLine, largest, without_lines
from planrunner.estimators.allan.phase import LONGEST, Phase, read_phase
from planrunner.estimators.allan.planning import (
    averaging_factors,
    planned_averaging,
    planned_record,
    require_averaging_times,
    takes_part,
)
from planrunner.estimators.allan.scale import (
    ScaleFactorKind,
    SensedBy,
    coefficient_units,
    sensed_by,
    squares_to_coefficients,
)
from planrunner.estimators.allan.table import KINDS, Deviation, deviations, octave_factors
from planrunner.estimators.interface import (
    Coefficient,
    CoefficientRole,
    Design,
    DesignRequest,
    Estimate,
    EstimateRequest,
    EstimationError,
    Foresight,
    UnfitDataError,
    Unpredicted,
)
from planrunner.estimators.root_of_square import root_of
from planrunner.estimators.tables import Plot, Role, Table, TableColumn, by_columns
from planrunner.observation.lattice import undeclared_step
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, MapOf, Number, QuantityOf, Record, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.plan.schedule import Rest
from planrunner.uncertainty.influences import Influence

WORDS = {
    "Q": said("quantisation: 3·Q²/τ²"),
    "N": said("random walk of the integrated output: N²/τ"),
    "B": said("bias instability: the flat part is at 0.664·B"),
    "K": said("random walk of the output: K²·τ/3"),
}
_FLOOR_FREEDOM = 10.0  # fewest degrees of freedom of the Allan deviation that is reported as the lowest
_SIGNIFICANT = 2.0  # a squared coefficient is significant from this number of standard uncertainties
_SEEN = 2**14  # phase points from which a count is determined
_NAMED = 3  # most lines named in a sentence


class AllanDeviationParameters(Record):
    """Declares the plan keys of the estimator `allan_deviation`."""

    outputs: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=1, single=True),
        "Channels, each analysed separately; by default all channels of the recording.",
        ["gyro_z"],
        default_factory=tuple,
    )
    deviations: tuple[str, ...] = key(
        ListOf(Choice(KINDS), minimum=1, single=True),
        "Deviations to tabulate; the coefficients always come from the overlapping Allan deviation.",
        ["overlapping", "hadamard"],
        default=("overlapping",),
    )
    taus: tuple[Quantity, ...] = key(
        ListOf(QuantityOf("time", "positive"), minimum=1),
        "Averaging times, each rounded to whole samples; by default octaves of the sample interval.",
        ["1 s", "10 s", "100 s"],
        default_factory=tuple,
    )
    terms: tuple[str, ...] = key(
        ListOf(Choice(TERMS), minimum=1, single=True), "Coefficients to fit.", ["N", "B"], default=TERMS
    )
    fit_up_to: Quantity | None = optional(
        QuantityOf("time", "positive"), "Longest averaging time in the fit, above which drift dominates.", "1 h"
    )
    scale_factors: dict[str, Quantity | str] = key(
        MapOf(ScaleFactorKind()),
        "Scale factor of an output that is not a rate or acceleration: a quantity, or a coefficient of an estimate in "
        "`uses`. The noise coefficients then refer to the rate or acceleration.",
        {"torquer_x": "0.2012 (deg/h)/(pulse/s)", "torquer_y": "drift.SF_X"},
        default_factory=dict,
    )
    bridge: Quantity = key(
        QuantityOf("time", "not negative"),
        "Gaps up to this length are filled by linear interpolation; longer gaps split the record.",
        "0 s",
        default=parse_quantity("0 s"),
    )
    confidence: float = key(Number(0.5, 0.999), "Confidence level of the intervals.", 0.95, default=0.95)


class AllanDeviation:
    """Implements the estimator `allan_deviation`."""

    summary = "Allan deviations with confidence intervals, and noise coefficients N, B, K, Q with uncertainties"
    Parameters = AllanDeviationParameters

    def design(self, request: DesignRequest[AllanDeviationParameters]) -> Design:
        """Checks that the planned record is suitable. Raises `EstimationError` if the plan is not suitable."""
        parameters = request.parameters
        names = parameters.outputs or tuple(output.name for output in request.sensor.outputs)
        moving = [segment.label for segment in request.segments if not isinstance(segment.motion, Rest)]
        notes = [
            f"'{label}' moves: its outputs include the effect of the motion, which is treated as noise."
            for label in moving
        ]
        _known_scale_factors(parameters, names)
        for name in names:
            output = request.sensor.output(name)
            if output is None:
                known = ", ".join(item.name for item in request.sensor.outputs)
                raise EstimationError(f"the bench's sensor has no output '{name}'; it has {known}")
            if output.constant and not moving:
                raise EstimationError(_never_changes(name))
        remarks = planned_averaging(request, names, parameters.taus, parameters.fit_up_to)
        return Design((), notes=tuple(notes), remarks=remarks)

    def foresee(self, request: DesignRequest[AllanDeviationParameters]) -> Foresight:
        """Predicts the coefficients from the declared noise and the planned record, without simulating samples. Raises
        `EstimationError` for scale factors that do not fit their outputs."""
        parameters = request.parameters
        names = parameters.outputs or tuple(output.name for output in request.sensor.outputs)
        predicted: list[Coefficient] = []
        unpredicted: list[Unpredicted] = []
        for name in names:
            sure, unsure = _foreseen(request, name)
            predicted += sure
            unpredicted += unsure
        return Foresight(tuple(predicted), tuple(unpredicted))

    def estimate(self, request: EstimateRequest[AllanDeviationParameters]) -> Estimate:
        """Computes deviations and coefficients from the samples. Raises `EstimationError` if the plan or the data are not suitable."""
        parameters = request.parameters
        if not request.segments:
            raise EstimationError("no recorded segments are chosen: check the labels in `segments`")
        names = parameters.outputs or request.segments[0].statistics.channels
        _known_scale_factors(parameters, names)
        results = [_output(request, name) for name in names]
        size = sum(len(result.coefficients) for result in results)
        covariance, place = np.zeros((size, size)), 0
        for result in results:
            end = place + len(result.coefficients)
            covariance[place:end, place:end] = result.covariance
            place = end
        coefficients = tuple(item for result in results for item in result.coefficients)
        return Estimate(
            request.name,
            "allan_deviation",
            coefficients,
            covariance,
            headline=tuple(item.name for item in coefficients),
            settings={
                "deviations": list(parameters.deviations),
                "terms": list(parameters.terms),
                "confidence": parameters.confidence,
                "bridge": f"{parameters.bridge.value:g} s",
            },
            tables=tuple(table for result in results for table in result.tables),
            plots=tuple(result.plot for result in results),
            notes=tuple(dict.fromkeys(note for result in results for note in result.notes)),
            warnings=tuple(warning for result in results for warning in result.warnings),
            segments=tuple(recorded.label for recorded in request.segments),
            extra={
                "taus": {name: [row.tau for row in result.rows] for name, result in zip(names, results, strict=True)}
            },
            influences=tuple(_influences(results)),
        )


class _Result:
    """The results for one output."""

    def __init__(self, name: str, unit: str):
        self.name, self.unit = name, unit
        self.coefficients: list[Coefficient] = []
        self.covariance: Array = np.zeros((0, 0))
        self.rows: list[Deviation] = []
        self.tables: list[Table] = []
        self.notes: list[Said] = []
        self.warnings: list[Said] = []
        self.plot = Plot("", "", "", (), {})
        self.sensed: SensedBy | None = None


def _output(request: EstimateRequest[AllanDeviationParameters], name: str) -> _Result:
    parameters = request.parameters
    phase = read_phase(request.segments, name, parameters.bridge.value)
    result = _Result(name, request.segments[0].units[name])
    if any(recorded.units[name] != result.unit for recorded in request.segments):
        raise EstimationError(f"channel '{name}' is recorded in different units: use segments of one kind")
    try:
        factors = averaging_factors(parameters.taus, phase.lengths, phase.interval, name)
    except EstimationError as error:
        if phase.gaps:
            raise UnfitDataError(str(error)) from None
        raise
    rows = {
        kind: deviations(phase, kind, factors, parameters.confidence)
        for kind in ("overlapping", *parameters.deviations)
    }
    result.rows = rows["overlapping"]
    if not any(row.value for row in result.rows):
        raise UnfitDataError(_never_changes(name))
    if name in parameters.scale_factors:
        result.sensed = sensed_by(parameters.scale_factors[name], name, result.unit, request.uses)
    _fit(result, phase, parameters)
    for kind in parameters.deviations:
        result.tables.append(_table(name, result.unit, kind, rows[kind], parameters.confidence))
    _describe_gaps(result, phase)
    return result


def _never_changes(name: str) -> str:
    return (
        f"'{name}' never changes in the chosen segments: check whether it is connected and whether its resolution "
        "is finer than its noise"
    )


def _known_scale_factors(parameters: AllanDeviationParameters, names: Sequence[str]) -> None:
    for name in parameters.scale_factors:
        if name not in names:
            raise EstimationError(
                f"`scale_factors` names '{name}', which is not one of the outputs of this estimate: {closest(name, names)}"
            )


def _influences(results: Sequence[_Result]) -> list[Influence]:
    """Returns the contribution of the uncertainty of the scale factors. Every coefficient is proportional to the scale factor of
    its output, or to the reciprocal of the scale factor."""
    values = np.array([item.value for result in results for item in result.coefficients])
    found, place = [], 0
    for result in results:
        end = place + len(result.coefficients)
        if result.sensed and result.sensed.quantity.standard_uncertainty:
            sensitivities = np.zeros((values.size, 1))
            sensitivities[place:end, 0] = result.sensed.power * values[place:end] / result.sensed.quantity.value
            found.append(Influence(result.sensed.quantity, sensitivities))
        place = end
    return found


def _fit(result: _Result, phase: Phase, parameters: AllanDeviationParameters) -> None:
    chosen = [row for row in result.rows if takes_part(row.tau, row.freedom, parameters.fit_up_to)]
    terms = [term for term in TERMS if term in parameters.terms]
    for dropped in ("K", "Q", "B", "N"):
        if len(terms) > max(1, len(chosen) - 1) and dropped in terms and len(terms) > 1:
            terms.remove(dropped)
            result.notes.append(
                said(
                    "{name}: there are too few averaging times to fit {dropped}, so it is left out.",
                    name=result.name,
                    dropped=dropped,
                )
            )
    try:
        require_averaging_times(result.name, len(chosen))
    except EstimationError as error:
        if phase.gaps:
            raise UnfitDataError(str(error)) from None
        raise
    count = _count(phase)
    described = described_range(phase, chosen, terms, lambda: _hadamard(phase, chosen, parameters), count)
    if phase.decimation == 1 and (described.shorter > described.rounded or not described.fits):
        quiet, lines = without_lines(phase)
        if lines:
            factors = np.array([row.factor for row in chosen], dtype=np.int64)
            clean = [row for row in deviations(quiet, "overlapping", factors, parameters.confidence) if row.value > 0]
            described = described_range(quiet, clean, terms, lambda: _hadamard(quiet, chosen, parameters), count)
            result.warnings.append(_periodic(result, lines))
    fit, covariance = described.fit, described.covariance
    widening = _judge(result, described, count)
    units = result.sensed.units if result.sensed else coefficient_units(result.unit)
    roots = squares_to_coefficients(phase.interval)
    spreads = []
    for term in terms:
        k = TERMS.index(term)
        text, factor = units[term]
        value, spread = root_of(fit.squares[k], math.sqrt(covariance[k, k]) * widening)
        scale = roots[term] * factor
        spreads.append(spread * scale)
        found = Coefficient(
            f"{term}_{result.name}",
            value * scale,
            text,
            spread * scale,
            description=WORDS[term],
            role=CoefficientRole.SCALE,
        )
        result.coefficients.append(found)
        if fit.squares[k] < _SIGNIFICANT * math.sqrt(covariance[k, k]) * widening:
            bound = (value + 2 * spread) * scale
            result.notes.append(
                said(
                    "{coefficient} cannot be distinguished from zero in this record; it is below about {bound:.2g} "
                    "{text}.",
                    coefficient=found.name,
                    bound=bound,
                    text=text,
                )
            )
    index = [TERMS.index(term) for term in terms]
    inner = covariance[np.ix_(index, index)]
    size = np.sqrt(np.diag(inner))
    result.covariance = inner / np.outer(size, size) * np.outer(spreads, spreads)
    result.plot = _plot(result, described)


def _count(phase: Phase) -> float:
    """Returns the step of which all differences between samples are multiples, in the output's unit; 0 if there is none."""
    longest = max(phase.runs, key=len)
    return undeclared_step(np.diff(longest[:_SEEN]), fewest=2)


def _periodic(result: _Result, lines: Sequence[SpectralLine]) -> Said:
    shown = largest(lines, _NAMED)
    return said(
        "{name}: the output contains a periodic disturbance ({lines}). The noise coefficients describe the output without "
        "this disturbance. The deviations in the tables include it.",
        name=result.name,
        lines=", ".join(f"{one.frequency:.4g} Hz, amplitude {one.amplitude:.3g} {result.unit}" for one in shown),
    )


def _hadamard(phase: Phase, chosen: Sequence[Deviation], parameters: AllanDeviationParameters) -> list[Deviation]:
    """Returns the Hadamard deviations at the averaging times of the fit, if they have enough degrees of freedom."""
    factors = np.array([row.factor for row in chosen], dtype=np.int64)
    rows = deviations(phase, "hadamard", factors, parameters.confidence)
    return [row for row in rows if row.value > 0 and takes_part(row.tau, row.freedom, parameters.fit_up_to)]


def _judge(result: _Result, found: DescribedRange, count: float) -> float:
    """Adds notes and warnings about the fitted range of averaging times. Returns the factor that widens the uncertainties if the
    model does not describe any range of averaging times. `count`: size of one count of the output, in the output's unit; 0 if the
    values are not rounded."""
    name, drift = result.name, found.drift
    if drift is not None:
        result.notes.append(
            said(
                "{name}: the coefficients are fitted to the Hadamard variances, because in the Allan variances a "
                "steady drift would imitate a random walk of the output.",
                name=name,
            )
        )
        if drift.present:
            result.notes.append(
                said(
                    "{name}: the output drifts steadily by ({slope:.3g} ± {uncertainty:.2g}) {unit} per hour "
                    "(standard uncertainty).",
                    name=name,
                    slope=drift.slope * 3600,
                    uncertainty=drift.standard_uncertainty * 3600,
                    unit=result.unit,
                )
            )
    if not found.fits:
        widening = math.sqrt(max(1.0, found.fit.chi_square / max(1, found.fit.freedom)))
        result.warnings.append(
            counted(
                "{name}: the fitted noise does not describe the deviations (χ² = {chi_square:.3g} with {freedom} "
                "degree of freedom); the uncertainties are multiplied by {factor:.2g}. The record may contain "
                "drift, vibration or a periodic disturbance.",
                "{name}: the fitted noise does not describe the deviations (χ² = {chi_square:.3g} with {freedom} "
                "degrees of freedom); the uncertainties are multiplied by {factor:.2g}. The record may contain "
                "drift, vibration or a periodic disturbance.",
                count=found.fit.freedom,
                name=name,
                chi_square=found.fit.chi_square,
                freedom=found.fit.freedom,
                factor=widening,
            )
        )
        return widening
    if found.rounded and found.shorter == found.rounded:
        result.warnings.append(
            said(
                "{name}: the output is rounded to counts of {count:.3g} {unit}, and the rounding error is carried over to the "
                "next sample. The noise coefficients describe only averaging times of {time:.4g} s and more, because "
                "rounding errors that are closer together in time depend on each other.",
                name=name,
                count=count,
                unit=result.unit,
                time=found.fitted[0].tau,
            )
        )
    elif found.shorter:
        result.warnings.append(
            said(
                "{name}: the noise coefficients describe only averaging times of {time:.4g} s and more. At shorter "
                "averaging times, the deviations differ from this description: the output is filtered or "
                "rounded, or contains a periodic disturbance "
                "such as vibration.",
                name=name,
                time=found.fitted[0].tau,
            )
        )
    if found.longer:
        result.warnings.append(
            said(
                "{name}: the noise coefficients describe only averaging times up to {time:.4g} s. At longer "
                "averaging times, the deviations differ from this description: the output warms up or drifts "
                "unsteadily.",
                name=name,
                time=found.fitted[-1].tau,
            )
        )
    return 1.0


def _table(name: str, unit: str, kind: str, rows: Sequence[Deviation], probability: float) -> Table:
    return by_columns(
        f"{kind.capitalize()} deviation of {name}",
        (TableColumn("τ", Role.NUMBER, "s"), [row.tau for row in rows]),
        (TableColumn(f"{kind} deviation", Role.VALUE, unit), [row.value for row in rows]),
        (TableColumn(f"lower {100 * probability:g} %", Role.VALUE, unit), [row.low for row in rows]),
        (TableColumn(f"upper {100 * probability:g} %", Role.VALUE, unit), [row.high for row in rows]),
        (TableColumn("degrees of freedom", Role.DEGREES_OF_FREEDOM), [row.freedom for row in rows]),
        (TableColumn("noise"), [NAMES[row.alpha] + (" (carried)" if row.carried else "") for row in rows]),
        (TableColumn("differences", Role.COUNT), [row.terms for row in rows]),
    )


def _plot(result: _Result, found: DescribedRange) -> Plot:
    """Returns a plot of the deviations and of the model over all averaging times."""
    rows = [row for row in result.rows if row.value > 0]
    factors = np.array([row.factor for row in found.fitted], dtype=np.int64)
    variances = model_matrix(factors) @ found.fit.squares
    fitted = {int(m): math.sqrt(max(0.0, value)) for m, value in zip(factors, variances, strict=True)}
    series = {
        "measured": tuple(row.value for row in rows),
        "fitted": tuple(fitted.get(row.factor, math.nan) for row in rows),
    }
    spread = tuple(row.value * min(0.9, 1 / math.sqrt(2 * row.freedom)) for row in rows)
    taus = tuple(row.tau for row in rows)
    title = f"Allan deviation of {result.name}"
    return Plot(title, "averaging time [s]", f"deviation [{result.unit}]", taus, series, {"measured": spread}, log=True)


def _describe_gaps(result: _Result, phase: Phase) -> None:
    changing = [row for row in result.rows if row.value > 0]
    known = [row for row in changing if row.freedom >= _FLOOR_FREEDOM] or changing[:1]
    lowest = min(known, key=lambda row: row.value)
    flat = lowest.value / math.sqrt(FLAT)
    result.notes.append(
        said(
            "{name}: the lowest Allan deviation is {deviation:.3g} {unit}, at {time:.4g} s. Divided by 0.664, "
            "it gives a bias instability of {flat:.3g} {unit}, if no other kind of noise contributes to it.",
            name=result.name,
            deviation=lowest.value,
            unit=result.unit,
            time=lowest.tau,
            flat=flat,
        )
    )
    result.notes.append(
        said(
            "Standard uncertainties come from the covariance of the fit; χ² intervals of the deviations are "
            "in the tables."
        )
    )
    if phase.gaps or phase.bridged:
        share = 100 * phase.lost / max(1, phase.samples)
        result.notes.append(
            said(
                "{name}: {missing} samples are missing; {bridged} of them were filled by linear interpolation. The "
                "other gaps ({gaps}) divide the record into {stretches} usable stretches; {share:.2g} % of the "
                "samples are in stretches that are too short. No difference is taken across a gap.",
                name=result.name,
                missing=phase.missing,
                bridged=phase.bridged,
                gaps=phase.gaps,
                stretches=len(phase.runs),
                share=share,
            )
        )
    if phase.decimation > 1:
        result.notes.append(
            said(
                "{name}: the record has more than {most} samples, so only one in {step} phase points is kept; "
                "the shortest averaging time is {time:.4g} s.",
                name=result.name,
                most=LONGEST,
                step=phase.decimation,
                time=phase.interval,
            )
        )


def _foreseen(
    request: DesignRequest[AllanDeviationParameters], name: str
) -> tuple[list[Coefficient], list[Unpredicted]]:
    """Returns the predicted coefficients. N and B are the values that the bench file declares, with the uncertainty expected from
    the planned record. Q and K are not predicted; neither are N and B if the bench file does not declare them."""
    parameters = request.parameters
    output = request.sensor.output(name)
    assert output is not None  # design refuses others
    stated = parameters.scale_factors.get(name)
    if isinstance(stated, str) and not request.uses.get(stated.partition(".")[0], Design(())).known:
        return [], []
    sensed = sensed_by(stated, name, output.unit, request.uses) if stated else None
    units = sensed.units if sensed else coefficient_units(output.unit)
    record = planned_record(request)
    long_enough = record is not None and record.lengths.max() >= 64
    declared = {"N": output.noise.white, "B": output.noise.bias_instability}
    squares, spread, roots = np.zeros(4), np.zeros(4), {}
    if record is not None and long_enough and output.noise.white > 0:
        interval, lengths = record.interval, record.lengths
        factors = octave_factors(lengths)[: -1 if not parameters.taus else None]
        squares = np.array([0.0, output.noise.white**2 / interval, output.noise.bias_instability**2, 0.0])
        spread = np.sqrt(np.diag(expected_covariance(factors, squares, lengths, parameters.terms)))
        roots = squares_to_coefficients(interval)
    found, without = [], []
    for k, term in enumerate(TERMS):
        if term not in parameters.terms:
            continue
        (text, factor), label, words = units[term], f"{term}_{name}", WORDS[term]
        if squares[k] > 0 and (sensed is None or math.isfinite(sensed.quantity.standard_uncertainty)):
            value, u = root_of(squares[k], float(spread[k]))
            scale = roots[term] * factor
            found.append(
                Coefficient(label, value * scale, text, u * scale, description=words, role=CoefficientRole.SCALE)
            )
            continue
        why = f"the bench declares no noise of this kind for '{name}'"
        if declared.get(term):
            why = "the planned record is too short, or its length is not known"
        without.append(Unpredicted(label, text, why, words, CoefficientRole.SCALE))
    return found, without

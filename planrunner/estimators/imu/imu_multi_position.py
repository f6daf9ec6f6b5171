"""Estimates bias, scale factor, misalignment and g-sensitivity of an IMU's triads from positions at rest and from rates about each
axis.

Each output is fitted by a linear model of named terms at the mean stimulus of every segment (IEEE Std 1431, IEEE Std 1293;
Titterton and Weston, Strapdown Inertial Navigation Technology, chapter 8). The stimulus includes the Earth's rotation. Gyros use
all segments. Accelerometers use only segments at rest. During a spin, an accelerometer senses centripetal acceleration, except if
it is on the rotation axis.

The report contains tables of the matrices and their inverses, and notes that explain how to apply them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.error_model.terms import ErrorModel, columns_of, error_model, term_names
from planrunner.estimators.basis_judgement import judge, planned_basis, require_basis
from planrunner.estimators.declared_axes import contradictions
from planrunner.estimators.derived import Derived, derived
from planrunner.estimators.drift_order import planned_drift
from planrunner.estimators.expected import Known
from planrunner.estimators.fit_positions import PositionsDesign, fit_positions, site_influences
from planrunner.estimators.fit_tables import bases_table, drift_tables, residual_plot, residual_table
from planrunner.estimators.imu.coefficients import AXES, Framed, Response, calibration
from planrunner.estimators.interface import (
    Coefficient,
    Design,
    DesignBlock,
    DesignRequest,
    EstimateRequest,
    EstimationError,
    Remark,
)
from planrunner.estimators.method import Method, Quantities, Words
from planrunner.estimators.outputs_fit import OutputsFit, uncertainty_basis
from planrunner.estimators.stated_errors import mean_poses
from planrunner.estimators.tables import FilledColumn, Role, Table, TableColumn, by_columns
from planrunner.observation.drift import drift, thermometer
from planrunner.observation.flicker import drift_span
from planrunner.observation.observations import Observations, observe, recorded_times, weights_of
from planrunner.physics.earth import Site
from planrunner.physics.stimulus import StimulusError
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, Record, key
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Rest, Segment
from planrunner.plan.units import DIMENSIONS, ZERO_CELSIUS, UnknownUnitError, unit
from planrunner.uncertainty.influences import Influence

_RATES, _FORCES = ("rate_x", "rate_y", "rate_z"), ("accel_x", "accel_y", "accel_z")
A_SENSOR = {"gyro": "a gyro", "accel": "an accelerometer"}
_EARTH_ALONE = 1.5  # Earth rates; the rate of a table is usually at least a hundred Earth rates


_TRIADS = {"gyro": said("Gyros"), "accel": said("Accelerometers")}


class ImuMultiPositionParameters(Record):
    """Declares the plan keys of the estimator `imu_multi_position`."""

    gyros: tuple[str, ...] = key(
        ListOf(CHANNEL),
        "The three gyro channels, for x, y and z.",
        ["gyro_x", "gyro_y", "gyro_z"],
        default_factory=tuple,
    )
    accelerometers: tuple[str, ...] = key(
        ListOf(CHANNEL),
        "The three accelerometer channels, for x, y and z.",
        ["accel_x", "accel_y", "accel_z"],
        default_factory=tuple,
    )
    gyro_terms: tuple[str, ...] = key(
        ListOf(term_names(), minimum=1),
        "Terms of each gyro, by name. The terms of specific force are its g-sensitivity.",
        ["bias", *_RATES],
        default=("bias", *_RATES, *_FORCES),
    )
    accelerometer_terms: tuple[str, ...] = key(
        ListOf(term_names(), minimum=1), "Terms of each accelerometer.", ["bias", *_FORCES], default=("bias", *_FORCES)
    )
    misalignment: str = key(
        Choice(("full", "lower_triangular")),
        "full: six misalignments, in the axes of the planned orientations. lower_triangular: three misalignments in the frame of the "
        "accelerometers, and the rotation from this frame to the planned axes. The x axis of this frame is the first input axis, and its "
        "y axis is in the plane of the first two input axes. If there are no accelerometers, the frame is that of the gyros.",
        "lower_triangular",
        default="full",
    )
    uncertainty: str = uncertainty_basis()
    drift_span: Quantity = drift_span()
    drift: tuple[str, ...] = drift()
    temperature_channel: str | None = thermometer()


@dataclass(frozen=True, slots=True)
class Triad:
    """The observations and the fit of one triad. `kind`: gyro or accel."""

    kind: str
    design: PositionsDesign
    observations: Observations
    fit: OutputsFit


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuQuantities(Quantities):
    """Contains the results of a multi-position test of an IMU. `frame`: the responses in the reported frame. `found`: the reported
    quantities."""

    triads: tuple[Triad, ...]
    frame: Framed
    found: Derived


class ImuMultiPosition(Method[ImuMultiPositionParameters, ImuQuantities]):
    """Implements the estimator `imu_multi_position`."""

    name = "imu_multi_position"
    summary = "Bias, scale factor, misalignment and g-sensitivity of IMU triads from positions and rates"
    Parameters = ImuMultiPositionParameters

    def design(self, request: DesignRequest[ImuMultiPositionParameters]) -> Design:
        """Checks how well the planned positions and rates determine the coefficients of each output. Raises `EstimationError` if
        the plan is not suitable."""
        parameters = request.parameters
        blocks: list[DesignBlock] = []
        remarks: list[Remark] = []
        for kind, channels, terms in _triads(parameters):
            design = _design(kind, terms, request.segments, request.site)
            its_own = replace(request, segments=design.segments)
            made = design.blocks(its_own, channels)
            blocks += made
            remarks += planned_basis(its_own, made, parameters.uncertainty)
            remarks += planned_drift(request, made)
            if kind == "gyro":
                remarks += _earth_rate_alone(request, made)
        return Design(tuple(blocks), remarks=tuple(remarks))

    def known(self, request: DesignRequest[ImuMultiPositionParameters]) -> Known:
        """Returns the input axes of the outputs: x, y and z, in the order in which the plan names the outputs."""
        triads = _triads(request.parameters)
        return Known(directions={name: np.eye(3)[axis] for _, names, _ in triads for axis, name in enumerate(names)})

    def quantities(self, request: EstimateRequest[ImuMultiPositionParameters]) -> ImuQuantities:
        """Computes the coefficients from the means of the segments. Raises `EstimationError` if the plan or the data are not
        suitable."""
        parameters = request.parameters
        basis = parameters.uncertainty
        triads = tuple(_fit(request, *one) for one in _triads(parameters))
        drifts = [one.fit.drift for one in triads]
        shown = {course.name for drift in drifts if drift.by_evidence for course in drift.courses}
        if shown and len(triads) > 1:
            # A drift that one triad shows is fitted to the other triad as well.
            triads = tuple(_fit(request, *one, shown) for one in _triads(parameters))
        made = calibration([_response(one) for one in triads], parameters.misalignment == "lower_triangular")
        # The noise of the triads is assumed to be independent.
        found = derived(made.quantities, made.formula, *(one.fit for one in triads))
        coefficients = found.coefficients(basis)
        return ImuQuantities(
            coefficients=coefficients,
            covariance=found.covariance(basis),
            influences=found.influences([_stated(request, one) for one in triads]),
            unstated=found.unstated,
            extra=_extra(request, made.frame, coefficients),
            triads=triads,
            frame=made.frame,
            found=found,
        )

    def words(self, request: EstimateRequest[ImuMultiPositionParameters], made: ImuQuantities) -> Words:
        """Makes the tables of the matrices, of the residuals, and of the uncertainties of each kind."""
        parameters = request.parameters
        basis = parameters.uncertainty
        triads, frame, found = made.triads, made.frame, made.found
        notes: list[Said] = [formula(frame)]
        warnings: list[Said] = []
        for one in triads:
            judged = judge(one.fit, basis)
            notes += [
                note.text if note.output else said("{triad}: {note}", triad=_TRIADS[one.kind], note=note.text)
                for note in judged.notes
            ]
            warnings += judged.warnings
            warnings += contradictions(_response(one).rows(one.observations.channels))
        if len(triads) == 2 and len(triads[0].design.segments) > len(triads[1].design.segments):
            notes.append(said("Only the segments at rest are used for the accelerometers."))
        return Words(
            headline=tuple(one.name for one in found.quantities),
            settings={
                "uncertainty": basis,
                "misalignment": parameters.misalignment,
                "terms": {one.kind: list(one.design.model.names) for one in triads},
                "weights": {
                    name: words
                    for one in triads
                    for name, words in weights_of(one.observations.channels, one.fit.noises).items()
                },
            },
            tables=(
                *(table for one in frame.responses for table in matrices(one)),
                *(
                    residual_table(f"Residuals of the {one.kind} triad", "segment", one.observations, one.fit)
                    for one in triads
                ),
                *drift_tables([one.fit for one in triads], basis),
                bases_table(found, basis),
            ),
            plots=tuple(
                residual_plot(one.observations, one.fit, f"Residuals of the {one.kind} triad") for one in triads
            ),
            notes=tuple(dict.fromkeys(notes)),
            warnings=tuple(warnings),
            segments=tuple(recorded.label for recorded in request.segments),
        )


def _triads(parameters: ImuMultiPositionParameters) -> list[tuple[str, tuple[str, ...], tuple[str, ...]]]:
    """Returns the kind, the channels and the terms of each triad that the plan gives. Raises `EstimationError` if a triad does not
    have three channels, or if the plan gives no triad."""
    stated = (
        ("gyro", parameters.gyros, parameters.gyro_terms, _RATES),
        ("accel", parameters.accelerometers, parameters.accelerometer_terms, _FORCES),
    )
    found: list[tuple[str, tuple[str, ...], tuple[str, ...]]] = []
    for kind, channels, terms, sensed in stated:
        if not channels:
            continue
        if len(channels) != 3 or len(set(channels)) != 3:
            message = f"a triad has three channels, for x, y and z, but the plan gives {', '.join(channels)}"
            raise EstimationError(
                message, "name one channel for each axis", f"{'gyros' if kind == 'gyro' else 'accelerometers'}"
            )
        if not set(terms) & set(sensed):
            raise EstimationError(f"the {kind} triad needs at least one of the terms {', '.join(sensed)}")
        found.append((kind, channels, terms))
    if not found:
        hint = (
            "name the channels for x, y and z, such as `gyros: [gyro_x, gyro_y, gyro_z]`, and likewise for `accelerometers`; one of "
            "the "
            "two is enough"
        )
        raise EstimationError("neither `gyros` nor `accelerometers` is given", hint)
    return found


def _usable(kind: str, segments: Sequence[Segment]) -> list[Segment]:
    usable = [one for one in segments if kind == "gyro" or isinstance(one.motion, Rest)]
    if not usable:
        raise EstimationError("accelerometers need positions at rest, but every chosen segment moves")
    return usable


def _design(kind: str, terms: Sequence[str], segments: Sequence[Segment], site: Site) -> PositionsDesign:
    """Returns the design of each output of a triad at the segments that the triad can use. Raises `EstimationError` if the triad
    can use no segment, or if a term cannot be computed for the segments."""
    model, usable = error_model(terms), _usable(kind, segments)
    try:
        matrix = columns_of(model, mean_poses(usable), site)
    except StimulusError as error:
        raise EstimationError(str(error)) from None
    return PositionsDesign(model, tuple(usable), matrix, _magnitudes(model, matrix))


def _magnitudes(model: ErrorModel, matrix: Array) -> Array:
    """Returns the declared magnitudes of the columns, shape (p,). The three columns of the rates have the largest planned rate as
    magnitude, so that an axis without rotation is detected."""
    rates = [k for k, term in enumerate(model.terms) if term.unit == "rad/s"]
    sizes = model.magnitudes
    if rates:
        sizes[rates] = max(float(np.abs(matrix[:, rates]).max()), float(sizes[rates].max()))
    return sizes


def _fit(
    request: EstimateRequest[ImuMultiPositionParameters],
    kind: str,
    channels: Sequence[str],
    terms: Sequence[str],
    shown: Collection[str] = (),
) -> Triad:
    """Fits one triad. `shown`: names of the drift functions that at least one triad shows."""
    design = _design(kind, terms, [recorded.segment for recorded in request.segments], request.site)
    usable = {id(segment) for segment in design.segments}
    recorded = [one for one in request.segments if id(one.segment) in usable]
    observations = observe(recorded, channels, request.sensor)
    fit = fit_positions(request, design, observations, recorded, shown=shown)
    require_basis(fit, request.parameters.uncertainty, f"{request.name}, {kind} triad")
    return Triad(kind, design, observations, fit)


def _response(one: Triad) -> Response:
    try:
        units = tuple(unit(text) for text in one.observations.units)
    except UnknownUnitError as error:
        raise EstimationError(str(error)) from None
    wrong = DIMENSIONS["acceleration" if one.kind == "gyro" else "angular rate"]
    for name, own in zip(one.observations.channels, units, strict=True):
        if own.dimension == wrong:
            raise EstimationError(
                f"channel '{name}' is recorded in {own.text}, which is not a possible unit of {A_SENSOR[one.kind]}"
            )
    return Response(one.kind, units, one.design.model, one.fit.coefficients)


def _stated(request: EstimateRequest[ImuMultiPositionParameters], one: Triad) -> tuple[Influence, ...]:
    """Returns the influences of declared inputs on the coefficients of one triad."""
    return (*site_influences(request, one.design, one.fit), *one.fit.influences(request.parameters.uncertainty))


def _earth_rate_alone(
    request: DesignRequest[ImuMultiPositionParameters], blocks: Sequence[DesignBlock]
) -> list[Remark]:
    """Returns warnings about scale factors that are determined by the Earth's rotation alone. The rank of the design matrix does
    not show this."""
    terms = blocks[0].terms
    alone = [
        name
        for name in _RATES
        if name in terms
        and np.abs(blocks[0].matrix[:, terms.index(name)]).max(initial=0.0) < _EARTH_ALONE * request.site.earth_rate
    ]
    if not alone:
        return []
    axes = " and ".join(name[-1] for name in alone)
    message = (
        f"about {axes}, the gyros turn only with the Earth (15 deg/h), so only the Earth's rotation determines "
        f"{' and '.join(alone)}"
    )
    hint = (
        "add segments with a rate about each axis, in both directions; the predicted uncertainties show how "
        "poorly the present segments determine the scale factors"
    )
    return [Remark("physics-earth-rate-alone", message, hint, conditions=True)]


def _extra(
    request: EstimateRequest[ImuMultiPositionParameters], frame: Framed, found: Sequence[Coefficient]
) -> dict[str, object]:
    """Returns data for estimates that use this one: the matrices and, if all segments had the same temperature, the coefficients
    with this temperature."""
    extra: dict[str, object] = {
        one.kind: {
            "terms": list(one.model.names),
            "coefficients": one.values.tolist(),
            "inverse": inverse.tolist() if (inverse := _inverse(one)) is not None else None,
        }
        for one in frame.responses
    }
    kelvin = _held({recorded.segment.temperature for recorded in request.segments})
    if kelvin is not None:
        start, end = recorded_times(request.segments)
        extra["by_temperature"] = by_temperature(found, kelvin - ZERO_CELSIUS, float((start + end).mean()) / 2)
    return extra


def _held(planned: set[float | None]) -> float | None:
    """Returns the planned temperature [K] that all segments have in common; None if there is none."""
    return next(iter(planned)) if len(planned) == 1 else None


def _inverse(one: Response) -> Array | None:
    return inverse_matrix(one) if len(one.sensed) == 3 else None


def by_temperature(found: Sequence[Coefficient], celsius: float, time: float) -> Mapping[str, object]:
    """Returns the coefficients at one temperature, in the form that `interface.Estimate` describes for its field `extra`. `time`:
    mean time of the test, s. `celsius`: the temperature, degC."""
    return {
        one.name: {
            "temperature_degC": [celsius],
            "time_s": [time],
            "value": [one.value],
            "standard_uncertainty": [one.standard_uncertainty],
            "unit": one.unit,
        }
        for one in found
    }


_WORDS = {"gyro": ("ω", "deg/s"), "accel": ("f", "g")}


def formula(frame: Framed) -> Said:
    """Returns a note that explains how to apply the coefficients."""
    known = {one.kind for one in frame.responses}
    formulas = {
        "gyro": said("for gyros, ω = (S·M)⁻¹·(output − b − G·f)"),
        "accel": said("for accelerometers, f = (S·M)⁻¹·(output − b)"),
    }
    frames = {
        "gyro": said("in the gyro triad's own frame"),
        "accel": said("in the accel triad's own frame"),
        "": said("in the axes of the planned orientations"),
    }
    first, *others = (formula for kind, formula in formulas.items() if kind in known)
    if not others:
        return said(
            "Input {frame}, computed from the outputs: {formula}.",
            frame=frames[frame.reference],
            formula=first,
        )
    return said(
        "Input {frame}, computed from the outputs: {first}; {second}.",
        frame=frames[frame.reference],
        first=first,
        second=others[0],
    )


def matrices(one: Response) -> tuple[Table, ...]:
    """Makes tables of the matrix S·M, of the bias b and, for gyros, of the matrix G. If all three axes were excited, also makes a
    table of the inverse of S·M."""
    sensed = one.sensed
    if len(sensed) < 3:
        return ()
    letter, per = _WORDS[one.kind]
    forces = one.places("accel") if one.kind == "gyro" else {}
    columns: list[FilledColumn] = [
        (TableColumn("output"), AXES),
        (TableColumn("unit"), [own.text for own in one.units[:3]]),
        *(
            (TableColumn(f"{letter}_{axis}", Role.VALUE, f"per {per}"), one.values[:3, sensed[k]] * unit(per).factor)
            for k, axis in enumerate(AXES)
        ),
    ]
    if "bias" in one.model.names:
        columns.append((TableColumn("b", Role.VALUE), one.values[:3, one.model.names.index("bias")]))
    columns += [
        (TableColumn(f"G {AXES[k]}", Role.VALUE, "per g"), one.values[:3, place] * unit("g").factor)
        for k, place in forces.items()
    ]
    found = [by_columns(f"Matrix S·M of the {one.kind} triad", *columns)]
    if (inverse := inverse_matrix(one)) is not None:
        outputs = [
            (TableColumn(f"output {axis}", Role.VALUE, f"{per} per {own.text}"), values)
            for axis, own, values in zip(AXES, one.units, inverse.T, strict=True)
        ]
        found.append(by_columns(f"Inverse (S·M)⁻¹ of the {one.kind} triad", (TableColumn(letter), AXES), *outputs))
    return tuple(found)


def inverse_matrix(one: Response) -> Array | None:
    """Returns the matrix (S·M)⁻¹, shape (3, 3), in deg/s or g per recorded unit; None if the input axes of the outputs are linearly
    dependent."""
    matrix = one.values[:, [one.sensed[k] for k in range(3)]] * unit(_WORDS[one.kind][1]).factor
    lengths = np.linalg.norm(matrix, axis=1, keepdims=True)
    if (lengths == 0).any() or np.linalg.cond(matrix / lengths) > 1e6:
        return None
    return np.asarray(np.linalg.inv(matrix))

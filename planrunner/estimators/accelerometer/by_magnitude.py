"""Calibrates an accelerometer triad with the magnitude of gravity: nine parameters from still spans or whole segments in unknown
attitudes.

A Gauss–Newton fit with equal weights gives approximate values. The last step is a weighted linear fit of |f| − g. This step uses
the same code as all estimators that use positions. The weights of the last fit come from the noise within the poses and from the
declared flicker of each channel. The flicker affects |f| in proportion to the channel's component of gravity. The attitude of the
sensor does not matter, because |f| equals g in any attitude.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import counted, said
from planrunner.estimators.accelerometer.gravity_magnitude import NAMES, GravityFit, fit_magnitude, too_few
from planrunner.estimators.accelerometer.parameters import AccelerometerMultiPositionParameters
from planrunner.estimators.basis_judgement import MORE_SEGMENTS, judge, no_residual, require_basis
from planrunner.estimators.derived import Derived, Reported, derived
from planrunner.estimators.fit_tables import bases_table, drift_tables
from planrunner.estimators.interface import (
    Design,
    DesignRequest,
    EstimateRequest,
    EstimationError,
    Foresight,
    Remark,
    UnfitDataError,
    Unpredicted,
)
from planrunner.estimators.method import Quantities, Words
from planrunner.estimators.outputs_fit import OutputsFit, fit_outputs
from planrunner.estimators.tables import Plot, Role, Table, TableColumn, by_columns
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.observation.drift import DriftCourses, drift_of
from planrunner.observation.flicker import flicker_errors, unstated_flicker
from planrunner.observation.observations import Observations, observe, recorded_times
from planrunner.observation.still_detection import detection_limits, longest_span, still_spans
from planrunner.plan.schedule import Rest, Segment
from planrunner.plan.selection import Detection
from planrunner.plan.units import DIMENSIONS, unit
from planrunner.uncertainty.influences import Influence

_UNITS = ("mg",) * 3 + ("1",) * 3 + ("mrad",) * 3
_SCALE = np.array([1 / unit(text).factor for text in _UNITS])


def design(request: DesignRequest[AccelerometerMultiPositionParameters]) -> Design:
    """Checks that the planned poses can determine the nine parameters. The poses are checked only if the plan states their
    attitudes or their number. Raises `EstimationError` if the channels or the attitudes are not suitable."""
    outputs, detection = request.parameters.outputs, request.detection
    if detection is not None:
        units = {output.name: output.unit for output in request.sensor.outputs}
        detection_limits(detection, units, "the sensor of this bench")
        _same_channels(detection.channels, outputs)
    described = [(name, request.sensor.output(name)) for name in outputs]
    _factors_of({name: output.unit for name, output in described if output is not None})
    attitudes = [
        segment.attitude for segment in request.segments if _gives_pose(segment, detection, request.sensor.sample_rate)
    ]
    known = [attitude for attitude in attitudes if attitude is not None]
    count = len(attitudes)
    if detection is not None and len(known) < count:
        return Design(())  # the number of poses is not known before the recording
    if count <= len(NAMES):
        short = count < len(NAMES)
        if short or request.parameters.uncertainty == "residual":
            message = too_few(count) if short else no_residual(len(NAMES))
            hint = (
                f"add segments in other attitudes: {len(NAMES)} are the minimum, 20 are usual"
                if short
                else MORE_SEGMENTS
            )
            return Design((), remarks=(Remark("physics-poses", message, hint, error=True),))
    if len(known) == count:
        _at_rest(request.segments)
        fit_magnitude(np.array(known) @ request.site.specific_force_enu, request.site.gravity)
    return Design(())


def foresee(
    request: DesignRequest[AccelerometerMultiPositionParameters], general: Callable[[], Foresight]
) -> Foresight:
    """Predicts the coefficients if all poses are planned. If the poses are not planned, returns only the names of the coefficients,
    because the poses become known only from the recording."""
    if all(segment.attitude is not None for segment in request.segments):
        seen = general()
        if seen.known:
            return seen
    why = "the plan does not give the attitudes of the poses"
    rows = zip(NAMES, _UNITS, DESCRIPTIONS, strict=True)
    return Foresight(unpredicted=tuple(Unpredicted(name, text, why, words) for name, text, words in rows))


@dataclass(frozen=True, slots=True, kw_only=True)
class MagnitudeQuantities(Quantities):
    """The nine fitted parameters. `residuals`: array of shape (n,), residuals of |f| − g, m/s²."""

    poses: Observations
    sphere: GravityFit
    fit: OutputsFit
    shown: Derived
    residuals: Array


def quantities(request: EstimateRequest[AccelerometerMultiPositionParameters]) -> MagnitudeQuantities:
    """Computes the nine parameters with full covariance. Raises `EstimationError` if the plan or the data are not suitable."""
    basis = request.parameters.uncertainty
    expected = all(recorded.expected for recorded in request.segments)
    found_spans = request.detection is not None and not expected
    whole = [] if found_spans else _whole(request)
    poses = _found(request) if found_spans else observe(whole, request.parameters.outputs, request.sensor)
    found, fit = _fitted(request, poses, whole, basis)
    values, residuals = found.values + fit.coefficients[0], -fit.fits[0].residuals
    named = [Reported(*one) for one in zip(NAMES, _UNITS, DESCRIPTIONS, strict=True)]
    shown = derived(named, lambda flat: flat * _SCALE[:, None], fit, at=values)
    return MagnitudeQuantities(
        coefficients=shown.coefficients(basis),
        covariance=shown.covariance(basis),
        influences=shown.influences([(*_gravity(request, fit), *fit.influences(basis))]),
        unstated=shown.unstated,
        extra={"root_mean_square": _size(fit, residuals), "poses": len(poses.labels), "condition": found.condition},
        poses=poses,
        sphere=found,
        fit=fit,
        shown=shown,
        residuals=residuals,
    )


def words(request: EstimateRequest[AccelerometerMultiPositionParameters], found: MagnitudeQuantities) -> Words:
    """Makes the tables and plots of poses and residuals."""
    basis, poses, fit, residuals = request.parameters.uncertainty, found.poses, found.fit, found.residuals
    judged = judge(fit, basis, poses.channels)
    notes, warnings = list(judged.texts), list(judged.warnings)
    notes = [
        counted(
            "{poses} poses; residuals of |f| {rms:.3g} mm/s² rms, corrected for {freedom} degree of freedom; condition "
            "{condition:.3g}.",
            "{poses} poses; residuals of |f| {rms:.3g} mm/s² rms, corrected for {freedom} degrees of freedom; condition "
            "{condition:.3g}.",
            count=fit.freedom,
            poses=len(poses.labels),
            rms=_size(fit, residuals) * 1e3,
            freedom=fit.freedom,
            condition=found.sphere.condition,
        ),
        said("Scale factors are relative to the site's gravity of {gravity:.6g} m/s².", gravity=request.site.gravity),
        *notes,
    ]
    series = {"|f| − g": tuple(map(float, residuals))}
    return Words(
        headline=NAMES,
        settings={
            "reference": "gravity_magnitude",
            "uncertainty": basis,
            "gravity": request.site.gravity,
            **_detection(request),
        },
        tables=(bases_table(found.shown, basis), *drift_tables([fit], basis), _pose_table(poses, residuals)),
        plots=(Plot("Residuals of |f| per pose", "pose", "residual [m/s^2]", poses.labels, series),),
        notes=tuple(notes),
        warnings=tuple(warnings),
        segments=tuple(recorded.label for recorded in request.segments),
    )


def _size(fit: OutputsFit, residuals: Array) -> float:
    """Returns the root mean square of the residuals, corrected for the number of degrees of freedom."""
    return float(np.sqrt(np.sum(residuals**2) / fit.freedom)) if fit.freedom else 0.0


def _weighted(
    request: EstimateRequest[AccelerometerMultiPositionParameters],
    poses: Observations,
    recorded: Sequence[RecordedSegment],
    found: GravityFit,
) -> OutputsFit:
    """Makes the last step of the calibration: a weighted fit of |f| − g [m/s²], which is treated as a single output. `recorded`:
    the recorded segments that are the poses; empty if the poses are only parts of segments. Raises `EstimationError` if the plan or
    the data are not suitable."""
    directions = found.directions * _factors(poses)  # d|f|/d(reading), in the channels' own units
    felt = directions * poses.standard_error
    variance = np.einsum("ni,nj,ij->n", felt, felt, poses.correlation)
    magnitude = replace(
        poses,
        channels=("|f|",),
        units=("m/s^2",),
        mean=-found.residuals[:, None],
        standard_error=np.sqrt(variance)[:, None],
        correlation=np.eye(1),
    )
    span = request.parameters.drift_span.value
    effects = [_along(one, directions) for one in flicker_errors(poses, request.setup.inputs, span)]
    magnitudes = np.array([1.0] * 3 + [request.site.gravity] * 6)
    parameters = request.parameters
    drift = drift_of(parameters.drift, parameters.temperature_channel, poses, recorded, recorded)
    basis = parameters.uncertainty
    return fit_outputs(
        found.jacobian,
        magnitude,
        magnitudes,
        NAMES,
        basis,
        effects=effects,
        drift=_along_poses(drift, poses, directions),
        unstated=[_along(one, directions) for one in unstated_flicker(poses, request.setup.inputs, span)],
    )


def _along_poses(drift: DriftCourses, poses: Observations, directions: Array) -> DriftCourses:
    """Converts a drift of the three channels to a drift of |f| − g. The sign changes because the drift adds to the readings.
    `directions`: array of shape (n, 3), derivatives of |f| with respect to the readings."""
    courses = (replace(one, columns=-directions * one.columns, parts=poses.channels) for one in drift.courses)
    return replace(drift, courses=tuple(courses))


def _along(effect: CorrelatedError, directions: Array) -> CorrelatedError:
    """Converts an error of the three channels to an error of |f|. `directions`: array of shape (n, 3), derivatives of |f| with
    respect to the readings."""
    change = sum(directions[:, channel, None] * one for channel, one in effect.changes.items())
    within = sum(directions[:, channel] ** 2 * one for channel, one in effect.within.items())
    return replace(effect, changes={0: np.asarray(change)}, within={0: np.asarray(within)})


def _gravity(request: EstimateRequest[AccelerometerMultiPositionParameters], fit: OutputsFit) -> tuple[Influence, ...]:
    """Returns the influence of an uncertain magnitude of gravity, with which |f| is compared."""
    gravity = request.setup.inputs.get("gravity")
    return (Influence(gravity, fit.gains[0].sum(axis=1)[:, None]),) if gravity else ()


def _fitted(
    request: EstimateRequest[AccelerometerMultiPositionParameters],
    poses: Observations,
    recorded: Sequence[RecordedSegment],
    basis: str,
) -> tuple[GravityFit, OutputsFit]:
    """Fits the nine parameters. Raises `EstimationError` if the segments are too few or too similar, and `UnfitDataError` if the
    still spans found in the recording are too few or too similar."""
    factors = _factors(poses)
    try:
        if len(poses.labels) < len(NAMES):
            where = "raise `threshold` or shorten `at_least`, or record" if request.detection is not None else "record"
            raise EstimationError(f"{too_few(len(poses.labels))}: {where} more poses")
        found = fit_magnitude(poses.mean * factors, request.site.gravity)
        fit = _weighted(request, poses, recorded, found)
        require_basis(fit, basis, request.name)
    except EstimationError as error:
        if request.detection is None:
            raise
        raise UnfitDataError(str(error), error.hint, error.key) from None
    return found, fit


def _found(request: EstimateRequest[AccelerometerMultiPositionParameters]) -> Observations:
    """Finds the still spans in all chosen segments. Returns them as observations: one mean per span and channel."""
    outputs = request.parameters.outputs
    assert request.detection is not None
    channels = request.detection.channels
    _same_channels(channels, outputs)
    whole = observe(request.segments, outputs, request.sensor)
    order = [channels.index(name) for name in outputs]
    begun, _ = recorded_times(request.segments)
    labels, spans, late = [], [], []
    for recorded, start in zip(request.segments, begun, strict=True):
        for number, one in enumerate(still_spans(recorded, request.detection), start=1):
            labels.append(f"{recorded.label} {number}" if len(request.segments) > 1 else f"still {number}")
            spans.append(one)
            late.append(start - recorded.statistics.start)
    if not labels:
        raise UnfitDataError(
            f"{request.name}: no interval at rest was found: raise `threshold` or shorten `at_least` under `segments`"
        )
    return replace(
        whole,
        labels=tuple(labels),
        mean=np.array([one.mean[order] for one in spans]),
        standard_error=np.array([one.standard_error[order] for one in spans]),
        batches=np.array([one.batches for one in spans]),
        start=np.array([one.span.start for one in spans]) + late,
        end=np.array([one.span.end for one in spans]) + late,
        correlation=np.eye(len(outputs)),  # that of the whole recording is one of motion
        courses=None,
    )


def _whole(request: EstimateRequest[AccelerometerMultiPositionParameters]) -> list[RecordedSegment]:
    """Returns the segments that count as poses. In a schedule, these are the segments in which a pose will be found."""
    return [
        recorded
        for recorded in request.segments
        if not recorded.expected or _gives_pose(recorded.segment, request.detection, request.sensor.sample_rate)
    ]


def _factors(poses: Observations) -> Array:
    """Returns the factors that convert the three channels to m/s², shape (3,)."""
    return _factors_of(dict(zip(poses.channels, poses.units, strict=True)))


def _factors_of(units: Mapping[str, str]) -> Array:
    """Returns the factors that convert the channels to SI units. `units`: maps each channel to its unit. Raises `EstimationError`
    for a channel that is not an acceleration."""
    for name, text in units.items():
        if unit(text).dimension != DIMENSIONS["acceleration"]:
            raise EstimationError(f"channel '{name}' is recorded in {text}, which is not a unit of acceleration")
    return np.array([unit(text).factor for text in units.values()])


def _same_channels(channels: Sequence[str], outputs: Sequence[str]) -> None:
    if set(channels) != set(outputs):
        raise EstimationError(
            f"intervals at rest are searched for in {', '.join(channels)}, but the estimate uses {', '.join(outputs)}: "
            "name the same `channels` under `segments`"
        )


def _gives_pose(segment: Segment, detection: Detection | None, sample_rate: float) -> bool:
    """Returns True if a segment at rest is long enough for a pose. Also returns True for a moving segment in which spans are
    detected, because it may contain any number of poses."""
    if detection is None or segment.dwell is None or segment.attitude is None:
        return True
    # Windows hold whole samples, and a span ends at samples: one interval may be lost at either end.
    lost = 2 / (segment.sample_rate or sample_rate)
    return longest_span(segment.dwell, detection) - lost >= detection.at_least.value


def _at_rest(segments: Sequence[Segment]) -> None:
    moving = [segment.label for segment in segments if not isinstance(segment.motion, Rest)]
    if moving:
        raise EstimationError(
            f"segment '{moving[0]}' moves: an accelerometer can be compared with gravity only at rest"
        )


DESCRIPTIONS = (
    *(said("Bias of the {axis} axis", axis=axis) for axis in "xyz"),
    *(said("Scale factor of the {axis} axis", axis=axis) for axis in "xyz"),
    *(
        said(
            "Non-orthogonality of the axes {first} and {second}: 90° minus the angle between them",
            first=first,
            second=second,
        )
        for first, second in ("xy", "xz", "yz")
    ),
)
"""Descriptions of the parameters, in the order of `NAMES`."""


def _detection(request: EstimateRequest[AccelerometerMultiPositionParameters]) -> dict[str, str]:
    found = request.detection
    if found is None:
        return {}
    return {"window": str(found.window), "threshold": str(found.threshold), "at_least": str(found.at_least)}


def _pose_table(poses: Observations, residuals: Array) -> Table:
    readings = zip(("x", "y", "z", "residual of |f|"), (*(poses.mean * _factors(poses)).T, residuals), strict=True)
    return by_columns(
        "Poses and residuals",
        (TableColumn("pose"), poses.labels),
        (TableColumn("start", Role.NUMBER, "s"), poses.start),
        (TableColumn("end", Role.NUMBER, "s"), poses.end),
        *((TableColumn(title, Role.VALUE, "m/s^2"), values) for title, values in readings),
    )

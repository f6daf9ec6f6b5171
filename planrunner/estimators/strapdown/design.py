"""Checks before the recording whether the segments of a strapdown navigation are suitable, and predicts its errors.

The expected errors follow from the declared white noise, and from the uncertainties that the plan states for constant errors. The
filter of the alignment predicts the errors that remain after the alignment. These errors and the noise, rotated with the table, are
then the input of the linear error equations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.findings import closest
from planrunner.estimators.full_scale import beyond_full_scale, shares_by_name
from planrunner.estimators.interface import (
    Coefficient,
    Design,
    DesignRequest,
    EstimationError,
    Foresight,
    Remark,
    Unpredicted,
)
from planrunner.estimators.strapdown.alignment import (
    HIGHEST_LATITUDE,
    SHORTEST,
    end_attitude,
    levelled_out,
    same_attitude,
    stillness,
    to_navigation,
)
from planrunner.estimators.strapdown.navigating import (
    StrapdownNavigationParameters,
    parts,
    rate_of,
    wandering_sensors,
)
from planrunner.estimators.strapdown.navigation_errors import CEP_SHARE, CEP_SPREAD, HOUR, NAUTICAL_MILE
from planrunner.estimators.strapdown.uncertainty import (
    NAMES,
    PERIODS,
    SCHULER_PERIOD,
    errors_by_latitude,
    interpolated,
)
from planrunner.estimators.strapdown.wandering import WanderingBias
from planrunner.navigation import attitude
from planrunner.navigation.alignment import FineAlignment
from planrunner.navigation.error_equations import INPUTS, SIZE, TILT, ErrorEquations
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.plan.schedule import Cycle, Rest, Segment, Spin
from planrunner.plan.units import UnknownUnitError, unit

_STEP = 60.0  # s, step of the error equations, over which their inputs are averaged
_LONGEST = 7 * 86400.0  # s, longest navigation whose errors are predicted
_FINE = 60  # angles in each step
_MOMENTS = 24  # times at which the effect of changing biases is evaluated
_KNOTS = 1800  # most intervals of the alignment, each at least one second long
_COARSE_TURN = 0.05  # rad between samples; beyond, the errors of the coning and sculling corrections are not negligible


def design(request: DesignRequest[StrapdownNavigationParameters]) -> Design:
    """Returns remarks on the planned segments. Raises `EstimationError` for unsuitable segments or outputs."""
    parameters = request.parameters
    for name in (*parameters.gyros, *parameters.accelerometers):
        if request.sensor.output(name) is None:
            hint = closest(name, [item.name for item in request.sensor.outputs])
            raise EstimationError(f"the bench's sensor has no output '{name}': {hint}")
    labels = [segment.label for segment in request.segments]
    try:
        stop, moving = parts(request.segments, labels, parameters.align)
    except EstimationError as error:
        hint = "choose in `segments` the stop for the alignment, then the segment to navigate"
        return Design((), remarks=(Remark("physics-navigation-align", str(error), hint, error=True),))
    remarks = (
        *_on_alignment(request, stop),
        *_on_joint(request, stop, moving),
        *_on_navigation(request, moving),
        *beyond_full_scale(
            request, parameters.gyros, shares_by_name(request.segments, request.setup.mounting, parameters.gyros)
        ),
    )
    if any(remark.error for remark in remarks):
        return Design((), remarks=remarks)
    last = moving[-1]
    told = {"navigated": last.label, "turned": isinstance(last.motion, Spin | Cycle)}
    return Design((), extra=told, remarks=remarks)


def foresee(request: DesignRequest[StrapdownNavigationParameters]) -> Foresight:
    """Predicts the errors with the linear error equations, because a simulation of hours of navigation would take too long."""
    labels = [segment.label for segment in request.segments]
    predicted, note = _expected(request, *parts(request.segments, labels, request.parameters.align))
    if predicted:
        return Foresight(predicted, notes=(note,))
    unpredicted = tuple(Unpredicted(name, text, note, words) for name, (text, words) in NAMES.items())
    return Foresight(unpredicted=unpredicted, notes=(f"No errors are predicted: {note}.",))


def _on_alignment(request: DesignRequest[StrapdownNavigationParameters], stop: Segment) -> list[Remark]:
    found = []
    if not isinstance(stop.motion, Rest | Cycle):
        message = f"'{stop.label}' turns continuously; alignment needs a stop, or a cycle of stops"
        found.append(Remark("physics-navigation-align", message, "align at rest, before the motion begins", error=True))
    still = stillness(stop, stop.dwell if stop.dwell is not None else math.inf)
    if still < SHORTEST:
        message = f"'{stop.label}' is at rest for {still:g} s; alignment needs at least {SHORTEST:g} s"
        found.append(Remark("physics-navigation-align", message, "dwell 5 to 10 min", error=True))
    if abs(request.site.latitude) > HIGHEST_LATITUDE:
        message = f"gyrocompassing cannot find north at a latitude of {math.degrees(request.site.latitude):.4g} deg"
        found.append(Remark("physics-navigation-latitude", message, "use a bench nearer to the equator", error=True))
    return found


def _on_joint(
    request: DesignRequest[StrapdownNavigationParameters], stop: Segment, moving: Sequence[Segment]
) -> list[Remark]:
    found = []
    first = moving[0]
    ends = end_attitude(stop, request.setup.table)
    known = stop.attitude is not None and first.attitude is not None
    if known and ends is None and isinstance(stop.motion, Cycle):
        message = (
            f"'{stop.label}' has the dwell 'recorded', so the end of its cycle is "
            f"not known; '{first.label}' can follow it only if there is no pause between the two, or if whole cycles were recorded"
        )
        hint = f"write the recorded length of '{stop.label}', such as `dwell: {{cycles: 2}}` or `dwell: 10 min`"
        found.append(Remark("physics-navigation-gap", message, hint))
    elif known and not same_attitude(ends, first.attitude):
        message = f"'{first.label}' does not begin in the orientation in which '{stop.label}' ends, so the alignment is not valid for it"
        found.append(
            Remark(
                "physics-navigation-gap",
                message,
                "give both the same orientation, that of the start of the cycle",
                error=True,
            )
        )
    for before, after in pairwise(moving):
        if after.index != before.index + 1 or after.settle or after.soak or after.transition:
            message = f"time passes without samples between '{before.label}' and '{after.label}'; navigation cannot continue over this gap"
            found.append(Remark("physics-navigation-gap", message, "navigate in one segment", error=True))
    rates = {segment.sample_rate or request.sensor.sample_rate for segment in (stop, *moving)}
    if len(rates) > 1:
        message = "alignment and navigation have different sample rates"
        found.append(Remark("physics-navigation-rate", message, "give both the same `sample_rate`", error=True))
    return found


def _on_navigation(request: DesignRequest[StrapdownNavigationParameters], moving: Sequence[Segment]) -> list[Remark]:
    found = []
    lasting = [segment.dwell for segment in moving if segment.dwell is not None]
    if len(lasting) == len(moving) and sum(lasting) < SCHULER_PERIOD:
        message = (
            f"the navigation lasts {sum(lasting) / 60:.4g} min, less than a Schuler period of 84.4 min: its results "
            f"in nmi/h must not be extrapolated to longer times"
        )
        found.append(Remark("physics-navigation-short", message, "navigate for several hours"))
    for segment in moving:
        turning = segment.motion.rate if isinstance(segment.motion, Spin | Cycle) else 0.0
        rate = segment.sample_rate or request.sensor.sample_rate
        if abs(turning) / rate > _COARSE_TURN:
            message = (
                f"'{segment.label}' turns {math.degrees(abs(turning)) / rate:.3g} deg from sample to sample; at "
                f"this step the residual errors of the coning and sculling corrections are not small"
            )
            found.append(Remark("physics-navigation-rate", message, "sample faster, or turn more slowly", "segments"))
    return found


def _expected(
    request: DesignRequest[StrapdownNavigationParameters], stop: Segment, moving: Sequence[Segment]
) -> tuple[tuple[Coefficient, ...], str]:
    """Returns the expected errors and a note about them. If no errors can be predicted, the note gives the reason."""
    parameters = request.parameters
    white, constant = _declared(request), _stated(parameters)
    dwells = [segment.dwell for segment in (stop, *moving)]
    if not white.any() and not constant.any():
        return (), "the noise, gyro_uncertainty and accelerometer_uncertainty are all unknown"
    if stop.attitude is None or any(dwell is None for dwell in dwells):
        what = "orientation" if stop.attitude is None else "dwell"
        return (), f"the plan does not state the {what} of a segment"
    if sum(dwell or 0.0 for dwell in dwells) > _LONGEST:
        return (), f"the navigation lasts more than {_LONGEST / 86400:g} days"
    equations = ErrorEquations.at(request.site)
    rotation = np.asarray(stop.attitude, dtype=float).T
    density = to_navigation(rotation, white**2)
    step = max(1.0, (stop.dwell or 0.0) / _KNOTS)
    course = _turning([stop], rotation, step)[:, :3, :3]
    wandering = wandering_sensors(request.setup.inputs, parameters)
    after = FineAlignment(equations, density, step, constant, _STEP if wandering else None)
    after.take(np.zeros((len(course), 2)), course, _about_up(stop, len(course), step))
    aligned = after.finish(course[-1])
    start = aligned.covariance[: SIZE + INPUTS, : SIZE + INPUTS]
    # Navigation errors follow from the errors after the alignment and from the constant errors that it compensates.
    turned = _turning(moving, rotation, _STEP)
    driven = turned @ np.eye(INPUTS, SIZE + INPUTS, SIZE)
    responses = equations.responses(np.eye(SIZE, SIZE + INPUTS), driven, _STEP)
    turning = any(not isinstance(segment.motion, Rest) for segment in moving)
    noise = equations.covariances(
        np.zeros((SIZE, SIZE)), levelled_out(density) if turning else density, _STEP, len(driven)
    )
    covariances = responses @ start @ responses.transpose(0, 2, 1) + np.array(list(noise))
    if latitude := request.setup.inputs.get("latitude"):
        change = errors_by_latitude(equations, request.site, _STEP, len(covariances))
        covariances[:, :4, :4] += latitude.standard_uncertainty**2 * np.einsum("an,bn->nab", change, change)
    sensitivities = -attitude.angle_sensitivities(rotation)
    angles = sensitivities @ start[TILT, TILT] @ sensitivities.T
    if wandering:
        followed, between = aligned.followed[TILT], round((moving[0].start - stop.start) / _STEP)
        response = WanderingBias(equations, followed, turned[:, :3, :3], between, _STEP, parameters.drift_span.value)
        time = _STEP * np.arange(1.0, len(covariances) + 1)
        moments = np.unique(time[np.linspace(0, len(time) - 1, _MOMENTS).round().astype(int)])
        each = response.covariances(moments)
        for k, quantity in wandering.items():
            own = (quantity.standard_uncertainty * rate_of(quantity, request.sensor)) ** 2 * each[:, k]
            angles = angles + sensitivities @ own[-1, :3, :3] @ sensitivities.T
            covariances[:, :4, :4] += interpolated(time, moments, own[:, 3:, 3:])
    note = (
        "Expected errors are root mean squares over many units of this kind. They include the "
        "declared noise and, if stated, gyro_uncertainty, accelerometer_uncertainty and the uncertainty of the latitude."
    )
    return _coefficients(rotation, angles, covariances), note


def _declared(request: DesignRequest[StrapdownNavigationParameters]) -> Array:
    """Returns the white noise that the sensor declares, rad/√s and m/s/√s, shape (6,)."""
    parameters = request.parameters
    found = np.zeros(6)
    for k, name in enumerate((*parameters.gyros, *parameters.accelerometers)):
        output = request.sensor.output(name)
        assert output is not None
        try:
            found[k] = output.noise.white * unit(output.unit).factor
        except UnknownUnitError as error:
            raise EstimationError(f"output '{name}': {error}") from None
    return found


def _stated(parameters: StrapdownNavigationParameters) -> Array:
    gyro, accelerometer = parameters.gyro_uncertainty, parameters.accelerometer_uncertainty
    return np.array([gyro.value if gyro else 0.0] * 3 + [accelerometer.value if accelerometer else 0.0] * 3)


def _about_up(stop: Segment, count: int, step: float) -> Array:
    """Returns the mean rate of rotation about the vertical (count,), rad/s, in each `step` [s] of the alignment."""
    if not isinstance(stop.motion, Cycle):
        return np.zeros(count)
    edges: Array = step * np.arange(count + 1, dtype=np.float64)
    angle = RotationCycle.of(stop.motion, math.inf).angle(edges)
    return np.asarray(np.diff(angle) / step)


def _turning(segments: Sequence[Segment], rotation: Array, step: float) -> Array:
    """Returns the matrices (n, 6, 6) that convert gyro errors ε and accelerometer errors ∇ from body to navigation axes, averaged
    over each `step` [s]. `rotation`: array of shape (3, 3), attitude at the start of each segment."""
    found = []
    for segment in segments:
        count = max(1, round((segment.dwell or 0.0) / step))
        times = (np.arange(count * _FINE) + 0.5) * step / _FINE
        angle = np.zeros(times.size)
        about = np.array([0.0, 0.0, 1.0])
        if isinstance(segment.motion, Cycle):
            angle = RotationCycle.of(segment.motion, math.inf).angle(times)
        elif isinstance(segment.motion, Spin):
            angle, about = segment.motion.rate * times, np.asarray(segment.motion.about)
        along = np.outer(about, about)
        skew = np.array([[0, -about[2], about[1]], [about[2], 0, -about[0]], [-about[1], about[0], 0]])
        cosine = np.cos(angle).reshape(count, _FINE).mean(axis=1)[:, None, None]
        sine = np.sin(angle).reshape(count, _FINE).mean(axis=1)[:, None, None]
        mean = (along + cosine * (np.eye(3) - along) + sine * skew) @ rotation
        both = np.zeros((count, INPUTS, INPUTS))
        both[:, :3, :3] = both[:, 3:, 3:] = mean
        found.append(both)
    return np.concatenate(found)


def _coefficients(rotation: Array, angles: Array, covariances: Array) -> tuple[Coefficient, ...]:
    time = _STEP * np.arange(1, len(covariances) + 1)
    radial = np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1])
    speed = np.sqrt(covariances[:, 2, 2] + covariances[:, 3, 3])
    rate = float(time @ radial / (time @ time)) * HOUR / NAUTICAL_MILE
    expected = (
        *np.degrees(np.sqrt(np.diag(angles))).tolist(),
        *np.sqrt(np.diag(covariances[-1])[:4]).tolist(),
        float(radial[-1]),
        float(radial.max()),
        float(np.sqrt(np.mean(radial**2))),
        float(speed.max()),
        float(np.sqrt(np.mean(speed**2))),
        rate,
        rate * CEP_SHARE * CEP_SPREAD,
    )
    nominal = dict(zip(("heading", "pitch", "roll"), np.degrees(attitude.angles(rotation)).tolist(), strict=True))
    nominal["cep_rate"] = rate * CEP_SHARE
    return tuple(
        Coefficient(name, nominal.get(name, 0.0), text, u, description=words, period=PERIODS.get(name, math.inf))
        for (name, (text, words)), u in zip(NAMES.items(), expected, strict=True)
    )

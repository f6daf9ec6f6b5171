"""Computes the uncertainties of the results of a strapdown navigation.

An uncertainty states how well one run determines the navigation errors that the constant errors of the sensors cause. The
uncertainties have three sources. The first is the white noise of the sensors. The second is the uncertainty of the alignment due to
this noise, propagated by the linear error equations. The third is the stated bias instabilities (see `wandering`). Constant sensor
errors do not make the navigation errors more uncertain, because their effect is part of the measured navigation errors. Only the
alignment angles become more uncertain, because the angles do not show the sensor errors.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.said import said
from planrunner.estimators.interface import EstimateRequest
from planrunner.estimators.strapdown.alignment import levelled_out
from planrunner.estimators.strapdown.navigating import (
    Navigated,
    StrapdownNavigationParameters,
    rate_of,
    wandering_sensors,
)
from planrunner.estimators.strapdown.navigation_errors import CEP_SHARE, CEP_SPREAD, HOUR, NAUTICAL_MILE
from planrunner.estimators.unstated_flicker import FlickerEvidence, UnstatedFlicker
from planrunner.navigation import attitude
from planrunner.navigation.error_equations import INPUTS, SIZE, TILT, ErrorEquations
from planrunner.navigation.wgs84 import radii
from planrunner.observation.flicker import mean_covariance, of_unit_size
from planrunner.physics.earth import Site
from planrunner.uncertainty.decision import coverage_factor
from planrunner.uncertainty.derivatives import jacobian, length
from planrunner.uncertainty.influences import Influence, InputQuantity
from planrunner.uncertainty.monte_carlo import square_root

SCHULER_PERIOD = 5064.0  # s, 84.4 min
PERIODS = {"heading": 360.0, "roll": 360.0}
"""Periods of the circular quantities, in their units. Pitch is not circular, because it is limited to ±90 deg."""
NAMES = {
    "heading": ("deg", said("Azimuth of the unit's y axis after alignment, from true north towards east")),
    "pitch": ("deg", said("Elevation of the unit's y axis after alignment")),
    "roll": ("deg", said("Rotation about the unit's y axis after alignment, positive with the x axis down")),
    "east_error": ("m", said("East position error at the end")),
    "north_error": ("m", said("North position error at the end")),
    "east_velocity_error": ("m/s", said("East velocity error at the end")),
    "north_velocity_error": ("m/s", said("North velocity error at the end")),
    "radial_error": ("m", said("Radial position error at the end")),
    "largest_radial_error": ("m", said("Largest radial position error")),
    "rms_radial_error": ("m", said("Root mean square of the radial position error over time")),
    "largest_velocity_error": ("m/s", said("Largest horizontal velocity error")),
    "rms_velocity_error": ("m/s", said("Root mean square of the horizontal velocity error over time")),
    "radial_error_rate": (
        "nmi/h",
        said("Slope of the straight line through the origin fitted to radial error over time"),
    ),
    "cep_rate": ("nmi/h", said("CEP rate of this run: √(ln 2) times the radial error rate")),
}
_DIRECT = 7  # number of leading results that are linear functions of the state
DEGREE = math.degrees(1.0)
RATE = HOUR / NAUTICAL_MILE
_DRAWS, _SEED = 1000, 20  # courses of errors; 1000 give a standard deviation to 2 %
_MOMENTS = 96  # times at which the effect of changing biases is evaluated


class Spread:
    """Contains the uncertainty that comes from noise. `covariance`: array of shape (m, m), covariance of the coefficients, in their
    units. `radial`: array of shape (n,), standard uncertainty of the radial error [m] at the points of `ErrorRecord.points`."""

    def __init__(self, equations: ErrorEquations, found: Navigated, points: Array, turns: bool):
        start = np.zeros((SIZE, SIZE))
        start[TILT, TILT] = found.aligned.alignment.tilt_covariance
        density = levelled_out(found.aligned.density) if turns else found.aligned.density
        step = float(points[0, 1] - points[0, 0]) if points.shape[1] > 1 else found.seconds
        count = points.shape[1] - 1
        covariances = np.array([start, *equations.covariances(start, density, step, count)])
        self.radial, _ = _lengths(points, covariances)
        rest = found.seconds - count * step
        end = next(equations.covariances(covariances[-1], density, max(rest, 0.0), 1))
        carried = equations.step(found.seconds)[0] @ start
        both = np.block([[start[TILT, TILT], carried[:4, TILT].T], [carried[:4, TILT], end[:4, :4]]])
        self.covariance = joined(found, both, _drawn(equations, found, points, start, density))
        last = len(NAMES) - 1
        self.covariance[last, last] = (found.record.radial_rate * RATE * CEP_SHARE * CEP_SPREAD) ** 2


class Wander:
    """Contains the uncertainty due to flicker, that is, due to biases that change over time.

    `influences`: one influence for each sensor whose bias instability is stated. `radial`: array of shape (n,), standard
    uncertainty [m] of the radial error at the points of `ErrorRecord.points`, due to these sensors. `unstated`: the flicker of each
    sensor whose bias instability the bench file does not give.
    """

    def __init__(self, request: EstimateRequest[StrapdownNavigationParameters], found: Navigated, points: Array):
        self.influences: tuple[Influence, ...] = ()
        self.unstated: tuple[UnstatedFlicker, ...] = ()
        self.radial = np.zeros(points.shape[1])
        channels, inputs = request.parameters.channels, request.setup.inputs
        stated = wandering_sensors(inputs, request.parameters)
        units = request.segments[0].units
        silent = {
            k: of_unit_size(name, units[name]) for k, name in enumerate(channels) if name in inputs.without_flicker
        }
        if found.wandering is None or not (stated or silent):
            return
        moments = np.unique([*np.linspace(points[0, -1] / _MOMENTS, points[0, -1], _MOMENTS), found.seconds])
        covariances = found.wandering.covariances(moments)
        for k, quantity in (stated | silent).items():
            own = rate_of(quantity, request.sensor) ** 2 * covariances[:, k]
            over_time = interpolated(points[0], moments, own[:, 3:, 3:])
            radial, speed = _lengths(points, over_time)
            values, vectors = np.linalg.eigh(joined(found, own[-1], _bounds(found, points, radial, speed)))
            kept = values > 0
            influence = Influence(quantity, vectors[:, kept] * np.sqrt(values[kept]))
            if k in stated:
                self.radial = np.hypot(self.radial, quantity.standard_uncertainty * radial)
                self.influences += (influence,)
            else:
                evidence = _evidence(found, k, rate_of(quantity, request.sensor), request.parameters.drift_span.value)
                self.unstated += (UnstatedFlicker(channels[k], influence, evidence),)


def _evidence(found: Navigated, sensor: int, rate: float, span: float) -> FlickerEvidence | None:
    """Returns what the readings at the first stop of the alignment show about the flicker of a sensor; None if there are too few
    readings. `rate`: SI value of the unit of the sensor's channel, rad/s or m/s². `span`: time over which a constant error is the
    average, s."""
    rest = found.aligned.rest
    n = rest.means.shape[1]
    if not (n > 1 and rest.white[sensor] > 0):
        return None
    start = rest.length * np.arange(n, dtype=np.float64)
    return FlickerEvidence(
        np.ones((n, 1)),
        rest.means[sensor] / rate,
        np.full(n, rest.white[sensor] / math.sqrt(rest.length) / rate),
        rest.freedom,
        square_root(mean_covariance(start, start + rest.length, span)),
        np.zeros(n),
        np.zeros((n, 0)),
    )


def interpolated(time: Array, moments: Array, covariances: Array) -> Array:
    """Returns the covariances (n, 4, 4) at the times `time` (n,), interpolated linearly between the covariances (k, 4, 4) at k
    moments. At time zero, the covariance is zero."""
    known = np.concatenate([np.zeros((1, *covariances.shape[1:])), covariances])
    each = known.reshape(len(known), -1).T
    at = np.append(0.0, moments)
    return np.array([np.interp(time, at, one) for one in each]).T.reshape(len(time), *covariances.shape[1:])


def _lengths(points: Array, covariances: Array) -> tuple[Array, Array]:
    """Returns the standard uncertainties of the radial position error and of the radial velocity error at the points, computed from
    covariances (n, k, k) of position and velocity."""
    return _along(points[1:3], covariances[:, :2, :2]), _along(points[3:5], covariances[:, 2:4, 2:4])


def joined(found: Navigated, both: Array, over_time: Array) -> Array:
    """Returns the covariance of the results `NAMES`, in their units, shape (m, m). The elements of the CEP rate are zero.

    The angles and the errors at the end are linear functions of the state. Correlations between figures that summarise the errors
    over time (largest and root-mean-square errors, error rate) are set to zero. `both`: array of shape (7, 7), joint covariance of
    the tilts after the alignment and of the errors at the end. `over_time`: array of shape (5,), standard uncertainties of the
    figures that summarise the errors over time.
    """
    angles = np.eye(_DIRECT)
    angles[:3, :3] = -attitude.angle_sensitivities(found.aligned.alignment.rotation) * DEGREE
    size = float(np.hypot(*found.final[:2]))
    line = np.zeros((_DIRECT + 1, _DIRECT))
    line[:_DIRECT] = angles
    line[_DIRECT, 3:5] = found.final[:2] / size if size else 0.0
    covariance = np.zeros((len(NAMES), len(NAMES)))
    covariance[: _DIRECT + 1, : _DIRECT + 1] = line @ both @ line.T
    places = range(_DIRECT + 1, _DIRECT + 1 + len(over_time))
    covariance[places, places] = np.square(over_time)
    return covariance


def _drawn(equations: ErrorEquations, found: Navigated, points: Array, start: Array, density: Array) -> Array:
    """Returns the standard uncertainties (5,) of the figures that summarise the errors over time (largest and root-mean-square
    errors, error rate). To compute them, errors that noise may cause are drawn at random and subtracted from the errors of the
    navigation; the figures are then computed again for each draw. On average, noise increases the largest and the root-mean-square
    errors. The figures are not corrected for this; instead, the mean change is added to the expanded uncertainty (JCGM 100:2008,
    F.2.4.5). `start`: array of shape (7, 7), covariance of the state at the start of the navigation. `density`: array of shape (6,
    6), density of the white noise in navigation axes. `points`: array of shape (5, n), errors as `ErrorRecord.points` returns
    them."""
    last = points.shape[1] - 1
    every = max(1, -(-last // _MOMENTS))
    course = np.column_stack([points[:, every::every], [found.seconds, *found.final]])
    draw = np.random.default_rng(_SEED)

    def drawn(root: Array) -> Array:
        return np.asarray(root @ draw.standard_normal((root.shape[1], _DRAWS)))

    state, errors = drawn(square_root(start)), np.zeros((5, course.shape[1], _DRAWS))
    steps = np.diff(course[0], prepend=0.0)
    transition, root = equations.step(steps[0])[0], square_root(equations.noise(density, steps[0]))
    for k, step in enumerate(steps.tolist()):
        if k == len(steps) - 1:
            transition, root = equations.step(step)[0], square_root(equations.noise(density, step))
        state = transition @ state + drawn(root)
        errors[1:, k] = state[:4]
    changes = _figures(course[..., None] - errors) - _figures(course[..., None])
    over_time = changes[_DIRECT + 1 - 3 : -1]
    return np.asarray(over_time.std(axis=1) + np.abs(over_time.mean(axis=1)) / coverage_factor(math.inf))


def _bounds(found: Navigated, points: Array, radial: Array, speed: Array) -> Array:
    """Returns upper bounds (5,) of the standard uncertainties of the figures that summarise the errors over time. The bounds hold
    because they assume that the errors at all times are fully correlated. `radial`, `speed`: arrays of shape (n,), standard
    uncertainties of the radial position and velocity errors at the points."""
    time, away, fast = points[0], np.hypot(*points[1:3]), np.hypot(*points[3:5])
    return np.array(
        [
            float(np.interp(found.record.largest_at, time, radial)),
            float(away @ radial / math.sqrt(away @ away * away.size)) if away.any() else float(radial[-1]),
            float(speed[int(np.argmax(fast))]),
            float(fast @ speed / math.sqrt(fast @ fast * fast.size)) if fast.any() else float(speed[-1]),
            float(time @ radial / (time @ time)) * RATE,
        ]
    )


def _along(errors: Array, covariances: Array) -> Array:
    """Returns the standard uncertainties of the lengths of the n vectors `errors` (2, n) with the covariances (n, 2, 2). For a
    vector of length zero, the standard uncertainty is the square root of the sum of the two variances."""
    size = np.hypot(*errors)
    unit_vectors = np.where(size > 0, errors / np.where(size > 0, size, 1.0), 0.0)
    along = np.einsum("in,nij,jn->n", unit_vectors, covariances, unit_vectors)
    lengths: Array = np.sqrt(np.maximum(np.where(size > 0, along, np.trace(covariances, axis1=1, axis2=2)), 0.0))
    return lengths


def influences(
    request: EstimateRequest[StrapdownNavigationParameters], equations: ErrorEquations, found: Navigated, points: Array
) -> tuple[Influence, ...]:
    """Computes how the latitude and constant sensor errors influence the results. Constant sensor errors influence only the
    alignment angles (heading, pitch, roll), as the module's docstring explains. An error of the latitude makes the assumed Earth
    rate wrong, and so influences the navigation errors; its influence on the alignment is neglected. Repeating a navigation under
    other conditions would take too long, so the sensitivities come from the error equations. A test compares them with repeated
    navigations. `points`: array of shape (5, n), navigation errors as `ErrorRecord.points` returns them."""
    parameters = request.parameters
    rotation = found.aligned.alignment.rotation
    turned = np.zeros((INPUTS, INPUTS))
    turned[:3, :3] = turned[3:, 3:] = rotation
    angles = -attitude.angle_sensitivities(rotation) * DEGREE @ equations.levelled() @ turned
    stated = (
        ("gyro constant error", "rad/s", parameters.gyro_uncertainty, slice(0, 3), "gyro_uncertainty"),
        (
            "accelerometer constant error",
            "m/s^2",
            parameters.accelerometer_uncertainty,
            slice(3, 6),
            "accelerometer_uncertainty",
        ),
    )
    influences = []
    for name, unit_text, quantity, columns, key in stated:
        if quantity is not None and not found.aligned.turned:
            sensitivities = np.zeros((len(NAMES), 3))
            sensitivities[:3] = angles[:, columns]
            source = f"plan estimates.{request.name}.{key}"
            influences.append(
                Influence(InputQuantity(name, 0.0, unit_text, quantity.value, source=source), sensitivities)
            )
    if latitude := request.setup.inputs.get("latitude"):
        course = np.column_stack([points[:, 1:], [found.seconds, *found.final]])
        parts = ((float(points[0, -1]) / max(1, points.shape[1] - 1), points.shape[1] - 1), (found.seconds, 1))
        errors = np.hstack([errors_by_latitude(equations, found.site, *part) for part in parts])
        change = np.vstack([np.zeros(course.shape[1]), errors])
        followed = jacobian(lambda by: _figures(course[..., None] + change[..., None] * by[0]), np.zeros(1))
        influences.append(Influence(latitude, np.concatenate([np.zeros((3, 1)), followed])))
    return tuple(influences)


def drift_influence(found: Navigated, points: Array) -> Influence | None:
    """Computes how the drift that the stops show influences the results; returns None if the stops show no drift. `points`: array
    of shape (5, n), navigation errors as `ErrorRecord.points` returns them.

    The change of each coefficient is its value with the drift minus its value without the drift. Changes of the drift that are as
    large as its uncertainty are treated as small and as independent of each other."""
    drift = found.drift
    if drift is None or not drift.fitted.courses:
        return None
    course = np.column_stack([points[:, 1:], [found.seconds, *found.final]])
    effect = np.array(
        [[np.interp(course[0], drift.time, row) for row in state.T] for state in drift.effect[:4]]
    ).swapaxes(1, 2)
    plain = _figures(course[..., None])
    signs = np.append(-1.0, np.ones(effect.shape[2] - 1))
    changes = signs * (
        _figures(course[..., None] + np.concatenate([np.zeros((1, *effect.shape[1:])), signs * effect])) - plain
    )
    rotation = found.aligned.alignment.rotation
    angles = -attitude.angle_sensitivities(rotation) * DEGREE @ drift.effect[TILT, 0]
    return Influence(
        InputQuantity("drift", 0.0, "1", 1.0, source="fitted drift, not corrected"), np.vstack([angles, changes])
    )


def errors_by_latitude(equations: ErrorEquations, site: Site, step: float, count: int) -> Array:
    """Computes the position errors [m] and velocity errors [m/s] per rad of error of the stated latitude, at the end of each `step`
    [s]. Returns an array of shape (4, count)."""
    shift = np.zeros((SIZE, 1))
    shift[1] = float(radii(site.latitude)[0]) + site.height
    found = equations.responses(shift, np.zeros((count, INPUTS, 1)), step) - shift
    return np.asarray(found[:, :4, 0].T)


def _figures(course: Array) -> Array:
    """Computes the results that follow the angles in `NAMES`, for k sets of navigation errors `course` (5, n, k). Returns an array
    of shape (m, k). The errors are in the form of `ErrorRecord.points`, without the first point."""
    time, radial, speed = course[0].real, length(course[1:3]), length(course[3:5])
    largest, fastest = radial.real.argmax(axis=0), speed.real.argmax(axis=0)
    each = np.arange(course.shape[2])
    rate = np.sum(time * radial, axis=0) / np.sum(time * time, axis=0) * RATE
    over_time = [
        radial[largest, each],
        np.sqrt(np.mean(radial * radial, axis=0)),
        speed[fastest, each],
        np.sqrt(np.mean(speed * speed, axis=0)),
        rate,
        rate * CEP_SHARE,
    ]
    return np.array([*course[1:, -1], radial[-1], *over_time])

"""Navigates recorded segments purely inertially. After an alignment during a stop, the strapdown mechanisation gives attitude,
velocity and position.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.interface import EstimateRequest, EstimationError
from planrunner.estimators.strapdown.alignment import STILL, Aligned, align, end_attitude, opposed, same_attitude
from planrunner.estimators.strapdown.drifting import StopDrift, stop_drift
from planrunner.estimators.strapdown.navigation_errors import ErrorRecord, Truth, difference, stride
from planrunner.estimators.strapdown.reading import (
    IncrementReader,
    Increments,
    reference_mean,
    reference_speed,
)
from planrunner.estimators.strapdown.standing import opposed_gyros
from planrunner.estimators.strapdown.wandering import MeanAttitude, WanderingBias, interval
from planrunner.instruments.models import SensorModel
from planrunner.navigation import attitude
from planrunner.navigation.error_equations import TILT, ErrorEquations
from planrunner.navigation.mechanisation import Knots, Navigator
from planrunner.navigation.wgs84 import normal_gravity
from planrunner.observation.drift import recorded_thermometer
from planrunner.observation.flicker import drift_span
from planrunner.physics.earth import Site
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, QuantityOf, Record, Text, key, optional
from planrunner.plan.quantity import Quantity, QuantityError, parse_quantity, without_uncertainty
from planrunner.plan.selection import matches
from planrunner.plan.units import DIMENSIONS, STANDARD_GRAVITY, unit
from planrunner.uncertainty.influences import Aspect, InputQuantity, Inputs

S = TypeVar("S")


_HIGHEST_REACHED = math.radians(89)


_FEWER = 256  # most intervals of a navigation if only a drift is computed
_INTERVALS = 4400  # most intervals of a navigation, over which biases are averaged: one minute each for 72 h


_GYRO = math.radians(0.1) / 3600  # rad/s


_ACCELEROMETER = STANDARD_GRAVITY * 1e-3  # m/s^2, 1 mg


@dataclass(frozen=True, slots=True)
class _Coordinate:
    """Describes one coordinate of the start position.

    `information`: name of the run information that may contain the coordinate. `channel`: name of the reference channel that may
    contain it. `farthest`: largest value of the coordinate on Earth, rad or m.
    """

    information: str
    channel: str
    dimension: str
    farthest: float


_LATITUDE = _Coordinate("initial_latitude", "reference_latitude", "angle", math.pi / 2)
_LONGITUDE = _Coordinate("initial_longitude", "reference_longitude", "angle", 2 * math.pi)
_HEIGHT = _Coordinate("initial_height", "reference_height", "length", 1e5)


class StrapdownNavigationParameters(Record):
    """Declares the plan keys of the estimator `strapdown_navigation`."""

    gyros: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=3, maximum=3),
        "Channels of the gyros about x, y, z: rates or increments of angle.",
        ["gyro_x", "gyro_y", "gyro_z"],
        default=("gyro_x", "gyro_y", "gyro_z"),
    )
    accelerometers: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=3, maximum=3),
        "Channels of the accelerometers along x, y, z: specific force or increments of velocity.",
        ["accel_x", "accel_y", "accel_z"],
        default=("accel_x", "accel_y", "accel_z"),
    )
    align: str = key(
        Text(r"[^\x00-\x1f]{1,80}", "a label, or a pattern with the wildcards * and ?"),
        "Label of the alignment segment; the segments before it are warm-up, and the "
        "navigation is computed over the segments after it.",
        "align",
        default="align*",
    )
    vertical: str = key(
        Choice(("held", "damped")),
        "Vertical channel: held (constant height, no vertical velocity), or damped by the reference height.",
        "damped",
        default="held",
    )
    gravity: str = key(
        Choice(("site", "wgs84")),
        "Gravity. `site`: the gravity declared for the site, scaled with latitude and height in the same way as "
        "normal gravity; `wgs84`: normal gravity.",
        "wgs84",
        default="site",
    )
    bridge: Quantity = key(
        QuantityOf("time", "not negative"),
        "Samples missing for up to this long are filled by linear interpolation; longer gaps end the navigation with an error.",
        "0 s",
        default=parse_quantity("0.1 s"),
    )
    gyro_uncertainty: Quantity | None = optional(
        QuantityOf("angular rate", "positive"),
        "Standard uncertainty of each gyro's constant error, for the uncertainty of the alignment and for the expected errors.",
        "0.005 deg/h",
    )
    accelerometer_uncertainty: Quantity | None = optional(
        QuantityOf("acceleration", "positive"),
        "Standard uncertainty of each accelerometer's constant error, for the uncertainty of the alignment and for the expected errors.",
        "50 ug",
    )

    drift_span: Quantity = drift_span()

    @property
    def channels(self) -> tuple[str, ...]:
        """Returns the names of the channels: the gyros x, y, z, then the accelerometers x, y, z."""
        return (*self.gyros, *self.accelerometers)

    @property
    def constant_errors(self) -> Array:
        """Returns the standard uncertainties of the constant errors, rad/s and m/s², shape (6,). If the plan states no values, the
        uncertainties are so large that the data alone determine the errors."""
        gyro = self.gyro_uncertainty.value if self.gyro_uncertainty else _GYRO
        accelerometer = self.accelerometer_uncertainty.value if self.accelerometer_uncertainty else _ACCELEROMETER
        return np.array([gyro] * 3 + [accelerometer] * 3)


@dataclass(frozen=True, slots=True)
class Navigated:
    """The result of a navigation.

    `site`: the point on the Earth at which the navigation starts. `final`: array of shape (4,), east and north errors of position
    [m] and of velocity [m/s] at the end. `seconds`: duration of the navigation, s. `start`: time at which the navigation begins, s.
    `gap`: time without samples after the alignment, s. `bridged`: number of missing samples that were filled in. `wandering`:
    response of the navigation to biases that change over time. `opposed`: indices of the gyros that seem to have the wrong sign.
    `drift`: what the stops show about a drift; None if the stops cannot show a drift, or if the carrier moves.
    """

    site: Site
    aligned: Aligned
    record: ErrorRecord
    final: Array
    seconds: float
    start: float
    gap: float
    bridged: int
    wandering: WanderingBias | None = None
    opposed: tuple[int, ...] = ()
    drift: StopDrift | None = None


def parts(segments: Sequence[S], labels: Sequence[str], pattern: str) -> tuple[S, Sequence[S]]:
    """Returns the segment for the alignment, and the segments to navigate. Raises `EstimationError` if there is not exactly one
    segment for the alignment, or if no segment follows it."""
    found = [k for k, label in enumerate(labels) if matches(label, pattern)]
    if not found:
        raise EstimationError(
            f"none of the segments is for alignment: no label matches '{pattern}'; add a stop with such a label "
            "before the navigation, or name it with `align`"
        )
    if len(found) > 1:
        raise EstimationError(
            f"'{labels[found[0]]}' and '{labels[found[1]]}' are both for alignment: choose one with `align`"
        )
    if found[0] == len(segments) - 1:
        raise EstimationError(f"no segment follows '{labels[found[0]]}': add the segment to navigate to `segments`")
    return segments[found[0]], segments[found[0] + 1 :]


def start_place(request: EstimateRequest[StrapdownNavigationParameters], stop: RecordedSegment, factor: float) -> Site:
    """Returns the point on the Earth at which the sensor is aligned. Each coordinate is taken from the first of these sources that
    contains it: the run information, the reference channels, the bench's site. `factor`: gravity at the site divided by normal
    gravity. Raises `EstimationError` for run information that is not a place on Earth."""

    def place(coordinate: _Coordinate) -> float | None:
        if text := request.setup.information.get(coordinate.information, "").strip():
            return _told(coordinate, text)
        return reference_mean(stop, coordinate.channel) if coordinate.channel in stop.statistics.channels else None

    site = _at(request.site.on_ellipsoid, place)
    return replace(site, gravity=factor * float(normal_gravity(site.latitude, site.height)))


def _at(site: Site, place: Callable[[_Coordinate], float | None]) -> Site:
    """Returns the site with the coordinates that the function `place` returns. If `place` returns None, the coordinate is
    unchanged."""
    latitude, longitude, height = (place(one) for one in (_LATITUDE, _LONGITUDE, _HEIGHT))
    return replace(
        site,
        latitude=site.latitude if latitude is None else latitude,
        longitude=site.longitude if longitude is None else longitude,
        height=site.height if height is None else height,
    )


def _told(coordinate: _Coordinate, text: str) -> float:
    """Reads a coordinate from a text of the run information. A plain number is in degrees or metres, as receivers display
    coordinates. Raises `EstimationError` for a text that is not a place on Earth."""
    try:
        value = math.radians(float(text)) if coordinate.dimension == "angle" else float(text)
    except ValueError:
        try:
            value = without_uncertainty(text, coordinate.dimension).value
        except QuantityError as error:
            raise EstimationError(
                f"the run information {coordinate.information} is '{text[:40]}': {error}; write for example 39.98 deg"
            ) from None
    if not abs(value) <= coordinate.farthest:
        message = f"the run information {coordinate.information} is '{text[:40]}', which is not a place on Earth"
        raise EstimationError(message)
    return value


def navigate(request: EstimateRequest[StrapdownNavigationParameters]) -> Navigated:
    """Aligns the sensor, and then navigates. Each sample is read once. Raises `EstimationError` if the segments are unsuitable."""
    parameters = request.parameters
    stop, moving = parts(request.segments, [item.label for item in request.segments], parameters.align)
    rates = {item.segment.sample_rate or request.sensor.sample_rate for item in (stop, *moving)}
    if len(rates) > 1:
        raise EstimationError(
            "alignment and navigation have different sample rates: give all of them one `sample_rate`"
        )
    thermometer = recorded_thermometer((stop, *moving), None, by_evidence=True)
    reader = IncrementReader(parameters.channels, rates.pop(), parameters.bridge.value, thermometer)
    bench = request.site.on_ellipsoid
    factor = (
        bench.gravity / float(normal_gravity(bench.latitude, bench.height)) if parameters.gravity == "site" else 1.0
    )
    site = start_place(request, stop, factor)
    inputs = request.setup.inputs
    flickering = wandering_sensors(inputs, parameters) or inputs.without_flicker & set(parameters.channels)
    lasting = sum(item.statistics.duration for item in (stop, *moving))
    step = interval(lasting, _INTERVALS if flickering else _FEWER)
    aligned = align(stop, reader, site, factor, parameters.constant_errors, step, lasting)
    planned = end_attitude(stop.segment, request.setup.table, stop.statistics.duration)
    turned_over = opposed(stop.label, planned, aligned.alignment.rotation)
    aligned = replace(aligned, warnings=(*aligned.warnings, *turned_over))
    gap = _gap(request, stop, moving, reader)
    attitudes = MeanAttitude(step)
    found = _run(request, reader, moving, site, factor, aligned, gap, attitudes)
    between = max(0, round((found.start - (stop.statistics.start - reader.interval)) / step))
    followed = aligned.alignment.followed[TILT]
    span = parameters.drift_span.value
    response = WanderingBias(ErrorEquations.at(found.site), followed, attitudes.means, between, step, span)
    if max(map(reference_speed, (stop, *moving))) > STILL:
        return replace(found, wandering=response)
    stated = {
        k: quantity.standard_uncertainty * rate_of(quantity, request.sensor)
        for k, quantity in wandering_sensors(inputs, parameters).items()
    }
    stops = aligned.stops.finish()
    wrong = () if turned_over else opposed_gyros(stops, _earth_rate(found.site))
    return replace(found, wandering=response, opposed=wrong, drift=stop_drift(stops, response, stated))


def _earth_rate(site: Site) -> Array:
    """Returns the Earth rate in East-North-Up, rad/s, shape (3,)."""
    return np.array([0.0, site.earth_rate * math.cos(site.latitude), site.earth_rate * math.sin(site.latitude)])


def wandering_sensors(inputs: Inputs, parameters: StrapdownNavigationParameters) -> dict[int, InputQuantity]:
    """Returns the sensors with a stated bias instability: maps the index of a sensor (gyros x, y, z, then accelerometers x, y, z)
    to its bias instability."""
    stated = (inputs.of_output(Aspect.BIAS_INSTABILITY, name) for name in parameters.channels)
    return {k: quantity for k, quantity in enumerate(stated) if quantity is not None}


def rate_of(quantity: InputQuantity, sensor: SensorModel) -> float:
    """Returns the SI value [rad/s or m/s²] of one unit of an output. For an output of increments, returns the SI value of one unit
    per sample interval."""
    known = unit(quantity.unit)
    increments = known.dimension in (DIMENSIONS["angle"], DIMENSIONS["speed"])
    return known.factor * (sensor.sample_rate if increments else 1.0)


def _gap(
    request: EstimateRequest[StrapdownNavigationParameters],
    stop: RecordedSegment,
    moving: Sequence[RecordedSegment],
    reader: IncrementReader,
) -> float:
    """Returns the time [s] between alignment and navigation, during which the attitude is assumed to stay the same. Raises
    `EstimationError` if the sensor may have rotated in this time."""
    first = moving[0]
    gap = first.statistics.start - stop.statistics.end - reader.interval
    if not gap > reader.bridge + reader.interval / 2:
        return 0.0
    between = f"{gap:.4g} s lie between '{stop.label}' and '{first.label}'"
    if max(map(reference_speed, (stop, *moving))) > STILL:
        raise EstimationError(
            f"{between}, and the carrier may have turned in this time: record the two without a pause"
        )
    if stop.truncated or not same_attitude(
        end_attitude(stop.segment, request.setup.table, stop.statistics.duration), first.segment.attitude
    ):
        raise EstimationError(
            f"{between}, and '{first.label}' does not begin in the orientation in which '{stop.label}' ends: align in the orientation "
            "in which navigation begins, or record the two without a pause"
        )
    reader.part()
    return gap


def _run(
    request: EstimateRequest[StrapdownNavigationParameters],
    reader: IncrementReader,
    moving: Sequence[RecordedSegment],
    site: Site,
    factor: float,
    aligned: Aligned,
    gap: float,
    attitudes: MeanAttitude,
) -> Navigated:
    every = max(1, round(1 / reader.interval))
    lasting = sum(item.statistics.duration for item in moving)
    if not any(item.statistics.count for item in moving):
        raise EstimationError("the segments to navigate hold no usable samples: record them again")
    if lasting < 2 * every * reader.interval:
        raise EstimationError(f"only {lasting:.3g} s are left to navigate: record longer")
    record = ErrorRecord(stride(int(lasting / (every * reader.interval))))
    navigator: Navigator | None = None
    start, time, truth = math.nan, math.nan, None
    aligned.stops.part()  # the knots of the navigation begin anew
    for item in moving:
        for piece in reader.blocks(item):
            if navigator is None:
                start = float(piece.time[0] - piece.interval[0])
                navigator, site = _begin(request, piece, site, factor, aligned, every)
            at = np.arange(every - 1 - navigator.steps % every, piece.time.size, every)
            knots = navigator.advance(piece.values, piece.interval, piece.reference.get("reference_height"))
            record.take(piece.time[at] - start, knots, _truth(piece, site, at))
            rotations = attitude.matrix(knots.attitude)
            attitudes.take(piece.time[at] - start, rotations)
            aligned.stops.take(piece, at, rotations)
            _check(navigator, item.label, float(piece.time[-1]) - start)
            time, truth = float(piece.time[-1]), _truth(piece, site, np.array([-1]))
    assert navigator is not None and truth is not None
    place = (np.array([value]) for value in navigator.position)
    final = difference(Knots(navigator.quaternion[None], navigator.velocity[None], *place), truth)[:, 0]
    return Navigated(site, aligned, record, final, time - start, start, gap, reader.bridged)


def _begin(
    request: EstimateRequest[StrapdownNavigationParameters],
    piece: Increments,
    site: Site,
    factor: float,
    aligned: Aligned,
    every: int,
) -> tuple[Navigator, Site]:
    """Returns a navigator for the start of the first interval, and the point on the Earth at which it starts. `every`: number of
    samples in an interval of the navigator."""
    parameters = request.parameters
    first = {name: _before(values) for name, values in piece.reference.items()}
    stated = request.setup.information

    def moved(coordinate: _Coordinate) -> float | None:
        return None if stated.get(coordinate.information, "").strip() else first.get(coordinate.channel)

    site = _at(site, moved)
    velocity = np.array([first.get(f"reference_velocity_{name}", 0.0) for name in ("east", "north", "up")])
    if parameters.vertical == "held":
        velocity[2] = 0.0
    navigator = Navigator(
        attitude.quaternion(aligned.alignment.rotation),
        velocity,
        (site.latitude, site.longitude, site.height),
        vertical=parameters.vertical,
        gravity_factor=factor,
        earth_rate=site.earth_rate,
        every=every,
        last=aligned.last,
    )
    return navigator, site


def _before(values: Array) -> float:
    """Returns the value of a reference channel one interval before its first sample, extrapolated linearly."""
    return float(2 * values[0] - values[1]) if len(values) > 1 else float(values[0])


def _truth(piece: Increments, site: Site, at: NDArray[np.int64]) -> Truth:
    """Returns the true position and velocity at some samples of a block, from the reference channels. Without reference channels,
    the sensor is assumed to stay where the navigation starts."""
    reference = piece.reference

    def of(name: str, otherwise: float) -> Array:
        return reference[name][at] if name in reference else np.full(len(at), otherwise)

    velocity = np.column_stack([of("reference_velocity_east", 0.0), of("reference_velocity_north", 0.0)])
    return Truth(
        of("reference_latitude", site.latitude),
        of("reference_longitude", site.longitude),
        of("reference_height", site.height),
        velocity,
    )


def _check(navigator: Navigator, label: str, seconds: float) -> None:
    if not np.isfinite(navigator.state).all() or abs(navigator.position[0]) > _HIGHEST_REACHED:
        raise EstimationError(
            f"after {seconds:.0f} s of '{label}' the navigated position comes near a pole, where East-North-Up axes "
            "are undefined: check the sensors' units and errors"
        )

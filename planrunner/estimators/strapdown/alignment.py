"""Aligns the sensor in a recorded segment, in which the sensor is at rest or is turned from stop to stop. The first stop gives the
coarse attitude and the noise, and the whole segment gives the fine attitude."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.estimators.interface import EstimationError, UnfitDataError
from planrunner.estimators.strapdown.reading import IncrementReader, Increments, reference_speed
from planrunner.estimators.strapdown.standing import StopReader
from planrunner.instruments.models import TableModel
from planrunner.navigation import attitude
from planrunner.navigation.alignment import Alignment, FineAlignment, coarse
from planrunner.navigation.error_equations import TILT, ErrorEquations
from planrunner.navigation.mechanisation import Navigator
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import rotation_about
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.plan.schedule import Cycle, Rest, Segment

SHORTEST = 60.0  # s
# cos = 0.087: beyond, the heading is eleven times as sensitive to gyro errors as at the equator.
HIGHEST_LATITUDE = math.radians(85)
STILL = 0.05  # m/s; a reference that moves faster is not at rest
_COARSE = 300.0  # s, longest time from which the coarse attitude and the noise are computed
_SPANS = 64  # most time spans of the first stop whose means give evidence of flicker
_GRAVITY_TOLERANCE = 0.01
# Fraction of the Earth's rate: such a gyro error changes the heading by 6 deg at the equator, the limit of small angles.
_EARTH_TOLERANCE = 0.1
_HEADING_LIMIT = math.radians(3)
_WIDENED = 1.5  # consistency from which uncertainties are widened
_MOVED = 0.1  # m/s; a unit on a floor or in a parked vehicle does not change its velocity by more within a second


@dataclass(frozen=True, slots=True)
class Aligned:
    """The result of an alignment.

    `alignment`: the fine alignment, with the covariance that is used. `last`: array of shape (6,), the last increments of angle and
    velocity. `density`: array of shape (6, 6), density of the white noise in navigation axes, from the scatter at rest. The density
    is the covariance that the noise adds to the integrated outputs per second. `white`: array of shape (6,), square roots of the
    noise densities in body axes. `seconds`: duration of the alignment, s. `turned`: True if the sensor was turned from stop to stop
    during the alignment, so that its constant errors were estimated too. `rest`: the readings at the first stop. `stops`: the
    readings at all stops.
    """

    alignment: Alignment
    last: Array
    density: Array
    white: Array
    seconds: float
    turned: bool
    warnings: tuple[Said, ...]
    rest: AtRest
    stops: StopReader


@dataclass(frozen=True, slots=True, eq=False)
class AtRest:
    """Contains the readings of the sensors at rest.

    `means`: array of shape (6, b), means over b successive time spans of `length` [s], rad/s and m/s². `white`: array of shape
    (6,), square roots of the densities of the white noise, rad/√s and m/s/√s. `freedom`: degrees of freedom of `white`.
    """

    means: Array
    length: float
    white: Array
    freedom: float


def align(
    recorded: RecordedSegment,
    reader: IncrementReader,
    site: Site,
    gravity_factor: float,
    constant: Array,
    follow: float | None = None,
    lasting: float = 0.0,
) -> Aligned:
    """Aligns the sensor, that is, determines its attitude at the end of a segment.

    `site`: the point on the Earth at which the sensor is aligned, with its latitude, height and gravity. `constant`: array of shape
    (6,), standard uncertainty of the constant errors of gyros and accelerometers, rad/s and m/s²; used only if the sensor is turned
    during the alignment. `follow`: the argument of `FineAlignment` with this name. `lasting`: total time of alignment and
    navigation, s. Raises `EstimationError` if the segment is unsuitable for an alignment. `gravity_factor`: gravity at the site
    divided by normal gravity.
    """
    seconds = recorded.statistics.duration
    still = stillness(recorded.segment, seconds)
    _check_stop(recorded, seconds, still, site)
    pieces = reader.blocks(recorded)
    begin = _first(pieces, still)
    mean, rest = _at_rest(begin, still)
    white = rest.white
    _check_at_rest(recorded.label, reader.channels, mean, site)
    start = coarse(mean[:3], mean[3:])
    turned = not isinstance(recorded.segment.motion, Rest)
    density = to_navigation(start, white**2)
    # If the noise is far smaller than the constant errors of the gyros (simulated data, quiet sensors), a filter that assumes only
    # this noise stops following these errors. A second filter therefore adds a random walk that reaches the size of the observed
    # gyro errors during the alignment.
    shown = density.copy()
    shown[:3, :3] += _rate_error(mean, site) ** 2 * seconds * np.eye(3)
    every = max(1, round(1 / reader.interval))
    filters = [
        FineAlignment(
            ErrorEquations.at(site),
            levelled_out(each) if turned else each,
            every * reader.interval,
            constant if turned else None,
            follow,
        )
        for each in (density, shown)
    ]
    navigator = Navigator(
        attitude.quaternion(start),
        np.zeros(3),
        (site.latitude, site.longitude, site.height),
        gravity_factor=gravity_factor,
        earth_rate=site.earth_rate,
        every=every,
    )
    before = start[None]
    stops = StopReader(site.earth_rate, white, max(lasting, seconds), recorded.statistics.start - reader.interval)
    for piece in chain(begin, pieces):
        at = np.arange(every - 1 - navigator.steps % every, piece.time.size, every)
        knots = navigator.advance(piece.values, piece.interval)
        rotations = np.concatenate([before, attitude.matrix(knots.attitude)])
        stops.take(piece, at, rotations[1:])
        turns = attitude.turned_about_up(rotations[:-1], rotations[1:]) / (every * reader.interval)
        for fine in filters:
            fine.take(knots.velocity[:, :2], (rotations[1:] + rotations[:-1]) / 2, turns)
        before = rotations[-1:]
    by_noise, by_errors = (fine.finish(navigator.rotation) for fine in filters)
    lost = by_noise.largest > _MOVED >= by_errors.largest
    found, warnings = _judged(recorded.label, by_errors if lost else by_noise, seconds)
    if lost:
        warnings += (_quiet(recorded.label, mean, site),)
    density = to_navigation(found.rotation, white**2)
    return Aligned(found, navigator.last, density, white, seconds, turned, warnings, rest, stops)


def stillness(segment: Segment, seconds: float) -> float:
    """Returns the time [s] for which the sensor is at rest at the start of a segment, at most `seconds`. The coarse attitude is
    computed from the samples in this time."""
    first = segment.motion.stop if isinstance(segment.motion, Cycle) else seconds
    return min(first, seconds, _COARSE)


def end_attitude(segment: Segment, table: TableModel | None, seconds: float | None = None) -> Array | None:
    """Returns the planned attitude at the end of a segment as a matrix (3, 3) whose rows are the sensor's axes; None if it is not
    known. `seconds`: the recorded length of the segment; by default the planned dwell."""
    if segment.attitude is None or not isinstance(segment.motion, Cycle):
        return segment.attitude if isinstance(segment.motion, Rest) else None
    dwell = segment.dwell if seconds is None else seconds
    if dwell is None:
        return None
    upright = [axis.max_acceleration for axis in table.axes if abs(axis.direction[2]) > 1 - 1e-9] if table else []
    angle = float(RotationCycle.of(segment.motion, upright[0] if upright else math.inf).angle(np.array([dwell]))[0])
    turned = rotation_about((0.0, 0.0, 1.0), angle)
    return np.asarray(segment.attitude @ turned.T)


def same_attitude(one: Array | None, other: Array | None) -> bool:
    """Returns True if both attitudes are known and equal within one microradian."""
    return one is not None and other is not None and bool(np.allclose(one, other, atol=1e-6))


def opposed(label: str, planned: Array | None, rotation: Array) -> tuple[Said, ...]:
    """Returns a warning if the attitude from the alignment differs from the planned attitude by more than 90 deg. One reversed
    channel changes the attitude by 180 deg. `planned`: array of shape (3, 3), planned attitude, whose rows are the sensor's axes;
    None if it is not known. `rotation`: array of shape (3, 3), attitude from the alignment, from body to navigation axes."""
    if planned is None:
        return ()
    angle = math.acos(min(1.0, max(-1.0, (float(np.trace(planned @ rotation)) - 1) / 2)))
    if angle <= math.pi / 2:
        return ()
    return (
        said(
            "The alignment in '{segment}' finds an attitude {angle:.0f} deg from the planned orientation. If the plan is right, a gyro or "
            "an accelerometer has the wrong sign, or two channels are exchanged: check the signs and the order of the channels.",
            segment=label,
            angle=math.degrees(angle),
        ),
    )


def _first(pieces: Iterator[Increments], seconds: float) -> list[Increments]:
    """Returns the pieces at the start of the record that together cover the first `seconds`."""
    found: list[Increments] = []
    covered = 0.0
    for piece in pieces:
        found.append(piece)
        covered += float(piece.interval.sum())
        if covered >= seconds:
            break
    return found


def _at_rest(pieces: Sequence[Increments], seconds: float) -> tuple[Array, AtRest]:
    """Returns the mean readings (6,), rad/s and m/s², over the first `seconds`, and the readings in this time as `AtRest`. The
    white noise is the Allan deviation of means over one second, which slow motion does not increase. The degrees of freedom of this
    noise are computed for overlapping differences of white noise."""
    values = np.hstack([piece.values for piece in pieces] or [np.zeros((6, 0))])
    interval = np.concatenate([piece.interval for piece in pieces] or [np.zeros(0)])
    within = int(np.searchsorted(np.cumsum(interval), seconds * (1 - 1e-9)))
    batches = int(seconds)
    size = within // batches
    if size == 0:
        return np.full(6, math.nan), AtRest(np.zeros((6, 0)), 0.0, np.zeros(6), 0.0)
    used = size * batches
    times = interval[:used].reshape(batches, size).sum(axis=1)
    means = values[:, :used].reshape(6, batches, size).sum(axis=2) / times
    white = np.sqrt(np.mean(np.diff(means) ** 2, axis=1) / 2 * times.mean())
    together = max(1, batches // _SPANS)
    spans = batches // together
    joined = means[:, : spans * together].reshape(6, spans, together).mean(axis=2)
    rest = AtRest(joined, float(together * times.mean()), white, 2 / 3 * (batches - 1))
    return values[:, :used].sum(axis=1) / times.sum(), rest


def to_navigation(rotation: Array, variances: Array) -> Array:
    """Converts variances (6,) in body axes to a covariance matrix (6, 6) in navigation axes. `rotation`: array of shape (3, 3),
    attitude, from body to navigation axes."""
    both = np.zeros((6, 6))
    both[:3, :3] = rotation * variances[:3] @ rotation.T
    both[3:, 3:] = rotation * variances[3:] @ rotation.T
    return both


def levelled_out(density: Array) -> Array:
    """Returns the noise density (6, 6) of a sensor that rotates about the vertical. The rotation makes the noise in the east and
    north axes equal."""
    found = np.zeros_like(density)
    for k in (0, 3):
        horizontal = (density[k, k] + density[k + 1, k + 1]) / 2
        np.fill_diagonal(found[k : k + 3, k : k + 3], (horizontal, horizontal, density[k + 2, k + 2]))
    return found


def _check_stop(recorded: RecordedSegment, seconds: float, still: float, site: Site) -> None:
    label = recorded.label
    if not isinstance(recorded.segment.motion, Rest | Cycle):
        raise EstimationError(
            f"segment '{label}' turns continuously: alignment needs a stop, or a cycle of stops; align before the "
            "motion begins"
        )
    if recorded.statistics.count == 0:
        raise UnfitDataError(f"segment '{label}' has no usable samples: record it again")
    if still < SHORTEST:
        what = "its first stop lasts" if seconds >= SHORTEST else "it has samples for"
        raise EstimationError(
            f"segment '{label}' is too short for alignment: {what} {still:.3g} s; alignment needs at least {SHORTEST:g} s, "
            "preferably 5 to 10 min"
        )
    if abs(site.latitude) > HIGHEST_LATITUDE:
        raise EstimationError(
            f"at latitude {math.degrees(site.latitude):.4g} deg the Earth's rate has almost no horizontal component: "
            "north cannot be found "
            f"by gyrocompassing beyond {math.degrees(HIGHEST_LATITUDE):g} deg"
        )
    speed = reference_speed(recorded)
    if speed > STILL:
        raise EstimationError(f"segment '{label}': the carrier moves at up to {speed:.3g} m/s: align during a stop")


def _rate_error(mean: Array, site: Site) -> float:
    """Returns the magnitude [rad/s] of the difference between the mean rate at rest and the Earth's rate. For this purpose, each
    rate is a vector of two components, horizontal and upward. `mean`: array of shape (6,), mean readings at rest, rad/s and
    m/s²."""
    found, earth = _rates(mean, site)
    return float(np.linalg.norm(found - earth))


def _rates(mean: Array, site: Site) -> tuple[Array, Array]:
    """Returns the horizontal and the upward component (2,) of the mean rate, and the same components of the Earth's rate, rad/s."""
    rate = float(np.linalg.norm(mean[:3]))
    up = float(mean[:3] @ mean[3:]) / float(np.linalg.norm(mean[3:]))
    earth = site.earth_rate * np.array([math.cos(site.latitude), math.sin(site.latitude)])
    return np.array([math.sqrt(max(0.0, rate * rate - up * up)), up]), earth


def _quiet(label: str, mean: Array, site: Site) -> Said:
    return said(
        "During '{segment}' the noise is far smaller than the difference between the gyro readings and the Earth's rate, "
        "{rate:.3g} deg/h; the alignment uses this difference as the uncertainty of the gyro readings.",
        segment=label,
        rate=math.degrees(_rate_error(mean, site)) * 3600,
    )


def _check_at_rest(label: str, channels: Sequence[str], mean: Array, site: Site) -> None:
    """Raises `UnfitDataError` if the mean readings do not agree with a sensor at rest. `channels`: names of the six channels.
    `mean`: array of shape (6,), rad/s and m/s², mean readings at the first stop."""
    if not np.isfinite(mean).all():
        raise UnfitDataError(f"segment '{label}' has too few usable samples: record it again")
    force = float(np.linalg.norm(mean[3:]))
    if abs(force / site.gravity - 1) > _GRAVITY_TOLERANCE:
        raise UnfitDataError(
            f"segment '{label}': the mean specific force is {force:.5g} m/s^2 but gravity is {site.gravity:.5g}: "
            "check the "
            "accelerometers' units and order, and that the unit is at rest"
        )
    if _rate_error(mean, site) > _EARTH_TOLERANCE * site.earth_rate:
        found, earth = _rates(mean, site)
        shown = np.degrees([*found, *earth]) * 3600
        if reversed_ := _would_agree(channels, mean, site):
            raise UnfitDataError(
                f"segment '{label}': the gyros measure {shown[1]:.4g} deg/h up, but the Earth rate is {shown[3]:.4g} up; with the "
                f"opposite sign of {' or of '.join(reversed_)}, the two would agree: check the signs of the channels"
            )
        raise UnfitDataError(
            f"segment '{label}': the gyros measure {shown[0]:.4g} deg/h horizontally and {shown[1]:.4g} deg/h up, but the "
            "Earth rate is "
            f"{shown[2]:.4g} and {shown[3]:.4g}: check that the unit is at rest, the gyros' units and order and the "
            "latitude; gyros with "
            "such errors cannot find north"
        )


def _would_agree(channels: Sequence[str], mean: Array, site: Site) -> list[str]:
    """Returns the channels that may have the wrong sign. Reversing the sign of any single one of these channels makes the rates at
    rest agree with the Earth's rate. `mean`: array of shape (6,), mean readings at rest, rad/s and m/s²."""
    signs = 1.0 - 2.0 * np.eye(len(mean))
    errors = [_rate_error(sign * mean, site) for sign in signs]
    limit = _EARTH_TOLERANCE * site.earth_rate
    return [name for name, error in zip(channels, errors, strict=True) if error <= limit]


def _judged(label: str, found: Alignment, seconds: float) -> tuple[Alignment, tuple[Said, ...]]:
    warnings: list[Said] = []
    covariance = found.covariance
    if found.largest > _MOVED:
        raise UnfitDataError(
            f"segment '{label}': velocity changes by {found.largest:.3g} m/s within a second, so the unit "
            "moved during alignment: align again at rest"
        )
    if found.consistency > _WIDENED:
        covariance = covariance * found.consistency**2
        warnings.append(
            said(
                "During '{segment}' the velocity deviates from zero by {factor:.2g} times the amount that noise explains "
                "(vibration or a swaying base); the uncertainties of the alignment are multiplied by this factor.",
                segment=label,
                factor=found.consistency,
            )
        )
    heading = math.sqrt(covariance[TILT, TILT][2, 2])
    if heading > _HEADING_LIMIT:
        raise UnfitDataError(
            f"segment '{label}': after {seconds:.0f} s north is only known to {math.degrees(heading):.2g} deg "
            "(standard uncertainty): "
            "align for longer, or use gyros with less noise and smaller errors"
        )
    return replace(found, covariance=covariance), tuple(warnings)

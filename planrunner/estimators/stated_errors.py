"""Computes how errors of declared inputs (latitude, gravity, and errors of the table) change the observations of a linear model.
Each input is changed by a small amount, and the model is evaluated again.

Errors of latitude and gravity change the columns of the model. These errors cause no scatter between segments, so their
contribution is added to the contribution of the data. The errors of the table are the errors of its positions, of its azimuth, of
the right angles between its axes, and of its rates. The errors of the table differ between segments and cause scatter, so they are
included in the weights of a fit (`correlated_errors`). The sign of each change applies to an input whose stated value is larger
than the true value. For a position error, the sign applies to a rotation of the sensor by this error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.kept import kept
from planrunner.error_model.terms import LinearModel
from planrunner.estimators.interface import Setup
from planrunner.instruments.models import TableModel
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis, Unreachable, cross, joint_angles, rotation_about
from planrunner.physics.stimulus import Poses, Stimulus
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Rest, Segment, Spin
from planrunner.uncertainty.conditions import StatedCondition
from planrunner.uncertainty.influences import InputQuantity, Inputs

DIRECTIONS = ("east", "north", "up")
UP = (0.0, 0.0, 1.0)

_STEP = 1e-4  # of an input; central differences of terms up to the second degree are exact for any step


def mean_poses(segments: Sequence[Segment]) -> Poses:
    """Returns the attitudes of the segments, averaged over the time of the recording. A spin is averaged over whole turns, because
    the angle at which the recording begins is not known."""
    return Poses.of(segments, [None if isinstance(one.motion, Spin) else one.dwell for one in segments])


def mean_stimulus(segments: Sequence[Segment], site: Site) -> Stimulus:
    """Returns the mean stimulus of the segments. A spin is averaged over whole turns."""
    return mean_poses(segments).felt(site)


def stated_site(inputs: Inputs, site: Site) -> Iterator[StatedCondition[Site]]:
    """Yields latitude and gravity as conditions that can be changed, if they are stated with an uncertainty. The azimuth is not
    included, because it rotates the sensor on the table but does not change the site."""
    if latitude := inputs.get("latitude"):
        yield StatedCondition.single(latitude, lambda by: replace(site, latitude=site.latitude + by))
    if gravity := inputs.get("gravity"):
        yield StatedCondition.single(gravity, lambda by: replace(site, gravity=site.gravity + by))


def site_errors(
    model: LinearModel, segments: Sequence[Segment], site: Site, inputs: Inputs, coefficients: Array
) -> tuple[CorrelatedError, ...]:
    """Computes the errors of the observations due to latitude and gravity, if these are stated with an uncertainty. Such an error
    changes the expected outputs, not the readings. If an expected output is too large, this has the same effect as a reading that
    is too small. `coefficients`: array of shape (m, p), for m outputs and p columns of the model, in the outputs' units per SI unit
    of each column."""
    stated = [one for one in (inputs.get("latitude"), inputs.get("gravity")) if one]
    if not stated:
        return ()
    poses = mean_poses(segments)
    found = _site_slopes_of_motion if model.of_motion else _site_slopes
    slopes = found(model, (poses.timeless if model.of_motion else poses).arrays, site, tuple(stated))
    moved = -_followed(slopes, coefficients)
    return tuple(_error(one, moved[:, :, k : k + 1]) for k, one in enumerate(stated))


def _site_slopes(model: LinearModel, poses: tuple[Array, ...], site: Site, stated: tuple[InputQuantity, ...]) -> Array:
    """Returns the changes (r, n, p) of the model's columns per unit of each of r inputs of the site (latitude, gravity)."""
    held = Poses(*poses)

    def felt(at: Site) -> Array:
        return np.array((held.mean @ at.earth_rate_enu, held.mean @ at.specific_force_enu))

    conditions = stated_site(Inputs({one.name: one for one in stated}), site)
    moves = np.array([one.answers(felt) for one in conditions])[:, 0].swapaxes(0, 1)
    return _slopes(model, held.felt(site), moves)


_site_slopes_of_motion = kept(64)(_site_slopes)


def table_errors(
    model: LinearModel, segments: Sequence[Segment], site: Site, setup: Setup, coefficients: Array
) -> tuple[CorrelatedError, ...]:
    """Computes the errors of the observations due to the table. Only errors of the table for which the bench file states an
    uncertainty are included.

    `coefficients`: array of shape (m, p), for m outputs and p columns of the model, in the outputs' units per SI unit of each
    column.
    """
    position, azimuth = setup.inputs.get("table position"), setup.inputs.get("azimuth")
    orthogonality, rate = setup.inputs.get("table orthogonality"), setup.inputs.get("table rate")
    poses = mean_poses(segments)
    resting = all(isinstance(segment.motion, Rest) for segment in segments)
    table = setup.table if orthogonality and resting else None
    slopes_of = _table_slopes_of_motion if model.of_motion else _table_slopes
    slopes = slopes_of(model, (poses.timeless if model.of_motion else poses).arrays, site, table)
    moved = _followed(slopes, coefficients)
    found: list[CorrelatedError] = []
    if position:
        found.append(_positions(position, segments, moved[:, :, : len(DIRECTIONS)]))
    if azimuth:
        found.append(_error(azimuth, moved[:, :, -2:-1]))
    leaning = moved[:, :, len(DIRECTIONS) : -2]
    if orthogonality and setup.table is not None and leaning.size:
        found.append(_error(orthogonality, leaning, pair_parts(setup.table)))
    if rate:
        found += rate_errors(rate, moved[:, :, -1], poses.table_rate)
    return tuple(found)


def _table_slopes(model: LinearModel, poses: tuple[Array, ...], site: Site, table: TableModel | None) -> Array:
    """Returns how much the model's columns change per unit of each of r errors of the table, shape (r, n, p). These errors are a
    rotation about each site axis; the angle between each pair of neighbouring axes, if the table is at rest and can reach the
    attitudes; the azimuth; and the rate."""
    held = Poses(*poses)
    felt = held.felt(site)
    both = np.array((felt.omega, felt.specific_force))
    directions = np.moveaxis(held.attitude, 2, 0)  # of the site, in the sensor's axes
    turned = np.cross(both[:, None], np.concatenate([directions, _tilts(table, held.attitude, site)]))
    up = np.array(UP)
    about_up = [[held.mean @ cross(vector, up)] for vector in (site.earth_rate_enu, site.specific_force_enu)]
    hastened = np.array([[held.spin], [np.zeros_like(held.spin)]])
    moves = np.concatenate([turned, about_up, hastened], axis=1)
    table_rate = np.zeros(moves.shape[1:3])
    table_rate[-1] = held.table_rate
    return _slopes(model, felt, moves, table_rate)


_table_slopes_of_motion = kept(64)(_table_slopes)


def _slopes(model: LinearModel, felt: Stimulus, moves: Array, table_rate: Array | float = 0.0) -> Array:
    """Returns how much the model's columns change per unit of each of r inputs, shape (r, n, p).

    `moves`: array of shape (2, r, n, 3), change of angular rate and specific force per unit of each input. `table_rate`: array of
    shape (r, n), change of the table's rate per unit of each input.
    """
    _, r, n, _ = moves.shape
    sides = np.array([-_STEP, _STEP])[:, None, None]
    rate = felt.table_rate + sides * np.broadcast_to(table_rate, (r, n))
    temperature, time, angle = np.tile((felt.temperature, felt.time, felt.table_angle), 2 * r)
    moved = Stimulus(
        (felt.omega + sides[..., None] * moves[0]).reshape(-1, 3),
        (felt.specific_force + sides[..., None] * moves[1]).reshape(-1, 3),
        temperature,
        time,
        rate.ravel(),
        angle,
        np.tile(felt.moving, 2 * r),
    )
    low, high = model.columns(moved).reshape(2, r, n, -1)
    return np.asarray((high - low) / (2 * _STEP))


def _followed(slopes: Array, coefficients: Array) -> Array:
    """Returns how much the observations of m outputs change per unit of each of r inputs, shape (m, n, r). `slopes`: array of shape
    (r, n, p). `coefficients`: array of shape (m, p)."""
    return np.asarray(np.einsum("mp,rnp->mnr", coefficients, slopes))


def rate_errors(quantity: InputQuantity, moved: Array, rates: Array) -> tuple[CorrelatedError, ...]:
    """Computes the errors of the observations due to a relative error of each commanded rate. The error is the same for all
    segments with the same rate. The result is empty if the table never rotates.

    `moved`: array of shape (m, n), change of the observations per relative change of the rate of each segment. `rates`: array of
    shape (n,) in rad/s.
    """
    different = np.array(sorted(set(rates[rates != 0].tolist())))  # np.unique loads masked arrays
    if not different.size:
        return ()
    own = rates[:, None] == different
    changes = {output: -change[:, None] * own for output, change in enumerate(moved)}
    return (CorrelatedError(quantity, changes, tuple(map(rate_part, different))),)


def common_rate(estimate: str, stated: Quantity | None) -> InputQuantity:
    """Returns the relative error that all rates of an estimate have in common, as an input quantity. `stated`: the relative
    standard uncertainty that the plan states, or None."""
    source = f"plan estimates.{estimate}.rate_uncertainty"
    width = stated.value if stated else 0.0
    return InputQuantity("table rate, common", 0.0, "1", width, source=source, shown="ppm", shown_factor=1e-6)


def rate_part(rate: float) -> str:
    """Returns the name of the error of one commanded rate [rad/s]. This error has the same name in all segments and estimates in
    which it acts."""
    return f"{np.degrees(rate):.9g} deg/s"


def pair_parts(table: TableModel) -> tuple[str, ...]:
    """Returns the names of the orthogonality errors between neighbouring axes of a table."""
    return tuple(f"{one.name} and {other.name}" for one, other in zip(table.axes, table.axes[1:], strict=False))


def orthogonality_tilts(
    axes: Sequence[TableAxis], attitudes: Sequence[Array | None], azimuth: float
) -> tuple[Array, ...]:
    """Computes how the sensor tilts if two neighbouring axes of a table are not at right angles. Returns, for each pair of axes,
    the tilt vectors at n attitudes, shape (n, 3), in rad per rad of deviation from the right angle.

    For a deviation of 1 rad, a vector v in the sensor's axes becomes v + tilt × v. A deviation turns the inner axis of the pair
    about c = outer × inner. The tilt is zero at the position where the table is aligned. At a joint angle q of the inner axis, the
    tilt is therefore c − R(inner, −q)·c in the frame of the inner axis. The rotations of the joints farther inside transform the
    tilt to the sensor's axes. The joints move from one attitude to the next by the fastest path. Raises `Unreachable` if the table
    cannot reach an attitude, or if an orientation is unknown.
    """
    if any(attitude is None for attitude in attitudes):
        raise Unreachable("the orientation is unknown")
    return _orthogonality_tilts(
        tuple(axes), tuple(np.asarray(one, dtype=float).tobytes() for one in attitudes), azimuth
    )


# Every estimate of a plan, and other plans, take the same orientations.
@lru_cache(maxsize=256)
def _orthogonality_tilts(
    axes: tuple[TableAxis, ...], attitudes: tuple[bytes, ...], azimuth: float
) -> tuple[Array, ...]:
    near = np.zeros(len(axes))
    directions = [np.asarray(axis.direction) for axis in axes]
    tilts = np.empty((len(axes) - 1, len(attitudes), 3))
    for n, attitude in enumerate(attitudes):
        near = joint_angles(axes, np.frombuffer(attitude).reshape(3, 3), near, azimuth)
        inward = [rotation_about(axis.direction, -float(angle)) for axis, angle in zip(axes, near, strict=True)]
        for k in range(len(axes) - 1):
            lean = cross(directions[k], directions[k + 1])
            tilt = lean - inward[k + 1] @ lean
            for turn in inward[k + 2 :]:
                tilt = turn @ tilt
            tilts[k, n] = tilt
    tilts.flags.writeable = False
    return tuple(tilts)


def _positions(position: InputQuantity, segments: Sequence[Segment], moved: Array) -> CorrelatedError:
    """Returns the errors of the observations due to position errors, one about each direction in each orientation. A position error
    is the same in all segments that have the same orientation. A position error changes only the component of a vector
    perpendicular to the direction of the error. An accelerometer that points up does not sense it; a level accelerometer senses it
    fully. `moved`: array of shape (m, n, 3), change of the observations per unit of the position error about each direction."""
    names = list(dict.fromkeys(segment.orientation for segment in segments))
    place = [names.index(segment.orientation) for segment in segments]
    m, n, _ = moved.shape
    changes = np.zeros((m, n, len(DIRECTIONS), len(names)))
    changes[:, np.arange(n), :, place] = moved.swapaxes(0, 1)
    parts = tuple(f"{name} about {word}" for word in DIRECTIONS for name in names)
    return _error(position, changes.reshape(m, n, -1), parts)


def _tilts(table: TableModel | None, attitudes: Array, site: Site) -> Array:
    """Returns the tilts of the sensor due to an orthogonality error of each pair of neighbouring axes, shape (pairs, n, 3); empty
    if the table cannot reach the attitudes."""
    if table is not None and len(table.axes) > 1:
        with suppress(Unreachable):
            return np.array(orthogonality_tilts(table.axes, list(attitudes), site.azimuth))
    return np.zeros((0, len(attitudes), 3))


def _error(quantity: InputQuantity, changes: Array, parts: tuple[str, ...] = ()) -> CorrelatedError:
    """Makes a correlated error of the outputs. `changes`: array of shape (m, n, r), change of the n observations of each of m
    outputs per unit of each of r inputs."""
    return CorrelatedError(quantity, dict(enumerate(changes)), parts)

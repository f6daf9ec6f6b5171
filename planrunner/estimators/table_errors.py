"""Errors of a table that differ between observations: positions, azimuth, right angles between its axes, and rates.

All of it makes segments scatter about a model, so that it belongs to the weights of a fit (`correlated_errors`). How far it moves an
output depends on that output's coefficients. Signs are those of a stated value that is too large; of positions, those of the turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from planrunner.error_model.terms import ErrorModel
from planrunner.estimators.interface import Setup
from planrunner.estimators.stated_influences import mean_poses, mean_stimulus
from planrunner.estimators.turned_segments import DIRECTIONS, UP
from planrunner.instruments.models import TableModel
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis, Unreachable, cross, joint_angles, rotation_about
from planrunner.physics.stimulus import Poses
from planrunner.plan.schedule import Rest, Segment, Spin
from planrunner.uncertainty.influences import InputQuantity

Array = NDArray[np.float64]

_STEP = 1e-5  # rad, or relative: of central differences, whose error is of the order of its square
_LEAN = 1e-3  # rad; central differences of terms up to the second degree are exact for any step


def table_errors(
    model: ErrorModel, segments: Sequence[Segment], site: Site, setup: Setup, coefficients: Array
) -> tuple[CorrelatedError, ...]:
    """Those for which the bench states an uncertainty. coefficients: (m, p) of m outputs, SI columns and the outputs' units."""
    inputs = setup.inputs
    found: list[CorrelatedError] = []
    poses = mean_poses(segments)
    if position := inputs.get("table position"):
        found.append(_positions(position, model, segments, poses, site, coefficients))
    if azimuth := inputs.get("azimuth"):
        ends = [model.columns(poses.felt(site, rotation_about(UP, step))) for step in (-_STEP, _STEP)]
        found.append(_of_one(azimuth, [_slope(ends, _STEP, coefficients)]))
    if (orthogonality := inputs.get("table orthogonality")) and setup.table is not None:
        found += _right_angles(orthogonality, setup.table, model, segments, poses, site, coefficients)
    if rate := inputs.get("table rate"):
        rates = np.array([one.motion.rate if isinstance(one.motion, Spin) else 0.0 for one in segments])
        ends = [model.columns(mean_stimulus(_hastened(segments, 1 + step), site)) for step in (-_STEP, _STEP)]
        found += rate_errors(rate, _slope(ends, _STEP, coefficients), rates)
    return tuple(found)


def rate_errors(quantity: InputQuantity, moved: Array, rates: Array) -> tuple[CorrelatedError, ...]:
    """A relative error of each commanded rate, the same whenever that rate comes again; nothing where nothing turns.

    moved: (m, n), change of the observations per relative change of their rates; rates: (n,), rad/s.
    """
    different = np.array(sorted(set(rates[rates != 0].tolist())))  # np.unique loads masked arrays
    if not different.size:
        return ()
    own = rates[:, None] == different
    changes = {output: -change[:, None] * own for output, change in enumerate(moved)}
    return (CorrelatedError(quantity, changes, tuple(map(rate_part, different))),)


def rate_part(rate: float) -> str:
    """Name of the error of one commanded rate [rad/s], so that it is known for the same wherever it acts."""
    return f"{np.degrees(rate):.9g} deg/s"


def orthogonality_tilts(
    axes: Sequence[TableAxis], attitudes: Sequence[Array | None], azimuth: float
) -> tuple[Array, ...]:
    """How a table turns the sensor when neighbouring axes are not at right angles: for each pair, (n, 3), rad per rad.

    A vector v in the sensor's axes becomes v + tilt × v per radian by which the inner axis of the pair leans out of its right angle, about
    c = outer × inner. The table reads zero where it is aligned, so that at joint angle q of the inner axis the error is c − R(inner, −q)·c
    in its own frame, carried inwards by the joints beyond. The joints go from one attitude to the next the quickest way. Raises
    `Unreachable`.
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


def _positions(
    position: InputQuantity,
    model: ErrorModel,
    segments: Sequence[Segment],
    poses: Poses,
    site: Site,
    coefficients: Array,
) -> CorrelatedError:
    """About each direction at each orientation, the same whenever that orientation is taken. It acts across a vector and not along it: an
    accelerometer that points up feels nothing of it, one that lies level all."""
    m, n = len(coefficients), len(segments)
    names = list(dict.fromkeys(segment.orientation for segment in segments))
    place = [names.index(segment.orientation) for segment in segments]
    changes = np.zeros((m, n, len(DIRECTIONS), len(names)))
    for k, about in enumerate(DIRECTIONS.values()):
        ends = [
            model.columns(poses.felt(site, rotation_about(about, step), axis_too=False)) for step in (-_STEP, _STEP)
        ]
        changes[:, np.arange(n), k, place] = _slope(ends, _STEP, coefficients)
    parts = tuple(f"{name} about {word}" for word in DIRECTIONS for name in names)
    return CorrelatedError(position, dict(enumerate(changes.reshape(m, n, -1))), parts)


def _right_angles(
    quantity: InputQuantity,
    table: TableModel,
    model: ErrorModel,
    segments: Sequence[Segment],
    poses: Poses,
    site: Site,
    coefficients: Array,
) -> tuple[CorrelatedError, ...]:
    """One input for each pair of neighbouring axes; nothing where the table cannot be at the orientations, or turns."""
    if len(table.axes) < 2 or not all(isinstance(segment.motion, Rest) for segment in segments):
        return ()
    try:
        tilts = orthogonality_tilts(table.axes, [segment.attitude for segment in segments], site.azimuth)
    except Unreachable:
        return ()
    felt = poses.felt(site)
    moved = []
    for tilt in tilts:
        turning, tipping = np.cross(tilt, felt.omega), np.cross(tilt, felt.specific_force)
        ends = [
            model.columns(
                replace(
                    felt,
                    omega=felt.omega + step * turning,
                    specific_force=felt.specific_force + step * tipping,
                )
            )
            for step in (-_LEAN, _LEAN)
        ]
        moved.append(-_slope(ends, _LEAN, coefficients))
    parts = tuple(f"{one.name} and {other.name}" for one, other in zip(table.axes, table.axes[1:], strict=False))
    return (_of_one(quantity, moved, parts),)


def _of_one(quantity: InputQuantity, moved: Sequence[Array], parts: tuple[str, ...] = ()) -> CorrelatedError:
    """moved: for each input, (m, n)."""
    return CorrelatedError(quantity, dict(enumerate(np.stack(moved, axis=2))), parts)


def _slope(ends: Sequence[Array], step: float, coefficients: Array) -> Array:
    """Change of the observations, (m, n), per unit of an input, from the columns (n, p) at both ends of a step either way."""
    low, high = ends
    return np.asarray(coefficients @ ((high - low) / (2 * step)).T)


def _hastened(segments: Sequence[Segment], factor: float) -> list[Segment]:
    return [
        replace(one, motion=replace(one.motion, rate=one.motion.rate * factor)) if isinstance(one.motion, Spin) else one
        for one in segments
    ]

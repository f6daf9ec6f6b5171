"""Describes the gain vector K·d of an axis in a fixture: the design matrix of several orientations, the polar form of the vector,
and the influences on it.

In each orientation, the output has a separate offset. The offset contains the bias, the dependence of the bias on gravity, and the
Earth's rotation along the axis of the table.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.interface import EstimationError, Setup
from planrunner.estimators.stated_errors import orthogonality_tilts, pair_parts, rate_errors
from planrunner.estimators.tilted.mounted_axes import MountedAxes, rotation_axis
from planrunner.estimators.tilted.turning_rates import as_recording_begins, mean_rates
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis, Unreachable, joint_angles, spin_axis
from planrunner.plan.schedule import Rest, Segment, Spin
from planrunner.uncertainty.conditions import StatedCondition
from planrunner.uncertainty.derivatives import Formula, angle_of, length

FITTED, STATED = "fitted", "stated"
AXES = ("x", "y", "z")


def tilt_part(orientation: str, axis: str) -> str:
    """Returns the name of a tilt of the fixture in one orientation. The tilt has the same name in all segments and estimates in
    which it acts."""
    return f"{orientation}, about {axis}"


@dataclass(frozen=True, slots=True)
class GainModel:
    """Describes the stimulus of n segments in several orientations.

    `felt`: array of shape (n, 3), mean rate in the fixture's frame, rad/s. `turning`: array of shape (n, 3), the part of this rate
    that comes from the table. `place`: array of shape (n,), index of the orientation.
    """

    segments: tuple[Segment, ...]
    orientations: tuple[str, ...]
    place: NDArray[np.int64]
    felt: Array
    turning: Array

    @property
    def directions(self) -> int:
        """Returns the number of linearly independent directions, in the fixture's frame, about which the table turned."""
        size = np.linalg.norm(self.turning, axis=1)
        units = self.turning[size > 0] / size[size > 0, None]
        return int(np.linalg.matrix_rank(units, tol=1e-6)) if len(units) else 0

    def terms(self, azimuth: str) -> tuple[str, ...]:
        gains = ("gain_x", "gain_y", "gain_z") if azimuth == FITTED else ("gain_across", "gain_along")
        return (*(f"offset {text}" for text in self.orientations), *gains)

    def matrix(self, basis: Array) -> Array:
        """Returns the design matrix. The matrix has one column for the offset of each orientation, followed by the columns of the
        gains. `basis`: array of shape (3, r), directions in the fixture's frame that span the gain vector."""
        return np.column_stack([np.eye(len(self.orientations))[self.place], self.felt @ basis])

    def magnitudes(self, basis: Array) -> Array:
        largest = float(np.linalg.norm(self.turning, axis=1).max(initial=1e-12))
        return np.array([1.0] * len(self.orientations) + [largest] * basis.shape[1])


def gain_model(segments: Sequence[Segment], seconds: Sequence[float | None], site: Site, setup: Setup) -> GainModel:
    """Makes the gain model of segments. Raises `EstimationError` for a segment that is neither a spin nor at rest, and for an
    unknown orientation. `seconds`: recorded durations of the segments, s."""
    for segment in segments:
        if not isinstance(segment.motion, Spin | Rest):
            kind = type(segment.motion).__name__.lower()
            raise EstimationError(
                f"segment '{segment.label}' has no constant rate ({kind}): leave it out of `segments`"
            )
        if segment.attitude is None:
            raise EstimationError(
                f"the orientation of segment '{segment.label}' is unknown, so it gives no information on the "
                "fixture's angles: give the orientation"
            )
    begun = as_recording_begins(segments, site, setup.table)
    known = tuple(dict.fromkeys(segment.orientation for segment in segments))
    rates = np.array([segment.rate for segment in segments])
    return GainModel(
        tuple(segments),
        known,
        np.array([known.index(segment.orientation) for segment in segments]),
        mean_rates(begun, site, seconds),
        rotation_axis(segments, along_z=False) * rates[:, None],
    )


def gain_basis(axes: MountedAxes, k: int, azimuth: str) -> Array:
    """Returns the directions in which the gain vector of axis k is fitted, shape (3, r). The directions are the fixture's x, y and
    z axes, or the direction of the stated azimuth and the z axis. Raises `EstimationError` if an azimuth is needed but not
    stated."""
    if azimuth == FITTED:
        return np.eye(3)
    if math.isnan(axes.azimuths[k]):
        raise EstimationError(f"mounting.{axes.names[k]} states no azimuth, which `azimuth: stated` needs")
    across = [math.cos(axes.azimuths[k]), math.sin(axes.azimuths[k]), 0.0]
    return np.array([across, [0.0, 0.0, 1.0]]).T


def polar(gain: Array, basis: Array, axes: MountedAxes, k: int) -> Formula:
    """Returns a formula that converts gain vectors to their polar form: K in output unit/(rad/s), angle [rad] and, if it is fitted,
    azimuth [rad]. From an array (r, n) of n gain vectors, it computes an array (q, n). The r gains are the components of the gain
    vector of axis k along the columns of `basis` (3, r). `gain`: array of shape (r,), a gain vector; the formula is used for gain
    vectors near it. K is negative if the gain vector points away from the stated direction. Raises `EstimationError` for an axis
    along z, which has no azimuth."""
    sign = -1.0 if float(basis @ gain @ axes.directions[k]) < 0 else 1.0
    about = 0.0 if math.isnan(axes.azimuths[k]) else float(axes.azimuths[k])
    if len(gain) == 3 and math.hypot(*gain[:2]) < 1e-9 * float(np.linalg.norm(gain)):
        raise EstimationError(
            "an axis is parallel to the fixture's z axis, so it has no azimuth: write `azimuth: stated`"
        )

    def formula(gains: Array) -> Array:
        own = sign * gains
        if len(own) == 2:
            return np.stack([sign * length(own), angle_of(own[0], own[1])])
        azimuth = angle_of(own[1], own[0])
        turns = np.round((azimuth.real - about) / (2 * math.pi))
        return np.stack([sign * length(own), angle_of(length(own[:2]), own[2]), azimuth - 2 * math.pi * turns])

    return formula


def stated_conditions(
    model: GainModel, setup: Setup, site: Site, axes: MountedAxes, k: int, azimuth: str
) -> Iterator[StatedCondition[Array]]:
    """Yields each stated input with a function that computes the design matrix of axis k for a given error of this input. Such an
    error changes the gain equally in all segments of one orientation. It therefore causes almost no scatter of the means about a
    line."""
    basis = gain_basis(axes, k, azimuth)

    def seen(by: Array) -> Array:
        """Computes the design matrix after the rates in the fixture's frame have changed by `by`, shape (n, 3)."""
        return replace(model, felt=model.felt + by).matrix(basis)

    def turned(o: int, about: Array, by: float) -> Array:
        return seen(np.where((model.place == o)[:, None], by * np.cross(model.felt, about), 0.0))

    def leaning(tilt: Array, by: float) -> Array:
        return seen(by * np.cross(tilt, model.felt))

    if position := setup.inputs.get("table position"):
        parts = {
            tilt_part(text, name): partial(turned, o, about)
            for o, text in enumerate(model.orientations)
            for name, about in zip(AXES, np.eye(3), strict=True)
        }
        yield StatedCondition(position, parts)
    if (
        (orthogonality := setup.inputs.get("table orthogonality"))
        and setup.table is not None
        and len(setup.table.axes) > 1
        and _outermost(setup.table.axes, model.segments, site.azimuth)
    ):
        try:
            tilts = orthogonality_tilts(setup.table.axes, [one.attitude for one in model.segments], site.azimuth)
        except Unreachable:
            tilts = ()
        if tilts:
            yield StatedCondition(
                orthogonality,
                dict(zip(pair_parts(setup.table), (partial(leaning, tilt) for tilt in tilts), strict=True)),
            )
    if azimuth == STATED and (mounted := setup.inputs.get(f"fixture azimuth {axes.names[k]}")):
        yield StatedCondition.single(
            mounted, lambda by: model.matrix(gain_basis(replace(axes, azimuths=axes.azimuths + by), k, azimuth))
        )


def held_rates(model: GainModel, setup: Setup, vector: Array) -> tuple[CorrelatedError, ...]:
    """Computes the errors that the stated error of each rate causes in an axis's output. These errors make the means scatter about
    a line. `vector`: array of shape (3,), gain vector of the axis."""
    rates = np.array([segment.rate for segment in model.segments])
    rate = setup.inputs.get("table rate")
    return rate_errors(rate, (model.turning @ vector)[None], rates) if rate else ()


def _outermost(axes: Sequence[TableAxis], segments: Sequence[Segment], azimuth: float) -> bool:
    """Returns True if every spin is made by the outermost axis of the table. Otherwise, the direction of the table's rate depends
    on the other axes."""
    for one in segments:
        if isinstance(one.motion, Spin) and one.attitude is not None:
            try:
                joints = joint_angles(axes, one.attitude, np.zeros(len(axes)), azimuth)
                if spin_axis(axes, joints, one.motion.about, azimuth):
                    return False
            except Unreachable:
                return False
    return True

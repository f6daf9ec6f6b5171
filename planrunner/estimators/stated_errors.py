"""How declared inputs of site and table change the observations of a linear model: an input is moved, and the model is evaluated again.

Latitude and gravity change the columns of the model. They cause no scatter between segments, so their contribution is added to that of the
data. Positions, azimuth, right angles between the table's axes, and rates differ between segments and cause scatter, so they belong to the
weights of a fit (`correlated_errors`). The size of each change depends on the coefficients of the output.
Signs are those of a stated value that is too large; of positions, those of the turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.error_model.terms import ErrorModel
from planrunner.estimators.interface import Setup
from planrunner.estimators.turned_segments import DIRECTIONS, UP
from planrunner.instruments.models import TableModel
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis, Unreachable, cross, joint_angles, rotation_about
from planrunner.physics.stimulus import Poses, Stimulus
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Rest, Segment, Spin
from planrunner.uncertainty.conditions import StatedCondition
from planrunner.uncertainty.derivatives import central
from planrunner.uncertainty.influences import InputQuantity, Inputs

Array = NDArray[np.float64]

_STEP = 1e-5  # rad, or relative: of central differences, whose error is of the order of its square
_LEAN = 1e-3  # rad; central differences of terms up to the second degree are exact for any step


def mean_poses(segments: Sequence[Segment]) -> Poses:
    """How the segments stand, spins over whole turns: at which angle recording begins in a spin is not known."""
    return Poses.of(segments, [None if isinstance(one.motion, Spin) else one.dwell for one in segments])


def mean_stimulus(segments: Sequence[Segment], site: Site) -> Stimulus:
    """The mean stimulus, for spins over whole turns."""
    return mean_poses(segments).felt(site)


@dataclass(frozen=True, slots=True)
class _Outputs:
    """m outputs of known coefficients (m, p), SI columns and the outputs' units."""

    model: ErrorModel
    coefficients: Array

    def follow(self, felt: Callable[[float], Stimulus], step: float = _STEP) -> Array:
        """Change of the observations, (m, n), per unit of an input. felt: what was felt with the input moved by so much."""
        return np.asarray(self.coefficients @ central(lambda by: self.model.columns(felt(by)), step).T)


def stated_site(inputs: Inputs, site: Site) -> Iterator[StatedCondition[Site]]:
    """Latitude and gravity, where they are stated with an uncertainty. The azimuth turns what stands on the table, not the site."""
    if latitude := inputs.get("latitude"):
        yield StatedCondition.single(latitude, lambda by: replace(site, latitude=site.latitude + by))
    if gravity := inputs.get("gravity"):
        yield StatedCondition.single(gravity, lambda by: replace(site, gravity=site.gravity + by))


def site_errors(
    model: ErrorModel, segments: Sequence[Segment], site: Site, inputs: Inputs, coefficients: Array
) -> tuple[CorrelatedError, ...]:
    """Of latitude and gravity, where they are stated with an uncertainty. The outputs are as they are: a model that expects more of them
    is answered as if they had read less. coefficients: (m, p) of m outputs, SI columns and the outputs' units."""
    poses = mean_poses(segments)

    def read_less(moved: Site) -> Array:
        return -coefficients @ model.columns(poses.felt(moved)).T

    return tuple(_of_one(one.quantity, one.answers(read_less)) for one in stated_site(inputs, site))


def table_errors(
    model: ErrorModel, segments: Sequence[Segment], site: Site, setup: Setup, coefficients: Array
) -> tuple[CorrelatedError, ...]:
    """Those for which the bench states an uncertainty. coefficients: (m, p) of m outputs, SI columns and the outputs' units."""
    inputs, outputs, poses = setup.inputs, _Outputs(model, coefficients), mean_poses(segments)
    found: list[CorrelatedError] = []
    if position := inputs.get("table position"):
        found.append(_positions(position, outputs, segments, poses, site))
    if azimuth := inputs.get("azimuth"):
        found.append(_of_one(azimuth, [outputs.follow(lambda by: poses.felt(site, rotation_about(UP, by)))]))
    if (orthogonality := inputs.get("table orthogonality")) and setup.table is not None:
        found += _right_angles(orthogonality, setup.table, outputs, segments, poses.felt(site), site)
    if rate := inputs.get("table rate"):
        rates = np.array([one.motion.rate if isinstance(one.motion, Spin) else 0.0 for one in segments])
        moved = outputs.follow(lambda by: mean_stimulus(_hastened(segments, 1 + by), site))
        found += rate_errors(rate, moved, rates)
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


def common_rate(estimate: str, stated: Quantity | None) -> InputQuantity:
    """The error that all rates share, as the plan states it for an estimate."""
    source = f"plan estimates.{estimate}.rate_uncertainty"
    width = stated.value if stated else 0.0
    return InputQuantity("table rate, common", 0.0, "1", width, source=source, shown="ppm", shown_factor=1e-6)


def rate_part(rate: float) -> str:
    """Name of the error of one commanded rate [rad/s], so that it is known for the same wherever it acts."""
    return f"{np.degrees(rate):.9g} deg/s"


def pair_parts(table: TableModel) -> tuple[str, ...]:
    """Names of the right angles between neighbouring axes of a table."""
    return tuple(f"{one.name} and {other.name}" for one, other in zip(table.axes, table.axes[1:], strict=False))


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
    position: InputQuantity, outputs: _Outputs, segments: Sequence[Segment], poses: Poses, site: Site
) -> CorrelatedError:
    """About each direction at each orientation, the same whenever that orientation is taken. It acts across a vector and not along it: an
    accelerometer that points up feels nothing of it, one that lies level all."""
    m, n = len(outputs.coefficients), len(segments)
    names = list(dict.fromkeys(segment.orientation for segment in segments))
    place = [names.index(segment.orientation) for segment in segments]
    changes = np.zeros((m, n, len(DIRECTIONS), len(names)))
    for k, about in enumerate(DIRECTIONS.values()):
        changes[:, np.arange(n), k, place] = outputs.follow(partial(_turned, poses, site, about))
    parts = tuple(f"{name} about {word}" for word in DIRECTIONS for name in names)
    return CorrelatedError(position, dict(enumerate(changes.reshape(m, n, -1))), parts)


def _right_angles(
    quantity: InputQuantity,
    table: TableModel,
    outputs: _Outputs,
    segments: Sequence[Segment],
    felt: Stimulus,
    site: Site,
) -> tuple[CorrelatedError, ...]:
    """One input for each pair of neighbouring axes; nothing where the table cannot be at the orientations, or turns."""
    if len(table.axes) < 2 or not all(isinstance(segment.motion, Rest) for segment in segments):
        return ()
    try:
        tilts = orthogonality_tilts(table.axes, [segment.attitude for segment in segments], site.azimuth)
    except Unreachable:
        return ()
    moved = []
    for tilt in tilts:
        turning, tipping = np.cross(tilt, felt.omega), np.cross(tilt, felt.specific_force)
        moved.append(-outputs.follow(partial(_leaning, felt, turning, tipping), _LEAN))
    return (_of_one(quantity, moved, pair_parts(table)),)


def _turned(poses: Poses, site: Site, about: Sequence[float], by: float) -> Stimulus:
    return poses.felt(site, rotation_about(about, by), axis_too=False)


def _leaning(felt: Stimulus, turning: Array, tipping: Array, by: float) -> Stimulus:
    return replace(felt, omega=felt.omega + by * turning, specific_force=felt.specific_force + by * tipping)


def _of_one(quantity: InputQuantity, moved: Sequence[Array], parts: tuple[str, ...] = ()) -> CorrelatedError:
    """moved: for each input, (m, n)."""
    return CorrelatedError(quantity, dict(enumerate(np.stack(moved, axis=2))), parts)


def _hastened(segments: Sequence[Segment], factor: float) -> list[Segment]:
    return [
        replace(one, motion=replace(one.motion, rate=one.motion.rate * factor)) if isinstance(one.motion, Spin) else one
        for one in segments
    ]

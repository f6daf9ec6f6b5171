"""Finds the positions of a plan that a design may move, and the response of an estimate at any other attitude.

A place is one orientation in the text of the plan, together with the segments that rest in this orientation. Segments with the same
place (repeats, temperatures) are moved together. The estimator itself computes the information of a position at rest, so this
module does not depend on the kind of sensor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.estimators.interface import Design, DesignBlock, DesignRequest, EstimationError, Setup, estimator_of
from planrunner.instruments.models import SensorModel
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis, Unreachable, joint_angles, transition_time
from planrunner.plan.model import EstimateSpec
from planrunner.plan.schedule import Rest, Segment, Spin
from planrunner.plan.selection import select


@dataclass(frozen=True, slots=True)
class Place:
    """One orientation in the text of a plan. `mark`: pair (line, column) of the orientation in the plan. `segments`: the segments
    at rest in this orientation, in the order of the plan."""

    mark: tuple[int, int]
    segments: tuple[Segment, ...]

    @property
    def label(self) -> str:
        return self.segments[0].label

    @property
    def attitude(self) -> Array:
        assert self.segments[0].attitude is not None
        return self.segments[0].attitude


@dataclass(frozen=True, slots=True)
class Sight:
    """Describes how one output of an estimate responds to the attitude of the sensor: contains the terms of the estimate, and
    computes the rows of its design matrix at any attitude.

    `magnitudes`: array of shape (p,), the magnitudes by which the columns are divided. `fixed`: rows (k, p) of the segments that
    the design leaves unchanged, such as spins, in units of the noise of a segment at rest.
    """

    name: str
    spec: EstimateSpec
    output: str
    others: tuple[str, ...]
    terms: tuple[str, ...]
    template: Segment
    site: Site
    sensor: SensorModel
    uses: Mapping[str, Design]
    setup: Setup
    magnitudes: Array
    fixed: Array

    def rows(self, attitudes: Array) -> Array:
        """Returns the rows (m, p) of the design matrix for attitudes (m, 3, 3). The columns are divided by their magnitudes."""
        segments = tuple(replace(self.template, attitude=attitude) for attitude in attitudes)
        design = _design(self.name, self.spec, segments, self.site, self.sensor, self.uses, self.setup)
        return np.asarray(self._block(design).matrix / self.magnitudes)

    def _block(self, design: Design | None) -> DesignBlock:
        assert design is not None
        return next(block for block in design.blocks if block.output == self.output)


def places(segments: Sequence[Segment], patterns: Sequence[str]) -> tuple[tuple[Place, ...], tuple[Segment, ...]]:
    """Returns the places of the segments that an estimate uses, and the spinning segments that it uses. The design leaves the
    spinning segments unchanged. Raises `EstimationError` for segments that a design of positions cannot move."""
    chosen = set(select([segment.label for segment in segments], patterns))
    groups: dict[tuple[int, int], list[Segment]] = {}
    spins = tuple(segments[index] for index in sorted(chosen) if isinstance(segments[index].motion, Spin))
    for index in sorted(chosen):
        segment = segments[index]
        if isinstance(segment.motion, Spin) and len(spins) < len(chosen):
            continue
        if not isinstance(segment.motion, Rest) or segment.attitude is None:
            why = "has no known orientation" if segment.attitude is None else "moves while it records"
            raise EstimationError(
                f"segment '{segment.label}' {why}: positions can be designed for segments at rest only"
            )
        groups.setdefault(_mark(segment), []).append(segment)
    for index, segment in enumerate(segments):
        if index not in chosen and _mark(segment) in groups:
            shared = groups[_mark(segment)][0].label
            raise EstimationError(
                f"segment '{segment.label}' has the same orientation as '{shared}', but the two belong to different estimates: write a "
                "separate orientation for it"
            )
    sizes = {len(group) for group in groups.values()}
    if len(sizes) > 1:
        raise EstimationError("the positions are recorded a different number of times; record each equally often")
    return tuple(Place(mark, tuple(group)) for mark, group in groups.items()), spins


def sight(
    name: str,
    spec: EstimateSpec,
    found: Sequence[Place],
    site: Site,
    sensor: SensorModel,
    uses: Mapping[str, Design],
    setup: Setup,
    spins: Sequence[Segment] = (),
    output: str | None = None,
) -> Sight:
    """Returns the response of an estimate at the given places. The spinning segments are not changed. `output`: name of the output,
    required if the design matrices of the outputs differ. Raises `EstimationError` if the estimate cannot be designed."""
    at_rest = tuple(place.segments[0] for place in found)
    design = _design(name, spec, (*at_rest, *spins), site, sensor, uses, setup)
    if design is None or not design.blocks:
        raise EstimationError(f"'{name}' ({spec.estimator}) has no design matrix to improve")
    names = [block.output for block in design.blocks]
    if output is not None and output not in names:
        raise EstimationError(f"'{name}' has no output '{output}'; it has {', '.join(names)}")
    block = design.blocks[names.index(output) if output else 0]
    alike = tuple(
        other.output
        for other in design.blocks
        if other.terms == block.terms and np.allclose(_scaled(other), _scaled(block))
    )
    if output is None and len(alike) < len(names):
        raise EstimationError(
            f"the outputs of '{name}' have different models: choose one of {', '.join(names)} with --output"
        )
    template = found[0].segments[0]
    moved = {segment.label for segment in at_rest}
    stays = np.array([label not in moved for label in block.labels], dtype=bool)
    if stays.all():
        raise EstimationError(
            f"the positions of segments at rest do not affect '{name}' ({spec.estimator}); use --rates to design its rates"
        )
    noise = np.asarray(block.sigma, dtype=float)
    typical = float(np.sqrt(np.mean(noise[~stays] ** 2))) if (~stays).any() else 0.0
    relative = typical / noise[stays] if typical > 0 and np.all(noise[stays] > 0) else np.ones(int(stays.sum()))
    share = relative / np.sqrt(len(found[0].segments))  # spins are run once, positions are run several times
    return Sight(
        name,
        spec,
        block.output,
        alike,
        tuple(block.terms),
        template,
        site,
        sensor,
        uses,
        setup,
        np.asarray(block.magnitudes, dtype=float),
        _scaled(block)[stays] * share[:, None],
    )


def _design(
    name: str,
    spec: EstimateSpec,
    segments: tuple[Segment, ...],
    site: Site,
    sensor: SensorModel,
    uses: Mapping[str, Design],
    setup: Setup,
) -> Design | None:
    estimator = estimator_of(spec)
    return estimator.design(DesignRequest(name, segments, spec.parameters, site, sensor, uses, setup))


def _scaled(block: DesignBlock) -> Array:
    return np.asarray(block.matrix / block.magnitudes)


def _mark(segment: Segment) -> tuple[int, int]:
    mark = segment.marks.get("orientation") or segment.marks[""]
    return mark.line, mark.column


# -- the table -------------------------------------------------------------------------------------------------------


def attitudes(axes: Sequence[TableAxis], settings: Array, azimuth: float) -> Array:
    """Returns the attitudes (m, 3, 3), with the sensor's axes as rows in East-North-Up, at joint angles (m, k) [rad]. The
    computation is efficient for many angles."""
    platform = np.broadcast_to(_turned(np.array([0.0, 0.0, 1.0]), np.array([-azimuth])), (len(settings), 3, 3))
    for axis, angles in zip(axes, settings.T, strict=True):
        platform = platform @ _turned(np.asarray(axis.direction, dtype=float), angles)
    return np.asarray(platform.transpose(0, 2, 1))


def _turned(axis: Array, angles: Array) -> Array:
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sine * skew + versine * (skew @ skew))


def reachable(axes: Sequence[TableAxis], wanted: Sequence[Array], azimuth: float) -> tuple[list[Array], Array]:
    """Returns the attitudes that the table can reach, and joint angles (m, k) near zero that give these attitudes."""
    kept, settings = [], []
    for attitude in wanted:
        try:
            settings.append(joint_angles(axes, attitude, np.zeros(len(axes)), azimuth))
        except Unreachable:
            continue
        kept.append(attitude)
    return kept, np.array(settings).reshape(-1, len(axes))


def quick_order(axes: Sequence[TableAxis], wanted: Sequence[Array], azimuth: float) -> list[int]:
    """Returns an order of the attitudes in which the table moves little. The search always takes the nearest remaining attitude
    next, and then exchanges pairs of attitudes if this shortens the path."""

    def travel(order: Sequence[int]) -> float:
        joints, total = np.zeros(len(axes)), 0.0
        for index in order:
            target = joint_angles(axes, wanted[index], joints, azimuth)
            total += transition_time(axes, joints, target)
            joints = target
        return total

    order: list[int] = []
    joints, left = np.zeros(len(axes)), list(range(len(wanted)))
    while left:
        targets = [joint_angles(axes, wanted[index], joints, azimuth) for index in left]
        times = [transition_time(axes, joints, target) for target in targets]
        place = int(np.argmin(times))
        joints = targets[place]
        order.append(left.pop(place))
    best = travel(order)
    pairs = [(i, j) for i in range(len(order)) for j in range(i)] if len(order) <= 12 else []
    for i, j in pairs:
        tried = list(order)
        tried[i], tried[j] = tried[j], tried[i]
        seconds = travel(tried)
        if seconds < best - 1e-9:
            order, best = tried, seconds
    return order

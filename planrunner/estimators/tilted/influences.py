"""Computes the Type B influences on scale factors of tilted axes. The sources of these influences are the fixture, the table, the
site, the temperature, the resolution, and drift of the zero.

Fixture, table and site are arguments (`conditions`) of the function that computes the results. The other sources change the means of
segments. Each change of a mean is multiplied by the sensitivity of the results to this mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.stated_errors import UP, rate_part
from planrunner.estimators.tilted.evaluation import (
    QUANTITIES,
    Group,
    K,
    TiltedConditions,
    TiltedResults,
    Worst,
    answers_to_averages,
    evaluate,
)
from planrunner.estimators.tilted.fixture_gains import tilt_part
from planrunner.estimators.tilted.scatter import in_common
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import rotation_about
from planrunner.physics.stimulus import Poses
from planrunner.plan.schedule import Segment
from planrunner.uncertainty.conditions import StatedCondition, influences_on, slopes
from planrunner.uncertainty.influences import Aspect, Influence, InputQuantity, Inputs

_BESIDE = 1e-6  # rad, step of numerical derivatives


@dataclass(frozen=True, slots=True)
class Situation:
    """Contains the data from which the influences are computed.

    `answers`: for each group (the rates at one temperature), the sensitivities of the group's quantities to the outputs at its
    rates, shape (n, m, 5). `gradient`: derivatives of `TiltedResults.vector` with respect to the means of all groups. `reference`:
    index of the group at the reference temperature. `segments`: the segments with their attitude at the start of the recording.
    `seconds`: recorded durations of the segments, s. `home`: the home orientation in words. `units`: units of the outputs.
    `fixture`: influences on the angles of the m axes [rad], if these angles come from a calibration instead of the plan; otherwise
    empty.
    """

    groups: tuple[Group, ...]
    conditions: TiltedConditions
    found: TiltedResults
    worst: Worst
    reference: int
    answers: tuple[Array, ...]
    gradient: Array
    segments: tuple[Segment, ...]
    seconds: tuple[float | None, ...]
    site: Site
    home: str
    units: tuple[str, ...]
    fixture: tuple[Influence, ...] = ()

    def again(self, conditions: TiltedConditions) -> Array:
        """Computes `TiltedResults.vector` for other conditions. Results that cannot be computed are set to zero."""
        return np.nan_to_num(evaluate(self.groups, conditions, self.reference, self.worst).vector)


@dataclass(frozen=True, slots=True)
class Rounding:
    """Describes the rounding error in the means of one output. `share`: rounding error of a mean divided by the rounding error of a
    single sample, 1 if the rounding errors do not average out. `in_scatter`: True if the samples vary, so that their scatter
    includes the rounding error."""

    share: float
    in_scatter: bool


def influences(
    situation: Situation,
    inputs: Inputs,
    common: InputQuantity,
    basis: str,
    rounding: Mapping[str, Rounding] | None = None,
    flicker: Sequence[CorrelatedError] = (),
    drifts: Mapping[int, float] | None = None,
) -> list[Influence]:
    """Returns the influences on `TiltedResults.vector`.

    `inputs`: values that bench and plan state with an uncertainty. `common`: relative error that all rates have in common.
    `rounding`: maps each output to the rounding error of its means. `flicker`: declared flicker in the means of segments, if the
    basis of uncertainty includes it. `drifts`: maps the index of an axis to half of the change of its zero.
    """
    found = [
        *_calibrated_fixture(situation),
        *influences_on(situation.again, _conditions(situation, inputs, common)),
        *_temperature(situation, inputs),
        *_resolution(situation, inputs, rounding or {}),
        *_flicker(situation, flicker, basis),
        *_zero_drift(situation, basis, drifts or {}),
    ]
    return [item for item in found if item.quantity.standard_uncertainty > 0]


def _conditions(
    situation: Situation, inputs: Inputs, common: InputQuantity
) -> Iterator[StatedCondition[TiltedConditions]]:
    """Yields a `StatedCondition` for each input that is stated with an uncertainty. Each of them contains functions that return the
    conditions of the evaluation for a given error of the input. Two inputs are errors of the rates. The bench states the
    uncertainty of a separate error for each rate; this error is the same in all repeats of the rate. The plan states the
    uncertainty of an error that all rates have in common (`common`)."""
    conditions, site = situation.conditions, situation.site
    axes, commanded = conditions.axes, conditions.commanded
    if not situation.fixture:
        for k, name in enumerate(axes.names):
            if stated := inputs.get(f"fixture angle {name}"):
                yield StatedCondition.single(stated, partial(_with_angle, conditions, k))
    if rate := inputs.get("table rate"):
        different = np.unique(commanded[commanded != 0])
        yield StatedCondition(
            rate,
            {rate_part(one): partial(_with_rates, conditions, (commanded == one).astype(float)) for one in different},
        )
    if common.standard_uncertainty:
        yield StatedCondition.single(common, partial(_with_rates, conditions, np.ones(len(commanded))))
    if position := inputs.get("table position"):
        parts = {
            tilt_part(situation.home, name): partial(_with_tilt, conditions, axis) for axis, name in enumerate("xy")
        }
        yield StatedCondition(position, parts)
    if conditions.felt is None:
        return

    poses = Poses.of(situation.segments, situation.seconds)

    def felt(earth: Array) -> TiltedConditions:
        return replace(conditions, felt=poses.mean @ earth + poses.spin)

    if latitude := inputs.get("latitude"):
        yield StatedCondition.single(
            latitude, lambda by: felt(replace(site, latitude=site.latitude + by).earth_rate_enu)
        )
    if azimuth := inputs.get("azimuth"):  # if the table is turned east, the Earth's rate appears turned west
        yield StatedCondition.single(azimuth, lambda by: felt(rotation_about(UP, by) @ site.earth_rate_enu))


def _calibrated_fixture(situation: Situation) -> Iterator[Influence]:
    """Yields the influences of the calibrated angles of the axes on the results."""
    if situation.fixture:
        angles = range(len(situation.conditions.axes.names))
        moved = [partial(_with_angle, situation.conditions, k) for k in angles]
        gradient = np.column_stack(slopes(situation.again, moved, _BESIDE))
        yield from (item.through(gradient) for item in situation.fixture)


def _temperature(situation: Situation, inputs: Inputs) -> Iterator[Influence]:
    """Yields the influence of an error of the thermometer that shifts all temperatures equally. K then belongs to a different
    temperature, but the temperature coefficient of K does not change."""
    stated, found = inputs.get("temperature"), situation.found
    if stated is None or not np.isfinite(found.coefficient).all():
        return
    means = np.zeros_like(found.means)
    means[..., K] = found.coefficient * found.means[situation.reference, :, K]
    sensitivities = np.zeros(len(found.vector))
    sensitivities[: means.size] = means.ravel()
    yield Influence(stated, sensitivities[:, None])


def _resolution(situation: Situation, inputs: Inputs, rounding: Mapping[str, Rounding]) -> Iterator[Influence]:
    """Yields the influence of the rounding of each mean. The rounding error is assumed to be the same in every repeat."""
    for axis, output in enumerate(situation.conditions.axes.outputs):
        stated, left = inputs.of_output(Aspect.RESOLUTION, output), rounding.get(output)
        if stated is not None and left is not None:
            acting = _by_courses(situation, stated, axis, _each_rate)
            yield replace(acting, sensitivities=left.share * acting.sensitivities, in_scatter=left.in_scatter)


def _flicker(situation: Situation, flicker: Sequence[CorrelatedError], basis: str) -> Iterator[Influence]:
    """Yields the influences of flicker, which changes the mean of each segment according to the time of the segment. If `basis` is
    `residual`, the covariance of the results already includes these influences."""
    if not flicker:
        return
    each = [
        np.einsum("jap,jn,ab->apbn", answers_to_averages(answers), group.averages, np.eye(answers.shape[1]))
        for group, answers in zip(situation.groups, situation.answers, strict=True)
    ]
    functionals = np.concatenate([one.reshape(-1, *one.shape[2:]) for one in each])
    for effect in flicker:
        yield effect.through(functionals, basis == "residual").through(situation.gradient)


def unstated_influences(
    situation: Situation, silent: Sequence[CorrelatedError], basis: str
) -> Iterator[tuple[CorrelatedError, Influence]]:
    """Computes how flicker of unknown size influences `TiltedResults.vector`. Yields each flicker together with its influence. If
    `basis` is `repeats`, an influence contains only the part that all repeats have in common. The scatter of the repeats shows the
    other part."""
    for error in silent:
        if basis == "repeats":
            pairs = zip(situation.groups, situation.answers, strict=True)
            common = np.concatenate([in_common(group, answers, [error]) for group, answers in pairs])
            yield error, Influence(error.quantity, situation.gradient * np.sqrt(common))
        else:
            yield from ((error, one) for one in _flicker(situation, [error], "within_segment"))


def _zero_drift(situation: Situation, basis: str, drifts: Mapping[int, float]) -> Iterator[Influence]:
    """Yields the influence of a drift of the zero. During the rates, the zero is assumed to lie between the start zero and the end
    zero: it differs from their mean by at most half of the difference between the two.

    Two shapes of the drift are considered: the same offset at all rates, and a steady change from one end of the series to the
    other. An offset causes no residuals. A steady change causes residuals about the line. If `basis` is `residual`, the scatter
    therefore already includes the steady change.
    """
    courses = _offset if basis == "residual" else _drift_courses
    for axis, half in drifts.items():
        text, spread = situation.units[axis], half / math.sqrt(3)
        name = f"zero drift {situation.conditions.axes.outputs[axis]}"
        quantity = InputQuantity(name, 0.0, text, spread, distribution="rectangular", source="start and end zeros")
        yield _by_courses(situation, quantity, axis, courses)


def _each_rate(n: int) -> dict[str, Array]:
    return {f"rate {row + 1}": one for row, one in enumerate(np.eye(n))}


def _offset(n: int) -> dict[str, Array]:
    return {"offset": np.ones(n)}


def _drift_courses(n: int) -> dict[str, Array]:
    return {**_offset(n), "steady change": np.linspace(-1, 1, n)}


def _by_courses(
    situation: Situation, quantity: InputQuantity, axis: int, courses: Callable[[int], dict[str, Array]]
) -> Influence:
    """Returns the influence of an error of one output. `courses`: a function that returns the shapes of the error over the n rates
    of a series. The errors at different temperatures are independent of each other. `axis`: index of this output's axis."""
    columns, parts = [], []
    width = situation.answers[0].shape[1] * len(QUANTITIES)
    for k, (group, answers) in enumerate(zip(situation.groups, situation.answers, strict=True)):
        for name, course in courses(len(group.rates)).items():
            change = np.zeros(answers.shape[1:])
            change[axis] = course @ answers[:, axis]
            columns.append(situation.gradient[:, k * width : (k + 1) * width] @ change.ravel())
            parts.append(f"{group.label} {name}")
    return Influence(quantity, np.column_stack(columns), parts=tuple(parts))


def _with_rates(conditions: TiltedConditions, which: Array, by: float) -> TiltedConditions:
    return replace(conditions, rate_error=by * which)


def _with_angle(conditions: TiltedConditions, axis: int, by: float) -> TiltedConditions:
    angles = conditions.axes.angles + by * (np.arange(len(conditions.axes.angles)) == axis)
    return replace(conditions, axes=replace(conditions.axes, angles=angles))


def _with_tilt(conditions: TiltedConditions, about: int, by: float) -> TiltedConditions:
    x, y = by * np.eye(2)[about]
    return replace(conditions, axes=replace(conditions.axes, tilt=(float(x), float(y))))

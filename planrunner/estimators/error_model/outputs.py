"""Builds the models of an estimate: the effects that act on each output in each segment, or the reason why there is no model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.base.said import Said, said
from planrunner.error_model.effects.interface import (
    ChangesWithinSegments,
    Effect,
    ExplainsTurning,
    effect_named,
    shown_by,
)
from planrunner.error_model.observed import axis_of
from planrunner.error_model.sample_columns import ErrorsAtSamples
from planrunner.error_model.segment_columns import (
    KINDS,
    Amplitude,
    EffectPart,
    ErrorsAtSegments,
    OutputColumns,
    OutputErrors,
    SegmentStates,
    estimable,
)
from planrunner.estimators.error_model.parameters import AXES, ErrorModelParameters
from planrunner.estimators.error_model.sampled_outputs import SampledOutputs
from planrunner.estimators.error_model.within import SampledOutput, WithinFit, fit_within
from planrunner.estimators.interface import EffectAbsentError, EstimationError
from planrunner.estimators.stated_errors import mean_stimulus
from planrunner.instruments.models import SensorModel
from planrunner.physics.earth import Site
from planrunner.physics.stimulus import StimulusError
from planrunner.plan.schedule import Motion, RecordedMotion, Rest, Rock, Segment
from planrunner.plan.units import DIMENSIONS, Unit, UnknownUnitError, unit

T = TypeVar("T")

_PER = {"gyro": "deg/s", "accel": "g"}
_WORDS = {"gyro": "a gyro", "accel": "an accelerometer"}
_SENSED = {"angular rate": "gyro", "acceleration": "accel"}


@dataclass(frozen=True, slots=True)
class ReportedAmplitude:
    """Describes how one amplitude is reported.

    `si`: SI value of one `unit`. `common`: True if all outputs whose model contains the amplitude share one value. `origin`: the
    reported value, in `unit`, that corresponds to a fitted value of zero.
    """

    name: str
    unit: str
    si: float
    description: Said
    common: bool = False
    origin: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ModelledOutput:
    """The linear model of one output. If the output is recorded in the unit of the measured quantity (`direct`), the model is means
    = own/unit.factor + matrix · amplitudes, where `own` and `matrix` are fields of `columns`. Otherwise, the amplitude with the
    index `gain` is the complete scale factor, by which the other columns are also multiplied.

    `rows`: indices of the output's segments among the segments of the estimate. `gain`: index of the scale factor among the
    amplitudes; None if the scale factor is not fitted. `within`: the fit to the output's samples; the model is linearised around
    its result. `within` is None if the output needs only the means. `followed`: empty unless `within` is given. `followed` contains
    (effect, name) of each amplitude that determines how errors of the table and the site affect the output.
    """

    errors: OutputErrors
    unit: Unit
    columns: OutputColumns
    rows: tuple[int, ...]
    coefficients: tuple[ReportedAmplitude, ...]
    gain: int | None
    within: WithinFit | None = None
    followed: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        return self.errors.output

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(one.name for one in self.coefficients)

    @property
    def direct(self) -> bool:
        return self.unit.dimension == unit(KINDS[self.errors.kind]).dimension

    @property
    def ideal(self) -> Array | float:
        """Returns the part of the observed means that is not fitted, in the output's unit, shape (n,). If no scale factor is
        fitted, this part is the reading of an ideal sensor; otherwise it is zero."""
        if self.within is not None:
            return self.within.offset
        return 0.0 if self.gain is not None else self.columns.own / self.unit.factor

    def reported(self, fitted: Array) -> Array:
        """Converts n sets of fitted coefficients to reported coefficients, each in its own unit. The fitted coefficients are in the
        output's unit per SI unit; both arrays have the shape (p, n)."""
        if self.direct:
            values = fitted * self.unit.factor
            if self.gain is not None:
                values = values - (np.arange(len(fitted)) == self.gain)[:, None]
        else:
            assert self.gain is not None
            scale = fitted[self.gain]
            values = np.stack([one if place == self.gain else one / scale for place, one in enumerate(fitted)])
        si, origins = (
            np.array(own)[:, None] for own in zip(*((c.si, c.origin) for c in self.coefficients), strict=True)
        )
        return np.asarray(values / si + origins)

    def ratios(self, fitted: Array) -> dict[int, float]:
        """Maps each axis to the response of the output along this axis (a ratio, SI), for fitted amplitudes (p,). The response
        along the output's own axis is 1 if no scale factor is fitted."""
        own = {} if self.gain is not None else {self.errors.axis: 1.0}
        along = [one.along for one in self.columns.amplitudes]
        return own | {
            axis: float(value) * self.unit.factor for axis, value in zip(along, fitted, strict=True) if axis is not None
        }

    def response(self, fitted: Array) -> Array:
        """Computes the response of the output to its own input and to each column. Returns an array of shape (1 + p,) for p fitted
        coefficients."""
        if self.within is not None:
            own = {(one.effect.id, one.name): n for n, one in enumerate(self.columns.amplitudes)}
            fitted = np.array([fitted[own[key]] if key in own else 0.0 for key in self.followed])
        return np.concatenate([[0.0 if self.gain is not None else 1 / self.unit.factor], fitted])


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """Describes a group of outputs that use the same segments. `rows`: indices of these segments among the segments of the
    estimate."""

    model: ErrorsAtSegments
    segments: tuple[Segment, ...]
    rows: tuple[int, ...]
    outputs: tuple[ModelledOutput, ...]


def models(
    parameters: ErrorModelParameters,
    units: Mapping[str, str],
    sensor: SensorModel,
    segments: Sequence[Segment],
    site: Site,
    states: SegmentStates,
    samples: SampledOutputs,
) -> tuple[Together, ...]:
    """Builds the models of all outputs.

    `units`: maps each output to its unit, as declared or recorded. `states`: states of all segments. `samples`: samples of all
    segments. Raises `EstimationError` if the outputs, the effects and the segments do not fit each other.
    """
    for name in parameters.axes:
        if name not in parameters.outputs:
            raise EstimationError(f"`axes` names '{name}'", closest(name, parameters.outputs), f"axes.{name}")
    effects: dict[str, Effect] = {}
    named = [_errors(name, parameters, units, sensor, effects) for name in parameters.outputs]
    groups: dict[tuple[bool, tuple[int, ...]], list[OutputErrors]] = {}
    for one in named:
        rows = _usable(one, segments)
        sampled = changes_within(one) or any(isinstance(segments[row].motion, Rock | RecordedMotion) for row in rows)
        groups.setdefault((sampled, samples.in_time(rows) if sampled else rows), []).append(one)
    return tuple(
        (_sampled if sampled else _together)(group, rows, units, segments, site, states, samples)
        for (sampled, rows), group in groups.items()
    )


def changes_within(one: OutputErrors) -> bool:
    """Returns True if an effect changes an output within segments."""
    return any(isinstance(part.effect, ChangesWithinSegments) for part in one.chosen)


def with_shape(group: Together, k: int, part: EffectPart) -> Together:
    """Returns a copy of the group in which the shape (such as the time constant) of one effect has another value. `part`: this
    effect, with the new value. The effect belongs to the model of the k-th output."""
    old = group.outputs[k]
    errors = replace(old.errors, chosen=tuple(part if one.effect is part.effect else one for one in old.errors.chosen))
    (columns,) = replace(group.model, outputs=(errors,)).of_outputs()
    made = _modelled(errors, old.unit, columns, old.rows)
    return replace(
        group,
        model=replace(group.model, outputs=_with(group.model.outputs, k, errors)),
        outputs=_with(group.outputs, k, made),
    )


def _with(items: tuple[T, ...], k: int, item: T) -> tuple[T, ...]:
    return (*items[:k], item, *items[k + 1 :])


def _errors(
    name: str,
    parameters: ErrorModelParameters,
    units: Mapping[str, str],
    sensor: SensorModel,
    loaded: dict[str, Effect],
) -> OutputErrors:
    key = f"outputs.{name}"
    if name not in units:
        raise EstimationError(f"there is no output '{name}'", closest(name, units), key)
    axis = parameters.axes.get(name)
    place = axis_of(name) if axis is None else AXES.index(axis)
    if place is None:
        hint = f"write for example `axes: {{{name}: z}}`"
        raise EstimationError(f"the name '{name}' does not contain the axis along which the output measures", hint, key)
    whole: dict[str, set[str]] = {}
    for text in parameters.outputs[name]:
        effect, _, part = text.partition(".")
        whole.setdefault(effect, set()).add(part)
    chosen = []
    for effect, parts in whole.items():
        if effect not in loaded:
            loaded[effect] = effect_named(effect)
        if why := estimable(loaded[effect]):
            raise EstimationError(f"'{effect}' cannot be estimated here: {why}", "leave it out of `outputs`", key)
        chosen.append(EffectPart(loaded[effect], () if "" in parts else tuple(sorted(parts))))
    return OutputErrors(name, _kind(name, units[name], sensor), place, tuple(chosen))


def _kind(name: str, text: str, sensor: SensorModel) -> str:
    try:
        own = unit(text)
    except UnknownUnitError as error:
        raise EstimationError(str(error)) from None
    for dimension, kind in _SENSED.items():
        if own.dimension == DIMENSIONS[dimension]:
            return kind
    output = sensor.output(name)
    if output is not None and output.senses is not None:
        return _SENSED[output.senses]
    if own.dimension == unit("pulse/s").dimension:
        return "gyro"
    hint = "name an output of angular rate, acceleration or pulses"
    raise EstimationError(
        f"'{name}' is in {text}, which is neither a rate nor an acceleration", hint, f"outputs.{name}"
    )


def _usable(one: OutputErrors, segments: Sequence[Segment]) -> tuple[int, ...]:
    """Returns the indices of the segments that an output can use. A gyro uses all segments whose rate is known. An accelerometer
    uses three kinds of segments: segments at rest, segments in which other accelerometers show the specific force, and turns if an
    effect describes what the accelerometer measures while turning."""
    turns = any(isinstance(item.effect, ExplainsTurning) for item in one.chosen)

    def shown(motion: Motion) -> bool:
        if one.kind == "gyro":
            return not isinstance(motion, RecordedMotion) or motion.channels != motion.forces
        return turns or isinstance(motion, Rest) or (isinstance(motion, RecordedMotion) and bool(motion.forces))

    rows = tuple(row for row, segment in enumerate(segments) if shown(segment.motion))
    if not rows and one.kind == "gyro":
        message = f"no segment shows the rate of '{one.output}': only accelerometers show the motion"
        raise EstimationError(message, "name `rates` or `attitude` for the motion", f"outputs.{one.output}")
    if not rows:
        hint = "add segments at rest, or `lever_arm` to the effects of the output"
        message = (
            f"'{one.output}' needs segments at rest, but all segments turn, and away from the axis of "
            f"rotation an accelerometer also senses the turning"
        )
        raise EstimationError(message, hint, f"outputs.{one.output}")
    return rows


def _together(
    group: Sequence[OutputErrors],
    rows: tuple[int, ...],
    units: Mapping[str, str],
    segments: Sequence[Segment],
    site: Site,
    states: SegmentStates,
    _: SampledOutputs,
) -> Together:
    chosen = tuple(segments[row] for row in rows)
    try:
        felt = mean_stimulus(chosen, site)
    except StimulusError as error:
        raise EstimationError(str(error)) from None
    model = ErrorsAtSegments(tuple(group), chosen, site, states.at(rows), felt)
    parts = model.of_outputs()
    outputs = tuple(_modelled(one, unit(units[one.output]), part, rows) for one, part in zip(group, parts, strict=True))
    return Together(model, chosen, rows, outputs)


def _sampled(
    group: Sequence[OutputErrors],
    rows: tuple[int, ...],
    units: Mapping[str, str],
    segments: Sequence[Segment],
    site: Site,
    states: SegmentStates,
    samples: SampledOutputs,
) -> Together:
    """Returns the models of the outputs of a group that is fitted to samples."""
    held = tuple(_as_if_held(segments[row]) for row in rows)
    try:
        felt = mean_stimulus(held, site)
    except StimulusError as error:
        raise EstimationError(str(error)) from None
    outputs, followed = [], []
    for one in samples.of(group, rows):
        errors, own = one.errors, unit(units[one.errors.output])
        _must_change(one)
        fit = fit_within(one)
        columns = OutputColumns(fit.own, fit.available, fit.amplitudes, fit.matrix)
        made = _modelled(errors, own, columns, rows)
        steady = tuple(
            replace(part, shape=fit.shapes.get(part.effect.id))
            for part in errors.chosen
            if not isinstance(part.effect, ChangesWithinSegments)
        )
        followed.append(replace(errors, chosen=steady))
        outputs.append(replace(made, within=fit))
    model = ErrorsAtSegments(tuple(followed), held, site, states.at(rows), felt)
    names = [tuple((a.effect.id, a.name) for a in columns.amplitudes) for columns in model.of_outputs()]
    whole = tuple(replace(one, followed=own) for one, own in zip(outputs, names, strict=True))
    return Together(model, held, rows, whole)


def _as_if_held(segment: Segment) -> Segment:
    """Returns a simplified segment for the computation of errors of the table and the site. A table that rocks, or whose motion is
    known only from the recording, is treated like a table at rest. If the attitude is unknown, it is set to zero, so that these
    errors have no influence."""
    if not isinstance(segment.motion, Rock | RecordedMotion):
        return segment
    attitude = np.zeros((3, 3)) if segment.attitude is None else segment.attitude
    return replace(segment, motion=Rest(), attitude=attitude)


def _must_change(output: SampledOutput) -> None:
    """Raises `EstimationError` for an effect within segments that cannot act in this plan, or that cannot be computed for an output
    in this unit."""
    errors = output.errors
    key, model = f"outputs.{errors.output}", ErrorsAtSamples.of(output.observed, errors)
    for part in errors.chosen:
        if not isinstance(part.effect, ChangesWithinSegments):
            continue
        if not len(model.grid(part)):
            raise _absent(part.effect, errors)
        if part.effect.acts_on == "output" and output.unit.dimension != unit(KINDS[errors.kind]).dimension:
            message = f"'{part.effect.id}' has a shape in {part.effect.shape_unit}, but {errors.output} is in {output.unit.text}"
            raise EstimationError(message, "leave it out, or record the output as a rate", key)


def _modelled(errors: OutputErrors, own: Unit, columns: OutputColumns, rows: tuple[int, ...]) -> ModelledOutput:
    _must_act(errors, columns)
    gains = [place for place, one in enumerate(columns.amplitudes) if one.along == errors.axis]
    coefficients = tuple(_coefficient(errors, own, one) for one in columns.amplitudes)
    made = ModelledOutput(errors, own, columns, rows, coefficients, gains[0] if gains else None)
    if not made.direct and made.gain is None:
        message = (
            f"'{errors.output}' is recorded in {own.text}: without its scale factor, its errors cannot be "
            f"expressed in units of {_PER[errors.kind]}"
        )
        raise EstimationError(message, f"add `{errors.kind}_scale_factor` to its effects", f"outputs.{errors.output}")
    return made


def _must_act(errors: OutputErrors, columns: OutputColumns) -> None:
    """Raises `EstimationError` for an effect that cannot act in this plan, and for a parameter that does not belong to its
    effect."""
    key = f"outputs.{errors.output}"
    for item in errors.chosen:
        here = [one.name for one in columns.amplitudes if one.effect is item.effect]
        if isinstance(item.effect, ChangesWithinSegments) and not item.only:
            continue  # see `_must_change`
        missing = [name for name in item.only if name not in here]
        effect = item.effect.id
        if missing:
            message = f"'{effect}' has no parameter '{missing[0]}' in {errors.output}"
            raise EstimationError(message, closest(missing[0], columns.available[effect]), key)
        if not here:
            raise _absent(item.effect, errors)


def _absent(effect: Effect, errors: OutputErrors) -> EffectAbsentError:
    message = f"'{effect.id}' does not act on {errors.output}, {_WORDS[errors.kind]}, in these segments"
    words = shown_by(effect)
    hint = f"leave it out, or record segments that show it ({words})" if words else "leave it out"
    return EffectAbsentError(effect.id, errors.output, message, hint)


def _coefficient(errors: OutputErrors, own: Unit, one: Amplitude) -> ReportedAmplitude:
    letter = AXES[errors.axis]
    effect, direct = one.effect.id, own.dimension == unit(KINDS[errors.kind]).dimension
    stem = f"{effect}_{one.name}" if one.several else effect
    # Each accelerometer has its own position on the table, but the tilt of the table is common to all.
    common = not one.alone and not isinstance(one.effect, ExplainsTurning)
    name = (
        f"{stem}_{letter}"
        if one.alone
        else f"{effect}_{one.name}"
        if common
        else f"{effect}_{one.name}_{errors.output}"
    )
    if one.along == errors.axis and not direct:
        per = _PER[errors.kind]
        text, si = f"({own.text})/({per})", 1 / unit(per).factor
        words = said("Scale factor of {output} along its own axis", output=errors.output)
        return ReportedAmplitude(name, text, si, words)
    if common:
        words = said("Parameter {parameter} of the effect {effect}", parameter=one.name, effect=effect)
    else:
        words = said(
            "Parameter {parameter} of the effect {effect} in {output}",
            parameter=one.name,
            effect=effect,
            output=errors.output,
        )
    return ReportedAmplitude(name, one.unit, one.factor, words, common, one.origin)

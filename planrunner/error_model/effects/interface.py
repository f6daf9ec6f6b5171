"""Defines the interface of effects. An effect describes errors of a sensor or of its surroundings by columns over the samples of a
recording. A column contains the change of the outputs for a unit amplitude.

An effect is a class found through the entry-point group `planrunner.effects`. A simulation adds effects, the estimator
`error_model` fits their amplitudes, and the diagnosis decides whether the data support them. An effect may act on several channels
simultaneously, have a shape (such as a time constant), or change the noise. An estimate can fit most effects (see
`segment_columns.estimable`). If an effect lasts longer than a segment (`ShapedOverSegments`), its shape is fitted to the means of
segments. If an effect changes an output within segments (`ChangesWithinSegments`), its shape is fitted to the samples.

    class MyEffect:
        id = "my_effect"                      # the entry point's name
        stage = "sensor"                      # stimulus, sensor, output, acquisition, covariance
        shown_by = "two temperatures"         # which segments determine it, for the messages of an estimate
        about = About(…)                      # plain name, physics, where to correct and what to do
        def variants(self, observed) -> list[Variant]

A variant is the effect at one value of its shape (a time constant, a limit). The change of the output is linear in the amplitudes
of its columns. An effect that acts on the noise states the kind of change in `outside`, such as 'random walk', 'white' or
'resolution'. If its stage is covariance, it has no columns. With `each = "orientation"`, an effect has separate, independent
amplitudes for every orientation. The columns of such an effect are listed orientation by orientation, in the order of first use.

An effect whose columns are only valid for small amplitudes also has a method `around` (see `Curved`). If `hypothesis = False`, the
diagnosis evaluates the effect only if the effect is named explicitly. Every additional hypothesis changes the probabilities of all
others, so an effect becomes a hypothesis only after blind trials.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import chain
from string import Formatter
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from planrunner.base import plugins
from planrunner.base.arrays import Array
from planrunner.base.findings import InputError, Mark
from planrunner.error_model.observed import Observed, TemperatureCourse


@dataclass(frozen=True, slots=True)
class Column:
    """Describes one column of an effect, which is multiplied by one amplitude.

    `magnitude`: prior scale (typical size) of the amplitude in SI units. Only the ratios between the magnitudes of an effect's
        columns matter, because a diagnosis fits their common size.
    `unit`: unit in which the amplitude is displayed.
    `factor`: SI value of `unit`.
    `parts`: maps the index of each affected channel to an array of shape (N,), the SI output for an amplitude of 1 in SI units.
    `segments`: array of shape (S,), True for the segments in which the column acts; None for all segments.
    `whole`: True if the effect is either present or absent, so that its amplitude is not a parameter.
    `along`: the axis of the sensor (0, 1, 2) if the column is the input along this axis. If the channel measures along the same axis, the
        amplitude is the error of the scale factor.
    `plain`: `unit` without a factor that is not a unit of measurement, such as the strength of a field; empty if there is no such factor.
    `axis`: the axis (0, 1, 2) if the column belongs to one axis alone; the column's name then ends with "_" and the letter of the axis.
        None for an amplitude of the whole sensor or of its surroundings. An effect must always state `axis`, because a column of
        one axis is reported for each output, and a column without an axis is reported once for all outputs.
    `smallest`, `largest`: the physically possible limits of the amplitude in SI units.
    """

    name: str
    unit: str
    factor: float
    magnitude: float
    parts: Mapping[int, Array] = field(repr=False)
    segments: NDArray[np.bool_] | None = field(default=None, repr=False)
    whole: bool = False
    along: int | None = None
    plain: str = ""
    axis: int | None = field(kw_only=True)
    smallest: float = field(default=-np.inf, kw_only=True)
    largest: float = field(default=np.inf, kw_only=True)


@dataclass(frozen=True, slots=True)
class Variant:
    """Describes an effect at one value of its shape. `shape`: the value in `shape_unit`, None for an effect without shape.
    `widths`: if a variant combines several effects, the number of columns of each effect. `fixed`: indices of the columns whose
    amplitude is 1 for physical reasons; these amplitudes are not fitted."""

    columns: tuple[Column, ...]
    shape: float | None = None
    widths: tuple[int, ...] = ()
    fixed: tuple[int, ...] = ()


class Effect(Protocol):
    """A candidate effect."""

    id: str
    stage: str

    def variants(self, observed: Observed) -> list[Variant]:
        """Returns the variants of the effect for this recording; empty if the effect cannot act, for example because the channel is
        missing or nothing rotates."""


class Actor(StrEnum):
    """States what must be changed to remove the cause of an effect. BENCH: at the table, the chamber, the mounting or their
    synchronisation. SENSOR: in the unit under test or its compensation. PLAN: in the states and times of the plan. SITE: in the declared
    place on the Earth. BOOKKEEPING: in the declarations of labels, units, signs and noise in files."""

    BENCH = "bench"
    SENSOR = "sensor"
    PLAN = "plan"
    SITE = "site"
    BOOKKEEPING = "bookkeeping"


@dataclass(frozen=True, slots=True)
class About:
    """Describes an effect for an engineer.

    `name`: the effect in plain words. `physics`: the cause, in one sentence. `remedy`: what to do; in this text, `{found}` is
    replaced by the fitted parameters. `figures`: a function that computes further values for the remedy, such as a bandwidth from a
    time constant. The function takes the fitted shape in `shape_unit` and returns a mapping of names to texts.
    """

    name: str
    physics: str
    actor: Actor
    remedy: str
    figures: Callable[[float], Mapping[str, str]] | None = None

    def advice(self, found: str, shape: float | None) -> str:
        """Returns the remedy, with the fitted parameters inserted as text. `found`: this text. `shape`: the fitted shape, None for
        an effect without a shape."""
        values = {} if self.figures is None or shape is None else dict(self.figures(shape))
        wanted = {field for _, field, _, _ in Formatter().parse(self.remedy) if field}
        return self.remedy.format(**dict.fromkeys(wanted, "unknown") | values | {"found": found})


@runtime_checkable
class TellsAbout(Effect, Protocol):
    """An effect with an attribute `about`, which gives its plain name and its remedy."""

    about: About


_BY_STAGE = {"stimulus": Actor.BENCH, "acquisition": Actor.BENCH}


def about(effect: Effect) -> About:
    """Returns the description of an effect. If a plug-in has no `about`, the description consists of the identifier of the effect,
    the first paragraph of its docstring, and the usual actor for its stage."""
    if isinstance(effect, TellsAbout):
        return effect.about
    physics = " ".join((effect.__doc__ or "").partition("\n\n")[0].split())
    actor = _BY_STAGE.get(effect.stage, Actor.SENSOR)
    return About(effect.id.replace("_", " "), physics or "The plug-in contains no description.", actor, _DEFAULT)


_DEFAULT = "Remove the cause, or compensate the effect: {found}."


@runtime_checkable
class Explained(Effect, Protocol):
    """An effect with a text `shown_by` that states which segments determine it."""

    shown_by: str


def effect_named(name: str) -> Effect:
    """Returns the installed effect with this name. Raises `InputError` if there is no such effect, or if the effect has the stage
    covariance and no attribute `outside`."""
    made: Effect = plugins.load(plugins.EFFECTS, name)()
    if made.stage == "covariance" and not isinstance(made, OutsideCoefficients):
        message = f"the effect '{name}' has the stage covariance, but no attribute 'outside'"
        hint = "the author of the plug-in must add this attribute; in development versions, its name was 'noise'"
        raise InputError.at(Mark("<plug-ins>"), "plugin-broken", message, hint)
    return made


def shown_by(effect: Effect) -> str:
    """Returns a description of the segments that determine an effect; the text is empty if the effect names no segments."""
    return effect.shown_by if isinstance(effect, Explained) else ""


@runtime_checkable
class ExplainsTurning(Effect, Protocol):
    """An effect that describes what accelerometers measure in addition to gravity while the table turns or rocks. Without such an effect,
    an estimate uses accelerometers only in segments at rest."""

    explains_turning: Literal[True]


@runtime_checkable
class FollowsTemperature(Effect, Protocol):
    """An effect that describes the change of a bias with temperature: it has one amplitude for each axis, and this amplitude is
    multiplied by the temperature. `with_temperature`: name of the amplitude, without the letter of its axis."""

    with_temperature: str


class Follows(StrEnum):
    """Lists the quantities, other than the motion, to which an effect can be proportional."""

    SUPPLY = "supply voltage"
    PRESSURE = "ambient pressure"


@runtime_checkable
class FollowsSurroundings(Effect, Protocol):
    """An effect that is proportional to the supply voltage or to the ambient pressure. If the plan does not state this quantity, it
    may come from the recording."""

    follows: Follows


@runtime_checkable
class ShownInSome(Effect, Protocol):
    """An effect that the diagnosis evaluates only if the recording can distinguish it from similar effects (`shown_in`)."""

    def shown_in(self, observed: Observed) -> bool: ...


@runtime_checkable
class NoHypothesis(Effect, Protocol):
    """An effect for simulations and estimates, which the diagnosis evaluates only if the effect is named explicitly."""

    hypothesis: Literal[False]


@runtime_checkable
class NotFitted(Effect, Protocol):
    """An effect that a diagnosis can subtract if its values are stated, but cannot fit. `not_fitted`: the reason, as a sentence."""

    not_fitted: str


@runtime_checkable
class WrongDeclarationOf(Effect, Protocol):
    """An effect for simulations that represents a mistake in a file or on the bench. Such a mistake is corrected, never fitted.
    `of_declaration`: always True."""

    of_declaration: Literal[True]


OutsideKind = Literal["white", "resolution", "random walk", "gauss-markov", "line", "stuck"]


@runtime_checkable
class OutsideCoefficients(Effect, Protocol):
    """Describes an effect that does not appear in the coefficients (means, slow changes and harmonics of segments) to which a
    diagnosis reduces a recording. Such an effect changes the noise, adds a line interference, or makes samples repeat earlier
    values. A diagnosis searches for such an effect outside the coefficients. An effect whose `stage` is covariance has no columns
    at all. A line interference does have columns, but only a simulation uses them."""

    outside: OutsideKind


class WithoutColumns:
    """Base of the effects that change only the noise, or let samples repeat earlier values."""

    stage = "covariance"

    def variants(self, observed: Observed) -> list[Variant]:
        return []


@runtime_checkable
class OfAccelerometers(OutsideCoefficients, Protocol):
    """An effect of the kind `OutsideCoefficients` that acts on accelerometers. An effect of this kind without the attribute
    `of_accelerometers` acts on gyros."""

    of_accelerometers: Literal[True]


def triad_of(effect: OutsideCoefficients) -> Literal["gyro", "accel"]:
    """Returns the triad on which an effect of the kind `OutsideCoefficients` acts."""
    return "accel" if isinstance(effect, OfAccelerometers) else "gyro"


@runtime_checkable
class PerOrientation(Effect, Protocol):
    """An effect with separate amplitudes for every orientation; a simulation draws these amplitudes at random."""

    each: Literal["orientation"]


@runtime_checkable
class HasShape(Effect, Protocol):
    """An effect with several variants. Its shape, such as a time constant or a number per turn, is a parameter in addition to the
    amplitudes."""

    shape_name: str
    shape_unit: str


@runtime_checkable
class ChangesWithinSegments(HasShape, Protocol):
    """An effect that changes an output within segments, so that an estimate fits it to samples.

    `acts_on` has one of three values. 'rate': the effect replaces the angular rate by an earlier or a smoothed rate. 'output': each
    output is a function of the value that it would have at the same moment without the effect (`Observed.fitted`). With 'rate' or
    'output', the effect has one column, which is the change of the output. 'amplitudes': the effect has a few possible values of its
    shape and, for each of these values, columns with amplitudes.
    """

    acts_on: Literal["rate", "output", "amplitudes"]


@runtime_checkable
class DependsOnPast(HasShape, Protocol):
    """An effect that depends on the temperatures before the first sample (`Observed.past`). A simulation computes such an effect in
    blocks of samples."""

    def remembered(self, observed: Observed, value: float) -> tuple[TemperatureCourse, ...]:
        """Returns a short course of temperatures that replaces all earlier temperatures: those before `observed` and those of the
        samples of `observed`. If the shape has the given value, the short course has the same effect on later samples. Its length
        does not grow with the number of samples."""


@runtime_checkable
class InEveryWorld(Effect, Protocol):
    """An effect that every simulation of a bench contains. The parameter is a factor: 1 does not change the effect, 0 removes it."""

    in_every_world: Literal[True]


@runtime_checkable
class CurvedAndShaped(HasShape, Protocol):
    """An effect that has a shape, and that is proportional to its amplitudes only while they are small."""

    def secant(self, amplitudes: Array) -> Shaped:
        """Returns a form of the effect that is exact at the given `amplitudes` (SI), which need not be small. At these amplitudes,
        the effect equals the sum of the columns of this form, each multiplied by its amplitude."""


@runtime_checkable
class Curved(Effect, Protocol):
    """An effect that is proportional to its amplitudes only while they are small."""

    def around(self, observed: Observed, amplitudes: Array) -> list[Variant]:
        """Returns the variants for given `amplitudes` (SI), which need not be small. At these amplitudes, the sum of the columns,
        each multiplied by its amplitude, is exactly the effect."""


class Shaped:
    """An effect whose shape is one positive number, `shape_name`, in `shape_unit`. The method `grid` gives values of the shape, and
    the method `at` gives the variant at one value. The diagnosis also searches between the values of the grid."""

    id: str
    stage: str
    shape_name: str
    shape_unit: str

    def grid(self, observed: Observed) -> Array:
        """Returns the values of the shape that the diagnosis tries first, in `shape_unit`, shape (n,). The result is empty if the
        effect cannot act."""
        raise NotImplementedError

    def at(self, observed: Observed, value: float) -> Variant:
        """Returns the variant of the effect at one value of the shape."""
        raise NotImplementedError

    def groups(self, observed: Observed) -> Iterator[list[Variant]]:
        """Yields the variants on the grid in groups, so that the samples of only one group need to be in memory. Each variant is a
        group; effects whose variants share their samples yield one group with all variants."""
        for value in self.grid(observed):
            yield [self.at(observed, float(value))]

    def variants(self, observed: Observed) -> list[Variant]:
        return list(chain.from_iterable(self.groups(observed)))


@runtime_checkable
class HasAlternatives(Effect, Protocol):
    """An effect that acts in one of several ways, such as clipping at an upper or at a lower limit. Each way has its own shape. A
    diagnosis names the most probable way. A simulation may combine several ways: it uses all ways whose shapes are stated.
    `alternatives`: one effect for each way. All of them have the same `id` and `stage`, but each has its own `shape_name`, and each
    is fully determined by its shape."""

    alternatives: Sequence[Shaped]


@runtime_checkable
class ShowsItsWays(HasAlternatives, Protocol):
    """An effect with alternatives, if the recording may show which of them act."""

    def ways_shown(self, observed: Observed) -> Sequence[Shaped]:
        """Returns the ways that the recording shows. A way may combine several alternatives. The result is empty if the recording
        does not show how the effect acts."""


@runtime_checkable
class PairedShapes(HasShape, Protocol):
    """An effect with two parameters of the shape, of which one is known. An example is an output with a limit in each direction."""

    def opposite(self, value: float) -> Shaped | None:
        """Returns the same effect with the other parameter as its shape. Returns None if there is no other parameter. `value`: the
        value of the present shape, which is then known."""


def ways_of(effect: Effect, observed: Observed) -> Sequence[Effect]:
    """Returns the ways in which an effect may act, each as an effect; usually this is the effect itself."""
    shown = effect.ways_shown(observed) if isinstance(effect, ShowsItsWays) else ()
    return shown or (effect.alternatives if isinstance(effect, HasAlternatives) else (effect,))


@runtime_checkable
class ShapedOverSegments(HasShape, Protocol):
    """An effect with one shape parameter. The effect lasts longer than a segment; therefore, the means of segments determine this
    parameter."""

    over_segments: Literal[True]

    def grid(self, observed: Observed) -> Array: ...

    def at(self, observed: Observed, value: float) -> Variant: ...


def products(vector: Array) -> list[tuple[str, Array]]:
    """Returns the names and the values of the products of two vector components: first the squares xx, yy, zz, then xy, yz, zx. The
    vector has the shape (N, 3), each product the shape (N,)."""
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)]
    return [("xyz"[i] + "xyz"[j], vector[:, i] * vector[:, j]) for i, j in pairs]


def per_axis(
    observed: Observed, kind: str, name: str, unit: str, factor: float, magnitude: float, signature: Array
) -> list[Column]:
    """Makes one column for each input axis of a triad. `signature`: array of shape (N,) if all axes have the same signature, or (N,
    3) with one signature per axis. `name`, `unit`, `factor`, `magnitude`: values of the fields of `Column`; the letter of the axis
    is appended to the name."""
    columns = []
    for axis, index, share in observed.inputs(kind):
        own = signature if signature.ndim == 1 else signature[:, axis]
        part = own if isinstance(share, float) else share * own
        columns.append(Column(f"{name}_{'xyz'[axis]}", unit, factor, magnitude, {index: part}, axis=axis))
    return columns


def on_stimulus(observed: Observed, omega: Array | None, force: Array | None) -> Mapping[int, Array]:
    """Computes how the outputs change if the stimulus changes. Returns the changes by index of the channel. `omega`: array of shape (N,
    3), additional angular rate. `force`: array of shape (N, 3), additional specific force; None if the specific force does not change."""
    parts = {}
    for index, channel in enumerate(observed.channels):
        felt = omega if channel.kind == "gyro" else force
        if felt is not None:
            parts[index] = observed.seen(index, felt)
    return parts


def on_rate(observed: Observed, omega: Array) -> Mapping[int, Array]:
    """Computes how the gyros' outputs change if the rate changes. Returns the changes by index of the channel. `omega`: array of
    shape (N, 3), additional angular rate. The response of the gyros in the fitted model is used if it is known, otherwise the
    declared response."""
    gyros = observed.of_kind("gyro")
    if observed.response is None:
        return {index: observed.seen(index, omega) for index in gyros}
    shown = omega @ observed.response[gyros].T
    return {index: shown[:, place] for place, index in enumerate(gyros)}


def whole(
    parts: Mapping[int, Array], segments: NDArray[np.bool_] | None = None, *, either_sign: bool = False
) -> Column:
    """Returns the column of an effect that is fully determined by its shape, such as a lag, a limit or a delay. `either_sign`: True
    if the effect may also be negative, like a delay; False for a lag or a dead zone. `parts`, `segments`: values of the fields of
    `Column`."""
    smallest = -np.inf if either_sign else 0.0
    return Column("share", "1", 1.0, 1.0, parts, segments, True, axis=None, smallest=smallest)


def single(columns: Sequence[Column]) -> list[Variant]:
    """Returns a list with the only variant of an effect without a shape."""
    return [Variant(tuple(columns))] if columns else []


def is_whole(columns: Sequence[Column]) -> bool:
    """Returns True if these columns belong to an effect that is fully determined by its shape, such as a lag, a limit or a delay."""
    return len(columns) == 1 and columns[0].whole

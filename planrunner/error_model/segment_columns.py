"""Computes the design matrix of an estimate from effects of the catalogue at the means of segments, for the planned or the recorded
stimulus.

An effect gives the values of its columns at single moments. The mean of a column over a segment cannot be computed from the mean
stimulus, because the mean of a product is not the product of means. Each segment is therefore represented by a few quadrature
nodes: evenly spaced angles of a turning table, and Gauss–Legendre nodes along a ramp of temperature. Over whole turns, the result
is exact for polynomials up to the seventh degree in quantities that turn with the table. Along a ramp, it is exact for polynomials
up to the fifth degree in time. The mean over a segment is computed as the weighted mean over its nodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, fields, replace
from functools import cached_property

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.error_model.effects.interface import (
    ChangesWithinSegments,
    Column,
    Effect,
    HasAlternatives,
    HasShape,
    OutsideCoefficients,
    PerOrientation,
    ShapedOverSegments,
    WrongDeclarationOf,
)
from planrunner.error_model.observed import (
    REFERENCE_TEMPERATURE,
    Channel,
    Observed,
    ObservedSegment,
    joined,
    planned_excess,
)
from planrunner.physics.earth import Site
from planrunner.physics.stimulus import Stimulus
from planrunner.plan.schedule import Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS

KINDS = {"gyro": "rad/s", "accel": "m/s^2"}
TRIADS = tuple(
    Channel(f"{kind}_{'xyz'[axis]}", kind, axis, text, 1.0, 0.0) for kind, text in KINDS.items() for axis in range(3)
)
"""Two ideal triads. The columns of an estimate are the outputs that the effects cause in these triads."""
_DIRECTIONS = 8  # number of angles of a turn
_ALONG = 3  # number of nodes along a ramp
_ALONG_SHAPED = 12  # number of nodes along a segment if an effect has a shape
_STEP = 1e-4  # relative step of a shape for the derivative
_CHANGED = 1.0  # K; a smaller difference between segments does not count as a change of temperature


@dataclass(frozen=True, slots=True, eq=False)
class SegmentStates:
    """Contains time, temperature, supply voltage and pressure of n segments; all arrays have the shape (n,).

    `time`: middle of the segment, s since power-on. `seconds`: length of the segment, s. `celsius`: mean temperature, degC. `ramp`:
    change of the temperature from the start to the end of the segment, K. `last_change`: sign of the last change of temperature, 0
    before the first change. `overvoltage`: mean supply voltage minus the nominal voltage of the sensor, V. `overpressure`: mean
    pressure minus the standard atmosphere, Pa.
    """

    time: Array
    seconds: Array
    celsius: Array
    ramp: Array
    last_change: Array
    overvoltage: Array
    overpressure: Array

    def at(self, rows: Sequence[int]) -> SegmentStates:
        """Returns the states of the selected segments."""
        place = list(rows)
        return SegmentStates(**{one.name: getattr(self, one.name)[place] for one in fields(self)})

    def measured(self, celsius: Array) -> SegmentStates:
        """Returns a copy in which measured mean temperatures [degC], shape (n,), replace the planned temperatures. The ramps remain
        as planned."""
        return replace(
            self, celsius=celsius, last_change=_last_changes(celsius - self.ramp / 2, celsius + self.ramp / 2)
        )


def states_of(segments: Sequence[Segment], start: Array, seconds: Array, nominal_supply: float) -> SegmentStates:
    """Returns the planned states of segments. A temperature, voltage or pressure that is not planned has its reference value.
    `start`, `seconds`: arrays of shape (n,) in s, start and length of each segment, planned or recorded. `nominal_supply`: nominal
    supply voltage of the sensor, V."""
    kelvin = [one.begins_at for one in segments]
    begin = np.array([REFERENCE_TEMPERATURE if one is None else one - ZERO_CELSIUS for one in kelvin])
    ends = [one.ramp_to for one in segments]
    end = np.array([own if to is None else to - ZERO_CELSIUS for own, to in zip(begin, ends, strict=True)])
    over = np.array([planned_excess(one, nominal_supply) for one in segments]).reshape(-1, 2)
    return SegmentStates(
        start + seconds / 2,
        seconds,
        (begin + end) / 2,
        end - begin,
        _last_changes(begin, end),
        over[:, 0],
        over[:, 1],
    )


def _last_changes(begin: Array, end: Array) -> Array:
    signs, last = np.zeros(len(begin)), 0.0
    for row in range(len(begin)):
        for change in (begin[row] - end[row - 1] if row else 0.0, end[row] - begin[row]):
            last = float(np.sign(change)) if abs(change) > _CHANGED else last
        signs[row] = last
    return signs


@dataclass(frozen=True, slots=True)
class EffectPart:
    """Describes one effect in the model of one output.

    `only`: names of the effect's columns in the model, without the letter of the axis; empty if the model contains all columns of
    the effect. `shape`: value of the effect's shape; None for an effect without shape. `sizes`: maps the name of a column, without
    the letter of the axis, to an amplitude in SI units. The derivative of the output with respect to the shape is computed at these
    amplitudes; it is a further column of the model. `sizes` is empty if the model has no such column.
    """

    effect: Effect
    only: tuple[str, ...] = ()
    shape: float | None = None
    sizes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class OutputErrors:
    """Lists the effects in the model of one output. `kind`: gyro or accel. `axis`: 0, 1 or 2 for the sensor axis x, y or z along
    which the output measures."""

    output: str
    kind: str
    axis: int
    chosen: tuple[EffectPart, ...]

    @property
    def channel(self) -> int:
        return 3 * list(KINDS).index(self.kind) + self.axis


@dataclass(frozen=True, slots=True)
class Amplitude:
    """Describes one amplitude (coefficient) in the model of an output.

    `name`: name of the column without the letter of the axis. `several`: True if the effect has other amplitudes for this output.
    `alone`: True if the column acts on this output only. `unit`: unit for display. `factor`: SI value of this unit. `along`: if the
    column is the input along a sensor axis, the index of this axis (as `Column.along`). `size`: largest absolute value, over all
    nodes and axes, of the columns of the effect that have this unit; 0 if nothing excites these columns. `origin`: if the amplitude
    is a change of the shape, the value of the shape [`unit`] from which the change counts. `shape`: True if the amplitude is a
    change of the effect's shape.
    """

    effect: Effect
    name: str
    several: bool
    alone: bool
    unit: str
    factor: float
    along: int | None
    size: float
    origin: float = 0.0
    shape: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class OutputColumns:
    """Contains the columns of one output's model at n segments.

    `own`: array of shape (n,) in SI units, the output of an ideal sensor. `matrix`: array of shape (n, p), SI output for an
    amplitude of 1 in SI units, one column for each amplitude. `available`: maps each effect to the names of all amplitudes that it
    has for this output.
    """

    own: Array
    available: Mapping[str, tuple[str, ...]]
    amplitudes: tuple[Amplitude, ...]
    matrix: Array

    @property
    def magnitudes(self) -> Array:
        """Returns the positive magnitudes by which the columns are divided, shape (p,)."""
        return np.array([one.size or 1.0 for one in self.amplitudes])


@dataclass(frozen=True, eq=False)
class ErrorsAtSegments:
    """Models m outputs at n segments, in which the sensor rests or turns in known orientations. `stimulus`: planned means over the
    segments."""

    outputs: tuple[OutputErrors, ...]
    segments: tuple[Segment, ...]
    site: Site
    states: SegmentStates
    stimulus: Stimulus
    of_motion: bool = False

    def columns(self, stimulus: Stimulus) -> Array:
        """Computes the columns of all outputs, one output after the other, shape (k·n, P). The columns of one output are the output's own
        input, followed by one column for each amplitude. `stimulus`: k·n rows, which are k ≥ 1 copies of the planned stimulus of the n
        segments; each copy has different small changes. A change in the mean stimulus of a segment is applied to all nodes of the
        segment."""
        n, found = len(self.segments), []
        for low in range(0, len(stimulus), n):
            part = slice(low, low + n)
            changes = (
                stimulus.omega[part] - self.stimulus.omega,
                stimulus.specific_force[part] - self.stimulus.specific_force,
            )
            made = self._evaluated(changes, stimulus.table_rate[part] - self.stimulus.table_rate)
            found.append(np.column_stack([np.column_stack([one.own, one.matrix]) for one in made]))
        return np.vstack(found)

    def shapes_of(self, effect: ShapedOverSegments) -> Array:
        """Returns the values of an effect's shape that the catalogue gives for these segments, in ascending order, shape (n,)."""
        return effect.grid(self._planned)

    def course(self, output: int, effect: Effect, amplitudes: Array) -> tuple[Array, Array]:
        """Computes what an effect with a shape adds to one output in the course of each segment, at the planned stimulus. Returns L
        positions along a segment, from −0.5 (start) to 0.5 (end), and the added values (n, L) at these positions. `amplitudes`:
        amplitudes of the effect's columns in this output."""
        errors, observed = self.outputs[output], self._planned
        part = next(one for one in errors.chosen if one.effect is effect)
        _, rows, _ = amplitudes_of(part, errors, observed, _columns(part.effect, observed, part.shape))
        values = np.split(amplitudes @ np.array(rows), observed.bounds[1:-1])
        along = np.polynomial.legendre.leggauss(_ALONG_SHAPED)[0] / 2
        return along, np.array([own.reshape(-1, len(along)).mean(axis=0) for own in values])

    def of_outputs(self) -> tuple[OutputColumns, ...]:
        """Computes the columns of each output at the planned stimulus."""
        return self._evaluated((np.zeros((len(self.segments), 3)),) * 2, np.zeros(len(self.segments)))

    def _evaluated(self, changes: tuple[Array, Array], faster: Array) -> tuple[OutputColumns, ...]:
        """Returns the columns of each output at a changed stimulus. `changes`: additional angular rate and specific force, each (n,
        3). `faster`: array of shape (n,), additional rate of the table."""
        observed, owner = self._planned, self._planned.owner
        felt = tuple(own + change[owner] for own, change in zip((observed.omega, observed.force), changes, strict=True))
        moved = replace(observed, felt=(felt[0], felt[1]), rate=observed.rate + faster[owner])
        made: dict[tuple[int, float | None], tuple[Column, ...]] = {}
        for one in (one for output in self.outputs for one in output.chosen):
            for shape in (one.shape, *_beside(one)):
                if (id(one.effect), shape) not in made:
                    made[id(one.effect), shape] = _columns(one.effect, moved, shape)
        return tuple(self._of(output, moved, made) for output in self.outputs)

    def _of(
        self, output: OutputErrors, observed: Observed, made: Mapping[tuple[int, float | None], tuple[Column, ...]]
    ) -> OutputColumns:
        felt = observed.omega if output.kind == "gyro" else observed.force
        amplitudes, columns, available = [], [], {}
        for one in output.chosen:
            own, rows, available[one.effect.id] = amplitudes_of(one, output, observed, made[id(one.effect), one.shape])
            amplitudes += own
            columns += rows
            if one.sizes:
                ways = [made[id(one.effect), shape] for shape in _beside(one)]
                columns.append(_derivative(one, output, *ways))
                effect, size = one.effect, max(float(np.abs(columns[-1]).max()), 1e-300)
                assert isinstance(effect, ShapedOverSegments)
                amplitudes.append(
                    Amplitude(
                        effect,
                        effect.shape_name,
                        True,
                        True,
                        effect.shape_unit,
                        1.0,
                        None,
                        size,
                        one.shape or 0.0,
                        True,
                    )
                )
        matrix = self._means(np.array(columns)).T if columns else np.zeros((len(self.segments), 0))
        return OutputColumns(self._means(felt[:, output.axis][None])[0], available, tuple(amplitudes), matrix)

    def _means(self, rows: Array) -> Array:
        """Returns the means (k, n) over the n segments, from values (k, N) at the nodes of all segments."""
        weight = np.concatenate([weight for _, _, weight in self._nodes])
        return np.asarray(np.add.reduceat(rows * weight, self._planned.bounds[:-1], axis=1))

    @cached_property
    def _nodes(self) -> list[tuple[Array, Array, Array]]:
        """Returns, for each segment, three arrays of shape (k,): the angle of the table at each node, the position of the node
        along the segment from −0.5 to 0.5, and the weight of the node."""
        shaped = any(one.shape is not None for output in self.outputs for one in output.chosen)
        places, weights = np.polynomial.legendre.leggauss(_ALONG_SHAPED if shaped else _ALONG)
        found = []
        for segment, ramp in zip(self.segments, self.states.ramp.tolist(), strict=True):
            turning = isinstance(segment.motion, Spin)
            angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS) if turning else np.zeros(1)
            along, weight = (places / 2, weights / 2) if ramp or shaped else (np.zeros(1), np.ones(1))
            grid = np.meshgrid(angle, along, indexing="ij")
            found.append((grid[0].ravel(), grid[1].ravel(), np.tile(weight / len(angle), len(angle))))
        return found

    @cached_property
    def _planned(self) -> Observed:
        """Returns the planned segments in the form of a recording. The recording contains two ideal triads, with one sample at each
        node."""
        states, made = self.states, []
        for row, (segment, (angle, along, _)) in enumerate(zip(self.segments, self._nodes, strict=True)):
            zero = np.zeros(len(angle))
            ramp, seconds = float(states.ramp[row]), float(states.seconds[row])
            made.append(
                ObservedSegment(
                    segment.label,
                    segment.motion,
                    np.asarray(segment.attitude),
                    states.time[row] + along * seconds,
                    angle,
                    zero + segment.rate,
                    zero,
                    states.celsius[row] + along * ramp,
                    zero + (ramp / seconds if ramp else 0.0),
                    np.zeros((len(angle), len(TRIADS))),
                    float(states.last_change[row]),
                    overvoltage=zero + states.overvoltage[row],
                    overpressure=zero + states.overpressure[row],
                )
            )
        return joined(self.site, TRIADS, made, magnetic=self.site.magnetic_field)


def amplitudes_of(
    part: EffectPart, output: OutputErrors, observed: Observed, columns: Sequence[Column]
) -> tuple[list[Amplitude], list[Array], tuple[str, ...]]:
    """Returns the amplitudes that an effect has in the model of one output, their columns (N,), and the names of all amplitudes
    that the effect has for this output. `columns`: all columns of the effect, for all outputs."""
    here = [column for column in columns if output.channel in column.parts]
    several = len(here) > 1 or isinstance(part.effect, ShapedOverSegments | ChangesWithinSegments)
    amplitudes, rows = [], []
    for column in here:
        name, alone = without_axis(column)
        if part.only and name not in part.only:
            continue
        alike = [values for other in columns if other.unit == column.unit for values in other.parts.values()]
        size = max(float(np.abs(values).max()) for values in alike)
        text = column.plain or column.unit
        amplitudes.append(Amplitude(part.effect, name, several, alone, text, column.factor, column.along, size))
        values = column.parts[output.channel]
        rows.append(values if column.segments is None else values * column.segments[observed.owner])
    return amplitudes, rows, tuple(without_axis(column)[0] for column in here)


def estimable(effect: Effect) -> str:
    """Returns the reason why an estimate cannot fit an effect; empty if an estimate can fit it."""
    if isinstance(effect, OutsideCoefficients):
        return "it acts on the noise, not on means: use allan_deviation"
    if isinstance(effect, HasShape) and not isinstance(effect, ShapedOverSegments | ChangesWithinSegments):
        return f"its class does not define how its shape parameter ({effect.shape_name}) changes the output: use `planrunner diagnose`"
    if isinstance(effect, HasAlternatives):
        return "it acts in one of several ways: use `planrunner diagnose`"
    if isinstance(effect, PerOrientation):
        return "it differs between orientations: state it in the bench file as `position_uncertainty` of the table"
    if isinstance(effect, WrongDeclarationOf):
        return "it is a wrong declaration: correct it in the plan, in the bench file or on the bench"
    return ""


def _beside(part: EffectPart) -> tuple[float, ...]:
    """Returns two values of the shape for a numerical derivative, one slightly above and one slightly below the chosen value; empty if no
    derivative is needed."""
    return (part.shape * (1 + _STEP), part.shape * (1 - _STEP)) if part.shape is not None and part.sizes else ()


def _derivative(part: EffectPart, output: OutputErrors, above: Sequence[Column], below: Sequence[Column]) -> Array:
    """Returns the derivative of an output with respect to an effect's shape, shape (N,). The amplitudes are held constant in their
    display units."""
    assert part.shape is not None
    found = np.zeros(len(next(iter(above[0].parts.values()))))
    for high, low in zip(above, below, strict=True):
        if output.channel in high.parts:
            size = part.sizes.get(without_axis(high)[0], 0.0)
            middle = (high.factor + low.factor) / 2
            found += size / middle * (high.factor * high.parts[output.channel] - low.factor * low.parts[output.channel])
    return np.asarray(found / (2 * _STEP * part.shape))


def _columns(effect: Effect, observed: Observed, shape: float | None = None) -> tuple[Column, ...]:
    if isinstance(effect, ShapedOverSegments):
        values = effect.grid(observed)
        if not len(values):
            return ()
        return effect.at(observed, float(np.sqrt(values[0] * values[-1])) if shape is None else shape).columns
    variants = effect.variants(observed)
    return variants[0].columns if variants else ()


def without_axis(column: Column) -> tuple[str, bool]:
    """Returns the name of a column without the letter of its axis, and whether the column acts on a single channel."""
    if column.axis is None or len(column.parts) != 1:
        return column.name, False
    return column.name.removesuffix(f"_{'xyz'[column.axis]}"), True

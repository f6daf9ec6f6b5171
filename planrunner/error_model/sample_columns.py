"""Uses effects of the catalogue to model an output that changes within segments. The effects are computed at the samples of a
recording, or at the bins of a long recording.

    output = F(own input + Σ amplitude · column)

The effects act in three stages. First, an effect of the stimulus that has amplitudes (a lever arm, a ripple of the table's rate)
changes the stimulus of all other columns. The sensor's scale factor and misalignments therefore also act on this change, and the
model is not linear in the amplitude of such an effect. Second, an effect that changes the rate (a lag or a delay) acts on the rate,
and all columns are evaluated at the changed rate. Third, an effect on the output (a dead zone, a limit) acts as the function F.
Effects of the second and the third stage have no amplitudes, only a shape. The columns come from the catalogue of effects.
Simulations add the same columns, and the diagnosis searches for them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.error_model.effects.interface import ChangesWithinSegments, Column, Curved, Effect, Shaped
from planrunner.error_model.observed import Observed
from planrunner.error_model.segment_columns import (
    TRIADS,
    Amplitude,
    EffectPart,
    OutputErrors,
    amplitudes_of,
    without_axis,
)

_STEP = 1e-6  # fraction of the largest output: step for the slope of an effect on the output


def shaped(part: EffectPart) -> bool:
    """Returns True if an effect has a shape, such as a time constant or a limit."""
    return isinstance(part.effect, Shaped | ChangesWithinSegments)


@dataclass(frozen=True, slots=True, eq=False)
class SampleColumns:
    """Contains the columns of one output's model at N samples.

    `own`: array of shape (N,) in SI units, the input along the axis of the output, after the effects on the rate. `rows`: array of shape
    (p, N), SI output for an amplitude of 1 in SI units, zero for an effect of the stimulus. `available`: maps each effect to the names of
    all amplitudes that it has for this output.
    """

    own: Array
    amplitudes: tuple[Amplitude, ...]
    rows: Array
    available: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True, eq=False)
class ErrorsAtSamples:
    """Models one output at the samples of a recording. `observed`: the stimulus at N samples. `ErrorsAtSamples.of` makes an object
    from a recording; this method replaces the channels of the recording by two ideal triads."""

    observed: Observed
    errors: OutputErrors

    @classmethod
    def of(cls, observed: Observed, errors: OutputErrors) -> ErrorsAtSamples:
        ideal = np.zeros((len(observed.time), len(TRIADS)))
        return cls(replace(observed, channels=TRIADS, values=ideal, along=None), errors)

    def grid(self, part: EffectPart) -> Array:
        """Returns the values of an effect's shape that the catalogue gives for this recording, in ascending order, shape (n,);
        empty if the effect cannot act on this output."""
        effect = part.effect
        seen = replace(self.observed, fitted=self._alone(self._own(self.observed)))
        variants = effect.variants(seen)
        if not any(self.errors.channel in column.parts for one in variants[:1] for column in one.columns):
            return np.zeros(0)
        if isinstance(effect, Shaped):
            return np.sort(effect.grid(seen))
        return np.array(sorted({one.shape for one in effect.variants(seen) if one.shape is not None}))

    def columns(self, shapes: Mapping[str, float], stimulus: Mapping[tuple[str, str], float]) -> SampleColumns:
        """Computes the columns of the effects. `shapes`: maps each effect to the value of its shape. `stimulus`: maps (effect, name
        of an amplitude) to the amplitude in SI; amplitudes that are not listed are zero."""
        felt = self._felt(shapes, stimulus)
        amplitudes: list[Amplitude] = []
        rows: list[Array] = []
        available = {}
        for part in self.errors.chosen:
            if not _fixed(part.effect):
                made = _columns(part.effect, felt, shapes)
                own, columns, available[part.effect.id] = amplitudes_of(part, self.errors, felt, made)
                if of_stimulus(part.effect):
                    columns = [np.zeros(len(felt.time))] * len(columns)
                amplitudes += own
                rows += columns
        matrix = np.array(rows) if rows else np.zeros((0, len(felt.time)))
        return SampleColumns(self._own(felt), tuple(amplitudes), matrix, available)

    def output(self, linear: Array, shapes: Mapping[str, float]) -> Array:
        """Applies the effects on the output (function F) to an output `linear` (N,), SI, that already contains all other effects.
        `shapes`: maps each effect to the value of its shape."""
        for part in self.errors.chosen:
            effect = part.effect
            if isinstance(effect, ChangesWithinSegments) and effect.acts_on == "output":
                seen = replace(self.observed, fitted=self._alone(linear))
                (column,) = _columns(effect, seen, shapes)
                linear = linear + column.parts[self.errors.channel]
        return linear

    def slope(self, linear: Array, shapes: Mapping[str, float]) -> Array:
        """Returns the derivative of the function F at the output values `linear`, shape (N,)."""
        step = _STEP * max(float(np.abs(linear).max()), 1e-12)
        return np.asarray((self.output(linear + step, shapes) - self.output(linear - step, shapes)) / (2 * step))

    @property
    def bent(self) -> bool:
        """Returns True if there is an effect on the output, so that the function F is not the identity."""
        return any(
            isinstance(part.effect, ChangesWithinSegments) and part.effect.acts_on == "output"
            for part in self.errors.chosen
        )

    def _own(self, felt: Observed) -> Array:
        return np.asarray((felt.omega if self.errors.kind == "gyro" else felt.force)[:, self.errors.axis])

    def _alone(self, linear: Array) -> Array:
        made = np.zeros((len(linear), len(TRIADS)))
        made[:, self.errors.channel] = linear
        return made

    def _felt(self, shapes: Mapping[str, float], stimulus: Mapping[tuple[str, str], float]) -> Observed:
        """Returns the samples with a changed stimulus. The effects of the stimulus are applied first, then the effects on the
        rate."""
        observed = self.observed
        change = np.zeros((len(TRIADS), len(observed.time)))
        for part in self.errors.chosen:
            if of_stimulus(part.effect):
                columns = _columns(part.effect, self.observed, shapes)
                every = part.effect.stage == "acquisition"  # a delay of the output delays all inputs of this output
                mine = [every or self.errors.channel in one.parts for one in columns]
                keys = [(part.effect.id, without_axis(one)[0]) for one in columns]
                sizes = [stimulus.get(key, 0.0) if own else 0.0 for key, own in zip(keys, mine, strict=True)]
                if isinstance(part.effect, Curved) and any(sizes):
                    columns = part.effect.around(self.observed, np.array(sizes))[0].columns
                for column, size in zip(columns, sizes, strict=True):
                    here = 1.0 if column.segments is None else column.segments[observed.owner]
                    for channel, values in column.parts.items() if size else ():
                        change[channel] += size * here * values
        if change.any():
            observed = replace(observed, felt=(observed.omega + change[:3].T, observed.force + change[3:].T))
        for part in self.errors.chosen:
            effect = part.effect
            if isinstance(effect, ChangesWithinSegments) and effect.acts_on == "rate":
                (column,) = _columns(effect, observed, shapes)
                change = np.column_stack([column.parts[channel] for channel in range(3)])
                observed = replace(observed, felt=(observed.omega + change, observed.force))
        return observed


def of_stimulus(effect: Effect) -> bool:
    """Returns True if amplitudes of an effect change the stimulus of the sensor. This includes an effect that delays the output,
    because a delay is applied to the stimulus, and scale factor and misalignments then act on the delayed stimulus."""
    delays = effect.stage == "acquisition" and isinstance(effect, Curved)
    return (effect.stage == "stimulus" or delays) and not _fixed(effect)


def _fixed(effect: Effect) -> bool:
    return isinstance(effect, ChangesWithinSegments) and effect.acts_on != "amplitudes"


def _columns(effect: Effect, observed: Observed, shapes: Mapping[str, float]) -> Sequence[Column]:
    if effect.id in shapes and isinstance(effect, Shaped):
        return effect.at(observed, shapes[effect.id]).columns
    variants = effect.variants(observed)
    if effect.id in shapes:
        variants = [one for one in variants if one.shape == shapes[effect.id]]
    return variants[0].columns if variants else ()

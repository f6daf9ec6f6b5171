"""Interface of candidate effects: physics that the nominal simulation lacks, as columns over the samples of a recording.

An effect is a class found through the entry-point group `planrunner.effects`. Error-model terms are different: a term is one column of one
output at segment means, and its coefficient is estimated. An effect may act on several channels at once, on samples, with a shape, or on
the noise, and the diagnosis decides whether the data support it.

    class MyEffect:
        id = "my_effect"                      # the entry point's name
        stage = "sensor"                      # stimulus, sensor, output, acquisition, covariance
        def variants(self, observed) -> list[Variant]

A variant is the effect at one value of its shape (a time constant, a limit); its columns are linear in their amplitudes. An effect of stage
covariance has no columns: its `noise` names its kind, 'random walk', 'white' or 'resolution'. `each = "orientation"`: its amplitudes are
independent for every orientation; its columns are then those of each orientation in turn, in the order of first use.

An effect that becomes nonlinear when large also has a method `around` (see `Curved`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from planrunner.error_model.observed import Observed

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Column:
    """One amplitude of an effect. magnitude: its prior scale in SI, relative to the effect's other columns. unit, factor: unit for
    display and its SI value. parts: channel index → signature (N,), SI output for an amplitude of 1 in SI. segments: (S,), where it
    acts; None for everywhere. whole: the effect is either present or absent, so its amplitude is not a parameter."""

    name: str
    unit: str
    factor: float
    magnitude: float
    parts: Mapping[int, Array] = field(repr=False)
    segments: NDArray[np.bool_] | None = field(default=None, repr=False)
    whole: bool = False


@dataclass(frozen=True, slots=True)
class Variant:
    """An effect at one value of its shape. shape: the value in `shape_unit`, None for an effect without shape. widths: for several
    combined effects, the number of columns of each."""

    columns: tuple[Column, ...]
    shape: float | None = None
    widths: tuple[int, ...] = ()


class Effect(Protocol):
    """A candidate."""

    id: str
    stage: str

    def variants(self, observed: Observed) -> list[Variant]:
        """The variants of the effect for this recording; empty if it cannot act (no such channel, no rotation)."""


NoiseKind = Literal["white", "resolution", "random walk"]


@runtime_checkable
class ActsOnNoise(Effect, Protocol):
    """An effect of stage covariance: it changes the noise of the gyros, and has no columns."""

    noise: NoiseKind


@runtime_checkable
class PerOrientation(Effect, Protocol):
    """An effect whose amplitudes are drawn anew for every orientation."""

    each: Literal["orientation"]


@runtime_checkable
class Curved(Effect, Protocol):
    """An effect that is linear only for small amplitudes."""

    def around(self, observed: Observed, amplitudes: Array) -> list[Variant]:
        """Its columns as secants: multiplied by these amplitudes, SI, they give the complete effect."""


class Shaped:
    """An effect whose shape is one positive number: `shape_name`, in `shape_unit`. Its variants are given by `at` for the values of a
    `grid` with constant ratio; the diagnosis refines between them."""

    id: str
    stage: str
    shape_name: str
    shape_unit: str

    def grid(self, observed: Observed) -> Array:
        """Values of the shape; empty if the effect cannot act."""
        raise NotImplementedError

    def at(self, observed: Observed, value: float) -> Variant:
        """The effect at one value."""
        raise NotImplementedError

    def variants(self, observed: Observed) -> list[Variant]:
        return [self.at(observed, float(value)) for value in self.grid(observed)]


def per_axis(
    observed: Observed, kind: str, name: str, unit: str, factor: float, magnitude: float, signature: Array
) -> list[Column]:
    """One column per input axis of a triad: `signature` (N,) for all axes, or (N, 3) with one column per axis."""
    columns = []
    for axis, index, share in observed.inputs(kind):
        own = signature if signature.ndim == 1 else signature[:, axis]
        part = own if isinstance(share, float) else share * own
        columns.append(Column(f"{name}_{'xyz'[axis]}", unit, factor, magnitude, {index: part}))
    return columns


def on_stimulus(observed: Observed, omega: Array | None, force: Array | None) -> Mapping[int, Array]:
    """Parts of a column that changes the stimulus: additional rate (N, 3) and specific force (N, 3)."""
    parts = {}
    for index, channel in enumerate(observed.channels):
        felt = omega if channel.kind == "gyro" else force
        if felt is not None:
            parts[index] = observed.seen(index, felt)
    return parts


def whole(parts: Mapping[int, Array], segments: NDArray[np.bool_] | None = None) -> Column:
    """The column of an effect that is fully determined by its shape: a lag, a limit, a delay."""
    return Column("share", "1", 1.0, 1.0, parts, segments, True)


def single(columns: Sequence[Column]) -> list[Variant]:
    """The variants of an effect without a shape."""
    return [Variant(tuple(columns))] if columns else []


def is_whole(columns: Sequence[Column]) -> bool:
    """Whether an effect is fully determined by its shape: a lag, a limit, a delay."""
    return len(columns) == 1 and columns[0].whole

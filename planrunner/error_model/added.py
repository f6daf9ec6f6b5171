"""Effects of the catalogue added to a simulation: their parameters with units, and their contributions to the outputs of a sensor.

An effect is added with the same columns that a diagnosis searches for. If the diagnosis then finds it, simulation and diagnosis agree with
each other, but this does not validate either; recordings from other sources do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planrunner.base import plugins
from planrunner.base.findings import InputError, Mark, closest
from planrunner.error_model.effects.interface import (
    ActsOnNoise,
    Column,
    Effect,
    NoiseKind,
    PerOrientation,
    Shaped,
    Variant,
    is_whole,
)
from planrunner.error_model.observed import Observed
from planrunner.plan.quantity import QuantityError, without_uncertainty
from planrunner.plan.units import UnknownUnitError, unit

Array = NDArray[np.float64]
STAGES = ("stimulus", "sensor", "output", "acquisition", "covariance")
NOISE: dict[NoiseKind, tuple[str, str]] = {
    "white": ("density", "deg/s*sqrt(s)"),
    "resolution": ("count", "deg/s"),
    "random walk": ("density", "deg/s/sqrt(s)"),
}
"""Noise effects: their only parameter and its unit. White noise and counts replace those of the sensor."""
_UNUSUAL = 3.0  # multiple of the declared noise, by default
_WALK = 1e-4  # deg/s/√s, by default


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """natural: default value, in `unit`."""

    name: str
    unit: str
    natural: float


@dataclass(frozen=True)
class Addition:
    """An effect with all its parameters, in their units. units: of the parameters."""

    effect: Effect
    values: Mapping[str, float]
    units: Mapping[str, str]

    @property
    def id(self) -> str:
        return self.effect.id


def addition(name: str, stated: Mapping[str, str], observed: Observed, mark: Mark) -> Addition:
    """An effect with its stated parameters. stated: parameter → value with its unit; the empty name means the only parameter, or all
    amplitudes. Parameters that are not stated have their natural size, but amplitudes are zero if others are named.

    observed: any recording or schedule of the plan; it determines the available parameters. Raises `InputError`.
    """
    if name not in plugins.names(plugins.EFFECTS):
        hint = closest(name, plugins.names(plugins.EFFECTS))
        raise InputError.at(mark, "effect-unknown", f"no effect '{name}' is installed", hint)
    effect = plugins.load(plugins.EFFECTS, name)()
    known = {parameter.name: parameter for parameter in parameters(effect, observed)}
    if not known:
        hint = "look at the sensor's outputs, the plan's motions and the site's magnetic_field"
        raise InputError.at(mark, "effect-cannot-act", f"'{name}' cannot act on this sensor under this plan", hint)
    shape = effect.shape_name if isinstance(effect, Shaped) else None
    named = any(key not in ("", shape) for key in stated)
    values = {one.name: 0.0 if named and one.name != shape else one.natural for one in known.values()}
    for key, text in stated.items():
        amplitudes = [one for one in known if one != shape] or list(known)
        for one in [key] if key else amplitudes:
            if one not in known:
                message = f"'{name}' has no parameter '{key}'"
                raise InputError.at(mark, "effect-parameter", message, closest(key, known))
            values[one] = _value(text, known[one], name, mark)
    return Addition(effect, values, {one.name: one.unit for one in known.values()})


def _value(text: str, parameter: EffectParameter, effect: str, mark: Mark) -> float:
    """A number in the parameter's unit, from a text with this unit, another unit of the same dimension, or no unit."""
    number, _, given = text.strip().partition(" ")
    wanted = parameter.unit
    hint = f"write a number, or a number with a unit such as '{parameter.natural:g} {wanted}'"
    try:
        if given.strip() in ("", wanted):
            value = float(number)
        else:
            quantity = without_uncertainty(text)
            value = quantity.to(wanted)
            if quantity.unit.dimension != unit(wanted).dimension:
                raise ValueError
    except (ValueError, QuantityError, UnknownUnitError):
        message = f"'{text}' is not a value of the parameter '{parameter.name}' of {effect}, whose unit is {wanted}"
        raise InputError.at(mark, "effect-value", message, hint) from None
    if not math.isfinite(value):
        raise InputError.at(mark, "effect-value", f"'{text}' is not a finite number", hint)
    return value


def parameters(effect: Effect, observed: Observed) -> list[EffectParameter]:
    """Parameters of an effect; empty if it cannot act."""
    if isinstance(effect, ActsOnNoise):
        gyros = observed.of_kind("gyro")
        if not gyros:
            return []
        name, text = NOISE[effect.noise]
        channel = observed.channels[gyros[0]]
        declared: float = {
            "white": channel.white,
            "resolution": max(channel.resolution, channel.white * math.sqrt(observed.sample_rate)),
            "random walk": _WALK * math.radians(1.0) / _UNUSUAL,
        }[effect.noise]
        return [EffectParameter(name, text, _UNUSUAL * declared / math.radians(1.0))]
    found = []
    variants = effect.variants(observed)
    if not variants:
        return []
    middle: Variant = variants[len(variants) // 2]
    if isinstance(effect, Shaped) and middle.shape is not None:
        found.append(EffectParameter(effect.shape_name, effect.shape_unit, middle.shape))
    if isinstance(effect, PerOrientation):
        column = middle.columns[0]
        return [*found, EffectParameter("size", column.unit, column.magnitude / column.factor)]
    if not is_whole(middle.columns):
        found += [
            EffectParameter(column.name, column.unit, column.magnitude / column.factor) for column in middle.columns
        ]
    return found


def added(observed: Observed, levels: Array, additions: Sequence[Addition], seed: int) -> Array:
    """Outputs without noise (N, K), SI, with the effects, stage by stage. seed: for the values drawn for each orientation."""
    out = levels.copy()
    for stage in STAGES[:-1]:
        seen = replace(observed, fitted=out.copy())
        for item in additions:
            if item.effect.stage == stage:
                for column, amplitude in _amplitudes(item, seen, seed):
                    here = 1.0 if column.segments is None else column.segments[seen.owner]
                    for channel, part in column.parts.items():
                        out[:, channel] += amplitude * part * here
    return out


def _amplitudes(item: Addition, observed: Observed, seed: int) -> list[tuple[Column, float]]:
    """Columns with their amplitudes in SI."""
    effect = item.effect
    if isinstance(effect, PerOrientation):
        return _each_orientation(item, observed, seed)
    if isinstance(effect, Shaped):
        columns = effect.at(observed, item.values[effect.shape_name]).columns if len(effect.grid(observed)) else ()
    else:
        columns = next((variant.columns for variant in effect.variants(observed)), ())
    if is_whole(columns):
        return [(columns[0], 1.0)]
    return [(column, item.values[column.name] * column.factor) for column in columns]


def _each_orientation(item: Addition, observed: Observed, seed: int) -> list[tuple[Column, float]]:
    """Amplitudes of the orientations, drawn from the seed and the orientation, so that an orientation always has the same ones."""
    (variant,) = item.effect.variants(_among_others(observed))
    found = []
    for column in variant.columns:
        # The other orientations only accompany the first.
        if column.axis is not None and column.segments is not None and column.segments[0]:
            place = np.rint(observed.attitude[0].ravel() * 1e6).astype(np.int64).view(np.uint32).tolist()
            drawn = float(np.random.default_rng([seed, column.axis, *place]).standard_normal())
            parts = {channel: part[: len(observed.time)] for channel, part in column.parts.items()}
            found.append((replace(column, parts=parts, segments=None), item.values["size"] * column.factor * drawn))
    return found


def _among_others(observed: Observed) -> Observed:
    """One segment with short copies in other orientations, because a single orientation has no separate error."""
    turns = [np.roll(np.eye(3), k, axis=0) for k in (1, 2)]
    half = np.diag([1.0, -1.0, -1.0])
    attitudes = [observed.attitude[0]] + [turn @ observed.attitude[0] for turn in (*turns, half, turns[0] @ half)]
    ends = len(observed.time) + np.arange(len(attitudes))
    sample = {
        name: np.concatenate([getattr(observed, name), np.repeat(getattr(observed, name)[-1:], len(attitudes) - 1)])
        for name in ("time", "angle", "rate", "acceleration", "temperature", "temperature_rate")
    }
    extended: dict[str, Any] = sample
    return replace(
        observed,
        labels=observed.labels * len(attitudes),
        motions=observed.motions * len(attitudes),
        attitude=np.array(attitudes),
        bounds=np.concatenate(([0], ends)).astype(np.int64),
        last_change=np.repeat(observed.last_change, len(attitudes)),
        values=np.zeros((int(ends[-1]), len(observed.channels))),
        fitted=None,
        **extended,
    )

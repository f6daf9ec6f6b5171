"""Adds effects of the catalogue to a simulation. Reads the parameters of the effects with their units, and changes the outputs of a
sensor.

An effect is added with the same columns that a diagnosis searches for. If the diagnosis then finds the effect, this shows only that
simulation and diagnosis agree. Only recordings that come from elsewhere can validate the two.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from planrunner.base import plugins
from planrunner.base.arrays import Array
from planrunner.base.findings import InputError, Mark, closest
from planrunner.error_model.effects.held import SamplesStuck, sticking
from planrunner.error_model.effects.interface import (
    Column,
    Curved,
    CurvedAndShaped,
    Effect,
    HasAlternatives,
    HasShape,
    InEveryWorld,
    OutsideCoefficients,
    OutsideKind,
    PerOrientation,
    Shaped,
    Variant,
    effect_named,
    is_whole,
    triad_of,
)
from planrunner.error_model.observed import Observed
from planrunner.plan.quantity import QuantityError, without_uncertainty
from planrunner.plan.units import UnknownUnitError, unit

STAGES = ("stimulus", "sensor", "output", "acquisition", "covariance")
NOISE: dict[OutsideKind, tuple[str, str]] = {
    "white": ("density", "*sqrt(s)"),
    "resolution": ("count", ""),
    "random walk": ("density", "/sqrt(s)"),
}
"""For each effect on the noise: the name of its parameter, and the text that is appended to the unit of the triad to give the
parameter's unit. White noise and counts replace the sensor's own values."""
OF_TRIAD: dict[str, str] = {"gyro": "deg/s", "accel": "m/s^2"}
"""Unit in which the noise of each triad is stated."""
BY_AXIS: dict[OutsideKind, str] = {"white": "white", "resolution": "count"}
"""Noise effects whose parameter may also be stated for single axes, as a diagnosis reports it, for example `white_x` or `count_z`.
The other axes keep the noise of the sensor."""
SIGMA = "sigma"
"""Parameter of a Gauss–Markov bias: its standard deviation. The second parameter is the correlation time `tau`."""
LASTING = "lasting"
"""Parameter of stuck samples: the time for which all outputs keep their values. `lasting_gyro_x` states this time for one
output."""
SHARE = "share"
"""Parameter of an effect that its shape determines completely: the fraction of the effect that acts. The default is 1."""
_OF_ORIENTATION = re.compile(r"orientation_[1-9][0-9]{0,3}_[xyz]")
SIZE = "size"
"""Parameter of an effect with a random value for every orientation: the standard deviation of these values."""
_UNUSUAL = 3.0  # default: multiple of the declared noise
_WALK = 1e-4  # default, deg/s/√s or m/s²/√s
_SIGMA = 1e-3  # default, deg/s or m/s²


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """A parameter of an effect. `natural`: default value, in `unit`. `least`: the permitted values. 'above zero' permits only
    positive values, for example of a time constant or a frequency. 'zero' also permits zero, for example for a duration or a
    standard deviation. 'any' permits both signs, for example of an amplitude."""

    name: str
    unit: str
    natural: float
    least: Literal["above zero", "zero", "any"] = "any"

    def allows(self, value: float) -> bool:
        return {"above zero": value > 0, "zero": value >= 0, "any": True}[self.least]


@dataclass(frozen=True)
class Addition:
    """Contains an effect with the values of all its parameters. `values`: maps each parameter to its value in its unit. `units`:
    maps each parameter to its unit."""

    effect: Effect
    values: Mapping[str, float]
    units: Mapping[str, str]

    @property
    def id(self) -> str:
        return self.effect.id

    def in_si(self, name: str) -> float:
        """Returns the value of a parameter, converted to SI units."""
        return self.values[name] * unit(self.units[name]).factor


def addition(name: str, stated: Mapping[str, str], observed: Observed, mark: Mark) -> Addition:
    """Makes an `Addition` from the name of an effect and the parameters that are stated for it. `stated`: maps each parameter to
    its value with unit; the empty name means the only parameter or, if there are several, all amplitudes. A parameter that is not
    stated has its default value. If an amplitude is stated under its own name, all amplitudes that are not stated are zero.

    `observed`: any recording or schedule of the plan. `observed` is necessary because the parameters of an effect depend on the
    plan. Raises `InputError` for an unknown parameter or value, and for an effect that cannot act on this sensor under this plan.
    """
    if name not in plugins.names(plugins.EFFECTS):
        hint = closest(name, plugins.names(plugins.EFFECTS))
        raise InputError.at(mark, "effect-unknown", f"no effect '{name}' is installed", hint)
    effect = effect_named(name)
    known = {parameter.name: parameter for parameter in parameters(effect, observed)}
    further = {parameter.name: parameter for parameter in _optional(effect, known, observed, stated)}
    if not known:
        hint = "check the sensor's outputs, the plan's motions and the site's magnetic_field"
        raise InputError.at(mark, "effect-cannot-act", f"'{name}' cannot act on this sensor under this plan", hint)
    shape = effect.shape_name if isinstance(effect, HasShape) else None
    named = any(key not in ("", shape, SHARE) for key in stated)
    values = {one.name: 0.0 if named and one.name != shape else one.natural for one in known.values()}
    if isinstance(effect, OutsideCoefficients) and any(key in further for key in stated):
        values = {} if shape is None else {shape: known[shape].natural}
    for key, text in stated.items():
        amplitudes = [one for one in known if one != shape] or list(known)
        for one in [key] if key else amplitudes:
            if one not in known and one not in further:
                message = f"'{name}' has no parameter '{key}'"
                raise InputError.at(mark, "effect-parameter", message, closest(key, known | further))
            values[one] = _value(text, (known | further)[one], name, mark)
    known |= further
    return Addition(effect, values, {one: known[one].unit for one in values})


def _optional(
    effect: Effect, known: Mapping[str, EffectParameter], observed: Observed, stated: Mapping[str, str]
) -> list[EffectParameter]:
    """Returns the optional parameters of an effect. A diagnosis may estimate these parameters, but they have no default value: they
    change the simulation only if they are stated."""
    if isinstance(effect, OutsideCoefficients) and effect.outside in BY_AXIS:
        (whole,) = known.values() or (None,)
        axes = sorted({observed.channels[index].axis for index in observed.of_kind(triad_of(effect))})
        return (
            [] if whole is None else [replace(whole, name=f"{BY_AXIS[effect.outside]}_{'xyz'[axis]}") for axis in axes]
        )
    if isinstance(effect, SamplesStuck):
        return [replace(known[LASTING], name=f"{LASTING}_{channel.name}") for channel in observed.channels]
    if isinstance(effect, PerOrientation) and known:
        return [replace(known[SIZE], name=key, least="any") for key in stated if _OF_ORIENTATION.fullmatch(key)]
    if isinstance(effect, Shaped) and set(known) == {effect.shape_name}:
        return [EffectParameter(SHARE, "1", 1.0)]
    return []


def _value(text: str, parameter: EffectParameter, effect: str, mark: Mark) -> float:
    """Converts a text to a number in the parameter's unit. The text may have this unit, another unit of the same dimension, or no
    unit."""
    number, _, given = text.strip().partition(" ")
    wanted = "" if parameter.unit == "1" else parameter.unit
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
    if not parameter.allows(value):
        limit = "above zero" if parameter.least == "above zero" else "zero or above"
        message = f"the parameter '{parameter.name}' of {effect} must be {limit}, but it is '{text}'"
        hint = f"write a value that is {limit}, such as '{parameter.natural:g} {wanted}'"
        raise InputError.at(mark, "effect-value", message, hint)
    return value


def parameters(effect: Effect, observed: Observed) -> list[EffectParameter]:
    """Returns the parameters of an effect; empty if the effect cannot act in this recording."""
    if isinstance(effect, SamplesStuck):
        return [EffectParameter("time", "s", 60.0, "zero"), EffectParameter(LASTING, "s", 1.0, "zero")]
    if isinstance(effect, OutsideCoefficients) and effect.outside == "gauss-markov":
        text = OF_TRIAD[triad_of(effect)]
        found = [EffectParameter("tau", "s", 300.0, "above zero"), EffectParameter(SIGMA, text, _SIGMA, "zero")]
        return found if observed.of_kind(triad_of(effect)) else []
    if isinstance(effect, OutsideCoefficients) and effect.outside in NOISE:
        triad = triad_of(effect)
        indices = observed.of_kind(triad)
        if not indices:
            return []
        name, text = NOISE[effect.outside]
        channel = observed.channels[indices[0]]
        declared: float = {
            "white": channel.white,
            "resolution": max(channel.resolution, channel.white * math.sqrt(observed.sample_rate)),
            "random walk": _WALK * unit(OF_TRIAD[triad]).factor / _UNUSUAL,
        }[effect.outside]
        own = unit(OF_TRIAD[triad])
        return [EffectParameter(name, OF_TRIAD[triad] + text, _UNUSUAL * declared / own.factor, "zero")]
    if isinstance(effect, HasAlternatives):
        # Zero means that the effect does not act in this way.
        return [replace(one, least="zero") for way in effect.alternatives for one in parameters(way, observed)]
    found = []
    variants = effect.variants(observed)
    if not variants:
        return []
    middle: Variant = variants[len(variants) // 2 if isinstance(effect, Shaped) else 0]
    if isinstance(effect, HasShape) and middle.shape is not None:
        signed = any(
            column.whole and column.smallest < 0 for column in middle.columns
        )  # a negative delay: the data are early
        least: Literal["above zero", "any"] = "any" if signed else "above zero"
        found.append(EffectParameter(effect.shape_name, effect.shape_unit, middle.shape, least))
    if isinstance(effect, PerOrientation):
        column = middle.columns[0]
        return [*found, EffectParameter(SIZE, column.unit, column.magnitude / column.factor, "zero")]
    if not is_whole(middle.columns) or not found:
        found += [
            EffectParameter(column.name, column.unit, column.magnitude / column.factor) for column in middle.columns
        ]
    return found


def stuck(name: str, time: Array, values: Array, additions: Sequence[Addition], before: float | None = None) -> Array:
    """Applies the effects that make samples stick to the readings of an output. A stuck sample repeats an earlier reading. Returns
    the changed readings, shape (n,). `time`: array of shape (n,), s since power-on. `before`: the reading before the first of
    `values`."""
    for item in additions:
        if isinstance(item.effect, SamplesStuck):
            lasting = item.values.get(f"{LASTING}_{name}", item.values.get(LASTING, 0.0))
            before = float(values[0]) if before is None else before
            values = sticking(time, values, item.values[item.effect.shape_name], lasting, before)
    return values


def added(
    observed: Observed, levels: Array, additions: Sequence[Addition], seed: int, orientation: int | None = None
) -> Array:
    """Adds all effects to the outputs, one stage after the other. Returns the outputs without noise, in SI units, shape (N, K).
    `levels`: array of shape (N, K), the outputs before the effects are added.

    `seed` and `orientation` are used for data of one segment. `seed`: the seed from which the amplitudes of each orientation are
    drawn. `orientation`: the number of the segment's orientation, counted from 1 in the order of first use. If the data contain
    several segments, no amplitudes are drawn: each orientation has only the amplitudes that are stated for it.
    """
    out = levels.copy()
    for stage in STAGES[:-1]:
        seen = replace(observed, fitted=out.copy())
        if observed.response is None and observed.along is None:
            seen = replace(seen, response=observed.response_in(out))
        for item in additions:
            if item.effect.stage == stage:
                for column, amplitude in _amplitudes(item, seen, seed, orientation):
                    here = 1.0 if column.segments is None else column.segments[seen.owner]
                    for channel, part in column.parts.items():
                        out[:, channel] += amplitude * part * here
    return out


def _amplitudes(item: Addition, observed: Observed, seed: int, orientation: int | None) -> list[tuple[Column, float]]:
    """Returns the columns of one added effect, each with its amplitude in SI units. `seed`, `orientation`: the same as in
    `added`."""
    effect, values = item.effect, item.values
    if isinstance(effect, PerOrientation) and len(observed) == 1:
        return _each_orientation(item, observed, seed, orientation)
    if isinstance(effect, PerOrientation):
        listed = [column for variant in effect.variants(observed) for column in variant.columns]
        return [(column, values.get(column.name, 0.0) * column.factor) for column in listed]
    if isinstance(effect, HasAlternatives):
        ways = [way for way in effect.alternatives if values[way.shape_name] > 0]
        return [(column, 1.0) for way in ways for column in way.at(observed, values[way.shape_name]).columns]
    if isinstance(effect, CurvedAndShaped) and isinstance(effect, Shaped):
        columns = effect.at(observed, values[effect.shape_name]).columns if len(effect.grid(observed)) else ()
        along = effect.secant(np.array([values[column.name] * column.factor for column in columns] or [0.0]))
        columns = along.at(observed, values[effect.shape_name]).columns if columns else ()
    elif isinstance(effect, Shaped):
        columns = effect.at(observed, values[effect.shape_name]).columns if len(effect.grid(observed)) else ()
    else:
        variants = effect.variants(observed)
        shape = values[effect.shape_name] if isinstance(effect, HasShape) else 0.0
        columns = min(variants, key=lambda one: abs((one.shape or 0.0) - shape)).columns if variants else ()
    if is_whole(columns):
        return [(columns[0], values.get(SHARE, 1.0) - isinstance(effect, InEveryWorld))]
    if columns and isinstance(effect, Curved):
        sizes = np.array([values[column.name] * column.factor for column in columns])
        columns = effect.around(observed, sizes)[0].columns
    return [(column, values[column.name] * column.factor) for column in columns]


def _each_orientation(
    item: Addition, observed: Observed, seed: int, orientation: int | None
) -> list[tuple[Column, float]]:
    """Does the same as `_amplitudes` for data of one segment and an effect that has separate amplitudes for each orientation. Each
    amplitude is the value that is stated for this orientation, plus a random value. The seed and the orientation determine the random
    value, so an orientation always has the same amplitudes."""
    (variant,) = item.effect.variants(_among_others(observed))
    found = []
    for column in variant.columns:
        # Only the columns of the first orientation belong to the segment.
        if column.axis is not None and column.segments is not None and column.segments[0]:
            place = np.rint(observed.attitude[0].ravel() * 1e6).astype(np.int64).view(np.uint32).tolist()
            drawn = float(np.random.default_rng([seed, column.axis, *place]).standard_normal())
            stated = item.values.get(f"orientation_{orientation}_{'xyz'[column.axis]}", 0.0)
            parts = {channel: part[: len(observed.time)] for channel, part in column.parts.items()}
            amplitude = (item.values[SIZE] * drawn + stated) * column.factor
            found.append((replace(column, parts=parts, segments=None), amplitude))
    return found


def _among_others(observed: Observed) -> Observed:
    """Extends a recording of one segment by short copies of this segment in other orientations. The copies are necessary because an
    effect with amplitudes for each orientation has no columns in a recording with a single orientation."""
    turns = [np.roll(np.eye(3), k, axis=0) for k in (1, 2)]
    half = np.diag([1.0, -1.0, -1.0])
    attitudes = [observed.attitude[0]] + [turn @ observed.attitude[0] for turn in (*turns, half, turns[0] @ half)]
    ends = len(observed.time) + np.arange(len(attitudes))
    sample = {
        name: np.concatenate([own, np.repeat(own[-1:], len(attitudes) - 1)]) for name, own in observed.sampled.items()
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

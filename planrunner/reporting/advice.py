"""Describes each effect that a diagnosis names: its plain name, its physics, who must act, and what to do. The text contains the
fitted parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from planrunner.base.documents import JsonObject
from planrunner.error_model.effects.interface import Actor, Effect, HasShape, about
from planrunner.gap.answer.parameters import ParameterEstimate
from planrunner.reporting.rounding import rounded
from planrunner.reporting.words import behind_number

MOST = 3
"""Maximum number of parameters in a sentence. The table of parameters contains all of them."""
CLEAR = 2.0
"""The sentence mentions a parameter if it is at least this number of times its standard uncertainty."""


@dataclass(frozen=True, slots=True)
class Advice:
    """Advice about one named effect. `remedy`: a sentence that contains the fitted parameters."""

    effect: str
    name: str
    physics: str
    actor: Actor
    remedy: str

    def to_json(self) -> JsonObject:
        """Returns the advice as JSON data according to `named` of `schemas/diagnosis.schema.json`."""
        plain: JsonObject = asdict(self) | {"actor": self.actor.value}
        return plain


def advice(effect: Effect, fitted: Sequence[ParameterEstimate]) -> Advice:
    """Returns the advice about an effect. `fitted`: the estimates of all effects that the diagnosis names."""
    own = [one for one in fitted if one.effect == effect.id]
    shape_name = effect.shape_name if isinstance(effect, HasShape) else None
    shape = next((one for one in own if one.name == shape_name), None)
    told = about(effect)
    return Advice(
        effect.id,
        told.name,
        told.physics,
        told.actor,
        told.advice(found(own, shape_name), None if shape is None else shape.value),
    )


def found(own: Sequence[ParameterEstimate], shape_name: str | None = None) -> str:
    """Returns the estimates of an effect in words: first its shape, then its most significant amplitudes."""
    shape = [one for one in own if one.name == shape_name]
    amplitudes = sorted((one for one in own if one.name != shape_name), key=_clearness, reverse=True)
    clear = [one for one in amplitudes if _clearness(one) >= CLEAR] or amplitudes[:1]
    left = len(clear) - MOST
    words = [_value(one) for one in (*shape, *clear[:MOST])] + ([f"and {left} more"] if left > 0 else [])
    return ", ".join(words) or "no parameter was fitted"


def _clearness(one: ParameterEstimate) -> float:
    size = abs(one.value)
    return size / one.standard_uncertainty if one.standard_uncertainty > 0 else float("inf") if size else 0.0


def _value(one: ParameterEstimate) -> str:
    return f"{one.name} {rounded(one.value, one.standard_uncertainty)}{behind_number(one.unit)}"

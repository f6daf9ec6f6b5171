"""What an engineer needs to know about an effect: its plain name, its physics, who can remove it, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from string import Formatter
from typing import Protocol, runtime_checkable

from planrunner.error_model.effects.interface import Effect


class Actor(StrEnum):
    """Who acts. BENCH: table, chamber, mounting and their synchronisation. SENSOR: the unit under test, or its compensation. PLAN: states
    and times. SITE: the declared place on the Earth. BOOKKEEPING: what files declare: labels, units, signs, noise."""

    BENCH = "bench"
    SENSOR = "sensor"
    PLAN = "plan"
    SITE = "site"
    BOOKKEEPING = "bookkeeping"


@dataclass(frozen=True, slots=True)
class About:
    """What an effect states about itself. name: in plain words. physics: one sentence. remedy: what to do; in this text, `{found}` is
    replaced by the fitted parameters. figures: computes further values for the remedy, by name, from the fitted shape in `shape_unit`,
    such as a bandwidth from a time constant."""

    name: str
    physics: str
    actor: Actor
    remedy: str
    figures: Callable[[float], Mapping[str, str]] | None = None

    def advice(self, found: str, shape: float | None) -> str:
        """The remedy with the fitted parameters in words."""
        values = {} if self.figures is None or shape is None else dict(self.figures(shape))
        wanted = {field for _, field, _, _ in Formatter().parse(self.remedy) if field}
        return self.remedy.format(**dict.fromkeys(wanted, "unknown") | values | {"found": found})


@runtime_checkable
class TellsAbout(Effect, Protocol):
    """An effect that states its plain name and its remedy."""

    about: About


_BY_STAGE = {"stimulus": Actor.BENCH, "acquisition": Actor.BENCH}


def about(effect: Effect) -> About:
    """What the effect states about itself. For a plug-in that states nothing, this consists of its identifier, the first paragraph of
    its docstring, and the actor for its stage."""
    if isinstance(effect, TellsAbout):
        return effect.about
    physics = " ".join((effect.__doc__ or "").partition("\n\n")[0].split())
    actor = _BY_STAGE.get(effect.stage, Actor.SENSOR)
    return About(effect.id.replace("_", " "), physics or "The plug-in describes no physics.", actor, _DEFAULT)


_DEFAULT = "Remove the cause, or compensate the effect: {found}."

"""Describes what an engineer needs to know about an effect: its plain name, its physics, who can remove it, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from string import Formatter
from typing import Protocol, runtime_checkable

from planrunner.error_model.effects.interface import Effect


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
        """Returns the remedy, with the fitted parameters inserted as text."""
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
    return About(effect.id.replace("_", " "), physics or "The plug-in describes no physics.", actor, _DEFAULT)


_DEFAULT = "Remove the cause, or compensate the effect: {found}."

"""Generates the list of effects, `docs/effects.md`, from the catalogue.

The command `python -m planrunner.error_model.reference docs` writes this file. A test checks that the file is up to date.
"""

from __future__ import annotations

import sys
from pathlib import Path

from planrunner.base import plugins
from planrunner.error_model.effects.interface import Actor, Effect, NoHypothesis, about, effect_named

_BEGINNING = """\
# Effects: where to correct, and what to do

`python -m planrunner.error_model.reference docs` writes this page from the classes of the effects. `planrunner diagnose` names effects
of this list, and states where to correct and what to do. In its output, the values that it found replace the words in italics.
`planrunner simulate --with EFFECT` adds an effect to a simulation, and the estimator [`error_model`](error-models.md) fits its
parameters.

Effects marked with † are used in simulations and estimates only. The diagnosis considers them only if you name them with `--given`. It
also considers the effects of the supply voltage if the voltage varies in the recording, the effects of the ambient pressure if the
pressure varies, and `gyro_saturation_asymmetric` if many readings stand at a limit that other readings exceed in the other direction.
"""
ACTORS = {
    Actor.BENCH: "the operator of the table, the chamber, the mounting and their synchronisation",
    Actor.SENSOR: "the manufacturer of the unit, or the person who compensates its outputs",
    Actor.PLAN: "the author of the plan, who chooses its states and times",
    Actor.SITE: "the person who declares the location of the bench on the Earth",
    Actor.BOOKKEEPING: "the author of the files, who declares labels, units, signs and noise",
}


def reference() -> str:
    """Returns the text of the page `docs/effects.md`."""
    effects = [effect_named(name) for name in plugins.names(plugins.EFFECTS)]
    parts = [_BEGINNING]
    for actor, words in ACTORS.items():
        rows = [_row(effect) for effect in effects if about(effect).actor is actor]
        parts.append(f"## Where to correct: {actor.value}\n\nCorrections are made by {words}.\n")
        parts.append("| effect | in plain words | physics | what to do |\n| --- | --- | --- | --- |\n" + "".join(rows))
    return "\n".join(parts)


def _row(effect: Effect) -> str:
    told = about(effect)
    remedy = told.remedy.partition(": {found}")[0].replace("{", "*").replace("}", "*")
    mark = " †" if isinstance(effect, NoHypothesis) else ""
    return f"| `{effect.id}`{mark} | {told.name} | {told.physics} | {remedy.rstrip('.')}. |\n"


if __name__ == "__main__":
    (Path(sys.argv[1]) / "effects.md").write_text(reference(), encoding="utf-8")

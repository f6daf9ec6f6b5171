"""What explains nearly all of a gap is named, whatever else there is; the rest is a remainder, and is said to be.

Terms of the full nominal model that a poorer one lacks: a sensor whose simulation has no bias has one; that it also swings a little,
in a way that no hypothesis has beside the bias, must not keep the bias from its name. And effects so strong that their idealised form
shows: what a flexible "something else" gains on them is then residue of the form.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from planrunner.plan.diagnosis_spec import NOMINAL_TERMS

STRONG = 2500.0  # twice the log evidence of an effect at 50 σ, above which its idealised form shows
RESIDUE = 0.05  # share of the explained energy below which the rest may be residue of an effect's form
FORM = 0.01  # the same, below which it is taken for that: of a second effect, or of what "something else" explains beyond one
ALIKE = 4.0  # nats of evidence between hypotheses that may be two names for one thing


def leading(log_evidence: Mapping[str, float], top: str, signatures: Collection[str]) -> tuple[str, str] | None:
    """The effect or pair that explains, at more than 50 σ, nearly all of what the likeliest hypothesis `top` does, and what of `top` is
    then a remainder; None where there is none, or where it is `top` itself.

    log_evidence: of every hypothesis relative to none; that of a strong effect is half the energy which it explains. signatures: effects
    that are more than noise.
    """
    parts = set(top.split("+"))
    if parts <= set(NOMINAL_TERMS):
        return None
    found = _most(log_evidence, NOMINAL_TERMS, (1 - RESIDUE) * log_evidence[top])
    if found is None and top == "unknown":
        found = _most(log_evidence, signatures, (1 - FORM) * log_evidence[top])
    return None if found is None else (found, "+".join(sorted(parts - set(found.split("+")))))


def _most(log_evidence: Mapping[str, float], among: Collection[str], least: float) -> str | None:
    known = [name for name in log_evidence if set(name.split("+")) <= set(among)]
    best = max(known, key=lambda name: log_evidence[name], default=None)
    return best if best is not None and 2 * log_evidence[best] > STRONG and log_evidence[best] >= least else None


def as_probable(log_evidence: Mapping[str, float], best: str) -> dict[str, float]:
    """Hypotheses with their probability relative to `best`, those left out that explain distinctly more."""
    away = {name: value - log_evidence[best] for name, value in log_evidence.items()}
    return {name: math.exp(min(value, 0.0)) for name, value in away.items() if value <= ALIKE}

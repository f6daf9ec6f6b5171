"""Terms of the full nominal model that a poorer one lacks: named where they explain nearly all of a gap, whatever else there is.

A sensor whose simulation has no bias has one; that it also swings a little, in a way that no hypothesis has beside the bias, must not
keep the bias from its name. What is left is a remainder, and is said to be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from planrunner.plan.diagnosis_spec import NOMINAL_TERMS

STRONG = 2500.0  # twice the log evidence of an effect at 50 σ, above which its idealised form shows
RESIDUE = 0.05  # share of the explained energy below which the rest is residue of an effect's form
ALIKE = 4.0  # nats of evidence between hypotheses that may be two names for one thing


def lacking(log_evidence: Mapping[str, float], top: str) -> tuple[str, str] | None:
    """The term, or pair of terms, that the nominal model lacks and that explains at more than 50 σ all but `RESIDUE` of what the likeliest
    hypothesis `top` does; and what of `top` is then a remainder. None where there is none, or where `top` is such a term itself.

    log_evidence: of every hypothesis relative to none; that of a strong effect is half the energy which it explains.
    """
    parts = set(top.split("+"))
    terms = {name: value for name, value in log_evidence.items() if set(name.split("+")) <= set(NOMINAL_TERMS)}
    if not terms or parts <= set(NOMINAL_TERMS):
        return None
    best = max(terms, key=lambda name: terms[name])
    if 2 * terms[best] <= STRONG or terms[best] < (1 - RESIDUE) * log_evidence[top]:
        return None
    return best, "+".join(sorted(parts - set(best.split("+"))))


def as_probable(log_evidence: Mapping[str, float], best: str) -> dict[str, float]:
    """Hypotheses with their probability relative to `best`, those left out that explain distinctly more."""
    away = {name: value - log_evidence[best] for name, value in log_evidence.items()}
    return {name: math.exp(min(value, 0.0)) for name, value in away.items() if value <= ALIKE}

"""From a posterior to a verdict: none, one effect, a pair, unknown, or a class of effects that this plan cannot distinguish.

An effect that explains nearly all of a gap is named, whatever else there is; the rest is reported as a remainder. The remainder may be
terms of the full nominal model that a reduced one lacks: if the simulation of a sensor has no bias, a small additional deviation that no
hypothesis explains must not prevent the naming of the bias. Effects can also be so strong that the difference from their idealised form is
visible: the energy that a flexible "something else" then explains is form residue.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planrunner.gap.answer.confusability import ALIKE, DISCRIMINABLE, beside, energy, fitted, reproduced
from planrunner.gap.answer.posterior import Posterior, pair_key
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing
from planrunner.plan.model import NOMINAL_TERMS

STRONG = 2500.0  # twice the log evidence of an effect at 50 σ, above which errors of its idealised form are visible
RESIDUE = 0.05  # share of the explained energy below which the rest may be form residue
FORM = 0.01  # the same, below which a second effect or "something else" counts as form residue
TWO_NAMES = 4.0  # nats of evidence between hypotheses that may have the same cause


def leading(log_evidence: Mapping[str, float], top: str, signatures: Collection[str]) -> tuple[str, str] | None:
    """The effect or pair that explains, at more than 50 σ, nearly as much as the likeliest hypothesis `top`, and the part of `top` that is
    then a remainder; None if there is no such effect, or if it is `top` itself.

    log_evidence: of every hypothesis relative to none; for a strong effect it is half the explained energy. signatures: effects that do not
    only change the noise.
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
    """Hypotheses with their probability relative to `best`, without those that explain clearly more."""
    away = {name: value - log_evidence[best] for name, value in log_evidence.items()}
    return {name: math.exp(min(value, 0.0)) for name, value in away.items() if value <= TWO_NAMES}


NAMEABLE = 0.05  # the probability of none above which no effect is named
RIVAL = 0.02  # fraction of the first's probability: less likely members of a class are left out, because the data exclude them
COVERED = 0.95
ELSEWHERE = 0.5  # share of an effect's energy in other channels at and above which it is not form residue
SOMETHING_ELSE = 0.90  # the probability at and above which "unknown" is reported


@dataclass(frozen=True, slots=True)
class Verdict:
    """kind: none, effect, pair, unknown or indistinguishable. effects: the likeliest. members: effects that cannot be distinguished from
    them, including themselves; pairs as 'a+b'. residue: an effect, or "unknown", that may be only form residue of the named effect; it
    may also be one of a named pair."""

    kind: str
    effects: tuple[str, ...] = ()
    members: tuple[str, ...] = ()
    residue: str | None = None


def verdict(weighing: Weighing, found: Posterior, candidates: Sequence[Candidate]) -> Verdict:
    """The verdict. Nothing is named while P(none) is 5 % or more, nor a member of a class that the plan cannot separate."""
    probability = found.probability
    if probability["none"] >= NAMEABLE:
        return Verdict("none")
    top = next(iter(probability))
    by_id = {candidate.id: candidate for candidate in candidates}
    top, remainder = leading(found.log_evidence, top, by_id) or (top, None)
    if top == "unknown":
        best = next(name for name in probability if name not in ("none", "unknown"))
        if probability["unknown"] >= SOMETHING_ELSE:
            return Verdict("unknown")
        return Verdict("indistinguishable", tuple(best.split("+")), (best, "unknown"))
    likely = probability if remainder is None else as_probable(found.log_evidence, top)
    if "+" not in top:
        return _named("effect", (top,), _rivals(likely, by_id, top), remainder)
    named, residue = _residue(found, by_id, top)
    if named == top or residue is None:
        return _named(
            "pair", tuple(top.split("+")), _rival_pairs(likely, found.pairs, by_id, top), remainder or residue
        )
    beside = {name: likely.get(pair_key(name, residue), 0.0) for name in by_id if name != residue}
    return _named("effect", (named,), _rivals(beside, by_id, named), remainder or residue)


def _named(kind: str, effects: tuple[str, ...], rivals: tuple[str, ...], residue: str | None) -> Verdict:
    """Effects of a kind or, if they have rivals, their class."""
    return (
        Verdict("indistinguishable", effects, rivals, residue)
        if len(rivals) > 1
        else Verdict(kind, effects, (), residue)
    )


def ambiguity_set(probability: Mapping[str, float]) -> list[str]:
    """The likeliest hypotheses with a total probability of 95 %."""
    chosen, total = [], 0.0
    for name, value in probability.items():
        chosen.append(name)
        total += value
        if total >= COVERED:
            break
    return chosen


def _confusable(weighed: Weighed, rivals: Sequence[Weighed]) -> bool:
    signature = fitted(weighed)
    share = reproduced(signature, rivals)
    return share > ALIKE or energy(signature) * (1 - share) < DISCRIMINABLE


def _rivals(probability: Mapping[str, float], by_id: Mapping[str, Candidate], top: str) -> tuple[str, ...]:
    """Single effects that cannot be distinguished from `top`, with itself first. Effects on the noise are distinguished only by their
    evidence."""
    found = [top]
    for name, value in probability.items():
        if name == top or "+" in name or name in ("none", "unknown") or value < RIVAL * probability.get(top, 0.0):
            continue
        if top in by_id and name in by_id:
            if _confusable(by_id[top].best, by_id[name].variants):
                found.append(name)
        elif value > probability.get(top, 0.0) / 10:
            found.append(name)
    return tuple(found)


def _rival_pairs(
    probability: Mapping[str, float], pairs: Mapping[str, Weighed], by_id: Mapping[str, Candidate], top: str
) -> tuple[str, ...]:
    """Pairs that share one effect with `top` and replace the other by one that cannot be distinguished from it; `top` first."""
    found = [top]
    mine = set(top.split("+"))
    for name, value in probability.items():
        theirs = set(name.split("+"))
        if name == top or len(theirs) < 2 or len(mine & theirs) != 1 or value < RIVAL * probability[top]:
            continue
        confusable = (
            _confusable(pairs[top], [pairs[name]]) if top in pairs and name in pairs else value > probability[top] / 10
        )
        if confusable:
            found.append(name)
    return tuple(found)


def _residue(found: Posterior, by_id: Mapping[str, Candidate], pair: str) -> tuple[str, str | None]:
    """The effects of a pair to name, and the one that may be form residue: the weaker effect, if at more than 50 σ it explains less than
    `RESIDUE` of what both explain. Below `FORM` it is not named. It is not form residue if it acts on channels on which the first does
    not act, or if it raises the noise level. Terms of a nominal model are exact and have no form residue."""
    energies = {name: 2 * float(by_id[name].log_bayes[0]) for name in pair.split("+") if name in by_id}
    first = max(energies, key=lambda name: energies[name], default="")
    if not first or first in NOMINAL_TERMS:
        return pair, None
    both = 2 * found.log_evidence[pair]
    other = next(name for name in pair.split("+") if name != first)
    if other in found.levels:
        return pair, None
    alone = 2 * max(found.log_evidence.get(first, -np.inf), 0.0)
    small = alone > STRONG and alone > (1 - RESIDUE) * both
    if not small or (pair in found.pairs and beside(found.pairs[pair], by_id[first]) > ELSEWHERE):
        return pair, None
    return (first if alone > (1 - FORM) * both else pair), other

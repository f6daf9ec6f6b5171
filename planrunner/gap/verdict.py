"""From a posterior to a verdict: none, one effect, a pair, unknown, or a class that this plan cannot tell apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planrunner.gap.candidates import Candidate, Weighed, Weighing
from planrunner.gap.confusability import ALIKE, DISCRIMINABLE, energy, fitted, reproduced
from planrunner.gap.posterior import Posterior, pair_key
from planrunner.gap.remainder import RESIDUE, STRONG, as_probable, leading

NAMEABLE = 0.05  # the probability of none above which no effect is named
RIVAL = 0.02  # of the first's probability: less likely members of a class are left out, the data have excluded them
COVERED = 0.95
SOMETHING_ELSE = (
    0.90  # the probability of unknown from which on a recording is said to hold what the catalogue does not
)


@dataclass(frozen=True, slots=True)
class Verdict:
    """kind: none, effect, pair, unknown or indistinguishable. effects: the likeliest. members: what cannot be told from them, themselves
    included; pairs as 'a+b'. residue: an effect that only takes up what the named one's idealised form leaves."""

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
    most = leading(found.log_evidence, top, by_id)
    if most is not None:
        best, rest = most
        alike = as_probable(found.log_evidence, best)
        pair = "+" in best
        rivals = _rival_pairs(alike, found.pairs, by_id, best) if pair else _rivals(alike, by_id, best)
        kind = "indistinguishable" if len(rivals) > 1 else ("pair" if pair else "effect")
        return Verdict(kind, tuple(best.split("+")), rivals if len(rivals) > 1 else (), rest)
    if top == "unknown":
        best = next(name for name in probability if name not in ("none", "unknown"))
        if probability["unknown"] >= SOMETHING_ELSE:
            return Verdict("unknown")
        return Verdict("indistinguishable", tuple(best.split("+")), (best, "unknown"))
    if "+" in top:
        first, residue = _residue(found, by_id, top)
        if residue is not None:
            beside = {name: probability.get(pair_key(name, residue), 0.0) for name in by_id if name != residue}
            rivals = _rivals(beside, by_id, first)
            kind = "effect" if len(rivals) == 1 else "indistinguishable"
            return Verdict(kind, (first,), rivals if len(rivals) > 1 else (), residue)
        rivals = _rival_pairs(probability, found.pairs, by_id, top)
        kind = "pair" if len(rivals) == 1 else "indistinguishable"
        return Verdict(kind, tuple(top.split("+")), rivals if len(rivals) > 1 else ())
    rivals = _rivals(probability, by_id, top)
    return Verdict("effect", (top,)) if len(rivals) == 1 else Verdict("indistinguishable", (top,), rivals)


def ambiguity_set(probability: Mapping[str, float]) -> list[str]:
    """The likeliest hypotheses that together hold 95 %."""
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
    """Single effects that cannot be told from `top`, with itself first. Effects on the noise are told by their evidence alone."""
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
    """Pairs that share one effect with `top` and replace the other by one that cannot be told from it; `top` first."""
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
    """The leading effect of a pair, and the other where it explains less than `RESIDUE` of what both explain at more than 50 σ."""
    leading = [name for name in pair.split("+") if name in by_id]
    if not leading:
        return pair, None
    energies = {name: 2 * float(by_id[name].log_bayes[0]) for name in leading}
    first = max(energies, key=lambda name: energies[name])
    both = 2 * found.log_evidence[pair]
    other = next(name for name in pair.split("+") if name != first)
    alone = 2 * max(found.log_evidence.get(first, -np.inf), 0.0)
    strong = alone > STRONG
    return (first, other) if strong and alone > (1 - RESIDUE) * both else (first, None)

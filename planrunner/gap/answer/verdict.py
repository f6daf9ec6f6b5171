"""Derives a verdict from a posterior: none, one effect, a pair, several effects, unknown, or a class of effects that this plan
cannot distinguish.

An effect that explains nearly all of a gap is named, even if an unknown cause acts in addition. The rest of the gap is reported as
the remainder. There are two typical cases. First, a simulation may lack a nominal term such as the bias. The bias is then named,
even if there is a small further deviation that no hypothesis explains. Second, an effect can be so strong that its deviation from
its idealised form becomes visible. The flexible patterns outside the catalogue then seem to explain this deviation. The energy of
the deviation is called form residue.

The confusability states which effects a plan can distinguish. It can be computed before and after the recording. For the
confusability ρ(A|B), the signature of effect A is whitened, and the part that the nominal parameters absorb is projected out. Then
ρ(A|B) is the fraction of the energy of this signature that effect B reproduces with suitable amplitudes. If λ is the energy of the
fitted effect A, the test between A and B has the non-centrality λ(1 − ρ).

In array shapes, M is the number of coefficients of a channel.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planrunner.base.arrays import Array
from planrunner.gap.answer.posterior import NAMEABLE, UNKNOWN, Posterior, without_unknown
from planrunner.gap.answer.sets import EffectSet, key_of
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing
from planrunner.plan.model import NOMINAL_TERMS

DISCRIMINABLE = 10.0  # non-centrality below which two effects are not distinguished
ALIKE = 0.9  # confusability above which two effects form one class at any energy
_RIDGE = 1e-9


def fitted(weighed: Weighed) -> list[Array]:
    """Returns the signature of an effect at its fitted amplitudes, an array of shape (M,) for each channel. The signature is
    whitened, and the part that the nominal parameters absorb is projected out."""
    amplitudes, _ = weighed.amplitudes
    return [block @ amplitudes for block in weighed.by_channel]


def energy(signature: Sequence[Array]) -> float:
    return float(sum(part @ part for part in signature))


def reproduced(signature: Sequence[Array], rivals: Sequence[Weighed]) -> float:
    """Returns the fraction of a signature's energy that the best of the `rivals` reproduces."""
    total = energy(signature)
    if total <= 0:
        return 0.0
    shares = []
    for rival in rivals:
        score = np.sum([block.T @ part for block, part in zip(rival.by_channel, signature, strict=True)], axis=0)
        gram = rival.gram[0] + _RIDGE * rival.trace / len(rival.gram[0]) * np.eye(len(rival.gram[0]))
        shares.append(float(score @ np.linalg.solve(gram, score)) / total)
    return min(1.0, max(shares, default=0.0))


def energy_beside(together: EffectSet, name: str) -> float:
    """Returns the fraction of an effect's fitted energy that lies in channels on which the other effects of the set do not act. An
    imperfect form of the other effects cannot cause this energy."""
    weighed, own = together.weighed, together.columns(name)
    amplitudes, _ = weighed.amplitudes
    others = np.ones(len(amplitudes), dtype=bool)
    others[own] = False
    energies = [float(((block[:, own] @ amplitudes[own]) ** 2).sum()) for block in weighed.by_channel]
    elsewhere = [part for part, raw in zip(energies, weighed.raw, strict=True) if not raw[:, others].any()]
    return sum(elsewhere) / sum(energies) if sum(energies) > 0 else 0.0


def shared(best: Sequence[Weighed]) -> Array:
    """Computes the confusability ρ(A|B) before data are recorded, shape (n, n) for n effects, one row for each effect A. The
    confusability is averaged over amplitudes from the prior of A: ρ = tr(G_ab·G_bb⁻¹·G_ba)/tr(G_aa), where G is the Gram matrix of
    the signatures of A and B. `best`: the evaluated best form of each effect."""
    bounds = np.concatenate(([0], np.cumsum([len(item.gram[0]) for item in best]))).astype(int)
    parts = [slice(low, high) for low, high in pairwise(bounds)]
    blocks = [np.hstack(channel) for channel in zip(*(item.by_channel for item in best), strict=True)]
    gram = np.sum([block.T @ block for block in blocks], axis=0)
    shares = np.empty((len(best), len(best)))
    for column, (b, part) in enumerate(zip(best, parts, strict=True)):
        own = b.gram[0] + _RIDGE * b.trace / len(b.gram[0]) * np.eye(len(b.gram[0]))
        taken = (np.linalg.solve(own, gram[part]) * gram[part]).sum(0)
        shares[:, column] = [taken[rows].sum() / a.trace for a, rows in zip(best, parts, strict=True)]
    return np.clip(shares, 0.0, 1.0)


def matrix(candidates: Sequence[Candidate]) -> tuple[list[str], Array]:
    """Returns the names of all candidates that have a signature, and the matrix of their confusabilities ρ(A|B). Each effect has
    its most probable shape. The matrix has one row for each effect A."""
    present = [candidate for candidate in candidates if np.isfinite(candidate.log_bayes).any()]
    return [c.id for c in present], shared([candidate.best for candidate in present])


STRONG = 2500.0  # twice the log evidence of an effect of 50 σ; errors of the form of a stronger effect are visible
RESIDUE = 0.05  # fraction of the explained energy below which the remaining energy may be form residue
FORM = 0.01  # fraction below which a second effect or "something else" counts as form residue
TWO_NAMES = 4.0  # nats, largest difference between the log evidences of hypotheses that may have the same cause


def leading(
    log_evidence: Mapping[str, float], log_weights: Mapping[str, float], top: str, signatures: Collection[str]
) -> tuple[str, str] | None:
    """Finds the most probable set of effects that explains nearly as much of the gap as the most probable hypothesis `top`. This
    set must also explain more than 50 standard deviations of the noise. Returns the name of this set, and the names of the other
    effects of `top`. The part of the gap that these other effects explain counts as the remainder. Returns None if there is no such
    set, or if `top` consists only of terms of the nominal model. The search covers only terms of the nominal model; if `top` is
    "unknown" and no such term is found, it covers all effects in `signatures`.

    `log_evidence`: log evidence of every hypothesis relative to "none". For a strong effect, the log evidence is about half of the
    explained energy. `log_weights`: log probability of every cause, up to a constant. `signatures`: names of the effects that change
    the outputs, not only the noise.
    """
    parts = set(top.split("+"))
    if parts <= set(NOMINAL_TERMS):
        return None
    found = _most(log_evidence, log_weights, NOMINAL_TERMS, (1 - RESIDUE) * log_evidence[top])
    if found is None and top == "unknown":
        found = _most(log_evidence, log_weights, signatures, (1 - FORM) * log_evidence[top])
    return None if found is None else (found, "+".join(sorted(parts - set(found.split("+")))))


def _most(
    log_evidence: Mapping[str, float], log_weights: Mapping[str, float], among: Collection[str], least: float
) -> str | None:
    """Returns the most probable set of effects in `among` whose log evidence is at least `least` and at least the log evidence of a
    strong effect."""
    known = [
        name
        for name, value in log_evidence.items()
        if value >= least and 2 * value > STRONG and set(name.split("+")) <= set(among) and name in log_weights
    ]
    return max(known, key=lambda name: log_weights[name], default=None)


def as_probable(log_evidence: Mapping[str, float], log_weights: Mapping[str, float], best: str) -> dict[str, float]:
    """Maps each cause to the ratio of its probability to the probability of `best`, limited to 1. Causes that explain clearly more
    of the gap than `best` are omitted. `log_evidence`: log evidence of each hypothesis. `log_weights`: log probability of each
    cause, up to a constant."""
    return {
        name: math.exp(min(log_weights[name] - log_weights[best], 0.0))
        for name, value in log_evidence.items()
        if name in log_weights and value - log_evidence[best] <= TWO_NAMES
    }


RIVAL = 0.02  # smallest probability of a member of a class, relative to the most probable member
UNCOMPARED = 0.1
"""The same as `RIVAL`, for hypotheses whose signatures cannot be compared: "unknown", and sets of effects on the noise."""
COVERED = 0.95
ELSEWHERE = 0.5  # fraction of an effect's energy in other channels at and above which the effect is not form residue
BESIDE = 0.5  # probability above which an effect on the noise, a tone or bursts are stated in addition to a cause
SOMETHING_ELSE = 0.90  # probability at and above which "unknown" is reported


@dataclass(frozen=True, slots=True)
class Verdict:
    """Contains the verdict of a diagnosis. `kind`: none, effect, pair, several, unknown or indistinguishable. `effects`: the
    effects of the most probable hypothesis. `members`: the hypotheses that this plan cannot distinguish, including `effects`; a set
    of effects is written 'a+b'. `residue`: an effect, or "unknown", that may be only form residue. Form residue is energy that
    remains because the strongest named effect deviates from its idealised form. `residue` may be one of the named effects.
    `something_else`: True if something that the catalogue does not contain acts in addition to the named effects. `noise`: effects
    on the level of the noise that probably act in addition.
    """

    kind: str
    effects: tuple[str, ...] = ()
    members: tuple[str, ...] = ()
    residue: str | None = None
    something_else: bool = False
    noise: tuple[str, ...] = ()

    @property
    def named(self) -> tuple[str, ...]:
        """Returns the effects of the cause, followed by the effects on the noise that act in addition."""
        return self.effects + self.noise

    @property
    def key(self) -> str:
        """Returns the name of the hypothesis in the verdict."""
        return key_of([*self.effects, *([UNKNOWN] if self.something_else else [])]) if self.effects else self.kind


def verdict(weighing: Weighing, found: Posterior, candidates: Sequence[Candidate]) -> Verdict:
    """Derives the verdict from the posterior. No effect is named if P(none) is 5 % or more. If the plan cannot distinguish several
    effects, their class is named instead of a single effect. If something else may be the whole cause, the class includes it."""
    said = _cause(weighing, found, candidates)
    if said.kind == "none":
        return said
    return replace(
        said, noise=tuple(name for name, p in found.noise.items() if p > BESIDE and name not in said.effects)
    )


def _cause(weighing: Weighing, found: Posterior, candidates: Sequence[Candidate]) -> Verdict:
    """Returns the verdict about the cause, without effects on the noise that act in addition."""
    probability = found.of_effects()
    if probability["none"] >= NAMEABLE:
        return Verdict("none")
    first = next(iter(probability))
    by_id = {candidate.id: candidate for candidate in candidates}
    top, remainder = leading(found.log_evidence, found.log_weights, first, by_id) or (first, None)
    if top == UNKNOWN:
        best = next((name for name in probability if name not in ("none", UNKNOWN)), "")
        if not best or probability[UNKNOWN] >= SOMETHING_ELSE:
            return Verdict("unknown")
        return Verdict("indistinguishable", tuple(best.split("+")), (best, UNKNOWN))
    likely = probability if remainder is None else as_probable(found.log_evidence, found.log_weights, top)
    named, residue = _residue(found, by_id, top)
    left = found.probability.get(key_of([*top.split("+"), UNKNOWN]), 0.0) > found.probability.get(top, 0.0)
    left = left or found.beside > BESIDE
    if named == top or residue is None:
        rivals = _rivals(likely, by_id, top) if "+" not in top else _rival_sets(likely, found.sets, by_id, top)
    else:
        beside = {
            without: value
            for name, value in likely.items()
            if (without := _without(name, residue)) and len(without.split("+")) == len(named.split("+"))
        }
        rivals = _rivals(beside, by_id, named) if "+" not in named else (named,)
    if remainder is not None and "+" not in named:
        rivals += tuple(name for name in _instead(found.log_evidence, first, named, by_id) if name not in rivals)
    if remainder is None and residue is None and likely.get(UNKNOWN, 0.0) > UNCOMPARED * likely.get(top, 0.0):
        rivals = (*rivals, UNKNOWN)
    return _named(tuple(named.split("+")), rivals, remainder or residue, left)


def _instead(log_evidence: Mapping[str, float], first: str, named: str, among: Collection[str]) -> list[str]:
    """Returns those effects of the most probable hypothesis `first` that explain nearly all of the gap without the other effects.
    If `named` is not in this hypothesis, such an effect may act instead of `named`: an output at its limit, for example, shows a
    smaller scale factor. `log_evidence`: log evidence of each hypothesis. `among`: effects that may be returned."""
    parts = first.split("+")
    if named in parts:
        return []
    least = (1 - FORM) * log_evidence[first]
    return [name for name in parts if name in among and log_evidence.get(name, -math.inf) >= least]


def _without(name: str, effect: str) -> str:
    """Returns the name of the set that remains after `effect` has been removed from the set `name`; empty if the set does not
    contain `effect`."""
    parts = name.split("+")
    return key_of(part for part in parts if part != effect) if effect in parts else ""


def _named(effects: tuple[str, ...], rivals: tuple[str, ...], residue: str | None, left: bool) -> Verdict:
    """Returns the verdict that names the effects. If there is more than one rival, the verdict names the class that consists of the
    effects and their rivals. `rivals`: the hypotheses that cannot be distinguished from each other, including the hypothesis that
    consists of `effects`. `left`: True if something else acts in addition."""
    if len(rivals) > 1:
        return Verdict("indistinguishable", effects, rivals, residue, left)
    return Verdict({1: "effect", 2: "pair"}.get(len(effects), "several"), effects, (), residue, left)


def ambiguity_set(probability: Mapping[str, float], said: Verdict) -> list[str]:
    """Returns the most probable hypotheses, in descending order, up to a total probability of 95 %. If the hypothesis of the
    verdict is not among them, it is added. It can be missing for two reasons: a more probable hypothesis explains only form
    residue, or "none" is so probable that no effect is named."""
    chosen, total = [], 0.0
    for name, value in probability.items():
        chosen.append(name)
        total += value
        if total >= COVERED:
            break
    stated = said.key
    if stated in probability and without_unknown(stated) not in map(without_unknown, chosen):
        chosen.append(stated)
    return chosen


def _confusable(weighed: Weighed, rivals: Sequence[Weighed]) -> bool:
    signature = fitted(weighed)
    share = reproduced(signature, rivals)
    return share > ALIKE or energy(signature) * (1 - share) < DISCRIMINABLE


def _rivals(probability: Mapping[str, float], by_id: Mapping[str, Candidate], top: str) -> tuple[str, ...]:
    """Returns the single effects that cannot be distinguished from `top`; the first one is `top` itself. Effects on the noise have
    no signature, so only their probabilities are compared."""
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


def _rival_sets(
    probability: Mapping[str, float], sets: Mapping[str, EffectSet], by_id: Mapping[str, Candidate], top: str
) -> tuple[str, ...]:
    """Returns the sets that differ from `top` in one effect and cannot be distinguished from it; the first one is `top` itself."""
    found = [top]
    mine = set(top.split("+"))
    for name, value in probability.items():
        theirs = set(name.split("+"))
        alike = len(theirs) == len(mine) and len(mine & theirs) == len(mine) - 1
        if name == top or not alike or value < RIVAL * probability.get(top, 0.0):
            continue
        ours, other = (key_of(part for part in key.split("+") if part in by_id) for key in (top, name))
        confusable = (
            _confusable(sets[ours].weighed, [sets[other].weighed])
            if ours in sets and other in sets and ours != other
            else value > UNCOMPARED * probability.get(top, 0.0)
        )
        if confusable:
            found.append(name)
    return tuple(found)


def _residue(found: Posterior, by_id: Mapping[str, Candidate], named: str) -> tuple[str, str | None]:
    """Examines whether the weakest effect of the set `named` may be form residue. Form residue is energy that remains because the
    strongest effect deviates from its idealised form. Returns two values: the effects that the verdict names, and the weakest
    effect if it may be form residue, otherwise None. Two conditions must be true for form residue: the other effects explain more
    than 50 standard deviations of the noise, and the weakest effect adds less than the fraction `RESIDUE` of the energy that all
    effects explain together. If the weakest effect adds less than the fraction `FORM`, it is not named. If most of an effect's
    energy is in channels on which the other effects do not act, or if the effect raises the noise level, it is not form residue.
    Terms of a nominal model are exact and have no form residue."""
    names = named.split("+")
    energies = {name: 2 * float(by_id[name].log_bayes[0]) for name in names if name in by_id}
    first = max(energies, key=lambda name: energies[name], default="")
    if len(names) < 2 or not first or first in NOMINAL_TERMS:
        return named, None
    whole = 2 * found.log_evidence[named]
    without = {
        name: 2 * max(found.log_evidence.get(_without(named, name), -np.inf), 0.0)
        for name in names
        if name != first and name not in found.levels
    }
    other = max(without, key=lambda name: without[name], default=None)
    if other is None:
        return named, None
    rest = without[other]
    small = rest > STRONG and rest > (1 - RESIDUE) * whole
    known = found.sets.get(key_of(name for name in names if name in by_id))
    if not small or (known is not None and other in by_id and energy_beside(known, other) > ELSEWHERE):
        return named, None
    return (_without(named, other) if rest > (1 - FORM) * whole else named), other

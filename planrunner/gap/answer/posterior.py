"""The posterior over {none, each effect, pairs, unknown}, with fixed and published priors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from planrunner.error_model.effects.interface import ActsOnNoise, Effect, Variant
from planrunner.gap.evidence.bayes_factors import averaged, from_eigen, pair_log_bayes_factor
from planrunner.gap.evidence.noise_levels import log_densities
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing
from planrunner.gap.hypotheses.open_set import Kinds, Line, competitors, unknown
from planrunner.gap.hypotheses.patterns import Pattern

Array = NDArray[np.float64]
BESIDE = 0.001  # probability of a tone or bursts beside an effect, from an independent cause
PRIORS = {"none": 0.20, "single": 0.50, "pair": 0.15, "unknown": 0.15}
FIRST = 6  # number of effects from which pairs are formed: the likeliest
WEIGHED = 10  # number of pairs evaluated in full, selected by a quick evaluation
PAIR_ENERGIES = np.geomspace(0.5, 1e6, 15)


@dataclass(frozen=True)
class Posterior:
    """probability: of every hypothesis, pairs as 'a+b' in alphabetical order. log_evidence: of each, relative to none, for effects from the
    coefficients alone. pairs: the
    weighed variant of pairs of two deterministic effects. kinds: log evidence, relative to none, of what "unknown" could be. by_channel:
    log BF (K,) of each of those in one channel alone. levels: effects that only raise the noise level. lines:
    tones. beside: probability of a tone or bursts beside an effect."""

    probability: dict[str, float]
    log_evidence: dict[str, float]
    pairs: dict[str, Weighed] = field(repr=False)
    kinds: dict[Pattern, float]
    by_channel: dict[Pattern, Array] = field(repr=False)
    levels: frozenset[str] = frozenset()
    lines: tuple[Line, ...] = ()
    beside: float = 0.0


def pair_key(first: str, second: str) -> str:
    return "+".join(sorted((first, second)))


def posterior(weighing: Weighing, effects: Sequence[Effect], candidates: Sequence[Candidate]) -> Posterior:
    """Weigh all hypotheses. effects: all that are installed; candidates: those of them with signatures, weighed."""
    nothing = np.zeros(len(weighing.base))
    levels = log_densities(weighing.declared, weighing.white, weighing.white_degrees, weighing.steps)
    acting = {effect.noise: effect.id for effect in effects if isinstance(effect, ActsOnNoise)}
    walk = acting.pop("random walk", "")
    others = {name: level for level, name in acting.items()}
    start = weighing.evidence(nothing) + levels["declared"]
    alone = {"": nothing} | {c.id: c.log_bayes for c in candidates if np.isfinite(c.log_bayes).any()}
    found: dict[str, float] = {}
    walks = (False, True) if walk and np.isfinite(weighing.log_prior[1]).any() else (False,)
    for (name, log_bayes), walking in product(alone.items(), walks):
        value = weighing.evidence(log_bayes, walking) - start
        for other, level in {"": "declared", **others}.items():
            present = [part for part in (name, walk if walking else "", other) if part]
            if len(present) < 3:
                found["+".join(sorted(present)) or "none"] = value + levels[level]
    together, weighed = _pairs(weighing, candidates)
    found |= {key: value + levels["declared"] - start for key, value in together.items()}
    kinds = competitors(weighing)
    found["unknown"] = weighing.evidence(unknown(kinds)) + levels["declared"] - start
    plainly = {what: weighing.evidence(value) + levels["declared"] - start for what, value in kinds.log_bayes.items()}
    beside = float(np.exp(np.log(BESIDE) + kinds.outside - _beside(kinds)))
    return Posterior(
        _normalised({name: value + (0.0 if name in PRIORS else _beside(kinds)) for name, value in found.items()}),
        found,
        weighed,
        plainly,
        kinds.by_channel,
        frozenset(acting.values()),
        kinds.lines,
        beside,
    )


def _beside(kinds: Kinds) -> float:
    """log BF of any effect, averaged over the presence of a tone or bursts from an independent cause."""
    return float(np.logaddexp(np.log1p(-BESIDE), np.log(BESIDE) + kinds.outside))


def _normalised(log_evidence: dict[str, float]) -> dict[str, float]:
    """Priors are shared evenly by all effects that the plan can excite, and by all pairs of these. An effect that this plan cannot
    excite counts as absent."""
    acting = sum(np.isfinite(value) and name not in PRIORS and "+" not in name for name, value in log_evidence.items())
    shares = {"single": PRIORS["single"] / max(acting, 1), "pair": PRIORS["pair"] / max(acting * (acting - 1) / 2, 1)}
    logs = {}
    for name, value in log_evidence.items():
        kind = name if name in PRIORS else ("pair" if "+" in name else "single")
        logs[name] = value + float(np.log(shares.get(kind, PRIORS.get(kind, 0.0))))
    total = np.logaddexp.reduce(list(logs.values()))
    return {name: float(np.exp(value - total)) for name, value in sorted(logs.items(), key=lambda item: -item[1])}


def _pairs(weighing: Weighing, candidates: Sequence[Candidate]) -> tuple[dict[str, float], dict[str, Weighed]]:
    """Log evidence of pairs of effects with signatures, and the fully evaluated best pairs.

    A quick evaluation fixes each likely effect at its most probable size and evaluates every form of the others on the rest. The best pairs
    are then evaluated with both amplitudes on a grid, under every setting of the noise. The others keep their evidence at the declared
    noise.
    """
    usable = [c for c in candidates if np.isfinite(c.log_bayes).any()]
    ranked = sorted(usable, key=lambda c: -weighing.evidence(c.log_bayes))[:FIRST]
    quick: dict[str, tuple[float, Weighed, Weighed, float]] = {}
    for first in ranked:
        a = first.best
        for second, (b, value) in _given(a, [other for other in usable if other.id != first.id]):
            cost = first.shape_cost + second.shape_cost
            value += float(a.log_bayes[0]) + cost
            key = pair_key(first.id, second.id)
            if key not in quick or value > quick[key][0]:
                quick[key] = (value, a, b, cost)
    declared = float(weighing.base[0] + weighing.log_prior[0][0])
    found = {key: declared + value for key, (value, *_) in quick.items()}
    best: dict[str, Weighed] = {}
    for key in sorted(quick, key=lambda key: -quick[key][0])[:WEIGHED]:
        _, a, b, cost = quick[key]
        own = a.variant.columns, b.variant.columns
        raw = [np.hstack(blocks) for blocks in zip(a.raw, b.raw, strict=True)]
        (both,) = weighing.weigh([Variant(own[0] + own[1], widths=(len(own[0]), len(own[1])))], raw)
        log_bayes = np.full(len(weighing.base), -np.inf)
        for g in np.flatnonzero(np.isfinite(weighing.log_prior[0])):
            log_bayes[g] = pair_log_bayes_factor(
                both.gram[g], both.score[g], len(a.variant.columns), (a.trace, b.trace), PAIR_ENERGIES
            )
        found[key], best[key] = weighing.evidence(log_bayes + cost), both
    return found, best


def _given(a: Weighed, others: Sequence[Candidate]) -> Iterator[tuple[Candidate, tuple[Weighed, float]]]:
    """The form of each effect that fits the data best in addition to `a` at its most probable size, and the log BF that it adds."""
    if not others:
        return
    mean, covariance = a.amplitudes
    forms = [len(other.variants) for other in others]
    size = np.zeros((sum(forms), max((other.variants[0].gram.shape[1] for other in others), default=0)))
    along, last = np.zeros_like(size), 0
    for other, count in zip(others, forms, strict=True):
        cross = other.across(a)
        grams = np.array([item.gram[0] for item in other.variants]) - np.swapaxes(cross, 1, 2) @ covariance @ cross
        scores = np.array([item.score[0] for item in other.variants]) - np.swapaxes(cross, 1, 2) @ mean
        values, vectors = np.linalg.eigh(grams)
        # the energies of each variant are in units of its trace
        traces = np.array([item.trace for item in other.variants])[:, None]
        part = slice(last, last := last + count), slice(values.shape[1])
        size[part] = np.maximum(values, 0.0) / traces
        along[part] = np.einsum("vji,vj->vi", vectors, scores) ** 2 / traces
    added = averaged(from_eigen(size, along, 1.0))
    for other, values in zip(others, np.split(added, np.cumsum(forms)[:-1]), strict=True):
        best = int(np.argmax(values))
        yield other, (other.variants[best], float(values[best]))

"""Computes the posterior over {none, each effect, sets of effects, unknown, sets with something else}, with fixed and published
priors.

The evidence directly determines the probabilities of three cases: effects of the catalogue are the whole cause, effects of the
catalogue act together with something else, or no effect of the catalogue acts. The probability of effects is then divided among the
sets of effects. For this division, the noise variance is multiplied by the dispersion of the residuals before the evidence is
computed. The dispersion is χ² divided by the degrees of freedom, or 1 if chance explains the residuals (`gap.answer.remainder`).
Thus, if even the best set does not explain the residuals, the evidence distinguishes the sets less sharply.

A hypothesis about the level of the noise does not compete with a cause. Hypotheses that differ only in an effect on the level of
the noise count as the same cause, and their probabilities are added. The probability of each effect on the noise level is stated
separately. A log weight is the logarithm of a probability that is not yet normalised.

In array shapes, K is the number of channels, and Q is the number of rates of events of the noise.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from itertools import product
from math import comb
from typing import TypeVar, get_args

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import Effect, OutsideCoefficients, triad_of
from planrunner.gap.answer.apart import Apart
from planrunner.gap.answer.remainder import dispersions
from planrunner.gap.answer.sets import EffectSet, key_of, sets_of
from planrunner.gap.evidence.noise_levels import Level, log_densities
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing
from planrunner.gap.hypotheses.open_set import (
    Kinds,
    competitors,
    events_beside,
    forms_of_unknown,
    look_alike,
    something_else,
    unknown,
)
from planrunner.gap.hypotheses.outside import Line
from planrunner.gap.hypotheses.patterns import Pattern
from planrunner.gap.hypotheses.short_offsets import RATES, ShortOffsets, averaged_over_rates

BESIDE = 0.001  # probability that a tone or bursts with an independent cause are present in addition to an effect
PRIORS = {"none": 0.20, "single": 0.50, "pair": 0.10, "several": 0.05, "unknown": 0.15}
"""Prior probabilities. `several` is divided equally between two cases: three and more effects of the catalogue, and effects
together with something else. Every further effect halves the probability."""
NAMEABLE = 0.05  # probability of "none" at and above which no effect is named
LIKELY = 1e-3  # smallest share of a set in the probability of all sets of its size, so that something else may act in addition
IMPERFECT = 0.05
"""If the log evidence of an effect is less than this fraction of the log evidence of something else, the effect is not considered
in addition to something else. The reason is that no pattern describes an unknown cause exactly. Effects of the catalogue can
imitate the part that the pattern does not describe."""
WORTH = 3.0  # log Bayes factor at and above which something else may cause the part that some of the effects explain
RIVAL = 12.0  # nats; events of the noise are evaluated beside each effect that is less probable than the best set by at most this
UNKNOWN = "unknown"
_Key = TypeVar("_Key", str, tuple[str, ...])


@dataclass(frozen=True)
class Posterior:
    """States how probable each hypothesis is, with the evidence behind the probabilities. `probability`: probability of every
    cause. A set of effects has a name such as 'a+b', in alphabetical order, or 'a+b+unknown' if something else acts in addition. An
    effect on the level of the noise is a cause only if nothing else acts. `noise`: probability of each effect on the level of the
    noise, summed over all causes. `log_evidence`: log evidence of each hypothesis relative to "none"; for effects, this log
    evidence is computed from the coefficients alone. `sets`: the evaluated sets of two or more deterministic effects. `kinds`: log
    evidence, relative to "none", of each pattern that belongs to "unknown". `by_channel`: for each pattern, an array of shape (K,),
    its log Bayes factor in each channel alone. `levels`: names of the effects that only change the noise level. `lines`: tones in
    the recording. `beside`: probability that a tone or bursts are present in addition to an effect. `log_weights`: logarithms of
    the probabilities in `probability`, up to a constant. They include hypotheses whose probability is too small for a
    floating-point number."""

    probability: dict[str, float]
    log_evidence: dict[str, float]
    kinds: dict[Pattern, float]
    by_channel: dict[Pattern, Array] = field(repr=False)
    levels: frozenset[str] = frozenset()
    lines: tuple[Line, ...] = ()
    beside: float = 0.0
    noise: Mapping[str, float] = field(default_factory=dict)
    sets: Mapping[str, EffectSet] = field(default_factory=dict, repr=False)
    log_weights: Mapping[str, float] = field(default_factory=dict, repr=False)

    def of_effects(self) -> dict[str, float]:
        """Returns the probabilities of "none", of "unknown" and of every set of effects, the most probable first. The probability
        of a set includes the case that something else acts in addition."""
        found: dict[str, float] = {}
        for name, value in self.probability.items():
            key = without_unknown(name)
            found[key] = found.get(key, 0.0) + value
        return dict(sorted(found.items(), key=lambda item: -item[1]))


def without_unknown(name: str) -> str:
    """Removes "unknown" from the name of a hypothesis, so that only the names of the effects remain."""
    return "+".join(part for part in name.split("+") if part != UNKNOWN) or UNKNOWN


@dataclass(frozen=True)
class _NoiseOnly:
    """Contains the evidence for the effects that act only on the noise. `walk`: name of the random walk of the gyros, or ''.
    `others`: maps each triad (gyro or accel) and each state of its white noise that differs from the declared noise to the effect
    that causes this state. `levels`: log density of the measured white noise for each combination of a state of the gyros with a
    state of the accelerometers. `apart`: log Bayes factors of the effects that the recording shows outside the coefficients, such
    as a line. Each of these effects is present or absent independently of the others.
    """

    walk: str
    others: Mapping[tuple[str, Level], str]
    levels: Mapping[tuple[Level, Level], float]
    apart: Mapping[str, float]

    @property
    def declared(self) -> float:
        """Returns the log density of the measured white noise if the declared noise is right."""
        return self.levels["declared", "declared"]

    @property
    def states(self) -> dict[tuple[str, ...], float]:
        """Maps each possible combination of effects on the noise to the log density of the measured white noise. A combination
        contains at most one effect on the white noise of each triad. It can also contain any effects in `apart`; the log Bayes
        factors of these effects are added."""
        found: dict[tuple[str, ...], float] = {}
        for (gyro, accel), value in self.levels.items():
            acting = [(kind, level) for kind, level in (("gyro", gyro), ("accel", accel)) if level != "declared"]
            if np.isfinite(value) and all(one in self.others for one in acting):
                found[tuple(self.others[one] for one in acting)] = value
        for name, more in self.apart.items():
            found |= {(*acting_too, name): value + more for acting_too, value in found.items()}
        return found


def posterior(
    weighing: Weighing, effects: Sequence[Effect], candidates: Sequence[Candidate], apart: Apart | None = None
) -> Posterior:
    """Evaluates all hypotheses.

    `effects`: all effects that are hypotheses. `candidates`: evaluated effects with signatures. `apart`: effects that were found
    outside the coefficients.
    """
    apart = apart or Apart()
    nothing = np.zeros(len(weighing.base))
    on_noise = [effect for effect in effects if isinstance(effect, OutsideCoefficients)]
    walk = next(
        (effect.id for effect in on_noise if effect.outside == "random walk" and triad_of(effect) == "gyro"), ""
    )
    acting: dict[tuple[str, Level], str] = {
        (triad_of(effect), level): effect.id
        for effect in on_noise
        for level in get_args(Level)
        if effect.outside == level
    }
    densities = log_densities(weighing.declared, weighing.white, weighing.white_degrees, weighing.steps)
    noise = _NoiseOnly(walk, acting, densities, apart.log_bayes)
    start = weighing.evidence(nothing) + noise.declared
    found, sets = _of_effects(weighing, candidates, noise)
    kinds = competitors(weighing, apart.outside)
    found[UNKNOWN] = weighing.evidence(unknown(kinds)) + noise.declared - start
    found |= {key_of([name, UNKNOWN]): found[UNKNOWN] + value for name, value in noise.apart.items()}
    plainly = {what: weighing.evidence(value) + noise.declared - start for what, value in kinds.log_bayes.items()}
    count = _acting(found)
    logs = {name: value + log_prior(name, count) for name, value in found.items()}
    events = _Events(weighing, kinds, candidates, sets, found, walk)
    gains = {name: events.gain(name) for name in logs}
    logs = {name: value + gains[name] for name, value in logs.items()}
    levels = frozenset(acting.values())
    by_id = {c.id: c for c in candidates}
    for name in logs:
        if UNKNOWN in name.split("+"):
            logs[name] += _whatever_noise(noise, len(name.split("+")), count)
    best = max((name for name in logs if name not in PRIORS), key=lambda name: logs[name], default="")
    if _shares(logs)["none"] < NAMEABLE:
        chain = _chain(best, sets, candidates)
        if chain:
            named = _shared(logs)
            walks = walk in best.split("+")
            ratios = np.ones(len(weighing.weights)) if walks else dispersions(weighing, chain[-1][1])
            if (ratios > 1).any():
                wide = weighing.inflated(ratios.tolist())
                once_more = [_again(wide, c) for c in candidates]
                again, again_sets = _of_effects(wide, once_more, noise, sets)
                in_wide = _Events(wide, kinds, once_more, again_sets, again, walk)
                named = _shared(
                    {
                        name: value + log_prior(name, count) + _in_noise(kinds, in_wide.beside(name))
                        for name, value in again.items()
                        if name in found and name not in PRIORS
                    }
                )
            singles = [(name, by_id[name].best) for name in chain[-1][0].split("+")]
            imitated, more, further = _with_something_else(weighing, [*singles[::-1], *chain], found, count)
            more = {
                key: value + _whatever_noise(noise, len(key.split("+")), count) + _in_noise(kinds, further[key])
                for key, value in more.items()
            }
            logs = _as_named(logs, named, more, walk)
            one_of = float(np.log(forms_of_unknown(kinds) * count))
            found[UNKNOWN] = float(np.logaddexp(found[UNKNOWN], imitated - one_of))
            imitated += log_prior(UNKNOWN, count) + _whatever_noise(noise, 1, count) - one_of
            imitated += _in_noise(kinds, kinds.no_events)
            logs[UNKNOWN] = float(np.logaddexp(logs[UNKNOWN], imitated))
    within = events.beside(best)
    beside = float(
        np.exp(np.log(BESIDE) + kinds.outside + averaged_over_rates(within) - _in_noise(kinds, within)) if best else 0.0
    )
    causes = _of_causes(logs, levels)
    return Posterior(
        dict(sorted(_shares(causes).items(), key=lambda item: -item[1])),
        found,
        plainly,
        kinds.by_channel,
        levels | noise.apart.keys(),
        kinds.lines + apart.lines,
        beside,
        _of_noise(_shares(logs), levels, noise, found, count),
        sets,
        causes,
    )


def _of_causes(logs: Mapping[str, float], levels: Collection[str]) -> dict[str, float]:
    """Returns the log weights of the causes. The probabilities of hypotheses that differ only in effects on the level of the noise
    are added. `levels`: names of the effects on the level of the noise. `logs`: log weight of each hypothesis."""
    found: dict[str, float] = {}
    for name, value in logs.items():
        key = key_of(part for part in name.split("+") if part not in levels) or name
        found[key] = float(np.logaddexp(found.get(key, -np.inf), value))
    return found


def _of_noise(
    shares: Mapping[str, float], levels: Set[str], noise: _NoiseOnly, found: Mapping[str, float], count: int
) -> dict[str, float]:
    """Returns the probability of each effect on the level of the noise. The probability of a hypothesis with something else covers
    all states of the noise, so it is divided among these states.

    `shares`: probability of each hypothesis. `levels`: names of the effects on the level of the noise. `found`: log evidence of the
    hypotheses that `posterior` evaluated directly. When the effects of such a hypothesis are counted, "unknown" counts as one of
    them. `count`: number of effects that the plan can excite.
    """
    total = dict.fromkeys(sorted(levels), 0.0)
    for name, share in shares.items():
        parts = name.split("+")
        states: dict[tuple[str, ...], float] = {(): 1.0}
        if UNKNOWN in parts:
            states = _shares(_states_beside(noise, len(parts) - (name not in found), count))
        for other, part in states.items():
            for one in levels & {*parts, *other}:
                total[one] += share * part
    return total


def _whatever_noise(noise: _NoiseOnly, size: int, count: int) -> float:
    """Returns the amount that is added to the log weight of a cause that consists of `size` effects. This amount allows for noise
    that differs from the declared noise. `count`: number of effects that the plan can excite."""
    return float(np.logaddexp.reduce(list(_states_beside(noise, size, count).values())))


def _states_beside(noise: _NoiseOnly, size: int, count: int) -> dict[tuple[str, ...], float]:
    """Returns the log weight of each state of the noise together with a cause of `size` effects, relative to the declared noise.
    `count`: number of effects that the plan can excite."""
    return {
        other: density - noise.declared + _log_prior_of(size + len(other), count) - _log_prior_of(size, count)
        for other, density in noise.states.items()
        if not noise.apart.keys() & set(other)
    }


def _of_effects(
    weighing: Weighing,
    candidates: Sequence[Candidate],
    noise: _NoiseOnly,
    known: Mapping[str, EffectSet] | None = None,
) -> tuple[dict[str, float], dict[str, EffectSet]]:
    """Returns two results. The first is the log evidence relative to "none" of the following hypotheses: "none", single effects,
    and sets of effects. The second contains the sets that were evaluated in full. `known`: the same as in `sets_of`."""
    nothing = np.zeros(len(weighing.base))
    start = weighing.evidence(nothing) + noise.declared
    alone = {"": nothing} | {c.id: c.log_bayes for c in candidates if np.isfinite(c.log_bayes).any()}
    found: dict[str, float] = {}
    walks = (False, True) if noise.walk and np.isfinite(weighing.log_prior[1]).any() else (False,)
    for (name, log_bayes), walking in product(alone.items(), walks):
        value = weighing.evidence(log_bayes, walking) - start
        for other, density in noise.states.items():
            present = [part for part in (name, noise.walk if walking else "", *other) if part]
            found[key_of(present) or "none"] = value + density
    count = _acting(found)
    sets = sets_of(weighing, candidates, lambda size: _log_prior_of(size, count), len(walks) > 1, known)
    for key, value in sets.quick.items():
        for other, density in noise.states.items():
            found[key_of([*key.split("+"), *other])] = value + density - start
    for key, one in sets.full.items():
        for value, walking in ((one.evidence, False), (one.walking, True)):
            for other, density in noise.states.items():
                if np.isfinite(value):
                    present = [*key.split("+"), *filter(None, (noise.walk if walking else "", *other))]
                    found[key_of(present)] = value + density - start
    return found, sets.full


def _again(weighing: Weighing, candidate: Candidate) -> Candidate:
    """Evaluates a candidate again with the noise of another `weighing`. The change of its log evidence that is due to averaging
    over the shape (`Candidate.shape_cost`) is not computed again."""
    if not np.isfinite(candidate.log_bayes).any():
        return candidate
    usable = [item for item in candidate.variants if item.trace > 0]
    weighed = weighing.weigh_reduced([item.variant for item in usable])
    best = np.max([item.log_bayes for item in weighed], axis=0)
    return replace(candidate, variants=tuple(weighed), log_bayes=best + candidate.shape_cost)


def _chain(name: str, sets: Mapping[str, EffectSet], candidates: Sequence[Candidate]) -> list[tuple[str, Weighed]]:
    """Orders the effects of a hypothesis that have signatures, and returns the growing sets: the first effect alone, the first two
    effects, and so on up to all effects."""
    by_id = {c.id: c for c in candidates}
    known = [part for part in name.split("+") if part in by_id]
    if len(known) == 1:
        return [(known[0], by_id[known[0]].best)]
    if key_of(known) not in sets:
        return []
    order = [member.id for member in sets[key_of(known)].members]
    found = [(order[0], by_id[order[0]].best)]
    for size in range(2, len(order) + 1):
        key = key_of(order[:size])
        if key in sets:
            found.append((key, sets[key].weighed))
    return found


def _with_something_else(
    weighing: Weighing, tried: Sequence[tuple[str, Weighed]], found: Mapping[str, float], count: int
) -> tuple[float, dict[str, float], dict[str, Array]]:
    """Evaluates something else in addition to effects. Returns three results: the log evidence of causes outside the catalogue that
    resemble one of the effects; the log weights of hypotheses in which something else acts in addition to a set of effects; and,
    for each of these hypotheses, the log Bayes factor of the events of the noise in the coefficients in addition, at each rate, shape
    (Q,).

    Some of the effects may only imitate something else. Therefore, something else is evaluated in addition to several sets,
    beginning with the last set. The evaluation ends when something else is no longer visible. Two kinds of sets are omitted: sets
    with physically impossible amplitudes, and sets whose evidence is small compared with something else (`IMPERFECT`). If something
    is visible in addition to a single effect, the effect itself may be imitated: a cause outside the catalogue may resemble it, but
    depend on the motion in another way.

    `tried`: the sets, that is, each effect of the likeliest set, and the growing sets that `_chain` returns. `found`: log evidence
    of each set and of "unknown". `count`: number of effects that the plan can excite.
    """
    made: dict[str, float] = {}
    events: dict[str, Array] = {}
    imitated = -np.inf
    for key, weighed in dict(reversed(tried)).items():
        if weighed.excluded or found[key] < IMPERFECT * found[UNKNOWN]:
            continue
        amplitudes, _ = weighed.amplitudes_at(weighing.likeliest[0])
        signatures = [raw @ amplitudes for raw in weighed.raw]
        besides, events[key] = something_else(weighing.beside(weighed), signatures, found[key])
        made[key] = found[key] + besides + log_prior(key_of([*key.split("+"), UNKNOWN]), count)
        if besides < WORTH:
            break
        if "+" not in key:
            imitated = float(np.logaddexp(imitated, found[key] + look_alike(weighing, signatures)))
    return imitated, made, events


def _as_named(
    logs: Mapping[str, float], named: Mapping[str, float], more: Mapping[str, float], walk: str
) -> dict[str, float]:
    """Divides the total probability of the effects among the sets of effects, in the proportions that `named` states (log shares).
    Also adds the hypotheses in which something else acts in addition to a set. Returns log weights.

    `more`: log weights of sets of effects in combination with something else. If such a set is one of the probable sets, the weight
    of the combination is divided among all probable sets of the same size, in proportion to `named`. Sets with a random walk
    (`walk`) are excluded, because a random walk explains the same part of the gap as something else.
    """
    whole = float(np.logaddexp.reduce([value for name, value in logs.items() if name not in PRIORS]))
    made = {name: value for name, value in logs.items() if name in PRIORS}
    made |= {name: whole + share for name, share in named.items()}
    for key, value in more.items():
        size = key.count("+")
        alike = {
            name: share
            for name, share in named.items()
            if name.count("+") == size and np.isfinite(share) and walk not in name.split("+")
        }
        total = float(np.logaddexp.reduce([*alike.values(), -np.inf]))
        likely = {name: share - total for name, share in alike.items() if share >= np.log(LIKELY) + total}
        if key not in likely:  # the part beside this set says nothing about the part beside the others
            likely = {key: 0.0}
        for name, share in likely.items():
            made[key_of([*name.split("+"), UNKNOWN])] = value + share
    return made


def _shared(logs: Mapping[str, float]) -> dict[str, float]:
    """Returns the logarithms of the normalised probabilities of the sets of effects, without "none", "unknown" and other hypotheses
    that have a fixed prior. `logs`: log weight of each hypothesis."""
    sets = {name: value for name, value in logs.items() if name not in PRIORS}
    total = float(np.logaddexp.reduce(list(sets.values())))
    return {name: value - total for name, value in sets.items()}


def _shares(logs: Mapping[_Key, float]) -> dict[_Key, float]:
    """Returns weights with the sum 1, computed from their logarithms."""
    total = np.logaddexp.reduce(list(logs.values()))
    return {name: float(np.exp(value - total)) for name, value in logs.items()}


class _Events:
    """Evaluates the events of the noise in addition to the hypotheses. In addition to "none" and to "something else", they have been
    evaluated with the patterns (`Kinds`). In addition to effects, they are evaluated for the best of the single effects and of the sets
    that were evaluated in full, and for each single effect that is visible and not much less probable. An effect that is not visible
    does not change the events."""

    def __init__(
        self,
        weighing: Weighing,
        kinds: Kinds,
        candidates: Sequence[Candidate],
        sets: Mapping[str, EffectSet],
        found: Mapping[str, float],
        walk: str,
    ):
        self._weighing, self._kinds, self._found, self._walk = weighing, kinds, found, walk
        self._by_id = {c.id: c for c in candidates if np.isfinite(c.log_bayes).any()}
        self._sets, self._short_offsets = sets, ShortOffsets(weighing)
        self._known: dict[str, Array] = {}
        self._best = max([*self._by_id, *sets], key=lambda key: self._found.get(key, -np.inf), default="")

    def _key(self, name: str) -> str:
        """Returns the effects of a hypothesis that have signatures, as the key of a set."""
        return key_of(part for part in name.split("+") if part in self._by_id)

    def gain(self, name: str) -> float:
        """Returns the log Bayes factor of noise with events, relative to noise without events, for one hypothesis. For effects, it
        includes the possibility that a tone or bursts act in addition."""
        weighing, kinds = self._weighing, self._kinds
        parts = name.split("+")
        quiet = weighing.evidence(np.zeros(len(weighing.base)))
        if name == "none":
            return weighing.evidence(averaged_over_rates(kinds.events + kinds.events_outside)) - quiet
        if UNKNOWN in parts:
            return weighing.evidence(kinds.with_events) - weighing.evidence(unknown(kinds))
        if not self._key(name) and self._walk not in parts:
            whole, within = (
                weighing.evidence(averaged_over_rates(kinds.events + more)) - quiet
                for more in (kinds.events_outside, np.zeros(len(RATES)))
            )
            return _or_beside(kinds, whole, within)
        return _in_noise(kinds, self.beside(name))

    def beside(self, name: str) -> Array:
        """Returns the log Bayes factor of the events in the coefficients in addition to the effects of a hypothesis, at each rate, shape
        (Q,). A hypothesis that is much less probable than the best set has no more events than this set."""
        key = self._key(name)
        each = [self._beside_effects(key)] if key else []
        if self._walk and self._walk in name.split("+"):
            each.append(self._beside_walk())
        if self._best and self._found.get(name, -np.inf) < self._found[self._best] - RIVAL:
            each.append(self._evaluated(self._best))
        return min(each or [self._without_effects()], key=lambda own: float(own.sum()))

    def _beside_effects(self, key: str) -> Array:
        if key == self._best or (key in self._by_id and self._rival(key)):
            return self._evaluated(key)
        visible = any(self._found.get(part, -np.inf) >= WORTH for part in key.split("+"))
        if not visible:
            return self._without_effects()
        if "+" in key and "+" not in self._best:
            return min(map(self._beside_effects, key.split("+")), key=lambda own: float(own.sum()))
        return self._evaluated(self._best)

    def _rival(self, name: str) -> bool:
        """Returns True if events are evaluated in addition to this effect."""
        return self._found[name] >= max(WORTH, self._found.get(self._best, -np.inf) - RIVAL)

    def _evaluated(self, key: str) -> Array:
        if key not in self._known:
            if key in self._by_id:
                known = self._by_id[key].best
                setting = self._weighing.likeliest_with(self._by_id[key].log_bayes, False)
            else:
                known = self._sets[key].weighed
                setting = self._weighing.likeliest_with(self._sets[key].log_bayes, False)
            self._known[key] = events_beside(self._weighing.beside(known), setting, self._short_offsets)
        return self._known[key]

    def _without_effects(self) -> Array:
        if "" not in self._known:
            self._known[""] = events_beside(self._weighing, self._weighing.likeliest[0], self._short_offsets)
        return self._known[""]

    def _beside_walk(self) -> Array:
        if self._walk not in self._known:
            setting = self._weighing.likeliest_with(np.zeros(len(self._weighing.base)), True)
            self._known[self._walk] = events_beside(self._weighing, setting, self._short_offsets)
        return self._known[self._walk]


def _in_noise(kinds: Kinds, within: Array) -> float:
    """Returns the log Bayes factor of the possibilities in addition to an effect (`_or_beside`). `within`: array of shape (Q,), log
    Bayes factor of the events in the coefficients at each rate."""
    whole, inside = (float(averaged_over_rates(one)) for one in (within + kinds.events_outside, within))
    return _or_beside(kinds, whole, inside)


def _or_beside(kinds: Kinds, events: float, within: float) -> float:
    """Returns the log Bayes factor of the possibilities in addition to an effect: events of the noise, or a tone or bursts that have an
    independent cause. `events`: log Bayes factor of noise with events. `within`: log Bayes factor of noise with events in the
    coefficients alone, because the bursts explain the others."""
    return float(np.logaddexp(np.log1p(-BESIDE) + events, np.log(BESIDE) + kinds.outside + within))


def _acting(log_evidence: Mapping[str, float]) -> int:
    """Returns the number of effects that the plan can excite. Effects that the plan cannot excite count as absent; their
    `log_evidence` is −∞."""
    return sum(np.isfinite(value) and name not in PRIORS and "+" not in name for name, value in log_evidence.items())


def log_prior(name: str, acting: int) -> float:
    """Returns the log prior of a hypothesis. All sets with the same number of effects have the same prior. `acting`: number of
    effects that the plan can excite."""
    if name in PRIORS:
        return float(np.log(PRIORS[name]))
    parts = name.split("+")
    return _log_prior_of(len([part for part in parts if part != UNKNOWN]), acting, UNKNOWN in parts)


def _log_prior_of(size: int, acting: int, besides: bool = False) -> float:
    """Returns the log prior of one set of `size` effects. `acting`: number of effects that the plan can excite. `besides`: True if
    something else acts in addition."""
    share = PRIORS["several"] / 2 ** (size + 1 if besides else size - 1)
    if not besides and size < 3:
        share = PRIORS["single" if size == 1 else "pair"]
    return float(np.log(share / max(comb(acting, size), 1)))

"""Searches for sets of two or more effects that explain a recording together. The search adds one effect at a time to the most
probable smaller sets, and fits all amplitudes again (forward selection; several of the best sets are extended, which is called a
beam search). In the most probable set, it also fits the shapes again.

In a quick evaluation, the amplitudes of a set are fixed at their most probable values, and every form of every other effect is
evaluated on the residuals. The best sets are then evaluated in full: with a separate scale for the amplitudes of every effect, and
at every setting of the noise that has a noticeable weight. A setting of the noise is a combination of levels of flicker and random
walk. The best sets are also evaluated together with a random walk of the gyros.

In array shapes, G is the number of settings of the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import Column, Curved, Shaped, Variant, is_whole
from planrunner.gap.evidence.bayes_factors import (
    averaged,
    best_amplitudes,
    best_scales,
    from_eigen,
    held_among,
    held_log_bayes_factor,
    pair_log_bayes_factor,
    set_log_bayes_factor,
    set_log_evidence,
)
from planrunner.gap.evidence.weighing import inner_products
from planrunner.gap.hypotheses.candidates import ABSORBED, EXCLUDED, Candidate, Weighed, Weighing
from planrunner.gap.hypotheses.forms import (
    BENT,
    WORSE,
    OnOthers,
    candidates_of,
    columns_of,
    on_others,
    on_output,
)

FIRST = 6  # number of the most probable effects from which pairs are formed
WEIGHED = 10  # number of pairs that are evaluated in full after a quick evaluation
BEAM = 3  # number of sets that are extended
EXTENDED = 4  # number of larger sets that are evaluated in full
MOST = 5  # largest number of effects in a set
WORTHWHILE = float(np.log(100.0))  # a set that is less probable than a smaller set by more than this is not extended
MATTERS = 12.0  # nats; a setting of the noise that is less probable than the best setting by more than this is omitted
PAIR_ENERGIES = np.geomspace(0.5, 1e6, 15)
_ROUNDS = 4  # number of evaluations of an effect on the output together with other effects
_GROWN = 0.1  # nats; a smaller increase of the evidence counts as no increase
_SAME = 0.1  # an amplitude counts as unchanged if it changes by less than this number of standard uncertainties


@dataclass(frozen=True)
class Member:
    """Describes an effect of a set, in one of its forms.

    `candidate`: the effect with all its forms, evaluated alone or in addition to the other effects of the set. `form`: the chosen
    form. `cost`: change of the log evidence, zero or negative, due to averaging over the shape of the effect.
    """

    candidate: Candidate
    form: Weighed
    cost: float

    @property
    def id(self) -> str:
        return self.candidate.id

    @classmethod
    def best(cls, candidate: Candidate) -> Member:
        return cls(candidate, candidate.best, candidate.shape_cost)


@dataclass(frozen=True)
class EffectSet:
    """Describes a set of effects that act together.

    `members`: the effects, in the order of their columns. `weighed`: the evaluation of all columns together. `log_bayes`: array of
    shape (G,), log Bayes factor at each setting of the noise (levels of flicker and random walk). `evidence`: log evidence without
    a random walk of the gyros. `walking`: log evidence with a random walk, −∞ if it was not evaluated. `on_others`: an effect on
    the output that also changes the other effects (for example a limit of the output), and its index among the members; None if
    there is no such effect.
    """

    members: tuple[Member, ...]
    weighed: Weighed = field(repr=False)
    log_bayes: Array = field(repr=False)
    evidence: float
    walking: float = -np.inf
    on_others: tuple[int, OnOthers] | None = field(default=None, repr=False)

    @property
    def key(self) -> str:
        return key_of(member.id for member in self.members)

    def columns(self, name: str) -> slice:
        """Returns the columns of one effect of the set."""
        at = [member.id for member in self.members].index(name)
        ends = np.cumsum([len(member.form.variant.columns) for member in self.members])
        return slice(int(ends[at]) - len(self.members[at].form.variant.columns), int(ends[at]))


@dataclass(frozen=True)
class Sets:
    """Contains the evaluated sets of effects. `quick`: log evidence of each pair from the quick evaluation. This evaluation fixes the
    amplitudes of the first of the two effects at their most probable values, at the most probable setting of the noise. `full`: the
    sets evaluated in full, by key."""

    quick: dict[str, float]
    full: dict[str, EffectSet] = field(repr=False)


def key_of(names: Sequence[str] | Iterator[str]) -> str:
    return "+".join(sorted(names))


def sets_of(
    weighing: Weighing,
    candidates: Sequence[Candidate],
    prior: Callable[[int], float],
    walks: bool,
    known: Mapping[str, EffectSet] | None = None,
) -> Sets:
    """Evaluates pairs and larger sets of effects that have signatures.

    `prior`: function that returns the log prior of one set of a given number of effects. `walks`: True if a random walk is a
    hypothesis. `known`: the sets that were evaluated with another level of the noise. If `known` is given, no shape is fitted
    again, and known sets in which an effect acts on the others keep their forms.
    """
    refit = known is None
    usable = [c for c in candidates if np.isfinite(c.log_bayes).any()]
    quick, level = _pairs(weighing, usable)
    best = max((weighing.evidence(c.log_bayes) for c in usable), default=-np.inf) + prior(1)
    if refit and level and max(one.evidence for one in level) + prior(2) > best + BENT:
        level += _with_output(weighing, usable, max(one.evidence for one in level))
    full = {one.key: one for one in sorted(level, key=lambda one: one.evidence)}  # of each set, the likeliest version
    level = list(full.values())
    while level:
        level = sorted(level, key=lambda one: -one.evidence)
        count = len(level[0].members)
        if level[0].evidence + prior(count) < best - WORTHWHILE:
            break
        likely = level[:BEAM]
        if refit:
            likely[0] = _refitted(weighing, likely[0])
            likely = sorted((_acting_on_others(weighing, one) for one in likely), key=lambda one: -one.evidence)
        if walks:
            likely[0] = _walking(weighing, likely[0])
        full |= {one.key: one for one in likely}
        best = max(best, likely[0].evidence + prior(count))
        if count == MOST:
            break
        level = _extended(weighing, likely, usable)
        full |= {one.key: one for one in level}
    for key, one in (known or {}).items():
        if one.on_others is not None:
            again = replace(_evaluated(weighing, _weighed_again(weighing, one.members)), on_others=one.on_others)
            full[key] = _walking(weighing, again) if np.isfinite(one.walking) else again
    return Sets(quick, full)


def _weighed_again(weighing: Weighing, members: Sequence[Member]) -> tuple[Member, ...]:
    """Evaluates the forms of the members with the noise of another weighing."""
    found = []
    for member in members:
        (form,) = weighing.weigh_reduced([member.form.variant])
        found.append(replace(member, form=form))
    return tuple(found)


def _pairs(weighing: Weighing, usable: Sequence[Candidate]) -> tuple[dict[str, float], list[EffectSet]]:
    """Evaluates all pairs that consist of a probable effect and any other effect. Returns two results: the log evidence of each
    pair from a quick evaluation, and the full evaluation of the best pairs."""
    ranked = sorted(usable, key=lambda c: -weighing.evidence(c.log_bayes))[:FIRST]
    quick: dict[str, tuple[float, tuple[Member, Member]]] = {}
    for first in map(Member.best, ranked):
        at = weighing.likeliest_with(first.form.log_bayes, False)
        for second, value in _given(weighing, first.form, [other for other in usable if other.id != first.id], at):
            value += weighing.evidence(first.form.log_bayes) + first.cost + second.cost
            key = key_of([first.id, second.id])
            if key not in quick or value > quick[key][0]:
                quick[key] = (value, (first, second))
    found = {key: value for key, (value, _) in quick.items()}
    chosen = sorted(quick, key=lambda key: -quick[key][0])[:WEIGHED]
    return found, [_evaluated(weighing, quick[key][1]) for key in chosen]


def _with_output(weighing: Weighing, usable: Sequence[Candidate], least: float) -> list[EffectSet]:
    """Evaluates pairs of the most probable effect and an effect on the output. An effect on the output, such as a dead zone,
    depends on the output itself. It is therefore evaluated at an output that contains the most probable effect. For example, the
    output may be inside the dead zone without the most probable effect, and outside the dead zone with this effect. Returns the
    pairs with an evidence of more than `least`."""
    first = max(usable, key=lambda c: weighing.evidence(c.log_bayes))
    acting = [c for c in usable if is_whole(c.best.variant.columns) and on_output(c.effect) is not None]
    amplitudes, _ = weighing.amplitudes(first.best, walking=False)
    columns = columns_of(weighing, first.effect, first.best, amplitudes)
    if on_output(first.effect) is not None or not columns or not acting:
        return []
    found = []
    for again in candidates_of(weighing.with_known(columns, amplitudes), [c.effect for c in acting]):
        if np.isfinite(again.log_bayes).any():
            (form,) = weighing.weigh_reduced([again.best.variant])
            members = Member.best(first), Member(again, form, again.shape_cost)
            if form.trace > 0:
                found.append(_evaluated(weighing, members))
    found.sort(key=lambda one: -one.evidence)
    each = [_acting_on_others(weighing, one) for one in found[:BEAM]]
    return [one for one in each if one.evidence > least]


def _extended(weighing: Weighing, level: Sequence[EffectSet], usable: Sequence[Candidate]) -> list[EffectSet]:
    """Adds one effect to each of the most probable sets, and evaluates the best of the larger sets in full."""
    quick: dict[str, tuple[float, tuple[Member, ...]]] = {}
    for one in level:
        inside = {member.id for member in one.members}
        at = weighing.likeliest_with(one.log_bayes, False)
        for more, value in _given(weighing, one.weighed, [other for other in usable if other.id not in inside], at):
            value += one.evidence + more.cost
            key = key_of([*inside, more.id])
            if key not in quick or value > quick[key][0]:
                quick[key] = (value, (*one.members, more))
    chosen = sorted(quick, key=lambda key: -quick[key][0])[:EXTENDED]
    return [_evaluated(weighing, quick[key][1]) for key in chosen]


def together(weighing: Weighing, members: Sequence[Member]) -> Weighed:
    """Evaluates several effects together: their columns form one linear model."""
    return weighing.together([member.form for member in members])


def _evaluated(weighing: Weighing, members: tuple[Member, ...]) -> EffectSet:
    weighed = together(weighing, members)
    log_bayes = _log_bayes(weighing, weighed, members, weighing.log_prior[0])
    return EffectSet(members, weighed, log_bayes, weighing.evidence(log_bayes))


def evaluated(weighing: Weighing, candidates: Sequence[Candidate]) -> EffectSet:
    """Evaluates a set of effects in full, each effect in its best form."""
    return _evaluated(weighing, tuple(map(Member.best, candidates)))


def _walking(weighing: Weighing, one: EffectSet) -> EffectSet:
    """Returns a copy of the set that also contains the log evidence for the case that a random walk acts in addition
    (`walking`)."""
    if np.isfinite(one.walking) or not np.isfinite(weighing.log_prior[1]).any():
        return one
    log_bayes = _log_bayes(weighing, one.weighed, one.members, weighing.log_prior[1])
    return replace(one, walking=weighing.evidence(log_bayes, walking=True))


def _log_bayes(weighing: Weighing, weighed: Weighed, members: Sequence[Member], log_prior: Array) -> Array:
    """Returns the log Bayes factor of the set at each setting of the noise, shape (G,). The value is −∞ at settings that have no
    noticeable weight under the given prior. `log_prior`: array of shape (G,), log prior of each setting."""
    widths = weighed.variant.widths
    traces = [member.form.trace for member in members]
    scales = best_scales(weighed.gram[0], weighed.score[0], widths)
    rough = weighing.base + log_prior + set_log_evidence(weighed.gram, weighed.score, scales)
    found = np.full(len(weighing.base), -np.inf)
    for g in np.flatnonzero(rough > rough.max() - MATTERS):
        gram, score = weighed.gram[g], weighed.score[g]
        if len(members) == 2:
            found[g] = pair_log_bayes_factor(gram, score, widths[0], (traces[0], traces[1]), PAIR_ENERGIES)
        else:
            found[g] = set_log_bayes_factor(gram, score, widths, traces, PAIR_ENERGIES, scales)
        if weighed.variant.fixed:
            found[g] += held_among(gram, score, scales, weighed.variant.fixed)
    return weighed.if_possible(found) + sum(member.cost for member in members)


def _refitted(weighing: Weighing, one: EffectSet) -> EffectSet:
    """Fits the shape of each effect again, together with the other effects of the set, and computes the secants of strong nonlinear
    effects at the amplitudes of the set. Secants are columns that reproduce a nonlinear effect exactly at given amplitudes. A new
    shape is kept only if the evidence of the set increases. New secants are more exact than the old columns, so they are rejected
    only if they are clearly less likely."""
    for number, member in enumerate(one.members):
        effect = member.candidate.effect
        if isinstance(effect, Shaped):
            others = [*one.members[:number], *one.members[number + 1 :]]
            (again,) = candidates_of(weighing.beside(together(weighing, others)), [effect])
            if not np.isfinite(again.log_bayes).any():
                continue
            (form,) = weighing.weigh_reduced([again.best.variant])
            changed, least = Member(again, form, again.shape_cost), one.evidence
        elif isinstance(effect, Curved) and float(member.form.log_bayes.max()) > BENT:
            (form,), least = weighing.weigh(_around(weighing, one, member, effect)), one.evidence - WORSE
            changed = replace(member, form=form)
        else:
            continue
        if form.trace <= 0:
            continue
        other = _evaluated(weighing, (*one.members[:number], changed, *one.members[number + 1 :]))
        one = other if other.evidence > least else one
    return one


def _around(weighing: Weighing, one: EffectSet, member: Member, effect: Curved) -> list[Variant]:
    """Returns the secants of a nonlinear effect: columns that reproduce it exactly at the amplitudes that it has in a set."""
    amplitudes, _ = weighing.amplitudes(one.weighed, walking=False)
    own = one.columns(member.id)
    size = np.array([column.magnitude for column in one.weighed.variant.columns[own]])
    return effect.around(weighing.observed, amplitudes[own] * size)


def _acting_on_others(weighing: Weighing, one: EffectSet) -> EffectSet:
    """Evaluates a strong effect on the output again, at an output that contains the other effects of the set. The other effects are
    evaluated as they appear in the output after this effect; a limit, for example, may hide them. This is more exact than the sum
    of the effects. The result is therefore rejected only if it is clearly less likely than this sum. The evaluation is repeated
    with the new amplitudes as long as the evidence increases. A set with two such effects is returned unchanged."""
    acting = [(k, on_output(m.candidate.effect)) for k, m in enumerate(one.members) if m.form.held]
    number, effect = next(((k, effect) for k, effect in acting if effect is not None), (0, None))
    if effect is None or sum(acts is not None for _, acts in acting) > 1:
        return one
    best, before = one, np.full(len(one.weighed.score[0]) - 1, np.inf)
    least, reached = one.evidence - WORSE, -np.inf
    for _ in range(_ROUNDS):
        own = one.columns(effect.id)
        amplitudes, covariance = weighing.amplitudes(one.weighed, walking=False)
        free = np.delete(np.arange(len(amplitudes)), own)
        now, spread = amplitudes[free], np.sqrt(np.diag(covariance)[free])
        columns = columns_beside(weighing, one, number)
        if (np.abs(now - before) < _SAME * spread).all() or not all(columns):
            break
        every = [column for each in columns for column in each]
        acted, before = on_others(weighing, effect, one.members[number].form, every, now), now
        if acted is None:
            break
        ends = np.cumsum([0, *map(len, columns)])
        members = list(one.members)
        places = [k for k in range(len(members)) if k != number]
        for k, low, high in zip(places, ends[:-1], ends[1:], strict=True):
            raw = [block[:, low:high] for block in acted.others]
            (form,) = weighing.weigh_reduced([members[k].form.variant.with_tables(raw)])
            members[k] = replace(members[k], form=form)
        members[number] = replace(members[number], form=acted.best)
        if any(member.form.trace <= 0 for member in members):
            break
        one = replace(_evaluated(weighing, tuple(members)), on_others=(number, acted))
        grown = one.evidence > reached + _GROWN
        reached = max(reached, one.evidence)
        if one.evidence > (least if best.on_others is None else best.evidence):
            best = one
        if not grown:
            break
    return best


def columns_beside(weighing: Weighing, one: EffectSet, number: int) -> list[Sequence[Column]]:
    """Returns the columns, with samples, of each member of a set except the one with the index `number`, at the fitted amplitudes.
    A member has no columns if they cannot be computed."""
    amplitudes, _ = weighing.amplitudes(one.weighed, walking=False)
    others = [member for k, member in enumerate(one.members) if k != number]
    return [columns_of(weighing, m.candidate.effect, m.form, amplitudes[one.columns(m.id)]) for m in others]


def _given(weighing: Weighing, a: Weighed, others: Sequence[Candidate], setting: int) -> Iterator[tuple[Member, float]]:
    """Assumes that the effect `a` acts with its most probable size. Under this condition, yields the best form of each of the other
    effects, and the increase of the log Bayes factor by this form. The increase includes the condition that the amplitudes of the
    other effect are physically possible. `setting`: index of the setting of the noise."""
    if not others:
        return
    mean, covariance = a.amplitudes_at(setting)
    own, means = weighing.transposed_at(a, setting), weighing.spectrum.means
    forms = [len(other.variants) for other in others]
    size = np.zeros((sum(forms), max((other.variants[0].gram.shape[1] for other in others), default=0)))
    along, last = np.zeros_like(size), 0
    fixed: dict[str, Array] = {}
    possible = np.zeros(len(size))
    for other, count in zip(others, forms, strict=True):
        columns = [column for item in other.variants for column in item.variant.columns]
        cross = np.swapaxes(inner_products(columns, own, means).reshape(len(mean), count, -1), 0, 1)  # (V, q, p)
        grams = (
            np.array([item.gram[setting] for item in other.variants]) - np.swapaxes(cross, 1, 2) @ covariance @ cross
        )
        scores = np.array([item.score[setting] for item in other.variants]) - np.swapaxes(cross, 1, 2) @ mean
        values, vectors = np.linalg.eigh(grams)
        # the energies of each variant are divided by its trace
        traces = np.array([item.trace for item in other.variants])[:, None]
        for place, (item, gram, score) in enumerate(zip(other.variants, grams, scores, strict=True), start=last):
            if item.limited and item.kept > ABSORBED:
                amplitudes = best_amplitudes(gram, score, item.variant.widths, item.variant.fixed)
                possible[place] = item.log_possible_at(*amplitudes)
        part = slice(last, last := last + count), slice(values.shape[1])
        size[part] = np.maximum(values, 0.0) / traces
        along[part] = np.einsum("vji,vj->vi", vectors, scores) ** 2 / traces
        if other.best.held:
            fixed[other.id] = held_log_bayes_factor(grams[:, 0, 0], scores[:, 0])
    added = averaged(from_eigen(size, along, 1.0)) + possible
    added = np.where(possible <= EXCLUDED, np.minimum(added, possible), added)
    for other, values in zip(others, np.split(added, np.cumsum(forms)[:-1]), strict=True):
        values = fixed.get(other.id, values)
        best = int(np.argmax(values))
        yield Member(other, other.variants[best], other.shape_cost), float(values[best])

"""Diagnoses a recording. A diagnosis determines where the recording differs from its simulation, which effect explains this
difference (the gap), and how much this effect reduces the gap.

The diagnosis has five steps. First, spectra and noise are computed, and the part of the data that the nominal parameters absorb is
projected out (`weighing`). The nominal parameters, such as bias and scale factors, are the parameters that the simulation fits.
Second, the evidence is evaluated for every installed effect (`candidates`), for pairs of effects, and for patterns outside the
catalogue (`posterior`, `open_set`). Third, a verdict is derived; if the plan cannot separate several effects, the verdict names all
of them as a class (`verdict`). Fourth, the gap is described and located (`gap_description`). Finally, the closure of the gap
is computed on held-out segments (`closure`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from planrunner.base import plugins
from planrunner.base.arrays import Array
from planrunner.base.documents import Json, JsonObject
from planrunner.error_model.effects.interface import (
    Column,
    Effect,
    HasShape,
    NoHypothesis,
    NotFitted,
    OutsideCoefficients,
    PairedShapes,
    Shaped,
    ShownInSome,
    effect_named,
)
from planrunner.error_model.observed import Observed
from planrunner.gap.answer import parameters as estimates
from planrunner.gap.answer.apart import Apart, found_apart, likely_repeats
from planrunner.gap.answer.closure import (
    Closure,
    FoldChoice,
    MeasuredNoise,
    NotMeasured,
    choices_of,
    closure,
    measured_noise,
    not_measured,
    whole_choices,
)
from planrunner.gap.answer.gap_description import (
    MisfitPlace,
    NoiseFound,
    UnknownForm,
    gap_by_channel,
    noise_found,
    pictures,
    places,
    unknown_form,
)
from planrunner.gap.answer.parameters import ParameterEstimate
from planrunner.gap.answer.posterior import PRIORS, UNKNOWN, Posterior, posterior
from planrunner.gap.answer.remainder import Remainder, dispersions, remainder
from planrunner.gap.answer.sets import EffectSet, Member, columns_beside, evaluated, key_of, together
from planrunner.gap.answer.verdict import Verdict, ambiguity_set, verdict
from planrunner.gap.hypotheses.candidates import FULL, Candidate, Forms, Weighed, Weighing
from planrunner.gap.hypotheses.forms import candidates_of, shape_alone, whole_forms
from planrunner.observation.refusals import ObservationError

FEWEST_SEGMENTS = 4
SHOWN_PLACES = 20
_MOST_CHOICES = 30
_LIKELY = 1e-3  # smallest probability of an effect or set that the closure may choose
_ABSORBED_SHARE = 0.05  # remaining fraction of a signature's energy below which an effect counts as absorbed


@dataclass(frozen=True, slots=True)
class DiagnosisOptions:
    """Options of a diagnosis.

    `nominal`: names of the terms that the nominal simulation fits, chosen from `candidates.FULL`. `effects`: names of the candidate
    effects, by default all installed effects. `given`: names of effects that are known to act. Given effects are fitted, and the
    gap that remains is diagnosed.
    """

    nominal: tuple[str, ...] = FULL
    effects: tuple[str, ...] | None = None
    given: tuple[str, ...] = ()


@dataclass(frozen=True)
class Grounds:
    """Contains the data on which a diagnosis is based, for further analysis.

    `nominal`: names of the terms that the nominal simulation fits. `choices`: the effects and sets of effects among which the
    closure chooses. `noise`: the noise that was measured for the closure. A closure is possible only if a named effect in a
    held-out segment can be predicted from the other segments; otherwise `noise` is None.
    """

    weighing: Weighing
    candidates: tuple[Candidate, ...]
    nominal: tuple[str, ...]
    choices: tuple[FoldChoice, ...]
    noise: MeasuredNoise | None


@dataclass(frozen=True)
class Diagnosis:
    """Contains the result of a diagnosis. `gap`: size of the gap of each channel, in the unit of the channel. `noise`: the noise of
    every channel. `where`: the parts of the recording that were examined, the most conspicuous first. `posterior`: probabilities of
    all hypotheses. `absorbed`: effects that the nominal parameters reproduce almost completely, each with the remaining fraction of
    its energy. `unknown`: form of the gap, if the verdict is that its cause is not in the catalogue. `rest`: the part of the gap
    that the named effects do not explain; None if no effect is named, or if a random walk is among the named effects. `pictures`:
    data for plots. `given`: parameters of the effects that are known to act, fitted together with the named effects.
    """

    gap: Mapping[str, Mapping[str, Json]]
    noise: tuple[NoiseFound, ...]
    where: tuple[MisfitPlace, ...]
    posterior: Posterior
    verdict: Verdict
    ambiguity_set: tuple[str, ...]
    absorbed: Mapping[str, float]
    parameters: tuple[ParameterEstimate, ...]
    closure: Closure
    unknown: UnknownForm | None
    rest: Remainder | None
    pictures: Mapping[str, Json] = field(repr=False)
    grounds: Grounds = field(repr=False)
    given: tuple[ParameterEstimate, ...] = ()

    def to_json(self) -> JsonObject:
        """Returns plain data according to `schemas/diagnosis.schema.json`; NaN becomes null."""
        shut = self.closure
        plain = {
            "gap": {name: dict(entry) for name, entry in self.gap.items()},
            "noise": [asdict(one) for one in self.noise],
            "where": [
                {
                    "channel": p.channel,
                    "factor": p.factor.value,
                    "level": p.level,
                    "share": p.share,
                    "of": p.of,
                    "p": p.p,
                }
                for p in self.where
            ],
            "posterior": dict(self.posterior.probability),
            "verdict": {
                "kind": self.verdict.kind,
                "effects": list(self.verdict.effects),
                "class": list(self.verdict.members),
                "form_residue": self.verdict.residue,
                "something_else": self.verdict.something_else,
                "noise": list(self.verdict.noise),
            },
            "noise_effects": dict(self.posterior.noise),
            "ambiguity_set": list(self.ambiguity_set),
            "absorbed": [{"effect": name, "kept_share": share} for name, share in self.absorbed.items()],
            "parameters": [
                {
                    "effect": p.effect,
                    "name": p.name,
                    "value": p.value,
                    "unit": p.unit,
                    "standard_uncertainty": p.standard_uncertainty,
                }
                for p in self.parameters
            ],
            "given": [asdict(one) for one in self.given],
            "closure": {
                "before": shut.before,
                "after": shut.after,
                "shrinks_by": shut.shrinks_by,
                "interval_90": list(shut.interval_90) if shut.resolvable else None,
                "resolvable": shut.resolvable,
                "reason": shut.reason,
                "unpredicted": list(shut.unpredicted),
                "channels": [asdict(one) for one in shut.channels],
                "repetition": None if shut.repetition is None else asdict(shut.repetition),
            },
            "unknown_form": None if self.unknown is None else self.unknown.to_json(),
            "rest": None if self.rest is None else asdict(self.rest),
            "next": None,
            "priors": dict(PRIORS),
            "pictures": dict(self.pictures),
        }
        finite: JsonObject = _finite(plain)
        return finite


def diagnose(observed: Observed, options: DiagnosisOptions = DiagnosisOptions()) -> Diagnosis:
    """Diagnoses a recording. Raises `ObservationError` if the recording cannot be diagnosed."""
    if len(observed) < FEWEST_SEGMENTS:
        few = f"the recording has {len(observed)} segments; distinguishing an effect from fitted parameters needs {FEWEST_SEGMENTS} or more"
        hint = (
            "cut long segments into several, in the plan and in the table of segments: changes with time then become "
            "visible; effects of orientation, rate or temperature need more orientations, rates or temperatures"
        )
        raise ObservationError(few, hint)
    effects = [effect for effect in hypotheses(options.effects, observed) if effect.id not in options.nominal]
    effects += hypotheses(
        [name for name in options.given if name not in {e.id for e in effects} | set(options.nominal)]
    )
    repeats = likely_repeats(observed, effects)
    weighing = Weighing(observed, options.nominal, held=repeats.held if repeats else None)
    apart = found_apart(weighing, effects, repeats)
    if apart.removed is not None:
        weighing = Weighing(observed, options.nominal, apart.removed, repeats.held if repeats else None)
    with_signatures = [effect for effect in effects if not isinstance(effect, OutsideCoefficients)]
    candidates = candidates_of(weighing, with_signatures)
    plain, given = weighing, _given(candidates, options.given)
    if given:
        weighing = weighing.beside(together(weighing, given))
        effects = [effect for effect in effects if effect.id not in options.given]
        candidates = candidates_of(weighing, [effect for effect in with_signatures if effect.id not in options.given])
    found = posterior(weighing, effects, candidates, apart)
    said = verdict(weighing, found, candidates)
    by_id = {candidate.id: candidate for candidate in candidates}
    named = [name for name in said.effects if name in by_id]
    absorbed = {c.id: c.kept for c in candidates if c.variants and c.kept < _ABSORBED_SHARE}
    usable = [c for c in candidates if np.isfinite(c.log_bayes).any()]
    key = key_of(named)
    if len(named) > 1 and key not in found.sets:  # of this set, only the quick evaluation is known
        own = evaluated(weighing, [by_id[name] for name in named])
        found = replace(found, sets={**found.sets, key: own})
    after = found.sets[key].weighed if key in found.sets else by_id[named[0]].best if named else None
    walks = {
        effect.id for effect in effects if isinstance(effect, OutsideCoefficients) and effect.outside == "random walk"
    }
    exact = _exact(weighing, by_id[named[0]]) if len(named) == 1 else {}
    choices = _choices(weighing, found, by_id, walks, exact)
    if after is not None and all(choice.effect != key for choice in choices):
        widths = after.variant.widths or (len(after.variant.columns),)
        choices.append(FoldChoice(key, after.raw, widths, 0.0, fixed=after.variant.fixed))
    rest = None if after is None or walks & set(said.effects) else remainder(weighing, after, said.something_else)
    ratios = (
        None
        if after is None or rest is None or rest.passes
        else dispersions(weighing, after, weighing.likeliest_with(after.log_bayes, False))
    )
    unpredicted = tuple(name for name in said.effects if name not in by_id)
    noise = None
    if after is not None:
        likeliest = max((choice for choice in choices if choice.effect == key), key=lambda choice: choice.probability)
        walking, explained = bool(walks & set(said.effects)), rest is not None and rest.passes
        noise = measured_noise(weighing, likeliest, after.log_bayes, walking, explained)
    beyond = 1 - found.probability["none"] - sum(choice.probability for choice in choices)
    if rest is not None and not rest.passes:  # then no effect or set is the whole cause
        choices, beyond = [replace(choice, probability=0.0) for choice in choices], 1.0
    return Diagnosis(
        gap_by_channel(weighing),
        noise_found(weighing, found.lines),
        tuple(places(weighing, found.by_channel)[:SHOWN_PLACES]),
        found,
        said,
        tuple(ambiguity_set(found.probability, said)),
        absorbed,
        tuple(_parameters(weighing, said, found, by_id, effects, exact, apart, ratios, after)),
        replace(_closure(weighing, noise, choices, max(beyond, 0.0), key, said), unpredicted=unpredicted),
        unknown_form(weighing, found) if "unknown" in (said.kind, said.residue, *said.members) else None,
        rest,
        pictures(weighing, usable, after),
        Grounds(weighing, tuple(candidates), options.nominal, tuple(choices), noise),
        tuple(_parameters_of_given(plain, given, found.sets.get(key), by_id, named)),
    )


def _closure(
    weighing: Weighing,
    noise: MeasuredNoise | None,
    choices: Sequence[FoldChoice],
    beyond: float,
    named: str,
    said: Verdict,
) -> Closure:
    """Returns the result of the check on held-out data. If `noise` is None, the result contains only the reason why the check was
    not made."""
    if noise is None:
        return not_measured(NotMeasured.RANDOM if said.effects else NotMeasured.NO_EFFECT)
    return closure(weighing, noise, choices, beyond, named)


def _given(candidates: Sequence[Candidate], names: Sequence[str]) -> list[Member]:
    """Returns the effects that are known to act, each in its best form. Raises `ObservationError` for an effect that cannot be
    fitted to this recording."""
    by_id = {candidate.id: candidate for candidate in candidates}
    for name in names:
        if name not in by_id:
            message = f"{name} is fitted by the simulation or acts only on the noise, which is measured in any case"
            raise ObservationError(message, "leave it out of --given")
        effect = by_id[name].effect
        if isinstance(effect, NotFitted):
            message = f"{name} can only be given with its values. {effect.not_fitted}"
            hint = f"state the {effect.shape_name}, as in --given '{name}=…'" if isinstance(effect, HasShape) else ""
            raise ObservationError(message, hint)
        if not np.isfinite(by_id[name].log_bayes).any():
            message = (
                f"the recording cannot show {name}: it does not act under this plan, or fitted parameters absorb it"
            )
            raise ObservationError(message, "leave it out of --given, or state its values")
    return [Member.best(by_id[name]) for name in dict.fromkeys(names)]


def _parameters_of_given(
    weighing: Weighing,
    given: Sequence[Member],
    named: EffectSet | None,
    by_id: Mapping[str, Candidate],
    names: Sequence[str],
) -> list[ParameterEstimate]:
    """Estimates the parameters of the effects that are known to act. These effects are fitted together with the named effects."""
    if not given:
        return []
    beside = named.members if named is not None else [Member.best(by_id[name]) for name in names]
    whole = together(weighing, [*given, *beside])
    listed: list[ParameterEstimate] = []
    begin = 0
    for member in given:
        end = begin + len(member.form.variant.columns)
        listed += estimates.amplitudes(weighing, member.id, whole, slice(begin, end)) + estimates.shape(
            member.candidate
        )
        begin = end
    return listed


def hypotheses(names: Sequence[str] | None, observed: Observed | None = None) -> list[Effect]:
    """Returns the effects with these names. If `names` is None, returns all installed effects that are hypotheses, except for the
    effects that cannot appear in `observed`."""
    if names is not None:
        return [effect_named(name) for name in names]
    installed = [effect_named(name) for name in plugins.names(plugins.EFFECTS)]
    return [effect for effect in installed if _weighed(effect, observed)]


def _weighed(effect: Effect, observed: Observed | None) -> bool:
    if observed is not None and isinstance(effect, ShownInSome):
        return effect.shown_in(observed)
    return not isinstance(effect, NoHypothesis)


def _exact(weighing: Weighing, candidate: Candidate) -> dict[str, Forms]:
    """Returns the forms of an effect without an amplitude, such as a delay or a limit, under the name of the effect. Each form is
    the effect at one value of its shape parameter. Returns an empty result in two cases: if the effect has an amplitude, or if the
    data contain too little evidence for the effect."""
    effect = shape_alone(candidate)
    found = candidate.whole or (whole_forms(weighing, effect) if effect is not None else ())
    return {candidate.id: found} if found else {}


def _choices(
    weighing: Weighing, found: Posterior, by_id: Mapping[str, Candidate], walks: Set[str], exact: Mapping[str, Forms]
) -> list[FoldChoice]:
    """Returns the forms of the probable effects and of the probable sets of effects. For each fold, the closure chooses one of
    these forms. Hypotheses that differ only in effects on the noise become one choice. For each choice, the probability that it is
    the whole cause is the sum over its hypotheses; hypotheses with a random walk or an unknown cause do not count."""
    likely: dict[str, float] = {}
    for name, p in found.probability.items():
        parts = name.split("+")
        key = "+".join(part for part in parts if part in by_id)
        if p >= _LIKELY and key:
            likely[key] = likely.get(key, 0.0) + (0.0 if {*walks, UNKNOWN} & set(parts) else p)
    chosen = [choice for key, p in likely.items() for choice in _forms(weighing, found, by_id, exact, key, p)]
    return sorted(chosen, key=lambda choice: -choice.probability)[:_MOST_CHOICES]


def _forms(
    weighing: Weighing, found: Posterior, by_id: Mapping[str, Candidate], exact: Mapping[str, Forms], key: str, p: float
) -> list[FoldChoice]:
    """Returns the forms of one effect or set of effects, as choices for the folds. `p`: the probability of this effect or set."""
    if key in exact:
        return whole_choices(weighing, key, by_id[key].effect, exact[key], p)
    if key in found.sets:
        one = found.sets[key]
        return choices_of(weighing, key, [(member.form, member.candidate) for member in one.members], p, one.on_others)
    if key not in by_id or by_id[key].best.trace <= 0:
        return []
    return choices_of(weighing, key, [(by_id[key].best, by_id[key])], p)


def _parameters(
    weighing: Weighing,
    said: Verdict,
    found: Posterior,
    by_id: Mapping[str, Candidate],
    effects: list[Effect],
    exact: Mapping[str, Forms],
    apart: Apart,
    ratios: Array | None,
    after: Weighed | None,
) -> list[ParameterEstimate]:
    """Estimates the parameters of the effects that the verdict names. The effects of a set are fitted together. `ratios`: the same
    as in `parameters.amplitudes`. `after`: the named effects that have a signature; None if there are none."""
    listed: list[ParameterEstimate] = []
    walking = any(
        isinstance(e, OutsideCoefficients) and e.outside == "random walk" and e.id in said.effects for e in effects
    )
    together = found.sets.get(key_of(name for name in said.effects if name in by_id))
    for name in said.named:
        if name not in by_id:
            on_noise = next(one for one in effects if one.id == name and isinstance(one, OutsideCoefficients))
            listed += apart.parameters.get(name) or estimates.of_noise(weighing, on_noise, after)
            continue
        shaped = shape_alone(by_id[name])
        if shaped is not None and name in exact:
            alone = _exact_shapes(weighing, shaped, exact[name])
            listed += estimates.wider(alone, by_id[name].best, ratios)
            continue
        if shaped is not None and len(said.effects) == 1 and by_id[name].best.amplitudes[0][0] < 0:
            listed += estimates.wider(estimates.opposite(shaped, by_id[name].best), by_id[name].best, ratios)
            continue
        if together is None:
            best = by_id[name].best
            listed += estimates.amplitudes(weighing, name, best, walking=walking, ratios=ratios)
            listed += estimates.wider(estimates.shape(by_id[name]), best, ratios)
        else:
            (member,) = (one for one in together.members if one.id == name)
            own = together.columns(name)
            acting = together.on_others
            if acting is not None and together.members[acting[0]] is member and shaped is not None:
                every = [column for each in columns_beside(weighing, together, acting[0]) for column in each]
                exactly = _exact_shapes(weighing, shaped, acting[1].forms, every)
                listed += estimates.wider(exactly, member.form, ratios)
                continue
            weights, columns = weighing, together.weighed
            if acting is not None:
                weights, columns = acting[1].weighed(weighing, columns)
            listed += estimates.amplitudes(weights, name, columns, own, walking, ratios)
            listed += estimates.wider(estimates.shape(member.candidate), member.form, ratios)
    return listed


def _exact_shapes(
    weighing: Weighing, effect: Shaped, forms: Forms, beside: Sequence[Column] = ()
) -> list[ParameterEstimate]:
    """Estimates the shape of an effect that has no amplitude. If the effect has another parameter (`PairedShapes`), it is estimated
    too, unless the data do not show it. `beside`: columns, with samples, of the other effects that act."""
    found = estimates.exact_shape(effect, forms)
    other = effect.opposite(found[0].value) if isinstance(effect, PairedShapes) else None
    opposite = whole_forms(weighing, other, columns=beside) if other is not None else []
    return [*found, *estimates.exact_shape(other, opposite)] if other is not None and opposite else found


def _finite(value: Json) -> Json:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value

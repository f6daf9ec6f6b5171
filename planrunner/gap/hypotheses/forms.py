"""Evaluates effects in different forms. The shape of an effect is a parameter, such as a time constant, on which the outputs do not
depend linearly. A form is the effect at one value of its shape. Each effect with a shape has a grid of such values. If the evidence
has a sharp peak, the grid is refined. Strong effects are evaluated in a nonlinear form.

Some effects (a lag, a delay, a dead zone, a limit) have no amplitude: the shape alone determines the effect. If such an effect is
weak, it is evaluated like the others, with an amplitude in addition to its shape, because the data cannot separate the two. If it
is strong, it is evaluated with the amplitude 1, and its shape is found exactly. If a strong effect acts on the output of the
sensor, the nominal parameters are fitted together with the effect. The nominal parameters are found by Gauss–Newton steps, and the
shape by a search. If the nominal parameters were fitted without the effect, they would absorb a part of the effect, and the
computed output would be wrong.

A dead zone or a limit acts on the output. Its size therefore depends on the bias and the scale factors of the sensor. To first
order in the nominal parameters θ, the effect is e(θ) = e(θ₀) + E·(θ − θ₀). Here, θ₀ is the operating point: the nominal parameters
at which the form of the effect was computed. Each column of E is the change of the effect per change of one parameter. It is
computed by a central difference. The step of these differences is one standard uncertainty of each parameter, because the exact
derivative of a dead zone is infinite at its edge.

In array shapes, M is the number of coefficients of a channel, G is the number of settings of the noise, and q is the number of
nominal parameters of a channel.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import (
    ChangesWithinSegments,
    Column,
    Curved,
    CurvedAndShaped,
    Effect,
    Shaped,
    Variant,
    is_whole,
    ways_of,
)
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.bayes_factors import RANGE, log_mean_exp
from planrunner.gap.evidence.weighing import coefficients_of
from planrunner.gap.hypotheses.candidates import ABSORBED, Candidate, Forms, Weighed, Weighing

_REFINE = 8.0  # log Bayes factor above which the grid of a shape is refined
BENT = 30.0  # log Bayes factor above which an effect may distort the fit of the nominal parameters
_SETTLING, _GAINED = 8, 1.0  # maximum number of refits; gain in nats that justifies another one
WORSE = float(np.log(100.0))  # a more exact form is rejected if it is less likely by more than this
_STILL = 0.1  # standard deviations of the noise; a smaller change of an effect counts as no change

_WIDTHS = (1000.0, 300.0, 100.0, 30.0, 10.0, 3.0, 1.0)
"""Steps of the differences that replace derivatives in the first iterations, in standard uncertainties of the output."""
_WIDTHS_BESIDE = (30.0, 10.0, 3.0, 1.0)  # the same, if the fit starts from the parameters of a neighbouring shape


def candidates_of(weighing: Weighing, effects: Sequence[Effect]) -> list[Candidate]:
    """Evaluates each effect with every shape on its grid. The grid is refined where the evidence is sharp."""
    if not effects:
        return []
    each = [ways_of(effect, weighing.observed) for effect in effects]
    ways = [way for own in each for way in own]
    forms = [weighing.reduced(_groups(way, weighing.observed)) for way in ways]
    weighed = iter(weighing.weigh_reduced([variant for form in forms for variant in form]))
    coarse = [[next(weighed) for _ in form] for form in forms]
    found: list[Candidate | None] = [None] * len(ways)
    reached = -np.inf
    for number in _order(ways, coarse):
        found[number] = one = _candidate(weighing, ways[number], coarse[number], reached)
        if one.whole and on_output(ways[number]) is not None and _leave_only_noise(weighing, one.whole):
            reached = max(reached, *(_evidence(weighing, form) for form, _ in one.whole))
    made = iter([one for one in found if one is not None])
    return [_likeliest([next(made) for _ in own]) for own in each]


def _order(ways: Sequence[Effect], coarse: Sequence[Sequence[Weighed]]) -> list[int]:
    """Returns the order in which effects are evaluated. Effects on the output are evaluated last, beginning with the most probable
    effect, because the searches for their shapes depend on what the preceding effects explain. `coarse`: the forms of each effect
    on its grid."""

    def likely(number: int) -> float:
        if on_output(ways[number]) is None:
            return np.inf
        return max((float(item.log_bayes.max()) for item in coarse[number] if item.can_be_seen), default=-np.inf)

    return sorted(range(len(ways)), key=lambda number: -likely(number))


def _leave_only_noise(weighing: Weighing, forms: Forms) -> bool:
    """Returns True if the most probable of the `forms`, with the amplitude 1, leaves no more than noise."""
    best, _ = max(forms, key=lambda one: one[1])
    taken = [raw[:, 0] for raw in best.raw]
    return _only_noise(weighing, weighing.nominal_values(taken), taken)


def _groups(effect: Effect, observed: Observed) -> Iterator[Sequence[Variant]]:
    """Yields the variants of an effect in groups (`Shaped.groups`). The variants of an effect without a shape are one group."""
    if isinstance(effect, Shaped):
        yield from effect.groups(observed)
    else:
        yield effect.variants(observed)


def _likeliest(ways: Sequence[Candidate]) -> Candidate:
    """Returns the most probable of several ways in which an effect can act. Its evidence is replaced by the average over all ways
    that the plan can excite."""
    shown = [way for way in ways if np.isfinite(way.log_bayes).any()]
    if len(ways) == 1 or not shown:
        return ways[0]
    best = max(shown, key=lambda way: float(way.log_bayes.max()))
    return replace(best, log_bayes=log_mean_exp(np.array([way.log_bayes for way in shown]), 0))


def _candidate(weighing: Weighing, effect: Effect, weighed: list[Weighed], reached: float) -> Candidate:
    """Evaluates an effect from its forms on the grid (`weighed`). `reached`: the same as in `whole_forms`."""
    usable = [item for item in weighed if item.can_be_seen]
    if not usable:
        return Candidate(effect, tuple(weighed), np.full(len(weighing.base), -np.inf))
    log_bayes = log_mean_exp(np.array([item.log_bayes for item in usable]), 0)
    settled, whole = False, tuple[tuple[Weighed, float], ...]()
    if isinstance(effect, Shaped) and float(log_bayes.max()) > _REFINE and len(usable) > 2:
        short = weighing if on_output(effect) is None else weighing.condensed()[0]
        usable, log_bayes = _refined(short, effect, usable, short.observed)
        if float(log_bayes.max()) > BENT and is_whole(usable[0].variant.columns):
            whole = _held(short, effect, usable, reached)
            if not whole:
                before = usable
                usable, log_bayes = _resettled(short, effect, usable, log_bayes)
                settled = usable is not before
                whole = _held(short, effect, usable, reached) if settled else ()
            if whole:
                usable, settled = [form for form, _ in whole], True
                log_bayes = _averaged(usable)
    if isinstance(effect, CurvedAndShaped) and float(log_bayes.max()) > BENT:
        usable, log_bayes = _along_secants(weighing, effect, usable, log_bayes)
    if isinstance(effect, Curved) and (float(log_bayes.max()) > BENT or usable[0].excluded):
        # The amplitude of the linear approximation may be impossible even if the exact amplitude is possible.
        usable, log_bayes = _curved(weighing, effect, usable, log_bayes)
    return Candidate(effect, tuple(usable), log_bayes, weighing.likeliest[0], settled, whole)


def _curved(weighing: Weighing, effect: Curved, usable: list[Weighed], log_bayes: Array) -> tuple[list[Weighed], Array]:
    """Evaluates a strong nonlinear effect with its secants at the most probable amplitudes. Secants are columns that replace the
    linear approximation: at given amplitudes, the sum of the columns, each multiplied by its amplitude, is exactly the effect. The
    secants are computed again until the amplitudes no longer change. They have as many parameters as the linear approximation. They
    are therefore used even if they explain the data no better, and rejected only if they explain the data clearly worse. `usable`:
    the evaluated form of the effect. `log_bayes`: array of shape (G,), its log Bayes factor. Returns both for the last secants that
    were not rejected; unchanged if the first secants were rejected."""
    least = float(log_bayes.max()) - WORSE
    for _ in range(_SETTLING):
        (best,) = usable
        size = np.array([column.magnitude for column in best.variant.columns])
        (again,) = weighing.weigh(effect.around(weighing.observed, best.amplitudes[0] * size))
        if float(again.log_bayes.max()) < least:
            break
        moved = again.amplitudes[0] - best.amplitudes[0]
        usable, log_bayes = [again], again.log_bayes
        if float(moved @ again.gram[weighing.likeliest[0]] @ moved) < _STILL**2:
            break
    return usable, log_bayes


def _along_secants(
    weighing: Weighing, effect: CurvedAndShaped, usable: list[Weighed], log_bayes: Array
) -> tuple[list[Weighed], Array]:
    """Does the same as `_curved`, for an effect that has a shape. First, the secants at the amplitudes of the most probable shape
    are computed, and the nominal parameters are fitted to the data minus this effect. Then the search for the shape is repeated
    with these secants, at the output that these parameters give. This is repeated as long as the evidence increases. `usable`: the
    evaluated forms. `log_bayes`: array of shape (G,), log Bayes factor averaged over the shape."""
    for _ in range(_SETTLING):
        best = max(usable, key=lambda weighed: float(weighed.log_bayes[weighing.likeliest[0]]))
        size = np.array([column.magnitude for column in best.variant.columns])
        amplitudes = best.amplitudes[0]
        along, seen = (
            effect.secant(amplitudes * size),
            weighing.seen(weighing.nominal_values([raw @ amplitudes for raw in best.raw])),
        )
        coarse = [item for item in weighing.weigh_groups(along.groups(seen)) if item.trace > 0]
        if len(coarse) < 3:
            break
        again, value = _refined(weighing, along, coarse, seen)
        if float(value.max()) < float(log_bayes.max()) + _GAINED:
            break
        usable, log_bayes = again, value
    return usable, log_bayes


def _resettled(
    weighing: Weighing, effect: Shaped, usable: list[Weighed], log_bayes: Array
) -> tuple[list[Weighed], Array]:
    """Evaluates again a strong effect that acts on the output of the sensor. The nominal parameters are fitted together with the
    effect's best form; they give a new output, at which the effect is evaluated. This is repeated as long as the effect explains
    more of the gap. `usable`, `log_bayes`: the same as in `_along_secants`. Both are returned, improved if possible."""
    values: Sequence[Array] | None = None
    for _ in range(_SETTLING):
        best = max(usable, key=lambda weighed: float(weighed.log_bayes[weighing.likeliest[0]]))
        values = _together(weighing, effect, best, values)
        seen = weighing.seen(values)
        coarse = [item for item in weighing.weigh_groups(effect.groups(seen)) if item.can_be_seen]
        if len(coarse) < 3:
            break
        again, value = _refined(weighing, effect, coarse, seen)
        if value[weighing.likeliest[0]] < log_bayes[weighing.likeliest[0]] + _GAINED:
            break
        usable, log_bayes = again, value
    return usable, log_bayes


def _together(
    weighing: Weighing,
    effect: Shaped,
    best: Weighed,
    values: Sequence[Array] | None,
    widths: Sequence[float] = _WIDTHS,
) -> list[Array]:
    """Fits the nominal parameters together with an effect of amplitude 1, and returns their values (q,) for each channel, in
    magnitudes. `best`: the form of the effect. `values`: nominal parameters at which the fit may start; None if no such parameters
    are known. `widths`: the same as in `settled`."""
    acting, taken = on_output(effect), [raw[:, 0] for raw in best.raw]
    if acting is None or values is None:
        values = weighing.nominal_values(taken)
    if acting is None:
        return list(values)
    return settled(weighing, acting, float(best.variant.shape or 0.0), values, widths=widths)


def _held(
    weighing: Weighing, effect: Shaped, usable: list[Weighed], reached: float
) -> tuple[tuple[Weighed, float], ...]:
    """Evaluates a strong effect whose shape determines it completely. The amplitude is not fitted; it is 1 for physical reasons.
    For example, the time constant of a lag determines both the delay and the attenuation. The result is empty if the data require
    the opposite sign, or if the effect is so weak that the data do not determine its amplitude. `reached`: the same as in
    `whole_forms`."""
    best = max(usable, key=lambda weighed: float(weighed.log_bayes[weighing.likeliest[0]]))
    forms = whole_forms(weighing, effect, reached=reached) if best.amplitudes[0][0] > 0 else []
    if len(forms) < 3 or any(form.trace <= 0 for form, _ in forms):
        return ()
    return tuple(forms)


def _averaged(forms: Sequence[Weighed]) -> Array:
    """Returns the log Bayes factor (G,), averaged over the shapes of an effect with the amplitude 1. The energy λ of the effect, in
    units of the noise, has the same prior as for other effects."""
    width = np.abs(np.gradient(np.log([form.trace for form in forms]))) / RANGE
    if not width.any():  # all forms have the same energy, so the prior has no width
        return np.full(len(forms[0].log_bayes), -np.inf)
    share = width / width.sum()
    stacked = np.array([form.log_bayes for form in forms])
    return np.asarray(log_mean_exp(stacked, 0, share[:, None]) + float(np.log(width.sum())))


def _refined(weighing: Weighing, effect: Shaped, coarse: list[Weighed], seen: Observed) -> tuple[list[Weighed], Array]:
    """Adds shapes to the grid around the best one, and averages the evidence over the shape by the trapezoidal rule. Every interval
    of the grid has the same prior.

    Three rounds add four shapes between the best shape and each neighbour, which is enough for the sharp peak of an effect of a
    hundred standard deviations. If the best shape with a random walk of the gyros differs from the best shape without it, the grid
    is refined around both shapes.
    """
    have = {float(item.variant.shape or 0.0): item for item in coarse}
    grid = np.array(sorted(have))
    for _ in range(3):
        shapes = np.array(sorted(have))
        tops = {int(np.argmax([have[shape].log_bayes[at] for shape in shapes])) for at in weighing.likeliest}
        intervals = sorted({k for top in tops for k in (top - 1, top) if 0 <= k < len(shapes) - 1})
        between = np.concatenate(
            [np.linspace(a, b, 6)[1:-1] for a, b in np.log([shapes[k : k + 2] for k in intervals])]
        )
        new = weighing.weigh_groups([effect.at(seen, float(np.exp(value)))] for value in between)
        have |= {float(item.variant.shape or 0.0): item for item in new if item.kept > ABSORBED}
    shapes = np.array(sorted(have))
    place = np.interp(np.log(shapes), np.log(grid), np.linspace(0.0, 1.0, len(grid)))
    steps = np.diff(place)
    share = np.zeros(len(shapes))
    share[:-1] += steps / 2
    share[1:] += steps / 2
    stacked = np.array([have[shape].log_bayes for shape in shapes])
    return [have[shape] for shape in shapes], log_mean_exp(stacked, 0, (share / share.sum())[:, None])


_STEPS = 20
_STEPS_BESIDE = 3  # number of steps with other effects, whose amplitudes are fitted again before the next steps
_ROUNDS = 15
_PATIENCE = 4  # number of steps without a larger evidence after which a search ends
_FAR = 100.0  # nats; an effect that is less probable by more than this is not evaluated exactly
_GROWN = 0.1  # nats; a smaller increase of the evidence counts as no increase
_FURTHER = 10.0  # times the gain of the last step, the largest gain that the next steps may bring
_SAME = 0.05  # standard deviations; two shapes that differ by less count as equal
_DROP = 0.5  # nats below the best log evidence, which correspond to one standard deviation
_TOLD = 1.0  # nats by which an effect must be more probable than no effect
_CLOSER = 16  # factor by which a parabola narrows the search for a shape
_SCATTERED = 3.0  # standard deviations by which the energy of noise may exceed its mean
_NEARBY = 6  # shapes between a shape and the next one of the grid
_SPAN, _FORMS = 4.0, 17  # range in standard deviations on both sides, and number of values in this range


def shape_alone(candidate: Candidate) -> Shaped | None:
    """Returns the effect of a candidate if its shape determines it completely; otherwise None."""
    effect = candidate.effect
    if isinstance(effect, Shaped) and any(is_whole(item.variant.columns) for item in candidate.variants):
        return effect
    return None


def whole_forms(
    weighing: Weighing,
    effect: Shaped,
    near: Weighed | None = None,
    columns: Sequence[Column] = (),
    reached: float = -np.inf,
) -> list[tuple[Weighed, float]]:
    """Returns the forms with the amplitude 1 around the most probable shape, in equal steps of the logarithm of the shape, and their
    probabilities. If the data require the opposite sign, no form explains the data better than no effect, and the result is empty.
    `near`: a form from which the search starts, None if no form is known. `columns`: columns, with samples, of other effects whose
    amplitudes are not known exactly. `reached`: log evidence of another effect that leaves only noise, −∞ if there is none. If the
    effect explains far less, the search for its shape ends early."""
    return _around_the_best(weighing, effect, near, columns, reached)[0]


def _around_the_best(
    weighing: Weighing, effect: Shaped, near: Weighed | None, columns: Sequence[Column], reached: float = -np.inf
) -> tuple[list[tuple[Weighed, float]], Sequence[Array]]:
    """Does the same as `whole_forms`. Also returns the nominal parameters (q,) of each channel with which the shape was found."""
    short, columns = (weighing, columns) if on_output(effect) is None else weighing.condensed(columns)
    found = _found(short.without_walks(), effect, near, columns, reached)
    around = found.shape * np.exp(found.sigma * np.linspace(-_SPAN, _SPAN, _FORMS))
    variants = short.reduced([replace(effect.at(found.seen, float(value)), fixed=(0,))] for value in around)
    forms = weighing.weigh_reduced(variants)
    if max(_evidence(weighing, form) for form in forms) < weighing.evidence(np.zeros(len(weighing.base))) + _TOLD:
        return [], found.values
    each = np.array([_evidence(found.along, form) for form in found.along.weigh_reduced(variants)])
    share = np.exp(each - each.max())
    return list(zip(forms, (share / share.sum()).tolist(), strict=True)), found.values


@dataclass(frozen=True)
class _Found:
    """Contains a shape that was found for an effect with the amplitude 1. `values`: for each channel, the values (q,) of the nominal
    parameters. `seen`: the recording with the nominal output. `along`: the prepared recording in which the shape was found.
    `sigma`: standard deviation of the logarithm of the shape."""

    values: Sequence[Array] = field(repr=False)
    seen: Observed = field(repr=False)
    along: Weighing = field(repr=False)
    shape: float
    sigma: float


def _found(
    weighing: Weighing, effect: Shaped, near: Weighed | None, columns: Sequence[Column], reached: float
) -> _Found:
    """Searches for the most probable shape and fits the nominal parameters. If an effect acts on the output, a first search uses few
    samples of each turn of the table (`Weighing.of_turns`). The exact search then begins at the result. It takes only one step if
    far more than noise remains, because the approximation then contributes nothing to what remains. `reached`: the same as in
    `whole_forms`."""
    few, of_few = (weighing, columns) if on_output(effect) is None else weighing.of_turns(columns)
    found = _search(few, effect, near, of_few, reached)
    if few is weighing:
        return found
    (best,) = weighing.weigh([effect.at(weighing.seen(found.values), found.shape)])
    taken = [raw[:, 0] for raw in best.raw]
    hopeless = _excess(weighing, found.values, taken) > 2 * _FAR or _evidence(weighing, best) < reached - _FAR
    steps = 1 if hopeless else _STEPS_BESIDE
    return _alternated(weighing, effect, best, found.values, columns, steps, widths=_WIDTHS[-1:])[1]


def _search(
    weighing: Weighing, effect: Shaped, near: Weighed | None, columns: Sequence[Column], reached: float
) -> _Found:
    """Searches for the most probable shape and fits the nominal parameters. For an effect on the output, the shape and the nominal
    parameters are varied together. This search follows the parameters from one optimum. There may be several optima: for example,
    an output near a dead zone can lie inside or outside the dead zone. Therefore, smaller and larger shapes are also tried, each
    with the nominal parameters that fit best. A clearly better shape replaces the shape that was found first. If the first shape
    leaves no more than noise, no other shape can explain clearly more, and none is tried. No other shape is tried either if another
    effect leaves only noise, and this effect explains far less (`reached`, as in `whole_forms`)."""
    best, values = (near, None) if near is not None else _start(weighing, effect)
    steps = _STEPS if near is None else _STEPS_BESIDE
    evidence, found = _alternated(weighing, effect, best, values, columns, steps, reached)
    acting = on_output(effect)
    if acting is None or near is not None or evidence < reached - _FAR:
        return found
    made = coefficients_of(weighing.observed, weighing.spectrum, effect.at(found.seen, found.shape).columns)
    if _only_noise(weighing, found.values, [raw.sum(axis=1) for raw in made]):
        return found
    value, other = _beside(weighing, acting, found.shape, found.values, columns)
    return other if value > evidence + _TOLD else found


def _only_noise(weighing: Weighing, values: Sequence[Array], taken: Sequence[Array]) -> bool:
    """Returns True if the coefficients minus an effect and the nominal outputs are not larger than noise. `values`, `taken`: for each
    channel, the values (q,) of the nominal parameters, and the coefficients (M,) that the effect causes."""
    return _excess(weighing, values, taken) <= 0.0


def _excess(weighing: Weighing, values: Sequence[Array], taken: Sequence[Array]) -> float:
    """Returns by how much the sum of the squared residuals, in units of the noise, exceeds the largest usual value of noise. The
    arguments are the same as in `_only_noise`."""
    rest = float(sum(weighing.misfits(values, taken)))
    fitted = sum(len(own) for own in values) + sum(one.shape[1] for one in weighing.angles)
    degrees = float(weighing.spectrum.values.size - fitted)
    return rest - degrees - _SCATTERED * float(np.sqrt(2 * degrees))


def _beside(
    weighing: Weighing, effect: Shaped, shape: float, values: Sequence[Array], columns: Sequence[Column]
) -> tuple[float, _Found]:
    """Evaluates shapes between `shape` and the next shapes of the grid, then shapes near the best of these shapes. Each shape is
    evaluated with the nominal parameters that fit best; the fit starts from the parameters of the neighbouring shape. Returns the
    evidence of the best shape, and this shape. The shape is not refined further, because the nominal parameters beside a limit
    belong to this shape alone. `values`: parameters (q,) of each channel for `shape`. `columns`: the same as in `moving`."""
    grid = np.log(effect.grid(weighing.observed))
    place, known = float(np.log(shape)), dict[float, tuple[float, Sequence[Array]]]()
    ends = [*grid[grid < place][-1:].tolist(), *grid[grid > place][:1].tolist()]
    for _ in range(2):
        for end in ends:
            now = values
            for at in np.linspace(place, end, _NEARBY + 1)[1:].tolist():
                now = settled(weighing, effect, float(np.exp(at)), now, widths=_WIDTHS_BESIDE)
                (form,) = weighing.weigh([effect.at(weighing.seen(now), float(np.exp(at)))])
                known[at] = _evidence(weighing, form), now
        found = np.array(sorted(known))
        evidence = np.array([known[at][0] for at in found])
        top = int(np.clip(np.argmax(evidence), 1, len(found) - 2))
        place, values = float(found[top]), known[float(found[top])][1]
        ends = [float(found[top - 1]), float(found[top + 1])]
    _, sigma = _parabola(found, evidence, top)
    along = moving(weighing, effect, float(np.exp(place)), values, columns)
    return float(evidence[top]), _Found(values, weighing.seen(values), along, float(np.exp(place)), sigma)


def _alternated(
    weighing: Weighing,
    effect: Shaped,
    best: Weighed,
    values: Sequence[Array] | None,
    columns: Sequence[Column],
    steps: int,
    reached: float = -np.inf,
    widths: Sequence[float] = _WIDTHS,
) -> tuple[float, _Found]:
    """Searches for the shape and fits the nominal parameters, in turn. If the search alternates between shapes or does not
    converge, the most probable of the visited shapes is used, with the nominal parameters that were fitted for it. The search also
    ends if several steps do not increase the evidence, or if it stays far below `reached` (as in `whole_forms`). Returns the
    evidence and the shape. `widths`: the same as in `settled`."""
    shape, last, acting = float(best.variant.shape or 0.0), np.nan, on_output(effect)
    visited: list[tuple[float, _Found]] = []
    course: list[float] = []  # largest evidence after each step
    for _ in range(steps):
        values = _together(weighing, effect, best, values, widths)
        seen, before, last = weighing.seen(values), last, shape
        along = weighing if acting is None else moving(weighing, acting, shape, values, columns)
        shape, sigma = _most_probable(along, effect, seen, last)
        (best,) = weighing.weigh([effect.at(seen, shape)])
        visited.append((_evidence(weighing, best), _Found(values, seen, along, shape, sigma)))
        if abs(np.log(shape / last)) < _SAME * sigma:
            return visited[-1]
        visited = [max(visited, key=lambda one: one[0])]  # each contains the outputs of a nominal model
        course.append(visited[0][0])
        if len(course) > _PATIENCE and course[-1] < course[-1 - _PATIENCE] + _GROWN:
            break
        if len(course) > 1 and course[-1] + _FURTHER * (course[-1] - course[-2]) < reached - _FAR:
            break
        if abs(np.log(shape / before)) < _SAME * sigma:
            break
    return visited[0]


def _start(weighing: Weighing, effect: Shaped) -> tuple[Weighed, Sequence[Array] | None]:
    """Returns the form from which a search starts, and the nominal parameters (q,) of each channel for which this form was
    computed. None means the parameters that are fitted without any effect. For an effect on the output, the search also tries the
    parameters of the declared sensor, and uses whichever parameters explain more. The reason is that the fitted scale factors are
    far too small if the output is limited in most readings."""
    starts: list[Sequence[Array] | None] = [None]
    if on_output(effect) is not None:
        starts.append([np.zeros(whole.shape[1]) for whole in weighing.whole])
    found = []
    for values in starts:
        seen = weighing.observed if values is None else weighing.seen(values)
        shape, _ = _most_probable(weighing, effect, seen, np.nan)
        (best,) = weighing.weigh([effect.at(seen, shape)])
        found.append((_evidence(weighing, best), best, values))
    _, best, values = max(found, key=lambda one: one[0])
    return best, values


def columns_of(weighing: Weighing, effect: Effect, form: Weighed, amplitudes: Array) -> Sequence[Column]:
    """Returns the columns of a form of an effect, with samples; no columns if the effect must be evaluated in another way.
    `amplitudes`: array of shape (p,) in magnitudes. At these amplitudes, the columns of a strong nonlinear effect are exact
    (secants)."""
    observed = weighing.observed
    if isinstance(effect, CurvedAndShaped):
        return ()
    if isinstance(effect, Curved):
        size = np.array([column.magnitude for column in form.variant.columns])
        strong = float(form.log_bayes.max()) > BENT
        (variant,) = effect.around(observed, amplitudes * size * strong)
        return variant.columns
    made = effect.variants(observed)
    if isinstance(effect, Shaped) and form.variant.shape is not None:
        made = [effect.at(observed, form.variant.shape)]
    return next((one.columns for one in made if one.shape == form.variant.shape), ())


@dataclass(frozen=True)
class OnOthers:
    """Describes an effect on the output that acts together with other effects. An example is a limit of an output that other
    effects also change.

    `forms`: the forms of the effect with the amplitude 1, and their probabilities. To the first order, the common output is the sum
    of the nominal output, a form, and `others` multiplied by the amplitudes of the other effects. `others`: for each channel, the
    coefficients (M, P) of the other effects as the output shows them. `point`: how the effect changes with the nominal
    parameters."""

    forms: tuple[tuple[Weighed, float], ...]
    others: tuple[Array, ...] = field(repr=False)
    point: OperatingPoint = field(repr=False)

    @property
    def best(self) -> Weighed:
        return max(self.forms, key=lambda one: one[1])[0]

    def weighed(self, weighing: Weighing, together: Weighed) -> tuple[Weighing, Weighed]:
        """Returns two results. The first is a copy of `weighing` that includes the change of the effect with the nominal
        parameters. The second is the evaluation of all columns of the effects (`together`) with this copy. The uncertainty of the
        amplitudes then includes the uncertainty of the nominal parameters."""
        along = weighing.moving(self.point.change, self.point.values)
        (found,) = along.weigh_reduced([together.variant])
        return along, found


def on_others(
    weighing: Weighing, effect: Shaped, form: Weighed, columns: Sequence[Column], amplitudes: Array
) -> OnOthers | None:
    """Finds the shape of an effect that acts on the whole output: on the nominal output and on the changes by other effects.
    Returns None if no shape explains the data.

    `form`: a form of the effect from which the search starts. `columns`: P columns of the other effects; their `parts` contain the
    samples. `amplitudes`: array of shape (P,), amplitudes of these columns, in units of `Column.magnitude`."""
    short, of_others = weighing.condensed(columns)
    beneath = short.with_known(of_others, amplitudes)
    forms, values = _around_the_best(beneath, effect, form, of_others)
    if not forms:
        return None
    best, _ = max(forms, key=lambda one: one[1])
    shape, taken = float(best.variant.shape or 0.0), [raw[:, 0] for raw in best.raw]
    point = operating_point(beneath, effect, shape, taken, values=values)
    others = passed_on(short, effect, shape, beneath.seen(point.values), of_others)
    shown = [
        (without - passed) @ amplitudes
        for without, passed in zip(coefficients_of(short.observed, short.spectrum, of_others), others, strict=True)
    ]
    made = []
    for one, share in forms:
        raw = [block + more[:, None] for block, more in zip(one.raw, shown, strict=True)]
        (weighed,) = weighing.weigh_reduced([one.variant.with_tables(raw)])
        if weighed.kept <= ABSORBED:  # a limit near zero, for example, leaves nothing of the output
            return None
        made.append((weighed, share))
    return OnOthers(tuple(made), tuple(others), point)


def _evidence(weighing: Weighing, form: Weighed) -> float:
    """Returns the log evidence of a form with the amplitude 1, up to a constant that is the same for all forms. A form that the nominal
    parameters absorb explains nothing; its score would consist of rounding errors."""
    if form.kept <= ABSORBED:
        return weighing.evidence(np.zeros(len(weighing.base)))
    return weighing.evidence(form.score[:, 0] - 0.5 * form.gram[:, 0, 0])


def _most_probable(weighing: Weighing, effect: Shaped, seen: Observed, near: float) -> tuple[float, float]:
    """Returns the most probable shape and the standard deviation of its logarithm. The search starts on the grid and continues
    beyond it if the best shape is at an edge. Then the search adds shapes between the best shape and its neighbours, until the
    neighbours are within one standard deviation. These shapes are near the peak of the parabola through the three best shapes. If
    this does not narrow the search enough, the added shapes are equally spaced. For a shape that the data barely constrain, the
    standard deviation is limited by the width of the grid. `near`: a shape near which the search starts, NaN if none is known."""
    known: dict[float, float] = {}
    width = np.inf
    new = np.log(effect.grid(seen))
    widest = float(np.ptp(new)) / (2 * _SPAN)
    if np.isfinite(near):
        first = int(np.clip(np.searchsorted(new, np.log(near)), 2, len(new) - 2)) - 2
        new = new[first : first + 4]
    for _ in range(_ROUNDS):
        weighed = weighing.weigh_groups([effect.at(seen, float(np.exp(value)))] for value in new)
        known |= {float(value): _evidence(weighing, item) for value, item in zip(new, weighed, strict=True)}
        place = np.array(sorted(known))
        evidence = np.array([known[value] for value in place])
        top = int(np.argmax(evidence))
        if top in (0, len(place) - 1):
            beyond, step = (place[0], place[0] - place[1]) if top == 0 else (place[-1], place[-1] - place[-2])
            new = beyond + step * np.arange(1, 4)
            continue
        if np.ptp(evidence[top - 1 : top + 2]) < _DROP:
            break
        below, middle, above = place[top - 1 : top + 2]
        before, width = width, above - below
        peak, sigma = _parabola(place, evidence, top)
        step = max(width / _CLOSER, sigma) / 2
        if below < peak - step and peak + step < above and width < before / 3:
            new = peak + step * np.array([-1, 0, 1])
        else:
            new = np.concatenate([np.linspace(a, b, 5)[1:-1] for a, b in ((below, middle), (middle, above))])
    peak, sigma = _parabola(place, evidence, int(np.clip(top, 1, len(place) - 2)))
    return float(np.exp(peak)), min(sigma, widest)


def _parabola(place: Array, evidence: Array, top: int) -> tuple[float, float]:
    """Returns the peak and the standard deviation of a density whose logarithm is a parabola through three points. `place`,
    `evidence`: coordinates of all points. `top`: index of the middle one of the three."""
    near = slice(top - 1, top + 2)
    bend, slope, _ = np.polyfit(place[near] - place[top], evidence[near] - evidence[top], 2)
    reach = float(place[top + 1] - place[top - 1])
    if bend >= 0:
        return float(place[top]), reach
    return float(place[top] + np.clip(-slope / (2 * bend), -reach, reach)), float(1 / np.sqrt(-2 * bend))


_LOST = 1e6  # times the smallest misfit, at and above which a fit returns to the parameters of the smallest misfit
_FITS = 12  # number of Gauss–Newton iterations
_ROUNDING = 1e-6
"""If the output changes by less than this fraction of a change of the nominal output, it counts as constant. Smaller changes are
rounding errors, which must not count as information about the parameters."""


@dataclass(frozen=True)
class OperatingPoint:
    """Contains the nominal parameters at which an effect on the output is linearised, and its change with these parameters. Each
    attribute has one array per channel. `values`: shape (q,), the nominal parameters θ₀ in units of their magnitudes. `nominal`:
    shape (M, q), the columns of the nominal parameters. `change`: shape (M, q), the change of the effect per magnitude of each
    parameter (E in the module docstring, multiplied by the amplitude of the effect); zero if the effect does not act on the
    channel."""

    values: tuple[Array, ...]
    nominal: tuple[Array, ...] = field(repr=False)
    change: tuple[Array, ...] = field(repr=False)


def on_output(effect: Effect) -> Shaped | None:
    """Returns the effect if it acts on the output and is fully determined by its shape; otherwise None."""
    acts = isinstance(effect, ChangesWithinSegments) and effect.acts_on == "output"
    return effect if acts and isinstance(effect, Shaped) else None


def operating_point(
    weighing: Weighing,
    effect: Shaped,
    shape: float,
    taken: Sequence[Array] | None = None,
    amplitude: float = 1.0,
    values: Sequence[Array] | None = None,
) -> OperatingPoint:
    """Computes how an effect on the output changes with the nominal parameters.

    `shape`, `amplitude`: shape and amplitude of the effect. `taken`: for each channel, the coefficients (M,) that the effect
    causes, or None. If `taken` is given, the nominal parameters are fitted together with the effect; otherwise, they are fitted
    without the effect. `values`: for each channel, nominal parameters (q,) near the result, None if they are not known.
    """
    if values is not None:
        values = settled(weighing, effect, shape, values, amplitude, _WIDTHS[-1:])
    else:
        values = weighing.nominal_values(taken)
        if taken is not None:
            values = settled(weighing, effect, shape, values, amplitude)
    change = _changes(weighing, effect, shape, weighing.seen(values), amplitude, _steps(weighing))
    return OperatingPoint(tuple(values), tuple(weighing.whole), tuple(change))


def moving(
    weighing: Weighing, effect: Shaped, shape: float, values: Sequence[Array], columns: Sequence[Column]
) -> Weighing:
    """Returns a copy of `weighing` that includes, to first order, the change of an effect on the output with the nominal
    parameters. The shape of the effect is then found together with these parameters and with the amplitudes of other effects.
    `values`: values of the parameters of each channel. `columns`: columns of the other effects, with samples."""
    seen = weighing.seen(values)
    change = _changes(weighing, effect, shape, seen, 1.0, _steps(weighing))
    return weighing.moving(change, values, passed_on(weighing, effect, shape, seen, columns) if columns else None)


def settled(
    weighing: Weighing,
    effect: Shaped,
    shape: float,
    values: Sequence[Array],
    amplitude: float = 1.0,
    widths: Sequence[float] = _WIDTHS,
) -> list[Array]:
    """Fits the nominal parameters together with an effect on the output. Returns the values (q,) of the parameters of each channel,
    in magnitudes. `shape`, `amplitude`: shape and amplitude of the effect. `values`: values of the nominal parameters at which the
    fit starts. `widths`: steps of the first derivatives, in standard uncertainties of the output.

    Repeated fits to the data minus the effect would converge slowly: in segments with a limited output, these data follow the scale
    factor of the preceding fit. Therefore, the fit includes the change of the effect with the parameters (Gauss–Newton). The first
    derivatives are differences over wide steps (`widths`): within a dead zone, the output is zero, and the exact derivative would
    not show how to leave the dead zone. The steps may also lead away from the best parameters. If the fit does not end with the
    smallest misfit, it is repeated with small steps from the parameters with the smallest misfit, separately in each channel.
    """
    found, steps = list(values), _steps(weighing)
    best = [(np.inf, own) for own in found]  # of each channel, the smallest misfit and its parameters
    for step in (widths, widths[-1:]):
        for number in range(_FITS):
            seen = replace(weighing.observed, fitted=weighing.output_at(found))
            if number < len(step):
                change = _changes(weighing, effect, shape, seen, amplitude, step[number] * steps)
            caused = coefficients_of(weighing.observed, weighing.spectrum, effect.at(seen, shape).columns)
            taken = [raw.sum(axis=1) * amplitude for raw in caused]
            now = [*zip(weighing.misfits(found, taken), found, strict=True)]
            best = [min(pair, key=lambda one: one[0]) for pair in zip(best, now, strict=True)]
            if not all(misfit <= _LOST * least for (misfit, _), (least, _) in zip(now, best, strict=True)):
                found = [own for _, own in best]
                continue
            fixed = [part - own @ at for part, own, at in zip(taken, change, found, strict=True)]
            before, found = found, weighing.nominal_values(fixed, change)
            moved = [
                own[0].whiten(whole @ (new - old)[:, None])
                for own, whole, new, old in zip(weighing.weights, weighing.whole, found, before, strict=True)
            ]
            if number >= len(step) - 1 and max(float((part**2).sum()) for part in moved) < _STILL**2:
                break
        if all(least >= misfit - _STILL**2 for (least, _), (misfit, _) in zip(best, now, strict=True)):
            break
        found = [own for _, own in best]
    return [own for _, own in best]


def _changes(
    weighing: Weighing, effect: Shaped, shape: float, seen: Observed, amplitude: float, step: Array
) -> list[Array]:
    """Returns, for each channel, the change (M, q) of the effect per magnitude of each nominal parameter. An effect on the output
    is a function of the nominal output alone, so its derivative follows from the chain rule: it is the derivative of the effect
    with respect to the nominal output, multiplied by the derivative of the nominal output with respect to the parameter. The other
    arguments are those of `_slopes`."""
    change = [np.zeros_like(whole) for whole in weighing.whole]
    for channel, slope in _slopes(effect, shape, seen, step).items():
        samples = slope[:, None] * weighing.samples_of(channel)
        acting = np.logical_or.reduceat(slope != 0, weighing.observed.bounds[:-1])
        change[channel] = weighing.spectrum.project(weighing.observed, samples, acting) * amplitude
    return change


def _slopes(effect: Shaped, shape: float, seen: Observed, step: Array) -> dict[int, Array]:
    """Returns the derivative (N,) of the effect with respect to the nominal output, for each channel in which it is not zero. `seen`:
    the recording with the nominal output. `step`: array of shape (N, K), step of the nominal output over which the effect is
    differentiated."""
    output, found = seen.nominal_output, dict[int, Array]()
    (more,), (less,) = (effect.at(seen.with_model(fitted=output + sign * step), shape).columns for sign in (1.0, -1.0))
    for channel in sorted(more.parts.keys() & less.parts.keys()):
        rise, run = more.parts[channel] - less.parts[channel], 2 * step[:, channel]
        slope = np.divide(rise, run, out=np.zeros(len(run)), where=run > 0)
        slope[np.abs(1 + slope) < _ROUNDING] = -1.0
        if slope.any():
            found[channel] = slope
    return found


def passed_on(
    weighing: Weighing, effect: Shaped, shape: float, seen: Observed, columns: Sequence[Column]
) -> list[Array]:
    """Computes how an effect on the output changes the other effects in this output. For example, the other effects do not appear
    while the output is at a limit. Returns, for each channel, the coefficients (M, P) of `columns`, multiplied by the derivative of
    the output with respect to its nominal value. `seen`: the recording with the nominal output, which contains the other effects.
    `shape`: shape of the effect on the output."""
    slopes = _slopes(effect, shape, seen, _steps(weighing))
    passed = [
        replace(
            column,
            parts={c: part * (1 + slopes[c]) if c in slopes else part for c, part in column.parts.items()},
        )
        for column in columns
    ]
    return coefficients_of(weighing.observed, weighing.spectrum, passed)


def _steps(weighing: Weighing) -> Array:
    """Returns the standard uncertainty (N, K) of each nominal output. It follows from the standard uncertainties of the nominal
    parameters."""
    channels = range(len(weighing.whole))
    return np.column_stack(
        [np.sqrt(weighing.samples_of(channel) ** 2 @ _uncertainty(weighing, channel) ** 2) for channel in channels]
    )


def _uncertainty(weighing: Weighing, channel: int) -> Array:
    """Returns the standard uncertainties (q,) of the nominal parameters of a channel, in units of their magnitudes. The uncertainty
    of each parameter is computed with the other parameters fixed; it is 0 for a parameter that the recording does not determine."""
    energy = (weighing.weights[channel][0].whiten(weighing.whole[channel]) ** 2).sum(axis=0)
    return np.where(energy > 0, 1 / np.sqrt(np.maximum(energy, 1e-300)), 0.0)

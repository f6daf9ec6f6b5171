"""Measures the closure: the relative reduction of the gap by an effect. The gap is the difference between a recording and its
simulation. The closure is measured in held-out segments, which were not used to choose or fit the effect.

Segments are held out in groups. Each group contains segments of every kind of motion, and for each group the effect is chosen and
fitted again with the other segments only. The difference d between the predictions with and without the effect is then known
exactly. The gap g is not known exactly, because the data contain noise. The size of the gap is |g| without the effect, and |g − d|
with it. The result is an average over the following two cases, weighted by their probabilities in the diagnosis.

- An effect or a set of effects from the catalogue (the collection of known effects) is the whole cause. Then g is the signature of
  this cause, that is, its change of the outputs. The amplitudes of the signature are estimated from all segments. The errors of the
  amplitudes have the covariance that follows from the noise.
- Something else acts, additionally or alone. Let r = g + noise be the residual of the nominal simulation in the held-out segments.
  It is whitened: after this transformation, its errors are independent and have unit variance. These errors include the uncertainty
  of the fitted nominal parameters. The component of g along d is then known with a standard deviation of 1. The size of the other
  component follows from a non-central χ² (its confidence distribution: Schweder and Hjort, Confidence, Likelihood, Probability,
  2016).

Both cases need the level of the noise. The declared slow noise may be wrong by any factor, but the evidence considers only three
levels: half the declared level, the declared level, and twice the declared level. The level is therefore measured from the
residuals after the fit of the most probable effects. It is measured separately for gyros and accelerometers, and separately for the
segment means and the changes within segments. A level from few residuals is uncertain. Therefore, the errors are assumed to have
Student's t distribution with the degrees of freedom of these residuals. The level of flicker relative to the other noise is
measured from the same residuals. This level is important because flicker is correlated between segments. Flicker hides slow
effects, but it cancels in the differences between neighbouring segments, which show fast effects.

In array shapes, M is the number of coefficients of a channel, K is the number of channels, S is the number of segments, G is the
number of settings of the noise, and p is the number of columns of a choice (an effect or a set of effects). The number of selected
coefficients, such as the held-out coefficients of all channels, is m.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import Effect
from planrunner.gap.evidence.bayes_factors import best_amplitudes, best_scales, log_bayes_factors
from planrunner.gap.evidence.weighing import DEPENDENT, WALKS, ChannelWeights
from planrunner.gap.hypotheses.candidates import ABSORBED, Candidate, Weighed, Weighing, joined
from planrunner.gap.hypotheses.forms import OnOthers, OperatingPoint, on_output, operating_point

FOLDS = 4
FEWEST = 6  # smallest number of segments; three quarters of fewer segments contain too little information
DRAWS = 2000
LEVELS = 40  # number of random noise levels, among which the draws for an unknown composition are divided
SEED = 21
WIDEST = 0.5  # largest width of the interval of a resolvable closure
TOLD = 0.5
"""Smallest fraction t of an effect's energy in the held-out segments that the other segments must determine. If they determine
less, the closure is not measured. Even if the effect is the whole cause, it shrinks the gap of the held-out segments only by 1 −
√(1 − t), which is 0.29 at this limit. With a smaller t, the closure would describe the plan, not the effect."""
KINDS = ("gyro", "accel")
FLICKER_LEVELS = (0.0, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0)  # relative to the declared level
EXCESS = 0.01  # p-value below which noise alone does not explain the residuals of a group
SMALLEST = 1e-4  # smallest measured variance of the noise, relative to the variance of the model
WALKED = 0.1
"""Smallest fraction of the gyros' squared residuals within segments that must remain after the expected energy of a random walk has
been subtracted. If less remains, these residuals do not show the level of the noise."""
SHAPES = 6  # number of shapes of an effect besides the best one
UNLIKELY = 8.0
"""If the log probability of a shape is lower than that of the most probable shape by more than this value [nats], the shape is
omitted. Together, n such shapes have a probability of less than n·exp(−8), which is 0.7 % for the 20 shapes of a refined grid."""
WORTH = 4.0  # smallest log Bayes factor with which an effect is selected in a fold


@dataclass(frozen=True, slots=True)
class ChannelClosure:
    """Contains the closure of one channel. `before`, `after`: size of the held-out gap in standard deviations of the noise, root
    mean square over the coefficients. `before_value`, `after_value`: size of this gap in `unit`, root mean square over the samples.
    `shrinks_by`, `interval_90`: the same quantities as in `Closure`, for this channel.
    """

    channel: str
    unit: str
    before: float
    after: float
    before_value: float
    after_value: float
    shrinks_by: float
    interval_90: tuple[float, float]


class NotMeasured(StrEnum):
    """Reasons why there is no closure. NO_EFFECT: no effect is named. RANDOM: the named effects are random processes or act only on
    the noise; the segments that are used for the fit do not determine how such effects act in the held-out segments. FEW_SEGMENTS:
    there are fewer than six segments. NOT_REPEATED: the segments that are used for the fit contain too little information about the
    effect. WIDE: the 90 % interval of the reduction is too wide, or the gap may be zero."""

    NO_EFFECT = "no effect"
    RANDOM = "random"
    FEW_SEGMENTS = "few segments"
    NOT_REPEATED = "not repeated"
    WIDE = "wide"


@dataclass(frozen=True, slots=True)
class Repetition:
    """States the expected reduction of the gap in a repetition of the same segments, if the effects are fitted to all segments.
    `shrinks_by`, `interval_90`: as in `Closure`."""

    shrinks_by: float
    interval_90: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Closure:
    """Contains the result of the check on held-out data. The result shows how much of the gap the named effects explain.

    `before`, `after`: size of the held-out gap without and with the effects, in standard deviations of the noise, root mean square
    over coefficients. `shrinks_by`: relative reduction, 1 for a closed gap. `interval_90`: 90 % interval of `shrinks_by`. `reason`:
    why the data do not determine the reduction (all numbers are then NaN), or None. `channels`: one entry for each channel whose
    data determine the reduction. `unpredicted`: named effects that cannot be predicted in the held-out segments from the other
    segments; their part of the gap remains. `repetition`: if the reason is `NOT_REPEATED`, the reduction in a repetition of the
    same segments, or None if the data do not determine it.
    """

    before: float
    after: float
    shrinks_by: float
    interval_90: tuple[float, float]
    reason: NotMeasured | None = None
    channels: tuple[ChannelClosure, ...] = ()
    unpredicted: tuple[str, ...] = ()
    repetition: Repetition | None = None

    @property
    def resolvable(self) -> bool:
        return self.reason is None


def not_measured(reason: NotMeasured) -> Closure:
    return Closure(np.nan, np.nan, np.nan, (np.nan, np.nan), reason)


@dataclass(frozen=True, slots=True)
class FoldChoice:
    """Describes a form of an effect, or of a set of effects, that can be chosen in a fold. A fold is a group of held-out segments.
    A form is an effect at one value of its shape, such as a time constant.

    `effect`: name of the effect or set. `raw`: for each channel, the coefficients (M, p) that the p columns of the form cause, not
    whitened; the amplitude of each column equals its prior scale. `widths`: number of columns of each effect. `probability`:
    probability that this form is the whole cause. `prior`: log prior probability of this form among the forms of the same effect,
    up to a constant. `fixed`: indices of the columns whose amplitude is 1 for physical reasons; these amplitudes are not fitted.
    `point`: for an effect on the output of the sensor, such as a dead zone, the dependence of the effect on the nominal parameters;
    otherwise None.
    """

    effect: str
    raw: tuple[Array, ...] = field(repr=False)
    widths: tuple[int, ...]
    probability: float
    prior: float = 0.0
    fixed: tuple[int, ...] = ()
    point: OperatingPoint | None = field(default=None, repr=False)

    @property
    def free(self) -> list[int]:
        """Returns the indices of the columns whose amplitudes are fitted."""
        return [column for column in range(sum(self.widths)) if column not in self.fixed]

    def amplitudes(self, gram: Array, score: Array) -> tuple[Array, Array]:
        """Computes the mean (p,) and the covariance (p, p) of the amplitudes from their information matrix `gram` (p, p) and their
        score vector `score` (p,)."""
        return best_amplitudes(gram, score, self.widths, self.fixed)

    def log_bayes(self, gram: Array, score: Array) -> float:
        """Computes the log Bayes factor of the choice from the information matrix `gram` (p, p) and the score vector `score` (p,)
        of its amplitudes."""
        return float(log_bayes_factors(gram, score, fixed=self.fixed))


@dataclass(frozen=True)
class MeasuredNoise:
    """The measured noise of the coefficients.

    `weights`: weights that whiten the coefficients of each channel, at the most probable level of flicker. `scale`: for each
    channel, an array (M,), the measured standard deviation of the whitened coefficients; 1 if `weights` are right. `group`: for
    each channel, an array (M,), the index of the noise group of each coefficient. A noise group contains the segment means of one
    triad, or the changes within the segments of one triad. `degrees`: array of shape (groups,), degrees of freedom of the measured
    level of each group. `limits`: array of shape (groups,), True if the level is only an upper limit, because the residuals contain
    a part of the gap and exceed the noise of the model.
    """

    weights: tuple[ChannelWeights, ...] = field(repr=False)
    scale: tuple[Array, ...] = field(repr=False)
    group: tuple[NDArray[np.int64], ...] = field(repr=False)
    degrees: Array
    limits: NDArray[np.bool_]


@dataclass(frozen=True)
class NoiseLevels:
    """Describes how well the noise levels of m residuals are known.

    `group`: array of shape (m,), noise group of each residual. `degrees`, `limits`: arrays of shape (groups,), as in
    `MeasuredNoise`."""

    group: NDArray[np.int64] = field(repr=False)
    degrees: Array
    limits: NDArray[np.bool_]

    def drawn(self, draw: np.random.Generator) -> Array:
        """Draws random variances (`LEVELS`, m) of the noise of each residual, relative to the measured variance: ν/χ², where χ² has
        ν degrees of freedom. If the measured variance is only an upper limit, the variance is drawn uniformly between 0 and this
        limit."""
        variances = self.degrees / draw.chisquare(self.degrees, (LEVELS, len(self.degrees)))
        share = draw.uniform(size=(LEVELS, 1))
        return np.where(self.limits, share, variances)[:, self.group]


@dataclass(frozen=True)
class Amplitudes:
    """Contains the amplitudes that are fitted to all segments. `mean`: array of shape (p,), mean of the amplitudes. `roots`: array
    of shape (groups + 1, p, p), square roots of the parts of the covariance: one part for each noise group, and a last part for the
    prior. `degrees`: array of shape (groups + 1,), degrees of freedom of each part, as in `MeasuredNoise`; infinite for the prior."""

    mean: Array
    roots: Array = field(repr=False)
    degrees: Array

    def drawn(self, count: int, draw: np.random.Generator) -> Array:
        """Draws `count` random values of the amplitudes, shape (count, p). The errors that a noise group (see `MeasuredNoise`)
        causes have Student's t distribution, because the noise level of the group is itself measured."""
        out = np.tile(self.mean, (count, 1))
        for root, degrees in zip(self.roots, self.degrees, strict=True):
            larger = np.sqrt(degrees / draw.chisquare(degrees, (count, 1))) if np.isfinite(degrees) else 1.0
            out += larger * (draw.standard_normal((count, len(self.mean))) @ root.T)
        return out


@dataclass(frozen=True)
class KnownCause:
    """Describes a cause from the catalogue. Let d be the difference between the predictions with and without the chosen effect.
    `gram`: array of shape (p, p), inner products between the signatures of the cause in the held-out segments. `along`: array of
    shape (p,), inner products between these signatures and d."""

    probability: float
    gram: Array = field(repr=False)
    along: Array = field(repr=False)
    amplitudes: Amplitudes = field(repr=False)


@dataclass(frozen=True)
class _Fold:
    """Contains the held-out coefficients (rows) of one fold, which is a group of segments.

    `channel`, `group`: arrays of shape (m,), channel and noise group (as in `MeasuredNoise`) of each row. `residual`: array of
    shape (m,), whitened residuals of the nominal simulation. `difference`: array of shape (m,), whitened change of the prediction
    by the chosen effect. `signatures`: one array (m, p) for each choice. `told`: one information matrix (p, p) for each choice. The
    matrix shows how well the other segments determine the amplitudes of the choice.
    """

    channel: NDArray[np.int64]
    group: NDArray[np.int64]
    residual: Array
    difference: Array
    signatures: list[Array]
    told: list[Array]


def choices_of(
    weighing: Weighing,
    effect: str,
    members: Sequence[tuple[Weighed, Candidate]],
    probability: float,
    acting: tuple[int, OnOthers] | None = None,
) -> list[FoldChoice]:
    """Returns the choices for an effect or a set of effects. The first choice has the best form of each effect. In every other
    choice, one effect has another probable form instead of its best one. `members`: for each effect, its best form, and the
    candidate with all forms of this effect. `acting`: an effect on the output that also changes the other effects (for example a
    limit of the output), and its index among the members; None if there is no such effect."""
    best = [form for form, _ in members]
    varied = [(best, 0.0)]
    for number, (form, candidate) in enumerate(members):
        others = _probable_shapes(form, candidate) if acting is None else []
        varied += [([*best[:number], other, *best[number + 1 :]], prior) for other, prior in others]
    whole = joined(best)
    shares = [1 / len(varied)] * len(varied)
    point = _operating_point(weighing, members) if acting is None else acting[1].point
    if acting is not None:
        varied = [([*best[: acting[0]], form, *best[acting[0] + 1 :]], 0.0) for form, _ in acting[1].forms]
        shares = [share for _, share in acting[1].forms]
    return [
        FoldChoice(
            effect,
            tuple(_compact(np.hstack(blocks)) for blocks in zip(*(form.raw for form in forms), strict=True)),
            whole.widths,
            probability * share,
            prior,
            whole.fixed,
            point,
        )
        for (forms, prior), share in zip(varied, shares, strict=True)
    ]


def _compact(columns: Array) -> Array:
    """Returns columns (M, p) unchanged, or an array of the same shape that needs no memory if all of them are zero. Many effects
    act only on the gyros, or only on the accelerometers."""
    return columns if columns.any() else np.broadcast_to(0.0, columns.shape)


def whole_choices(
    weighing: Weighing, name: str, effect: Effect, forms: Sequence[tuple[Weighed, float]], probability: float
) -> list[FoldChoice]:
    """Returns the choices for an effect that is fully determined by its shape. `forms`: the forms of the effect, all with the
    amplitude 1, and their probabilities."""
    shown = [(form, share) for form, share in forms if form.trace > 0]
    acting, point = on_output(effect), None
    if acting is not None and shown:
        likeliest, _ = max(shown, key=lambda one: one[1])
        shape = float(likeliest.variant.shape or 0.0)
        point = operating_point(weighing, acting, shape, [raw[:, 0] for raw in likeliest.raw])
    return [FoldChoice(name, form.raw, (1,), probability * share, fixed=(0,), point=point) for form, share in shown]


def _operating_point(weighing: Weighing, members: Sequence[tuple[Weighed, Candidate]]) -> OperatingPoint | None:
    """Returns the operating point of the first effect among `members` that acts on the output of the sensor; None if there is no
    such effect. The operating point is the set of nominal parameters about which the effect is linearised."""
    for number, (form, candidate) in enumerate(members):
        effect = on_output(candidate.effect)
        if effect is None:
            continue
        whole = weighing.together([form for form, _ in members])
        amplitude = float(whole.amplitudes[0][sum(whole.variant.widths[:number])])
        taken = [raw[:, 0] for raw in candidate.best.raw] if candidate.settled else None
        return operating_point(weighing, effect, float(form.variant.shape or 0.0), taken, amplitude)
    return None


def _probable_shapes(best: Weighed, candidate: Candidate) -> list[tuple[Weighed, float]]:
    """Returns at most `SHAPES` forms of an effect with other shapes than the best one, each with its log prior probability relative
    to `best`. The prior is uniform in the logarithm of the shape, so the weight of a form is proportional to the logarithmic
    distance between the shapes on either side of it."""
    known = {
        form.variant.shape: form for form in candidate.variants if form.trace > 0 and form.variant.shape is not None
    }
    if best.variant.shape is None or len(known) < 2:
        return []
    known[best.variant.shape] = best
    shapes = np.array(sorted(known))
    width = dict(zip(shapes.tolist(), np.gradient(np.log(shapes)).tolist(), strict=True))
    evidence = {shape: float(known[shape].log_bayes[candidate.at]) + np.log(width[shape]) for shape in width}
    likely = sorted((shape for shape in width if shape != best.variant.shape), key=lambda shape: -evidence[shape])
    worth = max(evidence.values()) - UNLIKELY
    return [
        (known[shape], float(np.log(width[shape] / width[best.variant.shape])))
        for shape in likely[:SHAPES]
        if evidence[shape] > worth
    ]


def closure(
    weighing: Weighing, noise: MeasuredNoise, choices: Sequence[FoldChoice], beyond: float, named: str
) -> Closure:
    """Computes the closure. `choices`: the effects and sets of effects from which each fold chooses one. `beyond`: probability
    that none of `choices` is the whole cause. `named`: the effect or set of the verdict, which is one of `choices`."""
    if not choices:
        return not_measured(NotMeasured.NO_EFFECT)
    if len(weighing.observed) < FEWEST:
        return not_measured(NotMeasured.FEW_SEGMENTS)
    folds = [_fold(weighing, noise, choices, held) for held in held_out(weighing)]
    fits = _fits(weighing, noise, choices)
    shares = _shares(choices, fits)
    likeliest = int(np.argmax(shares)) if shares.any() else len(choices) - 1
    (alone,) = _fits(weighing, noise, [replace(choices[likeliest], point=None)])
    if _told(choices[likeliest].widths, alone, likeliest, folds) < TOLD:
        return replace(
            not_measured(NotMeasured.NOT_REPEATED),
            repetition=_repetition(weighing, noise, choices, [fit.amplitudes for fit in fits], shares, beyond, named),
        )
    amplitudes = [fit.amplitudes for fit in fits]
    every = [np.ones(len(fold.channel), dtype=bool) for fold in folds]
    whole = _measured_rows(folds, every, amplitudes, shares, beyond, noise)
    if not whole.resolvable:
        return whole
    channels = []
    for index in range(len(weighing.weights)):
        rows = [fold.channel == index for fold in folds]
        own = _measured_rows(folds, rows, amplitudes, shares, beyond, noise)
        if own.resolvable:
            residual = np.concatenate([fold.residual[at] for fold, at in zip(folds, rows, strict=True)])
            channels.append(_in_unit(weighing, noise, index, own, residual))
    return replace(whole, channels=tuple(channels))


def _repetition(
    weighing: Weighing,
    noise: MeasuredNoise,
    choices: Sequence[FoldChoice],
    amplitudes: Sequence[Amplitudes],
    shares: Array,
    beyond: float,
    named: str,
) -> Repetition | None:
    """Returns the expected reduction of the gap in a repetition of the same segments, in which only the noise differs. The most
    probable form of the named effect or set is fitted to all segments. The nominal parameters are fitted to each repetition. The
    result is None if the data do not determine the reduction.

    `amplitudes`: the amplitudes of each choice. `shares`: array of shape (choices,), probability that each choice is the whole
    cause. `beyond`: probability that none of the choices is the whole cause. `named`: the effect or set of the verdict.
    """
    fits = _fits(weighing, noise, [replace(choice, point=None) for choice in choices])
    own = np.array([choice.effect == named for choice in choices])
    ranks = shares if shares[own].any() else np.array([fit.log_bayes for fit in fits])
    likeliest = int(np.argmax(np.where(own, ranks, -np.inf)))
    signatures = [np.concatenate(fit.columns) for fit in fits]
    moving = [_projected_change(fit, choice) for fit, choice in zip(fits, choices, strict=True)]
    difference = signatures[likeliest] @ fits[likeliest].amplitudes.mean
    known = []
    for one, more, fitted, share in zip(signatures, moving, amplitudes, shares, strict=True):
        signature = np.hstack([one, more])
        known.append(KnownCause(float(share), signature.T @ signature, signature.T @ difference, fitted))
    residual = np.concatenate([rows.residual for rows in fits[likeliest].rows])
    levels = NoiseLevels(np.concatenate(noise.group), noise.degrees, noise.limits)
    fitted_too = sum(rows.basis.shape[1] for rows in fits[likeliest].rows) + signatures[likeliest].shape[1] - 1
    found = measured(residual, difference, known, beyond, levels, fitted_too)
    return Repetition(found.shrinks_by, found.interval_90) if found.resolvable else None


def _projected_change(fit: _Fit, choice: FoldChoice) -> Array:
    """For an effect on the output, returns the derivative of its whitened signature with respect to each nominal parameter, over
    all channels, shape (m, q). For other effects, the result has no columns."""
    from scipy.linalg import block_diag

    changes = [] if choice.point is None else choice.point.change
    blocks = [
        rows.project(change if change.any() else change[:, :0]) for rows, change in zip(fit.rows, changes, strict=False)
    ]
    return np.asarray(block_diag(*blocks)) if blocks else np.zeros((sum(len(rows.residual) for rows in fit.rows), 0))


def measured_noise(
    weighing: Weighing, choice: FoldChoice, log_bayes: Array, walking: bool, explained: bool
) -> MeasuredNoise:
    """Measures the noise that remains after the fit of an effect.

    `log_bayes`: array of shape (G,), log Bayes factor of the effect at each setting of the noise, that is, for each combination of
    levels of flicker and random walk. `walking`: True if a random walk of the gyros acts in addition; the random walk belongs to
    the gap, not to the noise. `explained`: True if only noise remains after the fit of the effect. If False, the residuals contain
    a part of the gap, so the measured noise is limited to the noise of the model. A level at this limit shows only that the noise
    is not larger than the limit. If a random walk acts, the segment means contain it too, so their level is only an upper limit.
    The changes within the segments contain a small part of the random walk; the expected energy of this part is subtracted.
    """
    gyro, accel = divmod(weighing.likeliest_with(log_bayes, walking), weighing.shape[1])
    flicker = weighing.settings["gyro"][gyro].flicker
    still = next(k for k, one in enumerate(weighing.settings["gyro"]) if one.flicker == flicker and one.walk == 0)
    channels = weighing.observed.channels
    weights = [
        own[{"gyro": still, "accel": accel}[channel.kind]]
        for own, channel in zip(weighing.weights, channels, strict=True)
    ]
    within = (weighing.spectrum.frequency > 0).astype(np.int64)
    group = tuple(2 * KINDS.index(channel.kind) + within for channel in channels)
    if explained and not walking:
        for kind in KINDS:
            weights = _with_measured_flicker(weighing, choice, weights, group, kind)
    left = _left(weighing, choice, weights, group)
    means = 2 * KINDS.index("gyro")
    only_limit = np.arange(len(left.degrees)) == means
    if walking:
        left, known = _without_walk(weighing, left, log_bayes, weights, group, means)
        only_limit[means + 1] = not known
    from scipy.stats import chi2

    excess = chi2.sf(left.ratio * left.degrees, left.degrees) < EXCESS
    limits = (excess | (walking & only_limit)) & (not explained)
    scale = np.sqrt(np.maximum(np.where(limits, np.minimum(left.ratio, 1.0), left.ratio), SMALLEST))
    return MeasuredNoise(tuple(weights), tuple(scale[own] for own in group), group, left.degrees, limits)


def _without_walk(
    weighing: Weighing,
    left: _Left,
    log_bayes: Array,
    weights: Sequence[ChannelWeights],
    group: tuple[NDArray[np.int64], ...],
    means: int,
) -> tuple[_Left, bool]:
    """Subtracts the expected energy of a random walk of the gyros from the residuals within the segments. The degrees of freedom of
    the noise decrease, because the level of the random walk is uncertain. Part of this uncertainty is due to the distance between
    the evaluated levels (`WALKS`): the true level may lie anywhere between two neighbouring levels. If the random walk may explain
    almost all of these residuals, the residuals do not show the level of the noise. They are then unchanged, and the second result
    is False. `log_bayes`: the same as in `measured_noise`. `means`: the noise group of the means of the gyros."""
    terms = np.logaddexp.reduce((weighing.base + weighing.log_prior[1] + log_bayes).reshape(weighing.shape), axis=1)
    share = np.exp(terms - terms.max())
    gyros = weighing.observed.of_kind("gyro")
    energy = [
        sum(float(weighing.weights[c][k].walk_within @ weights[c].scale ** 2) for c in gyros)
        for k in range(len(weighing.settings["gyro"]))
    ]
    within, share = means + 1, share / share.sum()
    walked = float(share @ energy)
    between = walked * float(np.log(WALKS[1] / WALKS[0])) / np.sqrt(12)
    spread = float(share @ (np.array(energy) - walked) ** 2) + between**2
    spread += 2 * left.squares[within] ** 2 / left.degrees[within]
    squares, degrees, ratio = left.squares.copy(), left.degrees.copy(), left.ratio.copy()
    if squares[within] - walked < WALKED * squares[within]:
        return left, False
    squares[within] -= walked
    ratio[within] = squares[within] / degrees[within]
    degrees[within] = max(2 * squares[within] ** 2 / spread, 1.0)
    return replace(left, squares=squares, degrees=degrees, ratio=ratio), True


@dataclass(frozen=True)
class _Left:
    """The residuals that remain after a choice has been fitted to all segments.

    `squares`: array of shape (groups,), sum of squares of the residuals in each noise group. `degrees`: array of shape (groups,),
    their degrees of freedom. `ratio`: array of shape (groups,), `squares` divided by `degrees`, 1 for a group without residuals.
    `evidence`: restricted log likelihood, up to a constant, with the measured noise level in each group."""

    squares: Array
    degrees: Array
    ratio: Array
    evidence: float


def _left(
    weighing: Weighing, choice: FoldChoice, weights: Sequence[ChannelWeights], group: tuple[NDArray[np.int64], ...]
) -> _Left:
    """Fits a choice to all segments and returns its residuals.

    `group`: the same as in `MeasuredNoise`."""
    count = 2 * len(KINDS)
    one = tuple(np.ones(len(own)) for own in group)
    known = MeasuredNoise(tuple(weights), one, group, np.full(count, np.inf), np.zeros(count, dtype=bool))
    (fit,) = _fits(weighing, known, [choice])
    p = len(fit.score)
    covariance = np.sum([root @ root.T for root in fit.amplitudes.roots], axis=0)[:p, :p]
    squares, degrees = np.zeros(count), np.zeros(count)
    for rows, columns, own in zip(fit.rows, fit.columns, group, strict=True):
        free = 1 - (rows.basis**2).sum(1) - np.einsum("ij,jk,ik->i", columns, covariance, columns)
        np.add.at(squares, own, (rows.residual - columns @ fit.amplitudes.mean[:p]) ** 2)
        np.add.at(degrees, own, free)
    degrees = np.maximum(degrees, 1.0)
    ratio = np.where(degrees > 1, squares / degrees, 1.0)
    evidence = -0.5 * sum(weight.log_det for weight in weights)
    evidence -= 0.5 * float(degrees @ np.log(np.maximum(ratio, SMALLEST)))
    if len(choice.free):
        evidence += 0.5 * float(np.linalg.slogdet(covariance[np.ix_(choice.free, choice.free)])[1])
    return _Left(squares, degrees, ratio, float(evidence))


def _with_measured_flicker(
    weighing: Weighing,
    choice: FoldChoice,
    weights: list[ChannelWeights],
    group: tuple[NDArray[np.int64], ...],
    kind: str,
) -> list[ChannelWeights]:
    """Measures the level of flicker of one triad, and returns the weights of all channels with this level. The square of the level
    is averaged over `FLICKER_LEVELS`, weighted by their restricted likelihood. The weights are unchanged if no flicker is declared.
    `group`: the same as in `MeasuredNoise`."""
    settings = {
        one.flicker: index for index, one in reversed(list(enumerate(weighing.settings[kind]))) if one.walk == 0
    }
    low, high = min(settings), max(settings)
    if low == high:
        return weights

    def at(squared: float) -> list[ChannelWeights]:
        share, out = (squared - low**2) / (high**2 - low**2), list(weights)
        for index in weighing.observed.of_kind(kind):
            own, values = weighing.weights[index], weighing.spectrum.values[:, index]
            out[index] = own[settings[low]].towards(own[settings[high]], share, weighing.nominal[index], values)
        return out

    squared = np.array(FLICKER_LEVELS) ** 2
    evidence = np.array([_left(weighing, choice, at(float(level)), group).evidence for level in squared])
    likely = np.exp(evidence - evidence.max())
    return at(float(squared @ likely / likely.sum()))


@dataclass(frozen=True)
class _Fit:
    """Contains a choice that was fitted to all segments. `gram` (p, p), the information matrix, and `score` (p,), the score vector
    of the amplitudes, are sums over all channels. `rows`, `columns`: for each channel, its whitened coefficients, and the whitened
    columns (M, p) of the choice. `amplitudes`: the amplitudes of the choice. If the choice has an operating point
    (`FoldChoice.point`), `amplitudes` also contains the differences between the nominal parameters and their values at this
    point."""

    gram: Array
    score: Array
    log_bayes: float
    amplitudes: Amplitudes
    rows: list[_Rows]
    columns: list[Array]


def _fits(weighing: Weighing, noise: MeasuredNoise, choices: Sequence[FoldChoice]) -> list[_Fit]:
    every = np.ones(len(weighing.spectrum.segment), dtype=bool)
    points = {id(choice.point): choice.point for choice in choices}
    rows = {
        key: [_Rows(weighing, noise, channel, every, point) for channel in range(len(weighing.weights))]
        for key, point in points.items()
    }
    return [_fit(choice, noise, rows[id(choice.point)]) for choice in choices]


def _fit(choice: FoldChoice, noise: MeasuredNoise, rows: list[_Rows]) -> _Fit:
    columns = [own.project(raw) for own, raw in zip(rows, choice.raw, strict=True)]
    p = columns[0].shape[1]
    point = choice.point
    moving = [point is not None and bool(point.change[c].any()) for c in range(len(rows))]
    sizes = [own.basis.shape[1] if moves else 0 for own, moves in zip(rows, moving, strict=True)]
    ends = p + np.cumsum([0, *sizes])
    grams = np.zeros((len(noise.degrees), ends[-1], ends[-1]))
    for c, (block, group) in enumerate(zip(columns, noise.group, strict=True)):
        at = np.concatenate([np.arange(p), np.arange(ends[c], ends[c + 1])])
        both = np.hstack([block, rows[c].basis]) if moving[c] else block
        for number in np.unique(group):
            own = both[group == number]
            grams[number][np.ix_(at, at)] += own.T @ own
    gram = grams.sum(axis=0)[:p, :p]
    score = np.sum([block.T @ own.residual for block, own in zip(columns, rows, strict=True)], axis=0)
    mean, covariance = choice.amplitudes(gram, score)
    prior = covariance - covariance @ gram @ covariance
    # the errors of amplitudes and nominal parameters, from the scores of the columns and of the nominal basis
    means, along, across = [mean], [np.hstack([covariance, np.zeros((p, ends[-1] - p))])], [np.eye(p)]
    for c, own in enumerate(rows):
        if point is None or not moving[c]:
            continue
        parameters = own.parameters[: len(point.values[c])]
        per_amplitude = parameters @ (own.basis.T @ own.whiten(choice.raw[c]))
        means.append(own.moved(point.values[c]) - per_amplitude @ mean)
        block = np.zeros((len(parameters), ends[-1]))
        block[:, ends[c] : ends[c + 1]] = parameters
        along.append(block - per_amplitude @ along[0])
        across.append(-per_amplitude)
    estimator, per_prior = np.vstack(along), np.vstack(across)
    parts = np.concatenate([estimator @ grams @ estimator.T, (per_prior @ prior @ per_prior.T)[None]])
    values, vectors = np.linalg.eigh((parts + np.swapaxes(parts, 1, 2)) / 2)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    amplitudes = Amplitudes(np.concatenate(means), roots, np.append(noise.degrees, np.inf))
    return _Fit(gram, score, choice.log_bayes(gram, score), amplitudes, rows, columns)


def _shares(choices: Sequence[FoldChoice], fits: Sequence[_Fit]) -> Array:
    """Returns the probability that each choice is the whole cause, shape (choices,). The probability of each effect is divided anew
    among its forms, according to their evidence at the measured noise."""
    shares = np.array([choice.probability for choice in choices])
    for effect in {choice.effect for choice in choices if choice.probability > 0}:
        own = np.array([choice.effect == effect for choice in choices]) & (shares > 0)
        evidence = np.array([fit.log_bayes + choice.prior for fit, choice in zip(fits, choices, strict=True)])[own]
        likely = np.exp(evidence - evidence.max())
        shares[own] = shares[own].sum() * likely / likely.sum()
    return shares


def _measured_rows(
    folds: Sequence[_Fold],
    rows: Sequence[NDArray[np.bool_]],
    amplitudes: Sequence[Amplitudes],
    shares: Array,
    beyond: float,
    noise: MeasuredNoise,
) -> Closure:
    """Returns the closure computed from the selected `rows` of every fold. `rows`: for each fold, a mask of its held-out
    coefficients. `amplitudes`, `shares`, `beyond`: the same as in `_repetition`."""
    chosen = list(zip(folds, rows, strict=True))
    difference = np.concatenate([fold.difference[at] for fold, at in chosen])
    known = []
    for number, (fitted, share) in enumerate(zip(amplitudes, shares, strict=True)):
        signature = np.concatenate([fold.signatures[number][at] for fold, at in chosen])
        known.append(KnownCause(float(share), signature.T @ signature, signature.T @ difference, fitted))
    residual = np.concatenate([fold.residual[at] for fold, at in chosen])
    group = np.concatenate([fold.group[at] for fold, at in chosen])
    return measured(residual, difference, known, beyond, NoiseLevels(group, noise.degrees, noise.limits))


def _in_unit(weighing: Weighing, noise: MeasuredNoise, index: int, own: Closure, residual: Array) -> ChannelClosure:
    """Returns the closure of the channel with the index `index`, with the sizes of the gap also in the channel's unit. A size in
    standard deviations is converted with the root mean square of the noise of the coefficients. `own`: the closure of the channel.
    `residual`: array of shape (m,), the channel's held-out residuals in all folds; only their number is used."""
    channel, weight = weighing.observed.channels[index], noise.weights[index]
    sigma = float(np.sqrt(np.mean(weight.variances * noise.scale[index] ** 2)))
    size = sigma * float(np.sqrt(len(residual) / weighing.observed.counts.sum())) / channel.factor
    return ChannelClosure(
        channel.name,
        channel.unit,
        own.before,
        own.after,
        own.before * size,
        own.after * size,
        own.shrinks_by,
        own.interval_90,
    )


def predictions(
    weighing: Weighing, noise: MeasuredNoise, choices: Sequence[FoldChoice], change: Array, worth: float = WORTH
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Computes the gap g that a known change causes in the held-out segments, and its prediction d, each of shape (m,). Also
    returns the channel of every row. `change`: array of shape (M, K), coefficients of the known change in the outputs. The function
    is used in tests in which the true gap is known. `worth`: the log Bayes factor that a choice must reach to be selected in a
    fold."""
    gap, difference, channels = [], [], []
    for held in held_out(weighing):
        rows = [_Rows(weighing, noise, channel, ~held) for channel in range(len(weighing.weights))]
        known = [one.predict(change[:, [channel]], held)[1][:, 0] for channel, one in enumerate(rows)]
        gap.append(np.concatenate(known))
        fold = _fold(weighing, noise, choices, held, worth)
        difference.append(fold.difference)
        channels.append(fold.channel)
    return np.concatenate(gap), np.concatenate(difference), np.concatenate(channels)


def held_out(weighing: Weighing) -> list[NDArray[np.bool_]]:
    """Returns, for each fold (group of held-out segments), a mask of shape (M,) that is True for the coefficients that are held
    out."""
    dealt = dealt_by_motion([type(motion).__name__ for motion in weighing.observed.motions])
    return [(dealt == fold)[weighing.spectrum.segment] for fold in range(FOLDS)]


def dealt_by_motion(kinds: Sequence[str]) -> NDArray[np.int64]:
    """Returns the number of the fold to which each segment belongs, shape (S,). The segments of one kind of motion are distributed
    over the folds in turn; each new round starts one fold later. Many plans are periodic: without this shift, one fold could
    contain all segments of one orientation."""
    order = np.argsort(np.unique(kinds, return_inverse=True)[1], kind="stable")
    place = np.arange(len(kinds))
    dealt = np.empty(len(kinds), dtype=np.int64)
    dealt[order] = (place + place // FOLDS) % FOLDS
    return dealt


def _told(widths: tuple[int, ...], fit: _Fit, number: int, folds: Sequence[_Fold]) -> float:
    """Returns the fraction of an effect's energy in the held-out segments that the other segments determine. The amplitudes are
    assumed to have the estimated size. The fraction is 0 if only one segment shows the effect. `widths`: number of columns of each
    effect of the choice. `number`: index of the choice."""
    size = best_scales(fit.gram, fit.score, widths)
    shown = left = 0.0
    for fold in folds:
        own = fold.signatures[number][:, : len(size)]
        gram = own.T @ own
        unknown = np.linalg.inv(fold.told[number] + np.diag(1 / size))
        shown += float(np.diag(gram) @ size)
        left += float(np.sum(gram * unknown))
    return 1 - left / shown if shown > 0 else 0.0


def measured(
    residual: Array,
    difference: Array,
    known: Sequence[KnownCause] = (),
    beyond: float = 1.0,
    levels: NoiseLevels | None = None,
    fitted: int = 0,
) -> Closure:
    """Computes the closure from whitened held-out residuals (m,) and the known difference of the predictions (m,). `beyond`: the
    probability that the cause is none of `known`. `beyond` and the probabilities of `known` are used only in proportion to each
    other; their sum need not be 1. `levels`: how well the noise levels of the residuals are known; None if they are known exactly.
    `fitted`: number of parameters that were fitted to the residuals themselves."""
    m = len(residual)
    if float(np.linalg.norm(difference)) < 1e-9 or m < 3:
        return not_measured(NotMeasured.WIDE)
    draw = np.random.default_rng(SEED)
    share = np.array([beyond, *(one.probability for one in known)])
    counts = np.diff(np.round(DRAWS * np.concatenate(([0.0], np.cumsum(share))) / share.sum()).astype(int))
    variances = np.ones((1, m)) if levels is None else levels.drawn(draw)
    dealt = np.diff(np.round(np.linspace(0, counts[0], len(variances) + 1)).astype(int))
    drawn = [
        _unknown(residual, difference, one, int(n), draw, fitted) for one, n in zip(variances, dealt, strict=True) if n
    ]
    drawn += [
        _explained(one, float(difference @ difference), int(n), draw) for one, n in zip(known, counts[1:], strict=True)
    ]
    before, after = np.sqrt(np.maximum(np.concatenate(drawn), 0.0)).T
    if float(np.quantile(before, 0.05)) < 1e-9:  # no relative reduction of a gap that may be zero
        return not_measured(NotMeasured.WIDE)
    shrink = 1 - after / np.maximum(before, 1e-9)
    low, middle, high = (float(value) for value in np.quantile(shrink, [0.05, 0.5, 0.95]))
    if high - low > WIDEST:
        return not_measured(NotMeasured.WIDE)
    scale = np.sqrt(m)
    return Closure(float(np.median(before)) / scale, float(np.median(after)) / scale, middle, (low, high))


def _unknown(
    residual: Array, difference: Array, level: Array, count: int, draw: np.random.Generator, fitted: int = 0
) -> Array:
    """Draws random values (count, 2) of the squared size of a gap of unknown composition. The first column is the size without the
    chosen effect; the second column is the size with it. `level`: array of shape (m,), variance of the noise of each residual; for
    the part of the gap orthogonal to `difference`, the mean of `level` is used. `count`: number of draws. `fitted`: number of
    parameters that were fitted to the residuals."""
    from scipy.special import chndtr

    m, size = max(len(residual) - fitted, 2), float(np.linalg.norm(difference))
    along = float(residual @ difference) / size
    mean = float(np.mean(level))
    rest = (float(residual @ residual) - along**2) / mean
    parallel = along + draw.standard_normal(count) * float(np.sqrt(difference**2 @ level)) / size
    top = max(rest - m, 0.0) + 8 * np.sqrt(2 * m + 4 * max(rest - m, 0.0)) + 10
    grid = np.concatenate(([0.0], np.geomspace(1e-3, top, 400)))
    chance = 1 - chndtr(rest, m - 1, grid)
    across = mean * np.interp(draw.uniform(size=count), np.maximum.accumulate(chance), grid)
    return np.column_stack([parallel**2 + across, (parallel - size) ** 2 + across])


def _explained(cause: KnownCause, squared: float, count: int, draw: np.random.Generator) -> Array:
    """Draws random values (count, 2) of the squared size of a gap whose whole cause is known. The first column is the size without
    the chosen effect; the second column is the size with it. `squared`: |d|², squared size of the difference between the
    predictions with and without the chosen effect."""
    amplitudes = cause.amplitudes.drawn(count, draw)
    before = np.einsum("ni,ij,nj->n", amplitudes, cause.gram, amplitudes)
    return np.column_stack([before, before - 2 * amplitudes @ cause.along + squared])


def _fold(
    weighing: Weighing,
    noise: MeasuredNoise,
    choices: Sequence[FoldChoice],
    held: NDArray[np.bool_],
    worth: float = WORTH,
) -> _Fold:
    """Returns the held-out rows of all channels in one fold. The effect is chosen from the other rows. `held`: array of shape (M,),
    True for the held-out coefficients. `worth`: the log Bayes factor that a choice must reach to be selected; if none reaches it,
    the predicted change is zero."""
    used = [_Rows(weighing, noise, channel, ~held) for channel in range(len(weighing.weights))]
    bounds = np.concatenate(([0], np.cumsum([choice.raw[0].shape[1] for choice in choices])))
    parts = [slice(low, high) for low, high in pairwise(bounds)]
    score, told = np.zeros(bounds[-1]), [np.zeros((part.stop - part.start,) * 2) for part in parts]
    predicted = []
    for c, rows in enumerate(used):  # one after the other: the columns of all choices need much memory
        table = np.hstack([choice.raw[c] for choice in choices])
        columns = rows.project(table[~held])
        score += columns.T @ rows.residual
        for part, gram in zip(parts, told, strict=True):
            gram += columns[:, part].T @ columns[:, part]
        predicted.append(rows.predict(table, held))
    signatures = np.concatenate([s for _, s in predicted])
    best, amplitudes, highest = None, np.zeros(0), worth
    for choice, part, gram in zip(choices, parts, told, strict=True):
        shown = _all_shown(choice.widths, np.diag(gram), (signatures[:, part] ** 2).sum(0))
        value = choice.log_bayes(gram, score[part]) if shown else -np.inf
        if value > highest:
            highest, best = value, part
            amplitudes, _ = choice.amplitudes(gram, score[part])
    residual = np.concatenate([r for r, _ in predicted])
    difference = np.zeros(len(residual)) if best is None else signatures[:, best] @ amplitudes
    channel = np.repeat(np.arange(len(predicted)), [len(r) for r, _ in predicted])
    group = np.concatenate([own[held] for own in noise.group])
    points = {id(choice.point): choice.point for choice in choices if choice.point is not None}
    moving = {key: _moving(used, point, held) for key, point in points.items()}
    nothing = np.zeros((len(residual), 0))
    each = [
        np.hstack([signatures[:, part], moving.get(id(choice.point), nothing)])
        for choice, part in zip(choices, parts, strict=True)
    ]
    return _Fold(channel, group, residual, difference, each, told)


def _moving(used: Sequence[_Rows], point: OperatingPoint, held: NDArray[np.bool_]) -> Array:
    """For an effect on the output, returns the derivative of the predicted effect with respect to each nominal parameter, in the
    held-out segments of all channels, shape (m, q). `point`: the nominal parameters about which the effect is linearised. `held`:
    array of shape (M,), True for the held-out coefficients. q counts the parameters of all channels on which the effect acts."""
    from scipy.linalg import block_diag

    blocks = [
        rows.predict(change if change.any() else change[:, :0], held)[1]
        for rows, change in zip(used, point.change, strict=True)
    ]
    return np.asarray(block_diag(*blocks))


def _all_shown(widths: Sequence[int], used: Array, held: Array) -> bool:
    """Returns True if the segments that are used for the fit show every effect of a choice. Without this condition, rounding errors
    could determine an amplitude.

    `used`, `held`: arrays of shape (p,), energy of each column in the used and in the held-out segments, without the part that the
    nominal parameters absorb. `widths`: number of columns of each effect."""
    starts = np.concatenate(([0], np.cumsum(widths)[:-1])).astype(int)
    shown, whole = np.add.reduceat(used, starts), np.add.reduceat(used + held, starts)
    return bool(np.all(shown > ABSORBED * whole))


class _Rows:
    """Contains the chosen coefficients of one channel after whitening. The part that the nominal parameters explain has been
    removed."""

    def __init__(
        self,
        weighing: Weighing,
        noise: MeasuredNoise,
        channel: int,
        chosen: NDArray[np.bool_],
        point: OperatingPoint | None = None,
    ):
        self.weight = noise.weights[channel]
        self.scale = noise.scale[channel]
        self.values = weighing.spectrum.values[:, channel]
        self.nominal = weighing.nominal[channel]
        if point is not None and point.change[channel].any():
            change = point.change[channel]
            self.values = self.values + change @ point.values[channel]
            self.nominal = np.hstack(
                [point.nominal[channel] + change, weighing.angles[channel], weighing.known[channel]]
            )
        self.chosen = chosen
        self.whiten = self.whitening(chosen)
        size = np.linalg.norm(self.nominal, axis=0)
        size[size == 0] = 1.0
        left, values, right = np.linalg.svd(self.whiten(self.nominal[chosen] / size), full_matrices=False)
        told = values > DEPENDENT * values.max(initial=0.0)
        self.basis = left[:, told]
        self.parameters = right[told].T / values[told] / size[:, None]
        self.untold = right[~told].T / size[:, None]
        self.residual = self.project(self.values[chosen])

    def whitening(self, rows: NDArray[np.bool_]) -> Callable[[Array], Array]:
        """Returns a function that whitens the coefficients (n,) or (n, P) of the given rows with the measured level of the noise."""
        whiten, scale = self.weight.whitening(rows), self.scale[rows]
        return lambda columns: (whiten(columns).T / scale).T

    def project(self, columns: Array) -> Array:
        """Returns columns (n, P) or (n,) of the chosen rows after whitening and without the part that the nominal parameters absorb, in
        the same shape."""
        whitened = self.whiten(columns)
        return whitened - self.basis @ (self.basis.T @ whitened)

    def moved(self, values: Array) -> Array:
        """Returns the difference between the fitted nominal parameters (q,) and `values` (q,), in the directions that the rows
        determine. `values` belong to the first q nominal columns."""
        left = self.whiten((self.values - self.nominal[:, : len(values)] @ values)[self.chosen])
        return np.asarray((self.parameters @ (self.basis.T @ left))[: len(values)])

    def predict(self, signatures: Array, held: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Returns the held-out residual (m,) of a prediction without effects, and the change (m, p) of the prediction that the
        signatures (M, p) cause, both whitened.

        The nominal parameters are fitted to the chosen rows, once without and once with the effect. The covariance of these
        parameters is added to the held-out noise. Let U be the whitened root of this covariance. The factor (I + UUᵀ)^−½ then
        changes only components in the span of U. Directions that the chosen rows do not determine are projected out.
        """
        both = np.column_stack([self.values, signatures])
        fitted = self.parameters @ (self.basis.T @ self.whiten(both[self.chosen]))
        whiten, nominal = self.whitening(held), self.nominal[held]
        left = whiten(both[held] - nominal @ fitted)
        spread = whiten(nominal @ self.parameters)
        if self.untold.shape[1]:
            open_, _ = np.linalg.qr(whiten(nominal @ self.untold))
            left, spread = (part - open_ @ (open_.T @ part) for part in (left, spread))
        along, size, _ = np.linalg.svd(spread, full_matrices=False)
        left -= along @ ((1 - 1 / np.sqrt(1 + size**2))[:, None] * (along.T @ left))
        return left[:, 0], left[:, 1:]

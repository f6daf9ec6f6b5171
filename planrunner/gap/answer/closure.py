"""Closure: reduction of the gap on segments that were not used to choose or fit the effect.

Segments are held out in groups, each with segments of every kind of motion, and the effect is chosen again without each group. The
difference d between the predictions with and without the effect is then known exactly. The unknown is the gap g itself: its size is
|g| before and |g − d| after. Two cases are averaged, weighted by their probability in the diagnosis.

- An effect or pair of the catalogue is the whole cause: g is its signature with amplitudes estimated from all segments, normal with
  their covariance.
- Something else acts, additionally or alone. Let r be the held-out residual of the nominal simulation, whitened with the uncertainty
  of its fitted parameters (r = g + noise). The part of g along d is then measured with unit noise. The size of the other part follows
  from a non-central χ² (its confidence distribution: Schweder and Hjort, Confidence, Likelihood, Probability, 2016).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.gap.evidence.bayes_factors import best_amplitudes, best_scales, log_bayes_factors
from planrunner.gap.evidence.weighing import DEPENDENT
from planrunner.gap.hypotheses.candidates import Weighed, Weighing

FOLDS = 4
FEWEST = 6  # segments; three quarters of fewer carry too little information
DRAWS = 2000
SEED = 21
WIDEST = 0.5  # width of an interval above which the closure is not resolvable
TOLD = 0.5  # information on an effect that the other segments must have, relative to the held-out ones
_EXACT = np.full((1, 1), 1e-12)
WORTH = 4.0  # log BF in a fold at and above which an effect is selected


@dataclass(frozen=True, slots=True)
class ChannelClosure:
    """The closure of one channel. before, after: size of the held-out gap in standard deviations of the noise, root mean square
    over the coefficients; before_value, after_value: size of this gap in `unit`, root mean square over the samples. shrinks_by,
    interval_90: as in `Closure`."""

    channel: str
    unit: str
    before: float
    after: float
    before_value: float
    after_value: float
    shrinks_by: float
    interval_90: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Closure:
    """Result of the check on held-out data: how much of the gap the effects explain. before, after: size of the held-out gap in
    standard deviations of the noise, root mean square over coefficients. shrinks_by: relative reduction, 1 for a closed gap.
    interval_90: 90 % interval of `shrinks_by`. resolvable: False if the data do not determine the reduction; all numbers are then
    NaN. channels: one entry for each channel whose data determine the reduction."""

    before: float
    after: float
    shrinks_by: float
    interval_90: tuple[float, float]
    resolvable: bool
    channels: tuple[ChannelClosure, ...] = ()


NOT_RESOLVABLE = Closure(np.nan, np.nan, np.nan, (np.nan, np.nan), False)


@dataclass(frozen=True, slots=True)
class FoldChoice:
    """An effect or a pair of effects that a fold may choose. probability: probability that this choice is the whole cause. whole:
    True if its amplitude is fixed at 1."""

    weighed: Weighed
    probability: float
    whole: bool = False

    def amplitudes(self, gram: Array, score: Array) -> tuple[Array, Array]:
        """Mean (p,) and covariance (p, p) of the amplitudes, from information (p, p) and score (p,)."""
        return (np.ones(1), _EXACT) if self.whole else best_amplitudes(gram, score, self.weighed.variant.widths)

    def log_bayes(self, gram: Array, score: Array) -> float:
        if self.whole:
            return float(score[0] - 0.5 * gram[0, 0])
        return float(log_bayes_factors(gram[None], score[None], float(np.trace(gram)))[0])


@dataclass(frozen=True)
class KnownCause:
    """A cause from the catalogue. gram: (p, p), inner products of its held-out signatures with each other; along: (p,), inner
    products of these signatures with d; mean (p,), covariance (p, p): of the amplitudes of the cause."""

    probability: float
    gram: Array = field(repr=False)
    along: Array = field(repr=False)
    mean: Array = field(repr=False)
    covariance: Array = field(repr=False)


@dataclass(frozen=True)
class _Fold:
    """The held-out rows of one fold. channel: (m,), index of the channel of every row. residual, difference: (m,), whitened;
    signatures: (m, p), for each choice; told: (p, p), information about the amplitudes of each choice from the other segments."""

    channel: NDArray[np.int64]
    residual: Array
    difference: Array
    signatures: list[Array]
    told: list[Array]


def closure(weighing: Weighing, choices: Sequence[FoldChoice], beyond: float) -> Closure:
    """Computes the closure. choices: the effects and pairs among which each fold chooses again. beyond: probability that none of them is
    the whole cause."""
    if len(weighing.observed) < FEWEST or not choices:
        return NOT_RESOLVABLE
    folds = [_fold(weighing, choices, held) for held in held_out(weighing)]
    likeliest = max(range(len(choices)), key=lambda c: choices[c].probability)
    if _told(choices[likeliest].weighed, likeliest, folds) < TOLD:
        return NOT_RESOLVABLE
    whole = _measured_rows(choices, folds, [np.ones(len(fold.channel), dtype=bool) for fold in folds], beyond)
    if not whole.resolvable:
        return whole
    channels = []
    for index in range(len(weighing.weights)):
        rows = [fold.channel == index for fold in folds]
        own = _measured_rows(choices, folds, rows, beyond)
        if own.resolvable:
            residual = np.concatenate([fold.residual[at] for fold, at in zip(folds, rows, strict=True)])
            channels.append(_in_unit(weighing, index, own, residual))
    return replace(whole, channels=tuple(channels))


def _measured_rows(
    choices: Sequence[FoldChoice], folds: Sequence[_Fold], rows: Sequence[NDArray[np.bool_]], beyond: float
) -> Closure:
    """The closure computed from the selected `rows` of every fold."""
    chosen = list(zip(folds, rows, strict=True))
    difference = np.concatenate([fold.difference[at] for fold, at in chosen])
    known = []
    for number, choice in enumerate(choices):
        signature = np.concatenate([fold.signatures[number][at] for fold, at in chosen])
        gram, along = signature.T @ signature, signature.T @ difference
        fitted = choice.amplitudes(choice.weighed.gram[0], choice.weighed.score[0])
        known.append(KnownCause(choice.probability, gram, along, *fitted))
    return measured(np.concatenate([fold.residual[at] for fold, at in chosen]), difference, known, beyond)


def _in_unit(weighing: Weighing, index: int, own: Closure, residual: Array) -> ChannelClosure:
    """The closure of a channel, with the sizes of the gap also in the channel's unit. Coefficients count in proportion to the mean
    square of their noise."""
    channel, weight = weighing.observed.channels[index], weighing.weights[index][0]
    every = np.ones(len(weight.scale), dtype=bool)
    sigma = float(np.sqrt(np.mean(np.diag(weight.covariance(every)))))
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
    weighing: Weighing, choices: Sequence[FoldChoice], change: Array, worth: float = WORTH
) -> tuple[Array, Array, NDArray[np.int64]]:
    """The gap g (m,) that a known change causes in the held-out segments, its prediction d (m,), and the channel of every row. change:
    (M, K), coefficients of the change of the outputs. Used by tests in which the true gap is known. worth: the least log BF at which a
    fold selects one of the choices."""
    gap, difference, channels = [], [], []
    for held in held_out(weighing):
        rows = [_Rows(weighing, channel, ~held) for channel in range(len(weighing.weights))]
        known = [one.predict(change[:, [channel]], held)[1][:, 0] for channel, one in enumerate(rows)]
        gap.append(np.concatenate(known))
        fold = _fold(weighing, choices, held, worth)
        difference.append(fold.difference)
        channels.append(fold.channel)
    return np.concatenate(gap), np.concatenate(difference), np.concatenate(channels)


def held_out(weighing: Weighing) -> list[NDArray[np.bool_]]:
    """For each fold, a mask (M,) of the rows that are held out."""
    dealt = dealt_by_motion([type(motion).__name__ for motion in weighing.observed.motions])
    return [(dealt == fold)[weighing.spectrum.segment] for fold in range(FOLDS)]


def dealt_by_motion(kinds: Sequence[str]) -> NDArray[np.int64]:
    """The fold (S,) of each segment. Segments of one kind of motion are distributed in turn over the folds, and each round begins
    with the next fold. Plans are often periodic, so without this shift every fourth segment might contain all segments of one
    orientation."""
    order = np.argsort(np.unique(kinds, return_inverse=True)[1], kind="stable")
    place = np.arange(len(kinds))
    dealt = np.empty(len(kinds), dtype=np.int64)
    dealt[order] = (place + place // FOLDS) % FOLDS
    return dealt


def _told(weighed: Weighed, number: int, folds: Sequence[_Fold]) -> float:
    """The fraction of an effect's energy in held-out segments that the other segments determine, for amplitudes of the estimated
    size. The fraction is 0 if only one segment shows the effect."""
    size = best_scales(weighed.gram[0], weighed.score[0], weighed.variant.widths)
    shown = left = 0.0
    for fold in folds:
        gram = fold.signatures[number].T @ fold.signatures[number]
        unknown = np.linalg.inv(fold.told[number] + np.diag(1 / size))
        shown += float(np.diag(gram) @ size)
        left += float(np.sum(gram * unknown))
    return 1 - left / shown if shown > 0 else 0.0


def measured(residual: Array, difference: Array, known: Sequence[KnownCause] = (), beyond: float = 1.0) -> Closure:
    """The closure from whitened held-out residuals (m,) and the known difference of the predictions (m,). beyond: the probability that
    the cause is none of `known`. Only the ratios of `beyond` and the probabilities of `known` matter; their sum need not be 1."""
    m = len(residual)
    if float(np.linalg.norm(difference)) < 1e-9 or m < 3:
        return NOT_RESOLVABLE
    draw = np.random.default_rng(SEED)
    share = np.array([beyond, *(one.probability for one in known)])
    counts = np.diff(np.round(DRAWS * np.concatenate(([0.0], np.cumsum(share))) / share.sum()).astype(int))
    drawn = [_unknown(residual, difference, int(counts[0]), draw)]
    drawn += [
        _explained(one, float(difference @ difference), int(n), draw) for one, n in zip(known, counts[1:], strict=True)
    ]
    before, after = np.sqrt(np.maximum(np.concatenate(drawn), 0.0)).T
    if float(np.quantile(before, 0.05)) < 1e-9:  # no relative reduction of a gap that may be zero
        return NOT_RESOLVABLE
    shrink = 1 - after / np.maximum(before, 1e-9)
    low, middle, high = (float(value) for value in np.quantile(shrink, [0.05, 0.5, 0.95]))
    if high - low > WIDEST:
        return NOT_RESOLVABLE
    scale = np.sqrt(m)
    return Closure(float(np.median(before)) / scale, float(np.median(after)) / scale, middle, (low, high), True)


def _unknown(residual: Array, difference: Array, count: int, draw: np.random.Generator) -> Array:
    """Random values of the squared size of the gap before and after, (count, 2), for an unknown composition of the gap."""
    from scipy.special import chndtr

    m, size = len(residual), float(np.linalg.norm(difference))
    along = float(residual @ difference) / size
    rest = float(residual @ residual) - along**2
    parallel = along + draw.standard_normal(count)
    top = max(rest - m, 0.0) + 8 * np.sqrt(2 * m + 4 * max(rest - m, 0.0)) + 10
    grid = np.concatenate(([0.0], np.geomspace(1e-3, top, 400)))
    chance = 1 - chndtr(rest, m - 1, grid)
    across = np.interp(draw.uniform(size=count), np.maximum.accumulate(chance), grid)
    return np.column_stack([parallel**2 + across, (parallel - size) ** 2 + across])


def _explained(cause: KnownCause, squared: float, count: int, draw: np.random.Generator) -> Array:
    """Random values of the squared size of the gap before and after, (count, 2), if a known cause is the whole gap. squared: |d|²."""
    root = np.linalg.cholesky(cause.covariance)
    amplitudes = cause.mean + draw.standard_normal((count, len(cause.mean))) @ root.T
    before = np.einsum("ni,ij,nj->n", amplitudes, cause.gram, amplitudes)
    return np.column_stack([before, before - 2 * amplitudes @ cause.along + squared])


def _fold(weighing: Weighing, choices: Sequence[FoldChoice], held: NDArray[np.bool_], worth: float = WORTH) -> _Fold:
    """The held-out rows of all channels in one fold. The effect is chosen from the other rows."""
    used = [_Rows(weighing, channel, ~held) for channel in range(len(weighing.weights))]
    bounds = np.concatenate(([0], np.cumsum([len(choice.weighed.gram[0]) for choice in choices])))
    parts = [slice(low, high) for low, high in pairwise(bounds)]
    raw = [np.hstack([choice.weighed.raw[c] for choice in choices]) for c in range(len(used))]
    columns = [rows.project(table[~held]) for rows, table in zip(used, raw, strict=True)]
    score = np.sum([block.T @ rows.residual for block, rows in zip(columns, used, strict=True)], axis=0)
    told = [np.sum([block[:, part].T @ block[:, part] for block in columns], axis=0) for part in parts]
    best, amplitudes, highest = None, np.zeros(0), worth
    for choice, part, gram in zip(choices, parts, told, strict=True):
        value = choice.log_bayes(gram, score[part]) if np.trace(gram) > 0 else -np.inf
        if value > highest:
            highest, best = value, part
            amplitudes, _ = choice.amplitudes(gram, score[part])
    predicted = [rows.predict(table, held) for rows, table in zip(used, raw, strict=True)]
    residual = np.concatenate([r for r, _ in predicted])
    signatures = np.concatenate([s for _, s in predicted])
    difference = np.zeros(len(residual)) if best is None else signatures[:, best] @ amplitudes
    channel = np.repeat(np.arange(len(predicted)), [len(r) for r, _ in predicted])
    return _Fold(channel, residual, difference, [signatures[:, part] for part in parts], told)


class _Rows:
    """The chosen coefficients of one channel, whitened and without the part that the nominal parameters explain."""

    def __init__(self, weighing: Weighing, channel: int, chosen: NDArray[np.bool_]):
        self.weight = weighing.weights[channel][0]
        self.values = weighing.spectrum.values[:, channel]
        self.nominal = weighing.nominal[channel]
        self.chosen = chosen
        self.whiten = self.weight.whitening(chosen)
        size = np.linalg.norm(self.nominal, axis=0)
        left, values, right = np.linalg.svd(self.whiten(self.nominal[chosen] / size), full_matrices=False)
        told = values > DEPENDENT * values.max(initial=0.0)
        self.basis = left[:, told]
        self.parameters = right[told].T / values[told] / size[:, None]
        self.untold = right[~told].T / size[:, None]
        self.residual = self.project(self.values[chosen])

    def project(self, columns: Array) -> Array:
        whitened = self.whiten(columns)
        return whitened - self.basis @ (self.basis.T @ whitened)

    def predict(self, signatures: Array, held: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Held-out residual (m,) without an effect, and the change (m, p) of the prediction by signatures (M, p), both whitened.

        The nominal parameters are fitted to the chosen rows without and with the effect; their covariance adds to the held-out noise: with
        U its whitened root, (I + UUᵀ)^−½ acts in the span of U alone. The part that the chosen rows do not determine is projected out.
        """
        both = np.column_stack([self.values, signatures])
        fitted = self.parameters @ (self.basis.T @ self.whiten(both[self.chosen]))
        whiten, nominal = self.weight.whitening(held), self.nominal[held]
        left = whiten(both[held] - nominal @ fitted)
        spread = whiten(nominal @ self.parameters)
        if self.untold.shape[1]:
            open_, _ = np.linalg.qr(whiten(nominal @ self.untold))
            left, spread = (part - open_ @ (open_.T @ part) for part in (left, spread))
        along, size, _ = np.linalg.svd(spread, full_matrices=False)
        left -= along @ ((1 - 1 / np.sqrt(1 + size**2))[:, None] * (along.T @ left))
        return left[:, 0], left[:, 1:]

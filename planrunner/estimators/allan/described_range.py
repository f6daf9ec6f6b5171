"""Finds the range of averaging times that the four kinds of noise describe, and whether the record also contains a steady drift.

A record may contain more than noise. A filter or a periodic disturbance changes the deviations at short averaging times; a warm-up
changes the deviations at long averaging times; a steady drift looks like a random walk. The first fit uses all averaging times. If
some averaging times contradict the model, as few averaging times as possible are omitted at the ends of the range. Allan variances
cannot distinguish a random walk from a drift. If they show one of the two, Hadamard variances are fitted instead. The coefficients
are then valid both for a random walk and for a drift, and are only slightly less certain.

A record has a steady drift if its noise does not explain the difference between the means of the two halves of a run. These means
differ by the drift during half the run, and by noise. The variance of this noise is twice the Allan variance at an averaging time
of half the run. This Allan variance is computed from a fit to Hadamard variances, because a steady drift does not change them. The
variance is uncertain, mainly because the random walk is poorly known. The test therefore uses an upper bound of the variance, which
is two standard uncertainties above the estimate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import field, replace
from functools import cached_property

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.allan.fit import ALLAN, HADAMARD, TERMS, NoiseFit, covariance_for, fit_noise, model_matrix
from planrunner.estimators.allan.phase import Phase
from planrunner.estimators.allan.table import Deviation

_DOUBT = 0.01  # p-value of χ² below which the model is rejected
_BELIEF = 0.2
"""The limit that replaces `_DOUBT` in the search for a range of averaging times. With `_DOUBT` as the limit, the search would stop
at a range that is still distorted. The value is not derived; it was chosen with two simulated records in which rounding errors are
carried over to the next sample. In these records, with a limit of 0.01, the coefficient N was wrong by 1 to 2 standard
uncertainties."""
_NEGATIVE = 4.0  # standard uncertainties by which a square may be negative by chance
_SPARE = 2  # a range has at least this number of averaging times more than terms
_NEGLIGIBLE = 0.1  # of the standard deviation of a variance: largest permitted effect of correlated rounding errors
_CHANCE = 1e-3  # p-value of the difference between halves below which a drift is present
_QUANTISED, _WHITE, _WALK = TERMS.index("Q"), TERMS.index("N"), TERMS.index("K")


@dataclass(frozen=True, slots=True)
class SteadyDrift:
    """The steady drift of a record. `slope`: the drift in the output's unit per second (weighted mean over the runs), with its
    standard uncertainty. The uncertainty is computed for noise that is one standard uncertainty larger than estimated.
    `probability`: probability that noise alone causes differences of this size between the halves of the runs."""

    slope: float
    standard_uncertainty: float
    probability: float

    @property
    def present(self) -> bool:
        return self.probability < _CHANCE


@dataclass(frozen=True)
class DescribedRange:
    """The averaging times that the noise model describes.

    `fitted`: the deviations to which `fit` was fitted; these are Hadamard deviations if `drift` is given. `shorter`, `longer`:
    number of averaging times omitted at the short and at the long end. `distortions`: array of shape (r, 4). Each row belongs to
    one shortened end. If one more averaging time is omitted at this end, the squared coefficients change; the row contains the part
    of this change that chance does not explain. `rounded`: number of averaging times omitted in advance, because rounding errors
    are correlated; they are part of `shorter`. `fits`: True if the model describes the remaining averaging times. `probability`: if
    the model is right, the probability of a χ² at least as large as the χ² found.
    """

    fit: NoiseFit
    fitted: Sequence[Deviation]
    shorter: int = 0
    longer: int = 0
    drift: SteadyDrift | None = None
    distortions: Array = field(default_factory=lambda: np.zeros((0, len(TERMS))))
    rounded: int = 0

    @property
    def covariance(self) -> Array:
        """Returns the covariance of the squared coefficients, shape (4, 4). It includes the distortion that the choice of the
        averaging times may cause.

        The end of the range was chosen with the same deviations that are fitted. Whatever changed the deviations at the omitted
        averaging times may also change the neighbouring deviations, by too little for the χ² test to detect. The resulting
        distortion of the coefficients is estimated: it is the change of the coefficients if one more averaging time is omitted,
        minus the part of this change that chance explains. The distortion counts as a systematic error that is not corrected (JCGM
        100:2008, F.2.4.5)."""
        return np.asarray(self.fit.covariance + self.distortions.T @ self.distortions)

    @cached_property
    def probability(self) -> float:
        from scipy.special import chdtrc

        return float(chdtrc(self.fit.freedom, self.fit.chi_square)) if self.fit.freedom else 1.0

    @property
    def fits(self) -> bool:
        """Returns True if the model describes the averaging times: χ² is not too large, and no squared coefficient is significantly
        negative."""
        spreads = np.sqrt(np.diag(self.fit.covariance))
        return self.probability >= _DOUBT and bool(np.all(self.fit.squares >= -_NEGATIVE * spreads))


def described_range(
    phase: Phase,
    rows: Sequence[Deviation],
    terms: Sequence[str],
    hadamard: Callable[[], Sequence[Deviation]],
    count: float = 0.0,
) -> DescribedRange:
    """Finds the averaging times that the noise model describes.

    `rows`: overlapping Allan deviations that have enough degrees of freedom. `hadamard`: a function that computes the Hadamard
    deviations; it is called only if they are needed, because this takes time. `count`: size of one count of the output, in the
    output's unit; 0 if the values are not rounded.
    """
    found = _described(phase, rows, terms, hadamard)
    skipped = _correlated_rounding(found.fit, rows, count) if phase.decimation == 1 else 0
    if not 0 < skipped <= len(rows) - len(terms) - _SPARE:
        return found
    first = rows[skipped].factor
    later = _described(phase, rows[skipped:], terms, lambda: [row for row in hadamard() if row.factor >= first])
    return replace(later, shorter=later.shorter + skipped, rounded=skipped)


def _correlated_rounding(fit: NoiseFit, rows: Sequence[Deviation], count: float) -> int:
    """Returns the number of short averaging times at which the correlation of rounding errors matters. The number is 0 if the
    rounding error of a sample is not carried over to the next sample, because the output then has no quantisation noise. If it is
    carried over, Q²/τ0² is count²/12, where `count` is the size of one count of the output."""
    carried = count**2 / 12
    if not count or fit.squares[_QUANTISED] < carried / 2:
        return 0
    m = np.array([row.factor for row in rows], dtype=float)
    spread = np.array([row.value**2 * math.sqrt(2 / row.freedom) for row in rows])
    decay = np.exp(-2 * math.pi**2 * max(float(fit.squares[_WHITE]), 0.0) * m / count**2)
    left = 4 * carried * 6 / math.pi**2 * decay / m**2  # contribution to 3·Q²/τ² from the correlation at a lag of m
    matters = np.flatnonzero(left > _NEGLIGIBLE * spread)
    return int(matters[-1]) + 1 if len(matters) else 0


def _described(
    phase: Phase, rows: Sequence[Deviation], terms: Sequence[str], hadamard: Callable[[], Sequence[Deviation]]
) -> DescribedRange:
    allan = _Ranges(phase, rows, terms, ALLAN)
    walks, white = _walks(allan.whole.fit), _white(allan.whole.fit)
    if allan.whole.fits and not walks and white.squares.any() and not steady_drift(phase, white).present:
        return allan.whole
    third = hadamard()
    if len(third) > len(terms):
        drifting = _Ranges(phase, third, terms, HADAMARD).widest()
        drift = steady_drift(phase, drifting.fit)
        if drifting.fits and (drift.present or walks):
            return replace(drifting, drift=drift)
    return allan.widest()


class _Ranges:
    """Fits the noise model to different ranges of the same deviations."""

    def __init__(self, phase: Phase, rows: Sequence[Deviation], terms: Sequence[str], order: int):
        self.rows, self.terms, self.order, self.lengths = rows, terms, order, phase.lengths
        self.factors = np.array([row.factor for row in rows], dtype=np.int64)
        self.covariance = covariance_for(self.factors, phase.lengths, order)
        self.whole = self.without(0, 0)

    def widest(self) -> DescribedRange:
        """Returns the largest range that the model describes well. If several ranges have the same size, returns the range with the
        longest averaging times. If the model does not describe any range, it returns all averaging times."""
        if self.whole.fits:
            return self.whole
        most = len(self.rows) - len(self.terms) - _SPARE
        ends = [(shorter, fewer - shorter) for fewer in range(1, most + 1) for shorter in range(fewer, -1, -1)]
        fitting = [one for pair in ends if (one := self.without(*pair)).fits]
        chosen = next((one for one in fitting if one.probability >= _BELIEF), fitting[0] if fitting else None)
        return self.whole if chosen is None else replace(chosen, distortions=self._distortions(chosen))

    def _distortions(self, chosen: DescribedRange) -> Array:
        shorter, longer = chosen.shorter, chosen.longer
        fewer = [(shorter + 1, longer)] * bool(shorter) + [(shorter, longer + 1)] * bool(longer)
        return np.reshape([distortion(chosen.fit, self.without(*pair).fit) for pair in fewer], (-1, len(TERMS)))

    def without(self, shorter: int, longer: int) -> DescribedRange:
        end = len(self.rows) - longer
        rows = self.rows[shorter:end]
        variances, freedom = np.array([row.value**2 for row in rows]), np.array([row.freedom for row in rows])
        inner = self.covariance.among(shorter, end)
        factors = self.factors[shorter:end]
        return DescribedRange(
            fit_noise(factors, variances, freedom, self.lengths, self.terms, self.order, inner), rows, shorter, longer
        )


def distortion(chosen: NoiseFit, fewer: NoiseFit) -> Array:
    """Compares the squared coefficients of two fits. Returns the part δ of their change from `chosen` to `fewer` that chance does
    not explain, shape (4,). For efficient estimates, chance causes a change whose variance is the difference of the variances of
    the two fits (Hausman, 1978). Therefore, δ² = change² − this variance. A negative δ² counts as zero."""
    change = fewer.squares - chosen.squares
    by_chance = np.clip(np.diag(fewer.covariance) - np.diag(chosen.covariance), 0.0, None)
    return np.asarray(np.sign(change) * np.sqrt(np.clip(change**2 - by_chance, 0.0, None)))


def _walks(fit: NoiseFit) -> bool:
    """Returns True if the fit found a rate random walk. In Allan variances, this may also be a steady drift."""
    return bool(fit.squares[_WALK] > 2 * math.sqrt(fit.covariance[_WALK, _WALK]))


def _white(fit: NoiseFit) -> NoiseFit:
    """Returns a copy of the fit with the white noise alone, because a drift distorts the other terms."""
    return replace(
        fit,
        squares=np.where(np.arange(len(TERMS)) == _WHITE, np.maximum(fit.squares, 0.0), 0.0),
        covariance=0 * fit.covariance,
    )


def steady_drift(phase: Phase, fit: NoiseFit) -> SteadyDrift:
    """Estimates the steady drift of a record. `fit`: a fit of the noise model to the Hadamard variances of the same record."""
    from scipy.special import chdtrc

    halves = np.array([(run.size - 1) // 2 for run in phase.runs], dtype=np.int64)
    steps = np.array(
        [(run[2 * m] - 2 * run[m] + run[0]) / m for run, m in zip(phase.runs, halves.tolist(), strict=True)]
    )
    rows = model_matrix(halves)
    found = rows @ np.maximum(fit.squares, 0.0)
    unsure = np.sqrt(np.einsum("ri,ij,rj->r", rows, fit.covariance, rows))
    variances = 2 * (found + unsure)
    ratios = steps**2 / (2 * (found + 2 * unsure))
    spans = halves * phase.interval
    information = float(np.sum(spans**2 / variances))
    return SteadyDrift(
        float(np.sum(spans * steps / variances)) / information,
        1 / math.sqrt(information),
        float(chdtrc(len(steps), np.sum(ratios))),
    )

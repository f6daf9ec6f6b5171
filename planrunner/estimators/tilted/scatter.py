"""Computes the type A uncertainty of tilted scale factors on the basis that the plan selects.

    repeats         scatter of each quantity from repeat to repeat; it includes all effects that differ between repeats
    residual        scatter of the means over the repeats about the line, with the correlations of declared flicker
    within_segment  noise within the segments alone

The module also judges the drift of the zero between the readings before and after the rates.

The type A uncertainty includes the noise of the zeros. If flicker is declared, it also includes the flicker, and the drift in a
series may be a part of this flicker. A drift is therefore added separately only if noise and flicker together do not explain it.
Otherwise, every interval would include the same noise twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators import least_squares
from planrunner.estimators.interface import EstimationError
from planrunner.estimators.tilted.evaluation import (
    QUANTITIES,
    Group,
    K,
    TiltedResults,
    Worst,
    answers_to_averages,
    over_temperature,
)
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.observation.observations import SIGNIFICANCE, variances_differ
from planrunner.uncertainty.derivatives import jacobian

_RESOLVED = 1e-12  # of the variance of flicker: smallest assumed variance of the noise
BASES = ("repeats", "residual", "within_segment")


@dataclass(frozen=True, slots=True)
class NoiseOfMeans:
    """The uncertainty of the means over the repeats.

    `rates`: array of shape (g, n, m), standard uncertainties of the outputs at the rates, in the outputs' units. `rest`: array of
    shape (g, m), standard uncertainties of the rest values F_r. `correlation`: array of shape (m, m), correlation between outputs.
    `degrees_of_freedom`: array of shape (m,), degrees of freedom of these uncertainties for each output.
    """

    rates: tuple[Array, ...]
    rest: Array
    correlation: Array
    degrees_of_freedom: Array


@dataclass(frozen=True, slots=True)
class Scatter:
    """Contains the type A uncertainty of the groups' mean quantities.

    `covariance`: array of shape (g, 5·m, 5·m), covariance of the mean quantities of each group; the groups are independent of each
    other. `degrees_of_freedom`: array of shape (g, 5·m), degrees of freedom of the variances. `pooled`: array of shape (5·m,), True
    if one variance is used for all temperatures.
    """

    covariance: Array
    degrees_of_freedom: Array
    pooled: NDArray[np.bool_]


def scatter_between_repeats(
    found: TiltedResults, groups: Sequence[Group], answers: Sequence[Array], flicker: Sequence[CorrelatedError] = ()
) -> Scatter:
    """Returns the type A uncertainty from the scatter of the repeats. The variance of a quantity is pooled over the temperatures.
    The variance is not pooled if Bartlett's test finds that the variance differs between the temperatures. The correlations between
    quantities come from the repeats of all temperatures. A part of the declared flicker is common to all repeats. The scatter of
    the repeats cannot show this part, so it is added. `answers`: sensitivities of each group, from `answers_of`. Raises
    `EstimationError` if the rates are not repeated at a temperature."""
    repeats = [one.reshape(len(one), -1) for one in found.repeats]
    if min(len(one) for one in repeats) < 2:
        raise EstimationError(
            "at some temperature the rates were run only once, so their repeatability is unknown: add `repeat: 6`, or "
            "write `uncertainty: residual`"
        )
    degrees = np.array([len(one) - 1 for one in repeats])
    variances = np.array([np.nan_to_num(one.var(axis=0, ddof=1)) for one in repeats])
    pooled = degrees @ variances / degrees.sum()
    same = np.array(
        [
            len(repeats) == 1 or not (column > 0).all() or not variances_differ(column, degrees.astype(float), mean)
            for column, mean in zip(variances.T, pooled, strict=True)
        ]
    )
    size = np.sqrt(np.where(same, pooled, variances))
    deviations = np.nan_to_num(np.vstack([one - one.mean(axis=0) for one in repeats]))
    correlation = _correlation(deviations.T @ deviations)
    covariance = np.array([correlation * np.outer(own, own) / len(one) for own, one in zip(size, repeats, strict=True)])
    freedom = np.where(same, degrees.sum(), degrees[:, None]).astype(float)
    shared = np.array([in_common(group, own, flicker) for group, own in zip(groups, answers, strict=True)])
    seen = np.diagonal(covariance, axis1=1, axis2=2)
    larger = 1 + np.divide(shared, seen, out=np.zeros_like(seen), where=seen > 0)
    covariance = covariance * np.sqrt(larger[:, :, None] * larger[:, None, :])
    return Scatter(covariance, freedom * larger**2, same)


def in_common(group: Group, answers: Array, flicker: Sequence[CorrelatedError]) -> Array:
    """Returns the variances that flicker adds to the means over the repeats because it correlates the repeats, shape (5·m,). A
    variance is the mean of fᵣᵀCfₛ over all pairs of repeats r ≠ s, or zero if this mean is negative. fᵣ is the sensitivity of the
    quantities of repeat r to the means of segments, and C is the covariance of the flicker. `answers`: array of shape (n, m, 5),
    sensitivities from `answers_of`."""
    gains, q = answers_to_averages(answers), len(group.spins)
    found = np.zeros(gains.shape[1:])
    for effect in flicker:
        for axis in effect.changes:
            covariance, own = effect.covariance(axis, axis), 0.0
            for spins, rest in zip(group.spins, group.rest, strict=True):
                each = np.vstack([np.eye(len(rest))[spins], rest])
                own = own + each @ covariance @ each.T
            tied = (q**2 * group.averages @ covariance @ group.averages.T - own) / (q * (q - 1))
            found[axis] += np.einsum("np,nk,kp->p", gains[:, axis], tied, gains[:, axis])
    return np.maximum(found, 0.0).ravel()


def noise_of_means(groups: Sequence[Group], sigma: Array, correlation: Array, freedom: Array) -> NoiseOfMeans:
    """Returns the uncertainty of the means over the repeats.

    `sigma`: array of shape (N, m), standard uncertainty of each segment's mean. `correlation`: array of shape (m, m), correlation
    between outputs. `freedom`: array of shape (m,), degrees of freedom of `sigma`.
    """
    spread = [np.sqrt(group.averages**2 @ sigma**2) for group in groups]
    return NoiseOfMeans(tuple(one[:-1] for one in spread), np.array([one[-1] for one in spread]), correlation, freedom)


def scatter_of_means(
    groups: Sequence[Group],
    found: TiltedResults,
    answers: Sequence[Array],
    noise: NoiseOfMeans,
    basis: str,
    flicker: Sequence[CorrelatedError] = (),
) -> Scatter:
    """Returns the type A uncertainty from the residuals of the means, or from the noise within the segments. `answers`:
    sensitivities of each group, from `answers_of`. `flicker`: the declared flicker, which contributes to the residuals. Raises
    `EstimationError` if the basis is `residual` and there are no residuals."""
    covariances, freedoms = [], []
    for k, group in enumerate(groups):
        gains = answers_to_averages(answers[k])
        sigma, slow = noise.rates[k], np.zeros((len(noise.rest[k]), len(gains), len(gains)))
        freedom = np.repeat(noise.degrees_of_freedom, len(QUANTITIES))
        if basis == "residual":
            if len(group.rates) < 3:
                raise EstimationError(
                    "two rates leave no residuals from which an uncertainty could be estimated: add rates, or repeats"
                )
            sigma, slow = _about_the_line(group, found.residuals[k], sigma, flicker)
        rows = gains * np.vstack([sigma, noise.rest[k]])[..., None]
        covariance = np.einsum("nap,nbr,ab->apbr", rows, rows, noise.correlation)
        for axis, own in enumerate(slow):
            covariance[axis, :, axis] += gains[:, axis].T @ own @ gains[:, axis]
        covariances.append(covariance.reshape(len(freedom), -1))
        if basis == "residual":
            total, zeros = np.diag(covariances[k]), (rows[-1] ** 2).ravel()
            freedom = _effective(total - zeros, len(group.rates) - 2.0, zeros, freedom)
        freedoms.append(freedom)
    return Scatter(np.array(covariances), np.array(freedoms), np.zeros(len(freedoms[0]), dtype=bool))


def _about_the_line(
    group: Group, residuals: Array, noise: Array, flicker: Sequence[CorrelatedError]
) -> tuple[Array, Array]:
    """Computes the scatter of the outputs at the rates from the residuals (n, m). Returns two arrays. The first, of shape (n, m),
    contains the standard uncertainties of the outputs; for each output, they are equal at all rates. The second, of shape (m, n +
    1, n + 1), contains the covariances that flicker causes between the averages of `Group.averages`.

    Without declared flicker, the variance is s² = Σν²/(n − 2) for the residuals ν. With flicker, the covariance of the rates is
    proportional to V = σ²·1 + C. Here, σ² is the mean square of `noise` (n, m), and C is the covariance of the flicker. The
    residuals give a common factor for both parts. This factor is the minimum over β of (ν − Xβ)ᵀV⁻¹(ν − Xβ)/(n − 2), where the
    columns of X are 1 and the rates. For C = 0, the two formulas agree.
    """
    n, m = residuals.shape
    weights = group.averages
    slow = np.zeros((m, n + 1, n + 1))
    for effect in flicker:
        for axis in effect.changes:
            slow[axis] += weights @ effect.covariance(axis, axis) @ weights.T
    spread = np.sqrt(np.sum(residuals**2, axis=0) / (n - 2))
    matrix = np.column_stack([np.ones(n), group.rates / np.abs(group.rates).max()])
    for axis in range(m):
        tied = slow[axis, :n, :n]
        if tied.any():
            white = np.mean(noise[:, axis] ** 2) + _RESOLVED * np.trace(tied)
            factor = least_squares.fit(matrix, residuals[:, axis], covariance=white * np.eye(n) + tied).variance_factor
            spread[axis], slow[axis] = np.sqrt(factor * white), factor * slow[axis]
    return np.broadcast_to(spread, (n, m)), slow


def _effective(one: Array, freedom_of_one: float, other: Array, freedom_of_other: Array) -> Array:
    """Returns the degrees of freedom of a sum of two variances by the Welch–Satterthwaite formula (JCGM 100:2008, G.4.1). `one`:
    variance of the residuals. `other`: variance due to the noise of the zeros, which causes no residuals. Each variance has its own
    degrees of freedom."""
    known = np.where(freedom_of_other > 0, freedom_of_other, np.inf)
    squares = one**2 / freedom_of_one + other**2 / known
    return np.where(squares > 0, (one + other) ** 2 / np.where(squares > 0, squares, 1.0), freedom_of_one)


def gradient_of(found: TiltedResults, groups: Sequence[Group], reference: int, worst: Worst) -> Array:
    """Returns the derivatives ∂`TiltedResults.vector`/∂(means of all groups), shape (count, g·m·5), for g groups, m axes and five
    quantities of each axis. The repeatability is not a function of the means, so its rows are zero. `reference`: index of the
    reference temperature."""
    g, m, p = found.means.shape
    each = m * p
    gradient = np.zeros((len(found.vector), g * each))
    gradient[: g * each] = np.eye(g * each)
    if np.isfinite(found.coefficient).all():
        kelvin, means = np.array([group.kelvin for group in groups]), found.means[..., K]
        for axis in range(m):
            at = [(k * m + axis) * p + K for k in range(g)]
            decides = int(worst.temperature[axis])
            slopes = jacobian(
                partial(over_temperature, kelvin=kelvin, reference=reference, decides=decides), means[:, axis]
            )
            gradient[[-2 * m + axis, -m + axis], [[row] for row in at]] = slopes.T
    return gradient


def whole(found: TiltedResults, groups: Sequence[Group], scatter: Scatter, gradient: Array) -> tuple[Array, Array]:
    """Returns the covariance of `TiltedResults.vector`, shape (count, count), and the degrees of freedom of its elements, shape
    (count,). `gradient`: derivatives from `gradient_of`."""
    g, m, p = found.means.shape
    count, each = len(found.vector), m * p
    blocks = np.array(
        [gradient[:, k * each : (k + 1) * each] @ scatter.covariance[k] for k in range(g)]
    )  # (g, count, each)
    shares = np.array([np.einsum("ij,ij->i", blocks[k], gradient[:, k * each : (k + 1) * each]) for k in range(g)])
    covariance = sum((blocks[k] @ gradient[:, k * each : (k + 1) * each].T for k in range(g)), np.zeros((count, count)))
    freedom = np.full(count, np.inf)
    freedom[: g * each] = scatter.degrees_of_freedom.ravel()
    slopes = scatter.degrees_of_freedom.reshape(g, m, p)[..., K]
    for row in range(2 * m):
        own, at = slopes[:, row % m], count - 2 * m + row
        total, squares = shares[:, at].sum(), float((shares[:, at] ** 2 / own).sum())
        pooled = bool(scatter.pooled.reshape(m, p)[row % m, K])
        freedom[at] = own[0] if pooled else total**2 / squares if squares > 0 else own.min()
    # A standard deviation of q − 1 degrees of freedom is itself known to 1/√(2·(q − 1)) (JCGM 100:2008, E.4.3).
    for k, group in enumerate(groups):
        q = len(group.names)
        for axis in range(m):
            at = g * each + k * m + axis
            covariance[at, at] = found.repeatability[k, axis] ** 2 / (2 * (q - 1)) if q > 1 else np.nan
            freedom[at] = q - 1
    return covariance, freedom


def with_expected_repeatability(found: TiltedResults, groups: Sequence[Group], scatter: Scatter) -> TiltedResults:
    """Returns the results of a schedule that has not been recorded, with the repeatability that is expected from the scatter of the
    means."""
    g, m, p = found.means.shape
    spread = np.sqrt(np.diagonal(scatter.covariance, axis1=1, axis2=2)).reshape(g, m, p)[..., K]
    repeats = np.array([len(group.names) for group in groups])
    expected = np.abs(spread * np.sqrt(repeats)[:, None] / found.means[..., K])
    return replace(found, repeatability=np.where(repeats[:, None] > 1, expected, np.nan))


def _correlation(products: Array) -> Array:
    size = np.sqrt(np.diag(products))
    outer = np.outer(size, size)
    correlation: Array = np.divide(products, outer, out=np.zeros_like(products), where=outer > 0)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def half_drift(groups: Sequence[Group], axis: int, sigma: Array, shared: bool) -> float:
    """Returns half of the drift of an axis's zero, as a root mean square over temperatures and repeats. The contribution of noise
    is removed.

    `sigma`: array of shape (N,), standard uncertainty of each segment's mean. `shared`: True to return only the part of the drift
    that all repeats have in common. In this case, noise is not removed.
    """
    drifts = [group.drift[:, axis] for group in groups]
    if shared:
        return math.sqrt(np.mean([one.mean() ** 2 for one in drifts])) / 2
    own = [group.between**2 @ sigma**2 for group in groups]
    squares = [np.mean(drift**2 - noise) for drift, noise in zip(drifts, own, strict=True)]
    return math.sqrt(max(0.0, float(np.mean(squares)))) / 2


def moved_further(groups: Sequence[Group], sigma: Array, flicker: Sequence[CorrelatedError]) -> set[int]:
    """Returns the axes whose zeros drifted by more than noise and declared flicker explain, by a χ² test of all drifts at a significance
    level of 1 %.

    `sigma`: array of shape (N, m), standard uncertainty of each segment's mean from noise. Without noise and flicker, any drift
    counts as too large.
    """
    from scipy.special import chdtrc

    weights = np.vstack([group.between for group in groups])
    found = set()
    for axis in range(sigma.shape[1]):
        drift = np.concatenate([group.drift[:, axis] for group in groups])
        slow = [effect.covariance(axis, axis) for effect in flicker if axis in effect.changes]
        covariance = np.diag(sigma[:, axis] ** 2) + sum(slow)
        squares = float(drift @ np.linalg.pinv(weights @ covariance @ weights.T, hermitian=True) @ drift)
        if drift.any() and (not covariance.any() or chdtrc(len(drift), squares) < SIGNIFICANCE):
            found.add(axis)
    return found


def moved_alike(groups: Sequence[Group]) -> set[int]:
    """Returns the axes whose zeros drifted equally in all repeats, by more than the scatter between repeats explains. An F test at
    1 % compares the mean drifts at the temperatures with this scatter. Every group must have at least two repeats."""
    from scipy.special import fdtrc

    freedom = sum(len(group.drift) - 1 for group in groups)
    scatter = sum(((group.drift - group.drift.mean(axis=0)) ** 2).sum(axis=0) for group in groups) / freedom
    means = sum(len(group.drift) * group.drift.mean(axis=0) ** 2 for group in groups) / len(groups)
    ratio = np.divide(means, scatter, out=np.where(means > 0, np.inf, 0.0), where=scatter > 0)
    return {int(axis) for axis in np.flatnonzero(fdtrc(len(groups), freedom, ratio) < SIGNIFICANCE)}

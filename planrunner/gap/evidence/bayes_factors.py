"""Computes Bayes factors: the evidence for an effect with unknown amplitudes, relative to no effect.

The strength of an effect is its energy λ. λ is the energy of the effect's signature in units of the noise, without the part that
the nominal parameters absorb. The ratios between the amplitudes have the same distribution as the ratios between the components of
a random vector from N(0, D). The diagonal matrix D contains the squared prior magnitudes of the amplitudes. λ is log-uniform from
`WEAKEST` to `STRONGEST`. Weaker effects count as absent, because they cannot be distinguished from no effect. Amplitudes θ ~ N(0,
s²·D) with a log-uniform s² have the same ratios, but their λ may be smaller than `WEAKEST`. The Bayes factor is therefore computed
in three steps. First, the log Bayes factor of the Gaussian model is computed for given s²:

    −½·log det(I + s²DG) + ½·s²·cᵀD½(I + s²D½GD½)⁻¹D½c

Here, G is the Gram matrix of the signatures, and c is the product of the signatures with the data. Second, this Bayes factor is
multiplied by the posterior probability that λ = θᵀGθ is at least `WEAKEST`. Third, the product is averaged over log s². For given
s², λ is a sum of scaled non-central χ² variables; its distribution is approximated by a scaled χ² with the same mean and variance
(Patnaik, Biometrika 36, 1949). Above `STRONGEST`, the prior density continues, because a stronger effect is still the same effect.

In the functions, `gram` is the matrix G and `score` is the vector c, both in units of the prior magnitudes, so that D = I. `trace`
is the energy of an effect for an amplitude of 1; it scales the grid of s². In array shapes, p is the number of columns (one
amplitude each), and E is the number of points of a grid of s².
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array

WEAKEST, STRONGEST = 4.0, 1e4
RANGE = float(np.log(STRONGEST / WEAKEST))
_SWEEPS = 3
_ROUNDING = 1e-14  # fraction of the trace of a matrix that is added to the diagonal
ENERGIES = np.geomspace(0.5, 1e6, 25)  # grid of s², expressed as the expected energy
GAIN = 0.01
"""Standard deviation of an amplitude that is 1 for physical reasons. The fitted amplitude can differ from 1, because the effect
acts on an output that contains the scale factor error and the misalignment of the sensor. These errors are rarely larger than this
value."""


def log_bayes_factors(gram: Array, score: Array, trace: float | None = None, fixed: Sequence[int] = ()) -> Array:
    """Computes the log Bayes factor, averaged over λ, for stacked arrays gram (…, p, p) and score (…, p). The arrays are in units
    of the prior magnitudes (D = I).

    `trace`: energy of the effect for an amplitude of 1, which scales the grid of s². The default is tr(gram) of the first stacked
    array, without the fixed columns. `fixed`: columns with the amplitude 1. λ is then the energy of the other columns.
    """
    own, left = _free(gram, score, fixed)
    at = list(fixed)
    certain = score[..., at].sum(-1) - 0.5 * gram[..., at, :][..., at].sum((-2, -1))
    return certain + averaged(by_energy(own, left, trace)) if own.shape[-1] else np.asarray(certain)


def _free(gram: Array, score: Array, fixed: Sequence[int]) -> tuple[Array, Array]:
    """Returns the matrix G and the vector c of the amplitudes that are not fixed at 1, after the fixed columns have been subtracted
    from the data. `gram` (…, p, p), `score` (…, p), `fixed`: the same as in `log_bayes_factors`."""
    if not fixed:
        return gram, score
    free = np.delete(np.arange(score.shape[-1]), list(fixed))
    rows = gram[..., free, :]
    return rows[..., free], score[..., free] - rows[..., list(fixed)].sum(-1)


def averaged(terms: Array, energies: Array = ENERGIES) -> Array:
    """Averages Bayes factors over the prior of λ, and returns the logarithm of the average, an array of shape (…). `terms`: array
    of shape (…, E), log Bayes factor at each point of the grid of s². `energies`: array of shape (E,), this grid, expressed as the
    expected energy."""
    step = float(np.log(energies[1] / energies[0]))
    return np.asarray(log_mean_exp(terms, -1) + np.log(len(energies) * step / RANGE))


def by_energy(gram: Array, score: Array, trace: float | None = None) -> Array:
    """Computes the log Bayes factor at each of the E points of the grid of s², shape (…, E). `gram`: array of shape (…, p, p).
    `score`: array of shape (…, p). `trace`: the same as in `log_bayes_factors`."""
    values, vectors = np.linalg.eigh(gram)
    along = np.einsum("...ji,...j->...i", vectors, score) ** 2
    return from_eigen(np.maximum(values, 0.0), along, trace)


def from_eigen(values: Array, along: Array, trace: float | None = None) -> Array:
    """Computes the log Bayes factor at each of the E points of the grid of s², shape (…, E). `values`: array of shape (…, p),
    eigenvalues of the Gram matrix. `along`: array of shape (…, p), squared scores along its eigenvectors. `trace`: the same as in
    `log_bayes_factors`; the default is the sum of the first stacked eigenvalues."""
    if trace is None:
        trace = float(values.reshape(-1, values.shape[-1])[0].sum())
    s2 = ENERGIES[:, None] / max(trace, 1e-300)
    size = s2 * values[..., None, :]
    grown = 1 + size
    gain = s2 * along[..., None, :] / grown
    shrunk = size / grown
    found = gain * shrunk  # squared means of the amplitudes in units of the noise; their variances are `shrunk`
    strong = strong_enough((shrunk + found).sum(-1), 2 * (shrunk * (shrunk + 2 * found)).sum(-1))
    return np.asarray(gaussian(grown, gain) + strong)


def gaussian(grown: Array, gain: Array) -> Array:
    """Computes the log Bayes factor of amplitudes θ with the prior N(0, s²·D), shape (…). The energy of the amplitudes is not
    restricted.

    `grown`: array of shape (…, p), 1 + s²·μ for each eigenvalue μ of the Gram matrix. `gain`: array of shape (…, p), s² multiplied
    by the squared score and divided by `grown`."""
    return np.asarray(0.5 * (gain - np.log(grown)).sum(-1))


def strong_enough(mean: Array, variance: Array) -> Array:
    """Returns the log probability that an energy with the given mean and variance is at least `WEAKEST`. The arrays have the same
    shape and are evaluated element by element."""
    from scipy.special import gammaincc

    variance = np.maximum(variance, 1e-300)
    shape = mean**2 / variance
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(gammaincc(np.maximum(shape, 1e-12), WEAKEST * mean / variance)))


def held_log_bayes_factor(gram: Array, score: Array) -> Array:
    """Computes the log Bayes factor of an amplitude with the prior N(1, `GAIN`²). `gram`: energy of the amplitude's column.
    `score`: product of this column with the data. All arrays have the shape (…)."""
    precision = 1 / GAIN**2
    grown = gram + precision
    return np.asarray(0.5 * ((score + precision) ** 2 / grown - precision - np.log(grown / precision)))


def held_among(gram: Array, score: Array, scales: Array, held: Sequence[int]) -> float:
    """Computes the change of the log Bayes factor if the amplitudes with the indices `held` have the prior N(1, `GAIN`²) instead of
    N(0, s²). `gram`: array of shape (p, p). `score`: array of shape (p,). `scales`: array of shape (p,), s² of each amplitude. The
    change is the log ratio of the posterior to the prior density at amplitude 1 (Dickey, Ann. Math. Stat. 42, 1971)."""
    at = np.asarray(held)
    covariance = np.linalg.inv(gram + np.diag(1 / scales))
    away = 1 - (covariance @ score)[at]
    spread = covariance[np.ix_(at, at)] + GAIN**2 * np.eye(len(at))
    after = -0.5 * (away @ np.linalg.solve(spread, away) + np.linalg.slogdet(spread)[1])
    before = -0.5 * float((1 / scales[at] + np.log(scales[at])).sum())
    return float(after - before)


def best_amplitudes(
    gram: Array, score: Array, widths: Sequence[int] = (), fixed: Sequence[int] = ()
) -> tuple[Array, Array]:
    """Returns the posterior mean (p,) and covariance (p, p) of the amplitudes at the most probable s², in units of the prior
    magnitudes.

    `gram`: array of shape (p, p). `score`: array of shape (p,). `widths`: number of columns of each effect if the columns belong to
    several effects, each with a separate s². `fixed`: columns whose amplitude is 1 for physical reasons; the variance of these
    amplitudes is 0.
    """
    p = len(score)
    free = np.delete(np.arange(p), list(fixed))
    mean, covariance = np.ones(p), np.zeros((p, p))
    if len(free):
        own, left = _free(gram, score, fixed)
        owners = np.repeat(np.arange(len(widths)), widths)[free] if widths else np.zeros(len(free), dtype=int)
        among = np.bincount(owners)
        inverse = np.linalg.inv(own + np.diag(1 / best_scales(own, left, among[among > 0].tolist())))
        mean[free], covariance[np.ix_(free, free)] = inverse @ left, inverse
    return mean, covariance


def best_scales(gram: Array, score: Array, widths: Sequence[int] = ()) -> Array:
    """Returns, for each column, the most probable s² of the effect to which the column belongs, shape (p,). The arguments are those
    of `best_amplitudes`. The search varies the s² of one effect at a time and keeps the s² of the other effects fixed."""
    ends = np.cumsum(widths or (len(score),))
    parts = [slice(end - width, end) for end, width in zip(ends, widths or (len(score),), strict=True)]
    traces = [max(float(np.trace(gram[part, part])), 1e-300) for part in parts]
    scales = np.repeat(ENERGIES[-1] / np.array(traces), widths or (len(score),))
    for part, trace in list(zip(parts, traces, strict=True)) * (_SWEEPS if len(parts) > 1 else 1):
        others = np.ones(len(score), dtype=bool)
        others[part] = False
        taken = np.linalg.solve(
            gram[np.ix_(others, others)] + np.diag(1 / scales[others]), np.column_stack([gram[others], score[others]])
        )
        left = gram[part, part] - gram[part][:, others] @ taken[:, :-1][:, part]
        wanted = score[part] - gram[part][:, others] @ taken[:, -1]
        scales[part] = ENERGIES[int(np.argmax(by_energy(left, wanted, trace)))] / trace
    return scales


def pair_log_bayes_factor(gram: Array, score: Array, first: int, traces: tuple[float, float], energies: Array) -> float:
    """Returns the log Bayes factor of the hypothesis that two effects act together. The first effect has the columns 0 … first − 1,
    and the second effect has the remaining columns. The Bayes factor is averaged over the s² of each effect, on the grid
    `energies`. Each effect has at least the strength `WEAKEST`. `gram`: array of shape (p, p). `score`: array of shape (p,).
    `traces`: trace of the Gram matrix of each effect."""
    widths = (first, len(score) - first)
    one, two = np.meshgrid(energies / traces[0], energies / traces[1], indexing="ij")
    each = _at_scales(gram, score, widths, np.column_stack([one.ravel(), two.ravel()]))
    return float(averaged(averaged(each.reshape(len(energies), -1), energies), energies))


def set_log_bayes_factor(
    gram: Array, score: Array, widths: Sequence[int], traces: Sequence[float], energies: Array, near: Array
) -> float:
    """Computes the log Bayes factor for the hypothesis that several effects act together. The Bayes factor is averaged over the s²
    of each effect, on the grid `energies`. Each effect has at least the strength `WEAKEST`. `gram`: array of shape (p, p). `score`:
    array of shape (p,). `widths`, `traces`: number of columns and trace of the Gram matrix of each effect. `near`: array of shape
    (p,), the values of s² at which the search for the most probable s² starts.

    A grid over all s² together would have one dimension for each effect. Instead, the most probable s² are found for one effect at
    a time. Then the average over the s² of one effect is computed, with the other s² fixed at their most probable values. The
    result is exact if the integrand is a product of functions that each depend on the s² of one effect only.
    """
    grids = [energies / trace for trace in traces]
    start = near[np.cumsum(widths) - 1]
    at = [int(np.argmin(np.abs(np.log(grid / max(value, 1e-300))))) for grid, value in zip(grids, start, strict=True)]
    lines: list[Array] = []
    for _ in range(_SWEEPS):
        lines, before = [], list(at)
        for effect, grid in enumerate(grids):
            scales = np.array([[other[k] for other, k in zip(grids, at, strict=True)]] * len(grid))
            scales[:, effect] = grid
            lines.append(_at_scales(gram, score, widths, scales))
            at[effect] = int(np.argmax(lines[-1]))
        if at == before:
            break
    gained = [float(averaged(line, energies)) - float(line[k]) for line, k in zip(lines, at, strict=True)]
    return float(lines[-1][at[-1]]) + sum(gained)


def set_log_evidence(gram: Array, score: Array, scales: Array) -> Array:
    """Computes the log Bayes factor of Gaussian amplitudes with fixed s², for stacked arrays gram (…, p, p) and score (…, p).
    Returns an array of shape (…). `scales`: array of shape (p,), s² of each amplitude."""
    root = np.sqrt(scales)
    inner = np.eye(len(root)) + root[:, None] * gram * root
    along = root * score
    fitted = np.linalg.solve(inner, along[..., None])[..., 0]
    return np.asarray(0.5 * ((along * fitted).sum(-1) - np.linalg.slogdet(inner)[1]))


def _at_scales(gram: Array, score: Array, widths: Sequence[int], scales: Array) -> Array:
    """Returns the log Bayes factor of several effects at E combinations of their s², shape (E,). The result includes the logarithm
    of the probability that each effect has at least the strength `WEAKEST`. `gram`: array of shape (p, p). `score`: array of shape
    (p,). `widths`: number of columns of each effect. `scales`: array of shape (E, effects), the combinations."""
    p = len(score)
    root = np.sqrt(np.repeat(scales, widths, axis=1))
    inner = np.eye(p) + root[:, :, None] * gram * root[:, None, :]
    # Strong effects with nearly equal signatures: keep the matrix positive definite under rounding.
    inner += np.eye(p) * (_ROUNDING * np.trace(inner, axis1=1, axis2=2))[:, None, None]
    lower = np.linalg.cholesky(inner)
    each = -np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(1)
    covariance = root[:, :, None] * np.linalg.inv(inner) * root[:, None, :]
    amplitudes = covariance @ score
    each += 0.5 * amplitudes @ score
    ends = np.cumsum(widths)
    for part in (slice(end - width, end) for end, width in zip(ends, widths, strict=True)):
        own, spread, size = gram[part, part], covariance[:, part, part], amplitudes[:, part]
        product = own @ spread
        at = size @ own
        mean = np.trace(product, axis1=1, axis2=2) + (at * size).sum(1)
        variance = 2 * (product * np.swapaxes(product, 1, 2)).sum((1, 2)) + 4 * np.einsum(
            "ei,eij,ej->e", at, spread, at
        )
        each += strong_enough(mean, variance)
    return np.asarray(each)


def log_mean_exp(values: Array, axis: int, weights: Array | None = None) -> Array:
    """Returns the logarithm of the mean of exp(values) along an axis; the result has the shape of `values` without this axis.
    `weights`, if given, must sum to 1."""
    top = np.max(values, axis=axis, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    grown = np.exp(values - top)
    mean = grown.mean(axis=axis) if weights is None else (grown * weights).sum(axis=axis)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(mean) + np.squeeze(top, axis=axis))

"""Fits the four coefficients of inertial noise to Allan variances, by generalised least squares with the full covariance of the
variances.

The model is as follows (IEEE Std 952, annex C; τ in s, σ in the unit of the output):

    σ²(τ) = 3·Q²/τ² + N²/τ + (2·ln2/π)·B² + K²·τ/3

Q is the quantisation, N is the random walk of the integrated output (angle random walk), B is the bias instability (the flat part
of the deviation is at 0.664·B), and K is the rate random walk. The Hadamard variance uses third instead of second differences, and
so does not respond to a steady drift of the output (NIST SP 1065, 5.2.8). The model of the Hadamard variance has the same four
terms with other factors:

    Hσ²(τ) = (10/3)·Q²/τ² + N²/τ + ((8·ln2 − 3·ln3)/(2π))·B² + K²·τ/6

Overlapping variances at two averaging times are computed from the same data and are therefore correlated. Each variance is a mean
of squares of Gaussian differences, so the covariance of two variances is 2·Σ_p Σ_q C(q − p)²/(M_i·M_j). Here M_i and M_j are the
numbers of differences at the two averaging times, and C(q − p) is the covariance of difference p at one averaging time with
difference q at the other. C follows from the generalised autocovariance of the phase, which is the sum of the autocovariances of
the four kinds of noise (Greenhall and Riley, 2003). The covariance depends on the coefficients. Therefore the fit and the
covariance are computed in turn until they no longer change.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from functools import lru_cache

import numpy as np

from planrunner.base.arrays import Array, Integers
from planrunner.base.dataclass import dataclass

TERMS = ("Q", "N", "B", "K")
FLAT = 2 * math.log(2) / math.pi  # 0.4413; its root is 0.664
ALLAN, HADAMARD = 2, 3
"""Orders of the differences."""
_SIGNS = {ALLAN: (1.0, -2.0, 1.0), HADAMARD: (1.0, -3.0, 3.0, -1.0)}
_FACTORS = {ALLAN: (3.0, FLAT, 1 / 3), HADAMARD: (10 / 3, (8 * math.log(2) - 3 * math.log(3)) / (2 * math.pi), 1 / 6)}
"""Factors of the terms Q²/τ², B² and K²·τ."""
_EXACT = 48  # lags that are summed one by one; longer stretches are integrated
_ROUNDS = 12
_MOST_LENGTHS = 40


@dataclass(frozen=True)
class NoiseFit:
    """Contains the result of a fit of noise coefficients.

    `squares`: array of shape (4,), the estimates of Q²/τ0², N²/τ0, B² and K²·τ0 in the squared unit of the output, where τ0 is the
    time between phase points; 0 for omitted terms. An estimate may be negative if the output does not have this type of noise.
    Negative values are permitted, because a fit restricted to positive values would bias the other terms. `covariance`: array of
    shape (4, 4), covariance of the squares. `fitted`: array of shape (k,), the variances at the k averaging times according to the
    fitted model. `chi_square`: χ² of the fit, with `freedom` degrees of freedom. `terms`: names of the fitted terms.
    """

    squares: Array
    covariance: Array
    fitted: Array
    chi_square: float
    freedom: int
    terms: tuple[str, ...]


def model_matrix(factors: Integers, order: int = ALLAN) -> Array:
    """Returns the design matrix (k, 4) of the Allan (or Hadamard) variances at k averaging factors. Each column belongs to one
    squared coefficient, in the order of `TERMS`. The column contains the variances for the case that this squared coefficient is 1
    and the others are 0."""
    m = factors.astype(float)
    quantisation, flat, walk = _FACTORS[order]
    return np.column_stack([quantisation / m**2, 1 / m, np.full(m.size, flat), walk * m])


class VarianceCovariance:
    """Computes the covariance (k, k) of overlapping Allan (or Hadamard) variances for any mixture of the four kinds of noise.

    `factors`: array of shape (k,), averaging factors, ascending. `lengths`: number of phase points of each run.
    """

    def __init__(self, factors: Integers, lengths: Integers, order: int = ALLAN):
        lengths, counts = _grouped(np.asarray(lengths))
        terms = np.array([float(np.sum(counts * np.clip(lengths - order * m, 0, None))) for m in factors])
        scale = math.factorial(order) ** 2 / 2
        size = factors.size
        self.parts = np.zeros((size, size, 4, 4))
        for i in range(size):
            for j in range(i, size):
                part = _sum_of_squares(int(factors[i]), int(factors[j]), lengths, counts, order)
                part /= scale * float(factors[i]) ** 2 * float(factors[j]) ** 2 * terms[i] * terms[j]
                self.parts[i, j] = self.parts[j, i] = part

    def among(self, first: int, last: int) -> VarianceCovariance:
        """Returns the `VarianceCovariance` of the averaging factors whose index is at least `first` and less than `last`."""
        fewer = copy(self)
        fewer.parts = self.parts[first:last, first:last]
        return fewer

    def __call__(self, squares: Array) -> Array:
        return np.asarray(np.einsum("ijab,a,b->ij", self.parts, squares, squares))


@lru_cache(maxsize=4)
def _covariance(factors: tuple[int, ...], lengths: tuple[int, ...], order: int) -> VarianceCovariance:
    """Returns a `VarianceCovariance` from a cache. The cache is useful because the next output usually has runs of the same
    lengths. `factors`: averaging factors. `lengths`: number of phase points of each run."""
    return VarianceCovariance(np.array(factors, dtype=np.int64), np.array(lengths, dtype=np.int64), order)


def covariance_for(factors: Integers, lengths: Integers, order: int = ALLAN) -> VarianceCovariance:
    return _covariance(tuple(factors.tolist()), tuple(np.asarray(lengths).tolist()), order)


def _grouped(lengths: Integers) -> tuple[Integers, Array]:
    """Returns the distinct run lengths, and the number of runs of each length. If there are very many lengths, lengths that differ
    by a few per cent are treated as equal to the shortest of them."""
    found, counts = np.unique(lengths, return_counts=True)
    if found.size > _MOST_LENGTHS:
        edges = np.geomspace(found[0], found[-1] + 1, _MOST_LENGTHS)
        place = np.searchsorted(edges, found, side="right")
        groups = np.unique(place)
        weights = np.array([counts[place == group].sum() for group in groups])
        found, counts = np.array([found[place == group].min() for group in groups]), weights
    return found, counts.astype(float)


def _sum_of_squares(near: int, far: int, lengths: Integers, counts: Array, order: int) -> Array:
    """Returns, for every pair of kinds of noise a and b, the sum Σ_p Σ_q C_a(q − p)·C_b(q − p) over all runs, shape (4, 4). The
    index p counts differences with the averaging factor `near`, and q counts differences with the averaging factor `far` ≥ `near`.
    `lengths`, `counts`: the distinct run lengths, and the number of runs of each length."""
    points = range(order + 1)
    shifts = np.array([[a * near - b * far for b in points] for a in points], dtype=float).ravel()
    signs = np.outer(_SIGNS[order], _SIGNS[order]).ravel()
    nodes, weights = _nodes(near, far, lengths, order)
    smooth = _smooth(nodes[:, None] - shifts[None, :]) @ signs  # (3, nodes)
    weights = weights * _pairs(nodes, near, far, lengths, counts, order)
    total = np.zeros((4, 4))
    total[1:, 1:] = (smooth * weights) @ smooth.T
    places, which = np.unique(shifts, return_inverse=True)
    spikes = np.bincount(which, weights=signs)
    at_spikes = _pairs(places, near, far, lengths, counts, order) * spikes
    total[0, 0] = float(at_spikes @ spikes)
    total[0, 1:] = total[1:, 0] = (_smooth(places[:, None] - shifts[None, :]) @ signs) @ at_spikes
    return total


def _smooth(t: Array) -> Array:
    """Returns the generalised autocovariance of the phase for N, B and K at lags t [samples], shape (3, *t.shape)."""
    size = np.abs(t)
    logarithm = np.log(np.where(size > 0, size, 1.0))
    return np.stack([-size / 2, size**2 * logarithm / (2 * math.pi), size**3 / 12])


def _pairs(lag: Array, near: int, far: int, lengths: Integers, counts: Array, order: int) -> Array:
    """Returns the number of pairs of differences, over all runs, in the shape of `lag`. In a pair, one difference has the averaging
    factor `near` and the other has the averaging factor `far`, and the two are `lag` samples apart. `lengths`, `counts`: the
    distinct run lengths, and the number of runs of each length."""
    total = np.zeros(lag.shape)
    for length, count in zip(lengths, counts, strict=True):
        first, second = length - order * near, length - order * far
        if second > 0:
            total += count * np.clip(np.minimum(first, second - lag) - np.maximum(0.0, -lag), 0.0, None)
    return total


def _nodes(near: int, far: int, lengths: Integers, order: int) -> tuple[Array, Array]:
    """Returns lags and weights, one array each, for the numerical summation of a function over all lags. The function has corners
    at the lags a·near − b·far, where a and b are integers. Around these corners, it changes over a width of about `near`.
    `lengths`: the distinct run lengths."""
    longest = int(lengths.max())
    lowest, highest = -min(longest - order * near, 8 * far), min(longest - order * far, 8 * far)
    edges = {lowest, highest + 1}
    for b in range(order + 1):
        edges.update(a * near - b * far for a in range(-1, order + 2))
        reach = 2 * near
        while reach < 8 * far:
            edges.update((near - b * far - reach, near - b * far + reach))
            reach *= 2
    for length in lengths[-4:]:
        edges.update((int(length) - order * far, order * near - int(length)))
    ends = np.array(sorted(edge for edge in edges if lowest <= edge <= highest + 1))
    points, gauss = np.polynomial.legendre.leggauss(8)
    nodes, weights = [], []
    low, width = ends[:-1], np.diff(ends)
    for start, length in zip(low[width <= _EXACT], width[width <= _EXACT], strict=True):
        nodes.append(np.arange(start, start + length, dtype=float))
        weights.append(np.ones(int(length)))
    wide = width > _EXACT
    # A sum over whole lags is the integral between the half lags around them.
    nodes.append((low[wide, None] - 0.5 + width[wide, None] * (points + 1) / 2).ravel())
    weights.append((width[wide, None] * gauss / 2).ravel())
    return np.concatenate(nodes), np.concatenate(weights)


def fit_noise(
    factors: Integers,
    variances: Array,
    freedom: Array,
    lengths: Integers,
    terms: Sequence[str] = TERMS,
    order: int = ALLAN,
    covariance: VarianceCovariance | None = None,
) -> NoiseFit:
    """Fits `terms` to Allan (or Hadamard) variances (k,) at `factors`; at least one variance must be above zero. `freedom`: array
    of shape (k,), degrees of freedom of the variances, for the initial weights. `covariance`: covariance of the variances; by
    default, it is computed for runs of `lengths` phase points.

    Raises `ValueError` if there are fewer averaging times than terms.
    """
    from scipy.optimize import nnls

    chosen = [TERMS.index(name) for name in TERMS if name in terms]
    if factors.size < len(chosen):
        raise ValueError(f"{factors.size} averaging times cannot determine {len(chosen)} coefficients")
    whole = model_matrix(factors, order)
    matrix = whole[:, chosen]
    covariance_of = covariance or covariance_for(factors, lengths, order)
    positive = np.maximum(
        variances, variances[variances > 0].min()
    )  # alternating counts give 0 at even averaging factors
    weighting = np.diag(2 * positive**2 / freedom)
    squares = np.zeros(4)
    for _ in range(_ROUNDS):
        root = np.linalg.cholesky(weighting)
        white = np.linalg.solve(root, matrix)
        size = np.linalg.norm(white, axis=0)
        observed = np.linalg.solve(root, variances)
        before, squares = squares, np.zeros(4)
        squares[chosen] = nnls(white / size, observed)[0] / size
        if not squares.any():
            break
        weighting = _sound(covariance_of(squares))
        if np.allclose(squares, before, rtol=1e-6, atol=0):
            break
    full, free = np.zeros((4, 4)), np.zeros(4)
    inverse = np.linalg.pinv(white / size)
    free[chosen] = inverse @ observed / size
    gains = np.linalg.solve(root.T, (inverse / size[:, None]).T).T  # squares from variances
    full[np.ix_(chosen, chosen)] = inverse @ inverse.T / np.outer(size, size)
    full = _not_too_sure(full, free, squares, chosen, covariance_of, gains)
    residual = observed - white @ free[chosen]
    left = factors.size - len(chosen)
    fitted = whole @ free
    return NoiseFit(free, full, fitted, float(residual @ residual), left, tuple(TERMS[k] for k in chosen))


def _not_too_sure(
    full: Array, free: Array, squares: Array, chosen: Sequence[int], covariance_of: VarianceCovariance, gains: Array
) -> Array:
    """Returns the covariance of the squared coefficients, shape (4, 4). If a coefficient cannot be distinguished from zero, its
    covariance is enlarged: it is computed for a larger coefficient, two standard uncertainties above the estimate. Without this
    enlargement, a coefficient that is too small by chance would get too small an uncertainty as well. `full`: array of shape (4,
    4), the covariance before the enlargement. `free`: array of shape (4,), the estimates, which may be negative. `squares`: array
    of shape (4,), the estimates that are not negative, for which the covariance was computed. `chosen`: indices of the fitted
    coefficients. `gains`: for each fitted coefficient, its derivatives (k,) with respect to the variances."""
    widening = np.ones(4)
    for place, k in enumerate(chosen):
        spread = math.sqrt(full[k, k])
        if free[k] < 2 * spread:
            possible = squares.copy()
            possible[k] = max(0.0, free[k]) + 2 * spread
            widening[k] = max(1.0, math.sqrt(gains[place] @ covariance_of(possible) @ gains[place]) / spread)
    return np.asarray(full * np.outer(widening, widening))


def expected_covariance(factors: Integers, squares: Array, lengths: Integers, terms: Sequence[str] = TERMS) -> Array:
    """Predicts, before anything is recorded, how well `fit_noise` would determine the squared coefficients for the given noise.
    Returns their covariance, shape (4, 4). `factors`: averaging factors. `squares`: array of shape (4,), the squared coefficients
    of the given noise. `lengths`: number of phase points of each run."""
    chosen = [TERMS.index(name) for name in TERMS if name in terms]
    covariance = _sound(covariance_for(factors, lengths)(squares))
    white = np.linalg.solve(np.linalg.cholesky(covariance), model_matrix(factors)[:, chosen])
    size = np.linalg.norm(white, axis=0)
    full = np.zeros((4, 4))
    full[np.ix_(chosen, chosen)] = np.linalg.pinv((white / size).T @ (white / size)) / np.outer(size, size)
    return full


def _sound(covariance: Array) -> Array:
    """Returns the covariance after its small and negative eigenvalues have been raised to a small positive value, so that it has a
    square root. Numerical integration can cause such eigenvalues."""
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    lifted = (vectors * np.maximum(values, 1e-6)) @ vectors.T
    return np.asarray(lifted * np.outer(size, size))

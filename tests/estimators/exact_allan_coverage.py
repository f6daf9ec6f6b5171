"""How often a chi-squared interval of an overlapping Allan deviation holds the truth, exactly: from the spectrum of the noise.

The mean of the squared second differences of Gaussian noise is a sum of λ_j·χ²_1, λ the eigenvalues of their covariance over their
number. That covariance is the Fourier transform of the noise's spectrum times the squared response of a second difference; the sum's
distribution is integrated numerically (J. P. Imhof, Biometrika 48, 1961, 419). Nothing from the package.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.linalg import eigvalsh, toeplitz
from scipy.stats import chi2

POWER = {"Q": 2, "N": 0, "B": -1, "K": -2}  # of |2·sin(ω/2)|, the spectrum of the sampled rate for a coefficient of one
_FREQUENCIES = 1 << 20
_POINTS = 4_000


def covariance_of_differences(kind: str, factor: int, lags: int) -> np.ndarray:
    """Of Σ_{j<m} (y_{k+m+j} − y_{k+j}) at lags 0 …, shape (lags,), for a coefficient of one; the response is 4·sin²(mω/2)/(2·sin(ω/2))."""
    half = math.pi * np.arange(1, _FREQUENCIES // 2 + 1) / _FREQUENCIES
    density = np.full(
        _FREQUENCIES // 2 + 1, float(factor**4 if POWER[kind] == -2 else 0)
    )  # at zero, of the others nothing
    density[1:] = 16 * np.sin(factor * half) ** 4 * (2 * np.sin(half)) ** (POWER[kind] - 2)
    return np.fft.irfft(density, _FREQUENCIES)[:lags]


def true_variance(kind: str, factor: int) -> float:
    """Allan variance for a coefficient of one and samples 1 s apart."""
    return float(covariance_of_differences(kind, factor, 1)[0]) / (2 * factor**2)


@lru_cache(maxsize=64)
def weights(kind: str, factor: int, samples: int) -> np.ndarray:
    """λ of the estimate over its expectation; they add up to one. A symmetric Toeplitz matrix falls into two of half its size."""
    terms = samples + 1 - 2 * factor
    lag = covariance_of_differences(kind, factor, terms)
    whole = toeplitz(lag)
    h = terms // 2
    one, other = whole[:h, :h], whole[:h, terms - h :][:, ::-1]
    even = one + other
    if terms % 2:
        edge = math.sqrt(2) * whole[:h, h : h + 1]
        even = np.block([[even, edge], [edge.T, whole[h : h + 1, h : h + 1]]])
    parts = [eigvalsh(part) for part in (one - other, even) if part.size]
    return np.concatenate(parts) / (lag[0] * terms)


def distribution(own: np.ndarray, at: np.ndarray) -> np.ndarray:
    """P(Σ λ_j·χ²_1 < x) for each x of `at`."""
    own = own[own > 1e-12]
    step = 60 / math.sqrt(2 * np.sum(own**2)) / _POINTS
    u = (np.arange(_POINTS) + 0.5) * step
    angle, logarithm = np.zeros(_POINTS), np.zeros(_POINTS)
    for part in np.array_split(own, max(1, own.size // 100)):
        angle += 0.5 * np.arctan(np.outer(u, part)).sum(axis=1)
        logarithm += 0.25 * np.log1p(np.outer(u, part) ** 2).sum(axis=1)
    return np.array(
        [0.5 - float(np.sum(np.sin(angle - 0.5 * x * u) / (u * np.exp(logarithm)))) * step / math.pi for x in at]
    )


def exact_coverage(kind: str, factor: int, samples: int, freedom: float, probability: float = 0.95) -> float:
    """Of the interval that takes the estimate for χ² of `freedom`."""
    ends = chi2.ppf([(1 - probability) / 2, (1 + probability) / 2], freedom) / freedom
    low, high = distribution(weights(kind, factor, samples), ends)
    return float(high - low)

"""Determines how well deviations are known: identifies the type of power-law noise at each averaging time, and computes the
equivalent degrees of freedom (EDF) that follow from this type.

The type of noise is given by the exponent α of the frequency spectrum S_y ∝ f^α. White phase noise (in this field: quantisation)
has α = 2, flicker phase noise α = 1, white frequency noise (angle random walk) α = 0, flicker frequency noise (bias instability) α
= −1, and random-walk frequency noise (rate random walk) α = −2.

Sources: W. J. Riley and C. A. Greenhall, Power law noise identification using the lag 1 autocorrelation, 18th EFTF, 2004 (also NIST
SP 1065, 5.5.6); C. A. Greenhall and W. J. Riley, Uncertainty of stability variances based on finite differences, 35th PTTI, 2003
(SP 1065, 5.4.1). The phase is computed from rate samples, so it is the exact integral of the rate, not an average over a sampling
interval. Therefore the filter factor is F = ∞ for α ≤ 0. For white noise, the resulting degrees of freedom agree with the empirical
formula of SP 1065, even at the shortest averaging times. A sum whose length grows with the averaging factor is evaluated on a
coarser grid, which covers the same number of averaging times.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array, Integers

LEAST_POINTS = 30  # averages needed for the lag-1 autocorrelation to identify a noise type
MOST_POINTS = 2**20
NAMES = {
    2: "white phase",
    1: "flicker phase",
    0: "white",
    -1: "flicker",
    -2: "random walk",
    -3: "flicker walk",
    -4: "random run",
}
_GRID = 600  # terms of a sum over lags


def noise_exponent(runs: Sequence[Array], factor: int, before: int | None = None) -> int | None:
    """Determines the noise exponent α from averages of the phase over `factor` samples within its runs. Returns None if there are
    fewer than `LEAST_POINTS` averages.

    `before`: the exponent found at the next shorter averaging time. The function returns `before` if the exponent of the averages
    differs from `before` by at most half a step plus two standard deviations, because few averages are not reliable. From thirty
    averages alone, white noise would be mistaken for a neighbouring type in one of four cases.
    """
    averages, count = [], 0
    for run in runs:
        part = np.diff(run[::factor][: MOST_POINTS - count])
        if part.size >= 4:
            averages.append(part)
            count += part.size
        if count >= MOST_POINTS - 4:
            break
    if count < LEAST_POINTS:
        return None
    differenced = 0
    while True:
        delta = _delta(averages)
        if delta < 0.25 or differenced == 2:
            found = -2 * delta - 2 * differenced
            if before is not None and abs(found - before) <= 0.5 + 4 / math.sqrt(count):
                return before
            return int(np.clip(round(found), -4, 2))
        averages = [np.diff(part) for part in averages]
        differenced += 1


def _delta(parts: Sequence[Array]) -> float:
    """Returns r/(1 + r), where r is the lag-1 autocorrelation of all parts together."""
    products, squares = 0.0, 0.0
    for part in parts:
        centred = part - part.mean()
        products += float(centred[:-1] @ centred[1:])
        squares += float(centred @ centred)
    r = products / squares if squares > 0 else 0.0
    return r / (1 + r) if r > -0.999 else -999.0


def degrees_of_freedom(alpha: int, order: int, factor: int, points: int, modified: bool = False) -> float:
    """Returns the equivalent degrees of freedom (EDF) of a variance that is computed with maximum overlap; 0 if the run is too
    short for a single difference.

    `alpha`: noise exponent α. `order`: 2 for Allan, 3 for Hadamard. `factor`: averaging factor. `points`: number of phase points of
    the run. `modified`: True for the modified Allan variance, which averages the phase over each averaging time.

    The variance converges only for α > 1 − 2·order, so a smaller α is replaced by 2 − 2·order.
    """
    alpha = min(2, max(alpha, 2 - 2 * order))
    terms = points - order * factor - (factor if modified else 0) + (1 if modified else 0)
    if terms < 1:
        return 0.0
    if alpha == 2 and not modified:
        return _white_phase(order, factor, terms)
    lags = min(terms, (order + 1) * factor)
    shrink = min(1.0, _GRID / lags)
    step, count, last = factor * shrink, terms * shrink, round(lags * shrink)
    if modified:
        filtering = 1.0
    elif alpha == 1:
        filtering = step
    else:
        filtering = math.inf
    lag = np.arange(0, last + 1, dtype=float)
    covariance = _generalised(lag / step, filtering, alpha, order)
    weights = 2.0 * np.clip(1.0 - lag / count, 0.0, None)
    weights[0] = 1.0
    weights[-1] /= 2.0
    variance = float(covariance[0])
    if alpha == 1 and not modified:
        # The variance grows as the logarithm of the factor; the covariances at other lags do not.
        variance += math.comb(2 * order, order) * 2 * math.log(factor / filtering)
    return max(1.0, variance**2 * count / float(np.sum(weights * covariance**2)))


def freedom_of_runs(alpha: int, order: int, factor: int, lengths: Integers, modified: bool = False) -> float:
    """Returns the equivalent degrees of freedom (EDF) of a variance over several runs. `lengths`: number of phase points of each
    run. Runs are independent of each other, so their degrees of freedom are added. The other arguments are described in
    `degrees_of_freedom`."""
    sizes, counts = np.unique(lengths, return_counts=True)
    pairs = zip(sizes.tolist(), counts.tolist(), strict=True)
    return float(sum(count * degrees_of_freedom(alpha, order, factor, size, modified) for size, count in pairs))


def _white_phase(order: int, factor: int, terms: int) -> float:
    """Returns the degrees of freedom for white phase noise. The differences of such noise are correlated only if they are a whole
    number of averaging times apart. `terms`: number of differences in the run."""
    binomials = [math.comb(2 * order, order + k) for k in range(order + 1)]
    total = binomials[0] ** 2 + 2 * sum(
        max(0.0, 1 - k * factor / terms) * binomials[k] ** 2 for k in range(1, order + 1)
    )
    return max(1.0, binomials[0] ** 2 * terms / total)


def _generalised(t: Array, filtering: float, alpha: int, order: int) -> Array:
    """Computes s_z(t, F, α, d) of Greenhall and Riley (2003). Up to a constant factor, this is the covariance of two order-d
    differences that are t averaging times apart. `filtering`: the filter factor F."""
    signs = [(-1) ** k * math.comb(2 * order, order + k) for k in range(order + 1)]
    total: Array = signs[0] * _averaged(t, filtering, alpha)
    for k in range(1, order + 1):
        total += signs[k] * (_averaged(t - k, filtering, alpha) + _averaged(t + k, filtering, alpha))
    return total


def _averaged(t: Array, filtering: float, alpha: int) -> Array:
    """Computes the function s_x(t, F, α) of Greenhall and Riley (2003). `filtering`: the filter factor F."""
    if math.isinf(filtering):
        return _integrated(t, alpha + 2)
    width = 1.0 / filtering
    middle = 2 * _integrated(t, alpha) - _integrated(t - width, alpha) - _integrated(t + width, alpha)
    return np.asarray(filtering**2 * middle)


def _integrated(t: Array, alpha: int) -> Array:
    """Computes the function s_w(t, α) of Greenhall and Riley (2003) for α from −4 to 4."""
    size = np.abs(t)
    if alpha % 2 == 0:
        sign = -1.0 if alpha in (2, -2) else 1.0
        return np.asarray(sign * size ** (3 - alpha))
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.where(size > 0, np.log(np.where(size > 0, size, 1.0)), 0.0)
    sign = 1.0 if alpha in (1, -3) else -1.0
    return np.asarray(sign * size ** (3 - alpha) * logarithm)


def interval(deviation: float, freedom: float, probability: float) -> tuple[float, float]:
    """Returns the two-sided confidence interval of a deviation, with the confidence level `probability`. The square of the
    deviation follows a χ² distribution with `freedom` degrees of freedom."""
    from scipy.special import chdtri

    low = deviation * math.sqrt(freedom / float(chdtri(freedom, (1 - probability) / 2)))
    high = deviation * math.sqrt(freedom / float(chdtri(freedom, (1 + probability) / 2)))
    return low, high

"""Flicker for which the bench file gives no coefficient B: the largest size that the segments do not exclude, and its effect on
intervals.

Flicker increases the scatter of the segments about the model only a little, but it changes constants, which are averages over a long
span, much more. A few segments therefore cannot reveal it by their scatter, and a significance test would not find it. The question is
how large B can be. Its posterior follows from the residuals of the fit by restricted likelihood (Harville, J. Am. Stat. Assoc. 72,
1977) with the noise within the segments, whose variance is integrated out with its degrees of freedom. The prior of B is half-Cauchy
(Gelman, Bayesian Analysis 1, 2006); its scale is the B whose flicker scatters the segments as much as their noise does: a weak prior,
whose upper tail only the data can remove.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators import least_squares
from planrunner.estimators.outputs_fit import OutputsFit
from planrunner.observation.correlated_errors import CorrelatedError, mixed, stacked_roots
from planrunner.uncertainty.budget import merged
from planrunner.uncertainty.decision import coverage_factor

CREDIBLE = 0.95
"""Probability with which B is below its bound."""
SUFFICIENT = 0.90
"""Coverage to which flicker at its bound may reduce a 95 % interval without a remark."""
_ANGLES = 512  # of B: arctan(B/scale) on an even grid, on which the prior is constant
_LEAST = 0.01  # of a variance that flicker within the segments leaves for white noise


@dataclass(frozen=True, slots=True)
class OpenFlicker:
    """Flicker that the data do not exclude. quantity: name of the input. bound: of B, in the unit of the channel. output, term: index
    of the coefficient whose interval is the most affected; widening: factor by which its interval would have to be wider with B at the
    bound."""

    quantity: str
    unit: str
    bound: float
    output: int
    term: int
    widening: float


def open_flicker(fit: OutputsFit, basis: str) -> tuple[OpenFlicker, ...]:
    """Finds unstated flicker that may make an interval too narrow, at most one entry for each channel. None if the noise within the
    segments is not known."""
    if not (fit.unstated and all(noise.known for noise in fit.noises)):
        return ()
    m, p = fit.coefficients.shape
    covariance = fit.covariance(basis)
    for influence in merged(one for one in fit.influences(basis) if not one.in_scatter):
        covariance = covariance + influence.covariance
    freedom = fit.degrees_of_freedom(np.eye(m * p), basis)
    factors = np.array([coverage_factor(own) for own in freedom])
    halves = (factors * np.sqrt(covariance.diagonal())).reshape(m, p)
    found = []
    for error in fit.unstated:
        for k, change in error.changes.items():
            bound = _bound(fit, error, k)
            known = mixed(fit.noises[k].sigma, stacked_roots(fit.effects, m, len(fit.labels))[k])
            known = known + bound**2 * (change @ change.T)
            spreads = np.sqrt(np.einsum("pi,ij,pj->p", fit.gains[k], known, fit.gains[k]))
            narrow = spreads / halves[k]
            term = int(np.argmax(narrow))
            if narrow[term] * coverage_factor(math.inf, SUFFICIENT) > 1:
                widening = float(narrow[term] * coverage_factor(math.inf))
                found.append(OpenFlicker(error.quantity.name, error.quantity.unit, bound, k, term, widening))
    return tuple(found)


def _bound(fit: OutputsFit, error: CorrelatedError, output: int) -> float:
    """The bound of B from the residuals of one output, in the unit of the channel."""
    noise, change = fit.noises[output], error.changes[output]
    roots = stacked_roots(fit.effects, len(fit.outputs), len(fit.labels))[output]
    whitening = least_squares.whitener(mixed(noise.sigma, roots))
    columns, flicker = whitening @ fit.columns, whitening @ change
    orthonormal, _ = np.linalg.qr(columns, mode="complete")
    free = orthonormal[:, columns.shape[1] :].T
    included = whitening * np.sqrt(error.within.get(output, np.zeros(len(change))))
    # Contrasts that contain no coefficient, are uncorrelated and have the variance 1 + B²·λ.
    variances, vectors = np.linalg.eigh(free @ (flicker @ flicker.T - included @ included.T) @ free.T)
    squares = (vectors.T @ (free @ (whitening @ fit.fits[output].residuals))) ** 2
    sizes = np.tan((np.arange(_ANGLES) + 0.5) / _ANGLES * np.pi / 2) / _spread(flicker)
    ratios = np.maximum(1 + sizes[:, None] ** 2 * variances, _LEAST)
    chi_squared, freedom = np.sum(squares / ratios, axis=1), noise.degrees_of_freedom
    logarithm = -np.sum(np.log(ratios), axis=1) / 2
    if math.isinf(freedom):
        logarithm -= chi_squared / 2
    else:
        logarithm -= (freedom + len(squares)) / 2 * np.log1p(chi_squared / freedom)
    weights = np.cumsum(np.exp(logarithm - logarithm.max()))
    return float(sizes[min(int(np.searchsorted(weights, CREDIBLE * weights[-1])), _ANGLES - 1)])


def _spread(flicker: Array) -> float:
    """Standard deviation that flicker with B = 1 causes in observations (n, r), about their mean; for a single observation, its own
    standard deviation."""
    n = len(flicker)
    about = flicker - flicker.mean(axis=0) if n > 1 else flicker
    return float(np.sqrt(np.sum(about**2) / max(n - 1, 1)))

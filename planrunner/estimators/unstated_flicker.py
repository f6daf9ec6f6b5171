"""Estimates how large flicker may be if the bench file does not state its coefficient B: the largest size that the data do not
exclude.

Flicker increases the scatter of the segments about the model only a little, but it has a much larger effect on constants, which are
averages over a long time. A significance test of the scatter of a few segments would therefore not find the flicker. For this
reason, the module computes how large B may be. The posterior distribution of B follows from the residuals of a fit and the noise
within the segments by restricted likelihood (Harville, J. Am. Stat. Assoc. 72, 1977). The variance of this noise is known with some
degrees of freedom, and is integrated out. The prior distribution of B is half-Cauchy (Gelman, Bayesian Analysis 1, 2006). The scale
of this distribution is the value of B for which flicker scatters the segments as much as their noise does. The prior is weak: only
the data can exclude large values of B.

An estimator states how its results depend on the flicker (`UnstatedFlicker`), and which observations contain evidence of it
(`FlickerEvidence`). The analysis gives the warning (`open_flicker`).
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators import least_squares
from planrunner.observation.correlated_errors import mixed
from planrunner.uncertainty.influences import Influence

CREDIBLE = 0.95
"""Probability that B is below its bound."""
_ANGLES = 512  # of B: arctan(B/scale) on an even grid, on which the prior is constant
_MOST = 256  # observations
_LEAST = 0.01  # smallest fraction of a variance that counts as white noise


@dataclass(frozen=True, slots=True, eq=False)
class FlickerEvidence:
    """Contains the n observations of a channel, in its unit. The observations follow a linear model and may contain flicker.

    `columns`: array of shape (n, p), columns of the model. `values`: array of shape (n,), the observations. `sigma`: array of shape
    (n,), standard deviations of the noise of the observations. `freedom`: degrees of freedom of this noise. `flicker`: array of
    shape (n, r), changes of the observations per unit of each of r independent inputs; together, these inputs represent flicker
    with B = 1. `within`: array of shape (n,), the part of `sigma`² that is due to flicker with B = 1. `roots`: array of shape (n,
    q), a matrix R for which R·Rᵀ is the covariance due to the declared effects (`stacked_roots`).
    """

    columns: Array
    values: Array
    sigma: Array
    freedom: float
    flicker: Array
    within: Array
    roots: Array

    def bound(self) -> float:
        """Returns the value that the coefficient B does not exceed with the probability `CREDIBLE`, in the unit of the channel."""
        few = self._averaged()
        whitening = least_squares.whitener(mixed(few.sigma, few.roots))
        columns, flicker = whitening @ few.columns, whitening @ few.flicker
        orthonormal, _ = np.linalg.qr(columns, mode="complete")
        free = orthonormal[:, columns.shape[1] :].T
        included = whitening * np.sqrt(few.within)
        # Contrasts that contain no coefficient, are uncorrelated and have the variance 1 + B²·λ.
        variances, vectors = np.linalg.eigh(free @ (flicker @ flicker.T - included @ included.T) @ free.T)
        squares = (vectors.T @ (free @ (whitening @ few.values))) ** 2
        sizes = np.tan((np.arange(_ANGLES) + 0.5) / _ANGLES * np.pi / 2) / self._scale(flicker)
        ratios = np.maximum(1 + sizes[:, None] ** 2 * variances, _LEAST)
        chi_squared = np.sum(squares / ratios, axis=1)
        logarithm = -np.sum(np.log(ratios), axis=1) / 2
        if math.isinf(self.freedom):
            logarithm -= chi_squared / 2
        else:
            logarithm -= (self.freedom + len(squares)) / 2 * np.log1p(chi_squared / self.freedom)
        weights = np.cumsum(np.exp(logarithm - logarithm.max()))
        return float(sizes[min(int(np.searchsorted(weights, CREDIBLE * weights[-1])), _ANGLES - 1)])

    def _scale(self, whitened: Array) -> float:
        """Returns the reciprocal of the scale of the prior distribution of B. `whitened`: the whitened flicker, which is used only
        if the observations are not averaged. Otherwise, the flicker of the observations before averaging is used, divided by their
        standard deviations."""
        if len(self.values) <= _MOST:
            return _spread(whitened)
        return _spread(self.flicker / np.sqrt(self.sigma**2 + np.sum(self.roots**2, axis=1))[:, None])

    def _averaged(self) -> FlickerEvidence:
        """Returns the evidence after successive observations have been averaged, so that at most `_MOST` averages remain. The
        averages are linear functions of the observations and follow the same model. A bound that is computed from them is therefore
        valid with the same probability. For n observations, the computing time then grows with n² instead of n³."""
        n = len(self.values)
        if n <= _MOST:
            return self
        first = np.arange(0, n, -(-n // _MOST))
        counts = np.diff(np.append(first, n))

        def average(rows: Array) -> Array:
            return np.asarray(np.add.reduceat(rows, first, axis=0) / (counts if rows.ndim == 1 else counts[:, None]))

        return FlickerEvidence(
            average(self.columns),
            average(self.values),
            np.sqrt(average(self.sigma**2) / counts),
            self.freedom,
            average(self.flicker),
            average(self.within) / counts,
            average(self.roots),
        )


def _spread(flicker: Array) -> float:
    """Returns the standard deviation that flicker with B = 1 causes in the observations, computed from their changes (n, r). The
    standard deviation is taken about the mean of the observations or, for a single observation, about zero."""
    n = len(flicker)
    about = flicker - flicker.mean(axis=0) if n > 1 else flicker
    return float(np.sqrt(np.sum(about**2) / max(n - 1, 1)))


@dataclass(frozen=True, slots=True, eq=False)
class UnstatedFlicker:
    """Describes the flicker of a channel for which the bench file states no bias instability. `influence`: influence of flicker
    with B = 1, in the unit of the channel, on the coefficients of an estimate. `evidence`: the observations from which B can be
    bounded; None if the noise of the channel is not known."""

    channel: str
    influence: Influence
    evidence: FlickerEvidence | None

    def through(self, gradient: Array) -> UnstatedFlicker:
        """Returns the flicker with its influence on q quantities, which are computed from the coefficients. `gradient`: array of
        shape (q, m), ∂quantity/∂coefficient."""
        return UnstatedFlicker(self.channel, self.influence.through(gradient), self.evidence)

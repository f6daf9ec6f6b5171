"""Several outputs fitted by one design: coefficients with joint covariance on either basis, and their degrees of freedom.

Two bases of uncertainty, which answer different questions:

    within_segment   the noise seen within the segments: small and with many degrees of freedom, but blind to whatever changes from
                     segment to segment (positioning, switch-on, flicker slower than a segment, an incomplete model)
    residual         the scatter of the segments about the model: sees all that, from few degrees of freedom
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators import least_squares
from planrunner.estimators.least_squares import LinearFit
from planrunner.estimators.observations import SIGNIFICANCE, Noise, Observations, within_segment_noise

Array = NDArray[np.float64]

BASES = ("residual", "within_segment")


@dataclass(frozen=True, slots=True)
class OutputsFit:
    """m outputs fitted by p terms each from n segments.

    noises: what is known from within the segments, for each output. sigma: (m, n), the standard uncertainties that the observations were
    weighted by: the noises', or with a part between segments added (`between_segments`). between: (m,), that part. ratios: (m,), residual
    variance over that expected from the noise within the segments. pooled: whether one variance factor holds for all outputs, as it
    does when their noise stays in the proportion that is seen within the segments. gains: (m, p, n), coefficients from observations.
    cofactors: by basis, (m, p, m, p), covariance of the coefficients if the observations had `sigma` (residual) or the noises
    (within_segment) as their uncertainties and were fully correlated between outputs. stated: (m,), whether `sigma` holds uncertainties
    that were stated beside the noise.
    """

    outputs: tuple[str, ...]
    fits: tuple[LinearFit, ...]
    noises: tuple[Noise, ...]
    sigma: Array
    between: Array
    ratios: Array
    cofactors: Mapping[str, Array]
    correlation: Array
    gains: Array
    stated: NDArray[np.bool_]
    pooled: bool = False

    @property
    def coefficients(self) -> Array:
        """Shape (m, p)."""
        return np.array([fit.coefficients for fit in self.fits])

    @property
    def freedom(self) -> int:
        """Degrees of freedom of each output's residuals."""
        return self.fits[0].degrees_of_freedom

    def available(self, basis: str) -> bool:
        return self.freedom > 0 if basis == "residual" else all(noise.known for noise in self.noises)

    @property
    def variance_factors(self) -> Array:
        """Residual variance over that expected from the weights, shape (m,): one for each output, or their mean for all if pooled.

        Not below one where the weights hold what was stated: the few errors of positions say by chance that they are small, and would
        take with them the noise of segments that feel nothing of positions.
        """
        factors = np.array([fit.variance_factor for fit in self.fits])
        if self.pooled:
            return np.full_like(factors, factors.mean())
        return np.where(self.stated, np.maximum(factors, 1.0), factors)

    def scatter(self, basis: str) -> Array:
        """Covariance (m, m) of the weighted observations between outputs. Its correlation is that of the samples on either basis: the
        residuals of a few segments would say next to nothing of it."""
        sizes = np.sqrt(self.variance_factors) if basis == "residual" else np.ones(len(self.fits))
        return self.correlation * np.outer(sizes, sizes)

    def covariance(self, basis: str) -> Array:
        """Covariance of all coefficients, output after output, shape (m·p, m·p)."""
        m, p = self.coefficients.shape
        return (self.cofactors[basis] * self.scatter(basis)[:, None, :, None]).reshape(m * p, m * p)

    def degrees_of_freedom(self, gradients: Array, basis: str) -> Array:
        """Effective degrees of freedom (q,) of q quantities with the given gradients (q, m·p).

        By the Welch–Satterthwaite formula (JCGM 100:2008, G.4.1) over the outputs' shares of the variance; a pooled variance has the
        degrees of freedom of all outputs, fewer where their noise is correlated.
        """
        m, p = self.coefficients.shape
        if basis == "residual" and self.pooled:
            return np.full(len(gradients), self.freedom * m**2 / float(np.sum(self.correlation**2)))
        own = [float(self.freedom) if basis == "residual" else noise.degrees_of_freedom for noise in self.noises]
        g = gradients.reshape(-1, m, p)
        shares = np.einsum("qai,aiaj,qaj->qa", g, self.cofactors[basis], g) * np.diag(self.scatter(basis))
        total, squares = shares.sum(axis=1), (shares**2 / own).sum(axis=1)
        return np.where(squares > 0, total**2 / np.where(squares > 0, squares, 1.0), min(own))


def fit_outputs(
    matrix: Array,
    observations: Observations,
    magnitudes: Array,
    names: Sequence[str],
    basis: str = "within_segment",
    pooled: bool = False,
    equal: bool = False,
    beside: Array | None = None,
) -> OutputsFit:
    """Fit every observed channel by the same terms. Raises `EstimationError`.

    Weights come from the noise within the segments. On the residual basis, where that noise differs between segments and does not explain
    the residuals, a part between segments is added first: otherwise the quietest segment would draw the fit to itself although
    its error is as large as the others'. Outputs can be pooled only where their noise is known and needs no such part. equal: all segments
    have the same weight instead. beside: (m, n), standard uncertainties of the observations beside their noise, such as of the positions,
    by which they are weighted as well.
    """
    noises = tuple(within_segment_noise(observations, k) for k in range(len(observations.channels)))
    within = np.array([noise.sigma for noise in noises])
    sigma = within.copy() if beside is None else np.hypot(within, beside)
    stated = np.array([beside is not None and bool(beside[k].any()) for k in range(len(noises))])
    fits, between, ratios = [], np.zeros(len(noises)), np.full(len(noises), np.nan)
    for k, noise in enumerate(noises):
        observed = observations.mean[:, k]
        found = least_squares.fit(matrix, observed, noise.sigma, magnitudes, names)
        ratios[k] = found.variance_factor
        if stated[k]:
            found = least_squares.fit(matrix, observed, sigma[k], magnitudes, names)
        if equal:
            typical = float(np.sqrt(np.mean(noise.sigma**2)))
            sigma[k] = typical
            found = least_squares.fit(matrix, observed, sigma[k], magnitudes, names)
        elif basis == "residual" and (noise.unequal or stated[k]) and exceeds_noise(found, noise):
            between[k] = between_segments(matrix, observed, sigma[k], magnitudes, names)
            sigma[k] = np.hypot(sigma[k], between[k])
            found = least_squares.fit(matrix, observed, sigma[k], magnitudes, names)
        fits.append(found)
    # (AᵀWA)⁻¹·AᵀW: coefficients from observations.
    gains = np.array([fit.cofactor @ (matrix / own[:, None] ** 2).T for fit, own in zip(fits, sigma, strict=True)])
    cofactors = {}
    for name, spread in (("residual", sigma), ("within_segment", within)):
        roots = gains * spread[:, None, :]
        cofactors[name] = np.einsum("ain,bjn->aibj", roots, roots)
    pooled = pooled and all(noise.known for noise in noises) and not (between.any() or stated.any())
    correlation = observations.correlation
    return OutputsFit(
        observations.channels,
        tuple(fits),
        noises,
        sigma,
        between,
        ratios,
        cofactors,
        correlation,
        gains,
        stated,
        pooled,
    )


def exceeds_noise(found: LinearFit, noise: Noise) -> bool:
    """Whether the residuals are larger than the noise within the segments explains (F-test)."""
    from scipy.special import fdtrc

    if not (found.degrees_of_freedom and noise.known):
        return False
    return bool(fdtrc(found.degrees_of_freedom, noise.degrees_of_freedom, found.variance_factor) < SIGNIFICANCE)


def between_segments(matrix: Array, observed: Array, sigma: Array, magnitudes: Array, names: Sequence[str]) -> float:
    """The standard deviation between segments that, added to `sigma` (n,), brings chi²/dof to one (Mandel and Paule, Anal. Chem. 54, 1982).

    chi² falls steadily as it grows; found by bisection. Zero when chi²/dof does not exceed one without it.
    """
    from scipy.optimize import brentq

    def excess(width: float) -> float:
        return least_squares.fit(matrix, observed, np.hypot(sigma, width), magnitudes, names).variance_factor - 1.0

    if excess(0.0) <= 0:
        return 0.0
    high = float(np.max(sigma))
    while excess(high) > 0:
        high *= 4
    return float(brentq(excess, 0.0, high, xtol=1e-6 * float(np.min(sigma)), rtol=1e-9))

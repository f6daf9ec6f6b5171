"""Several outputs fitted by one design: coefficients with joint covariance on either basis, and their degrees of freedom.

Two bases of uncertainty, which answer different questions:

    within_segment   the noise seen within the segments: small and with many degrees of freedom, but blind to whatever changes from
                     segment to segment (positioning, switch-on, flicker slower than a segment, an incomplete model)
    residual         the scatter of the segments about the model: sees all that, from few degrees of freedom
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators import least_squares
from planrunner.estimators.interface import EstimationError
from planrunner.estimators.least_squares import LinearFit
from planrunner.estimators.observations import SIGNIFICANCE, Noise, Observations, within_segment_noise

Array = NDArray[np.float64]

BASES = ("residual", "within_segment")


@dataclass(frozen=True, slots=True)
class BasisComparison:
    """F = residual variance over within-segment variance of one output; probability: of an F this large if noise were all."""

    output: str
    ratio: float
    probability: float

    @property
    def exceeds(self) -> bool:
        return self.probability < SIGNIFICANCE


@dataclass(frozen=True, slots=True)
class OutputsFit:
    """m outputs fitted by p terms each from n segments.

    noises: what is known from within the segments, for each output. cofactors: (m, p, m, p), covariance of the coefficients if the
    weighted observations of all outputs had unit variance and were fully correlated between outputs. pooled: whether one variance
    factor holds for all outputs, as it does when their noise stays in the proportion that is seen within the segments.
    """

    outputs: tuple[str, ...]
    fits: tuple[LinearFit, ...]
    noises: tuple[Noise, ...]
    cofactors: Array
    correlation: Array
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
        """Residual variance over that expected from the weights, shape (m,): one for each output, or their mean for all if pooled."""
        factors = np.array([fit.variance_factor for fit in self.fits])
        return np.full_like(factors, factors.mean()) if self.pooled else factors

    def scatter(self, basis: str) -> Array:
        """Covariance (m, m) of the weighted observations between outputs. Its correlation is that of the samples on either basis: the
        residuals of a few segments would say next to nothing of it."""
        sizes = np.sqrt(self.variance_factors) if basis == "residual" else np.ones(len(self.fits))
        return self.correlation * np.outer(sizes, sizes)

    def covariance(self, basis: str) -> Array:
        """Covariance of all coefficients, output after output, shape (m·p, m·p)."""
        m, p = self.coefficients.shape
        return (self.cofactors * self.scatter(basis)[:, None, :, None]).reshape(m * p, m * p)

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
        shares = np.einsum("qai,aiaj,qaj->qa", g, self.cofactors, g) * np.diag(self.scatter(basis))
        total, squares = shares.sum(axis=1), (shares**2 / own).sum(axis=1)
        return np.where(squares > 0, total**2 / np.where(squares > 0, squares, 1.0), min(own))

    def comparison(self) -> tuple[BasisComparison, ...]:
        """The two bases against each other, for the outputs that have both."""
        from scipy.special import fdtrc

        found = []
        for output, fit, noise in zip(self.outputs, self.fits, self.noises, strict=True):
            if self.freedom and noise.known:
                ratio = fit.variance_factor
                found.append(
                    BasisComparison(output, ratio, float(fdtrc(self.freedom, noise.degrees_of_freedom, ratio)))
                )
        return tuple(found)


def fit_outputs(
    matrix: Array, observations: Observations, magnitudes: Array, names: Sequence[str], pooled: bool = False
) -> OutputsFit:
    """Fit every observed channel by the same terms, weighted by within-segment noise. Raises `EstimationError`.

    Outputs can be pooled only where the noise of all of them is known from within the segments.
    """
    noises = tuple(within_segment_noise(observations, k) for k in range(len(observations.channels)))
    fits = tuple(
        least_squares.fit(matrix, observations.mean[:, k], noise.sigma, magnitudes, names)
        for k, noise in enumerate(noises)
    )
    # (AᵀWA)⁻¹·Aᵀ·W^½: coefficients from weighted observations of unit variance.
    roots = np.array(
        [fit.cofactor @ (matrix / noise.sigma[:, None]).T for fit, noise in zip(fits, noises, strict=True)]
    )
    cofactors = np.einsum("ain,bjn->aibj", roots, roots)
    pooled = pooled and all(noise.known for noise in noises)
    return OutputsFit(observations.channels, fits, noises, cofactors, observations.correlation, pooled)


def require_basis(fit: OutputsFit, basis: str, name: str) -> None:
    """Raises `EstimationError` when the plan asks for a basis that the data cannot give."""
    if fit.available(basis):
        return
    if basis == "residual":
        p = fit.coefficients.shape[1]
        raise EstimationError(
            f"{name}: {p} segments for {p} coefficients leave no residual to take an uncertainty from; "
            "add segments or write `uncertainty: within_segment`"
        )
    raise EstimationError(
        f"{name}: the samples within the segments do not vary (or are too few), so there is no within-segment noise to take "
        "an uncertainty from; write `uncertainty: residual` or give the output's resolution in the bench file"
    )


def unlike_outputs(fit: OutputsFit) -> str:
    """A warning when the outputs' variance factors differ too much to be pooled; empty when they do not."""
    from scipy.special import fdtrc

    factors = np.array([one.variance_factor for one in fit.fits])
    low, high = int(np.argmin(factors)), int(np.argmax(factors))
    if not fit.freedom or factors[low] == factors[high]:
        return ""
    ratio = float(factors[high] / factors[low]) if factors[low] > 0 else np.inf
    if 2 * fdtrc(fit.freedom, fit.freedom, ratio) >= SIGNIFICANCE:
        return ""
    return (
        f"The residuals of {fit.outputs[high]} exceed its noise by more than those of {fit.outputs[low]} do (variance ratio {ratio:.3g}): "
        "write `pool_outputs: false` so that each output's uncertainty rests on its own residuals."
    )


def judge(fit: OutputsFit, basis: str) -> tuple[list[str], list[str]]:
    """Notes and warnings on the basis that was chosen, for the report."""
    notes, warnings = [], []
    if basis == "residual":
        together = ", pooled over the outputs" if fit.pooled else ""
        notes.append(
            f"Uncertainties rest on the residuals: {fit.freedom} degrees of freedom for each output{together}, "
            "so the coverage factors are large."
        )
        if fit.pooled and (different := unlike_outputs(fit)):
            warnings.append(different)
    else:
        notes.append(
            "Uncertainties rest on the noise within the segments; whatever changes from segment to segment is not in them."
        )
    for found in fit.comparison():
        text = f"{found.output}: residual variance is {found.ratio:.3g} times that expected from the noise within the segments"
        if found.exceeds:
            consequence = (
                "the within-segment uncertainties are too small"
                if basis == "within_segment"
                else "keep to the residual basis"
            )
            warnings.append(
                f"{text} (chance of that from noise alone: {found.probability:.2g}). Something changes from segment to segment "
                f"(positions, slow drift, or the model is incomplete): {consequence}."
            )
        else:
            notes.append(f"{text}, which noise alone explains (probability {found.probability:.2g}).")
    for output, noise in zip(fit.outputs, fit.noises, strict=True):
        if noise.weighting == "individual":
            notes.append(f"{output}: the noise differs between segments, so each is weighted by its own.")
    return notes, warnings

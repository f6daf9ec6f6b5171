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
    weighted observations of all outputs had unit variance and were fully correlated between outputs.
    """

    outputs: tuple[str, ...]
    fits: tuple[LinearFit, ...]
    noises: tuple[Noise, ...]
    cofactors: Array
    correlation: Array

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

    def scatter(self, basis: str) -> Array:
        """Covariance (m, m) of the weighted observations between outputs: from the residuals (Anderson, An Introduction to
        Multivariate Statistical Analysis, 8.2), or the unit variances and the samples' correlation."""
        if basis == "within_segment":
            return self.correlation
        weighted = np.array([fit.residuals / noise.sigma for fit, noise in zip(self.fits, self.noises, strict=True)])
        return weighted @ weighted.T / self.freedom

    def covariance(self, basis: str) -> Array:
        """Covariance of all coefficients, output after output, shape (m·p, m·p)."""
        m, p = self.coefficients.shape
        return (self.cofactors * self.scatter(basis)[:, None, :, None]).reshape(m * p, m * p)

    def degrees_of_freedom(self, gradients: Array, basis: str) -> Array:
        """Effective degrees of freedom (q,) of q quantities with the given gradients (q, m·p).

        The variance of a quantity is the trace of G·S with S the scatter between outputs, a Wishart matrix with ν degrees of freedom:
        ν_eff = ν·tr(GS)²/tr(GSGS). For outputs without correlation this is the Welch–Satterthwaite formula (JCGM 100:2008, G.4.1).
        """
        m, p = self.coefficients.shape
        nu = float(self.freedom) if basis == "residual" else min(noise.degrees_of_freedom for noise in self.noises)
        g = gradients.reshape(-1, m, p)
        product = np.einsum("qai,aibj,qbj->qab", g, self.cofactors, g) @ self.scatter(basis)
        trace = np.trace(product, axis1=1, axis2=2)
        square = np.trace(product @ product, axis1=1, axis2=2)
        return np.where(square > 0, nu * trace**2 / np.where(square > 0, square, 1.0), nu)

    def comparison(self) -> tuple[BasisComparison, ...]:
        """The two bases against each other, for the outputs that have both."""
        from scipy.special import fdtrc

        found = []
        for output, fit, noise in zip(self.outputs, self.fits, self.noises, strict=True):
            if self.freedom and noise.known:
                ratio = fit.variance_factor
                found.append(BasisComparison(output, ratio, float(fdtrc(self.freedom, noise.degrees_of_freedom, ratio))))
        return tuple(found)


def fit_outputs(matrix: Array, observations: Observations, magnitudes: Array, names: Sequence[str]) -> OutputsFit:
    """Fit every observed channel by the same terms, weighted by within-segment noise. Raises `EstimationError`."""
    noises = tuple(within_segment_noise(observations, k) for k in range(len(observations.channels)))
    fits = tuple(
        least_squares.fit(matrix, observations.mean[:, k], noise.sigma, magnitudes, names) for k, noise in enumerate(noises)
    )
    # (AᵀWA)⁻¹·Aᵀ·W^½: coefficients from weighted observations of unit variance.
    roots = np.array([fit.cofactor @ (matrix / noise.sigma[:, None]).T for fit, noise in zip(fits, noises, strict=True)])
    cofactors = np.einsum("ain,bjn->aibj", roots, roots)
    return OutputsFit(observations.channels, fits, noises, cofactors, observations.correlation)


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


def judge(fit: OutputsFit, basis: str) -> tuple[list[str], list[str]]:
    """Notes and warnings on the basis that was chosen, for the report."""
    notes, warnings = [], []
    if basis == "residual":
        notes.append(
            f"Uncertainties rest on the residuals: {fit.freedom} degrees of freedom for each output, so the coverage factors are large."
        )
    else:
        notes.append("Uncertainties rest on the noise within the segments; whatever changes from segment to segment is not in them.")
    for found in fit.comparison():
        text = f"{found.output}: residual variance is {found.ratio:.3g} times that expected from the noise within the segments"
        if found.exceeds:
            consequence = (
                "the within-segment uncertainties are too small" if basis == "within_segment" else "keep to the residual basis"
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

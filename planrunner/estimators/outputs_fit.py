"""Several outputs fitted by one design: coefficients with joint covariance on either basis, and their degrees of freedom.

What is known beforehand of the observations is one covariance V for each output: the noise seen within the segments, and the effects that
are stated beside it (`observation_effects`). The fit is generalised least squares with V. Two bases of uncertainty follow, which answer
different questions:

    within_segment   V is believed. The noise has its many degrees of freedom; the effects are influences, to be added. Blind to whatever
                     changes from segment to segment and is not stated (switch-on, an incomplete model)
    residual         V gives the proportions, and the scatter of the segments about the model one factor for all of it: sees what nobody
                     stated, from few degrees of freedom
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators import least_squares
from planrunner.estimators.least_squares import LinearFit
from planrunner.estimators.observation_effects import Effect, explained, functionals_of, mixed
from planrunner.estimators.observations import SIGNIFICANCE, Noise, Observations, within_segment_noise
from planrunner.uncertainty.influences import Influence

Array = NDArray[np.float64]

BASES = ("residual", "within_segment")


@dataclass(frozen=True, slots=True)
class OutputsFit:
    """m outputs fitted by p terms each from n segments.

    noises: what is known from within the segments, for each output. spreads: (m, n), the standard uncertainties that the observations were
    weighted by beside the effects: the noises', or with a part between segments added (`between_segments`). between: (m,), that part.
    ratios: (m,), residual variance over that expected from noise and effects. effects: those that are in the weights; the others (where
    an output's noise is not known) are in `unweighted`. pooled: whether one variance factor holds for all outputs, as it does when their
    noise stays in the proportion that is known beforehand; pooled_freedom: its degrees of freedom. gains: (m, p, n), coefficients from
    observations. cofactors: by basis, (m, p, m, p), covariance of the coefficients before the variance factors.
    """

    outputs: tuple[str, ...]
    fits: tuple[LinearFit, ...]
    noises: tuple[Noise, ...]
    spreads: Array
    between: Array
    ratios: Array
    effects: tuple[Effect, ...]
    unweighted: tuple[Effect, ...]
    cofactors: Mapping[str, Array]
    gains: Array
    pooled: bool = False
    pooled_freedom: float = 0.0

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

    def observed(self, output: int, basis: str) -> Array:
        """Covariance (n, n) of an output's observations that the basis rests on, before its variance factor."""
        if basis == "within_segment":
            return np.diag(self.noises[output].sigma ** 2)
        return mixed(self.spreads[output], self.effects, output)

    def covariance(self, basis: str) -> Array:
        """Covariance of all coefficients, output after output, shape (m·p, m·p)."""
        m, p = self.coefficients.shape
        size = np.sqrt(self.variance_factors) if basis == "residual" else np.ones(m)
        return (self.cofactors[basis] * np.outer(size, size)[:, None, :, None]).reshape(m * p, m * p)

    def influences(self, basis: str, functionals: Array | None = None) -> tuple[Influence, ...]:
        """The effects on the coefficients, output after output, or on whatever follows the observations by functionals (q, m, n). On the
        residual basis those that gave the weights are in the covariance already."""
        acting = functionals_of(self.gains) if functionals is None else functionals
        weighted = tuple(one.through(acting, basis == "residual") for one in self.effects)
        return (*weighted, *(one.through(acting) for one in self.unweighted))

    def degrees_of_freedom(self, gradients: Array, basis: str) -> Array:
        """Effective degrees of freedom (q,) of q quantities with the given gradients (q, m·p).

        By the Welch–Satterthwaite formula (JCGM 100:2008, G.4.1) over the outputs' shares of the variance; a pooled variance has the
        degrees of freedom of all outputs, fewer where their residuals are correlated.
        """
        m, p = self.coefficients.shape
        if basis == "residual" and self.pooled:
            return np.full(len(gradients), self.pooled_freedom)
        own = [float(self.freedom) if basis == "residual" else noise.degrees_of_freedom for noise in self.noises]
        g, whole = gradients.reshape(-1, m, p), self.covariance(basis).reshape(m, p, m, p)
        shares = np.einsum("qai,aiaj,qaj->qa", g, whole, g)
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
    effects: Sequence[Effect] = (),
) -> OutputsFit:
    """Fit every observed channel by the same terms. Raises `EstimationError`.

    Weights come from the noise within the segments and the effects. On the residual basis, where that noise differs between segments or
    there are effects, and both do not explain the residuals, a part between segments is added first: otherwise the quietest segment
    would draw the fit to itself although its error is as large as the others'. Outputs can be pooled only where their noise is
    known and needs no such part. equal: all segments have the same weight instead.
    """
    m = len(observations.channels)
    noises = [within_segment_noise(observations, k) for k in range(m)]
    acting, left = (tuple(effects), ()) if all(noise.known for noise in noises) else ((), tuple(effects))
    noises = [within_segment_noise(observations, k, explained(acting, k)) for k in range(m)]
    spreads = np.array([noise.sigma for noise in noises])
    fits, gains, between, ratios = [], [], np.zeros(m), np.full(m, np.nan)
    for k, noise in enumerate(noises):
        correlated = any(k in effect.changes for effect in acting)

        def fitted(spread: Array, k: int = k, correlated: bool = correlated) -> LinearFit:
            covariance = mixed(spread, acting, k) if correlated else None
            return least_squares.fit(matrix, observations.mean[:, k], spread, magnitudes, names, covariance)

        found = fitted(spreads[k])
        ratios[k] = found.variance_factor
        if not equal and basis == "residual" and (noise.unequal or correlated) and exceeds_noise(found, noise):
            between[k] = between_segments(fitted, spreads[k])
            spreads[k] = np.hypot(spreads[k], between[k])
            found = fitted(spreads[k])
        if equal:
            spreads[k] = np.sqrt(np.mean(noise.sigma**2))
            size = _residual_size(matrix, mixed(spreads[k], acting, k)) if correlated else spreads[k]
            found = least_squares.fit(matrix, observations.mean[:, k], size, magnitudes, names)
            weighted = matrix / size[:, None] ** 2
        elif correlated:
            weighted = np.linalg.solve(mixed(spreads[k], acting, k), matrix)
        else:
            weighted = matrix / spreads[k][:, None] ** 2
        fits.append(found)
        gains.append(found.cofactor @ weighted.T)  # (AᵀV⁻¹A)⁻¹·AᵀV⁻¹
    gained = np.array(gains)
    pooled = pooled and all(noise.known for noise in noises) and not between.any()
    return OutputsFit(
        observations.channels,
        tuple(fits),
        tuple(noises),
        spreads,
        between,
        ratios,
        acting,
        left,
        _cofactors(gained, noises, spreads, observations.correlation, acting),
        gained,
        pooled,
        _pooled_freedom(matrix, gained, spreads, observations.correlation, acting) if pooled else 0.0,
    )


def _cofactors(
    gains: Array, noises: Sequence[Noise], spreads: Array, correlation: Array, effects: Sequence[Effect]
) -> dict[str, Array]:
    """By basis. The noise's correlation between outputs is that of the samples on either basis: the residuals of a few segments would
    say next to nothing of it."""
    cofactors = {}
    for name, spread in (("residual", spreads), ("within_segment", np.array([noise.sigma for noise in noises]))):
        roots = gains * spread[:, None, :]
        cofactors[name] = np.einsum("ain,bjn->aibj", roots, roots) * correlation[:, None, :, None]
    if effects:
        moved = sum(effect.through(functionals_of(gains)).covariance for effect in effects)
        cofactors["residual"] = cofactors["residual"] + np.reshape(moved, cofactors["residual"].shape)
    return cofactors


def _pooled_freedom(
    matrix: Array, gains: Array, spreads: Array, correlation: Array, effects: Sequence[Effect]
) -> float:
    """Of the mean of the outputs' variance factors: that of a chi-squared variable with its mean and variance (Satterthwaite)."""
    m, p, n = gains.shape
    if not effects:
        return float((n - p) * m**2 / np.sum(correlation**2))
    # Residuals of weight one of each output: what two outputs' have in common decides how much the second adds.
    white = [
        least_squares.whitened(np.eye(n) - matrix @ own, mixed(spread, effects, k))
        for k, (own, spread) in enumerate(zip(gains, spreads, strict=True))
    ]
    common = 0.0
    for a in range(m):
        for b in range(m):
            joint = _between_outputs(spreads, correlation, effects, a, b)
            common += float(np.sum((white[a] @ joint @ white[b].T) ** 2))
    return (m * (n - p)) ** 2 / common if common else 0.0


def _between_outputs(spreads: Array, correlation: Array, effects: Sequence[Effect], one: int, other: int) -> Array:
    noise = np.diag(correlation[one, other] * spreads[one] * spreads[other])
    return np.asarray(noise + sum(effect.covariance(one, other) for effect in effects))


def _residual_size(matrix: Array, covariance: Array) -> Array:
    """(n,), all alike: the standard uncertainty of equally weighted observations that leads one to expect the residuals that those of
    this covariance leave on average."""
    n, p = matrix.shape
    basis = np.linalg.qr(matrix / np.abs(matrix).max(axis=0, initial=1e-300))[0]
    left = np.trace(covariance) - np.einsum("ni,nm,mi->", basis, covariance, basis)
    return np.full(n, np.sqrt(left / (n - p) if n > p else np.trace(covariance) / n))


def exceeds_noise(found: LinearFit, noise: Noise) -> bool:
    """Whether the residuals are larger than the noise within the segments explains (F-test)."""
    from scipy.special import fdtrc

    if not (found.degrees_of_freedom and noise.known):
        return False
    return bool(fdtrc(found.degrees_of_freedom, noise.degrees_of_freedom, found.variance_factor) < SIGNIFICANCE)


def between_segments(fitted: Callable[[Array], LinearFit], spread: Array) -> float:
    """The standard deviation between segments that, beside `spread` (n,), brings chi²/dof to one (Mandel and Paule, Anal. Chem. 54, 1982).

    fitted: the fit for a given spread. chi² falls steadily as it grows; found by bisection. Zero when chi²/dof does not exceed one
    without it.
    """
    from scipy.optimize import brentq

    def excess(width: float) -> float:
        return fitted(np.hypot(spread, width)).variance_factor - 1.0

    if excess(0.0) <= 0:
        return 0.0
    high = float(np.max(spread))
    while excess(high) > 0:
        high *= 4
    return float(brentq(excess, 0.0, high, xtol=1e-6 * float(np.min(spread)), rtol=1e-9))

"""Several outputs fitted by one design: coefficients with joint covariance on either basis, and their degrees of freedom.

The prior knowledge about the observations is one covariance V for each output: the noise observed within the segments, and the declared
correlated errors (`correlated_errors`). The fit is generalised least squares with V. Two bases of uncertainty follow, which answer
different questions:

    within_segment   V is used as it is. The noise has many degrees of freedom; the effects are added as influences. Does not include what
                     changes from segment to segment and is not stated (switch-on, an incomplete model)
    residual         V gives the proportions, and the scatter of the segments about the model one common factor: includes what is not
                     stated, from few degrees of freedom
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.estimators import least_squares
from planrunner.estimators.least_squares import LinearFit
from planrunner.observation.correlated_errors import CorrelatedError, explained, functionals_of, mixed, moved_together
from planrunner.observation.observations import SIGNIFICANCE, Observations, WithinSegmentNoise, within_segment_noise
from planrunner.uncertainty.influences import Influence

Array = NDArray[np.float64]

BASES = ("residual", "within_segment")


@dataclass(frozen=True, slots=True)
class OutputsFit:
    """m outputs fitted by p terms each from n segments. units: of the outputs; labels: of the segments; matrix: (n, p), the terms' columns.

    noises: what is known from within the segments, for each output. spreads: (m, n), the standard uncertainties that the observations were
    weighted by beside the effects: the noises', or with a part between segments added (`between_segments`). between: (m,), that part.
    ratios: (m,), residual variance over that expected from noise and effects. effects: those that are in the weights; the others (where
    an output's noise is not known) are in `unweighted`. pooled: whether one variance factor holds for all outputs, as it does when their
    noise stays in the proportion that is known beforehand; pooled_freedom: its degrees of freedom. gains: (m, p, n), coefficients from
    observations. cofactors: by basis, (m, p, m, p), covariance of the coefficients before the variance factors.
    """

    outputs: tuple[str, ...]
    units: tuple[str, ...]
    labels: tuple[str, ...]
    matrix: Array
    fits: tuple[LinearFit, ...]
    noises: tuple[WithinSegmentNoise, ...]
    spreads: Array
    between: Array
    ratios: Array
    effects: tuple[CorrelatedError, ...]
    unweighted: tuple[CorrelatedError, ...]
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
        return mixed(self.spreads[output], moved_together(self.effects, output, output))

    def covariance(self, basis: str) -> Array:
        """Covariance of all coefficients, output after output, shape (m·p, m·p)."""
        m, p = self.coefficients.shape
        size = np.sqrt(self.variance_factors) if basis == "residual" else np.ones(m)
        covariance: Array = (self.cofactors[basis] * np.outer(size, size)[:, None, :, None]).reshape(m * p, m * p)
        return covariance

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


def coefficients_by_noise(matrix: Array, observations: Observations, magnitudes: Array, names: Sequence[str]) -> Array:
    """The coefficients (m, p) of every observed channel by the noise within the segments alone. Raises `EstimationError`."""
    means = enumerate(observations.mean.T)
    fits = (
        least_squares.fit(matrix, mean, within_segment_noise(observations, k).sigma, magnitudes, names)
        for k, mean in means
    )
    return np.array([fit.coefficients for fit in fits])


def fit_outputs(
    matrix: Array,
    observations: Observations,
    magnitudes: Array,
    names: Sequence[str],
    basis: str = "within_segment",
    pooled: bool = False,
    equal: bool = False,
    effects: Sequence[CorrelatedError] = (),
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
    pairs = [(a, b) for a in range(m) for b in range(a + 1) if pooled or a == b]
    moved = {pair: moved_together(acting, *pair) for pair in pairs} if acting else {}
    found = []
    for k, noise in enumerate(noises):
        own = moved[k, k] if any(k in effect.changes for effect in acting) else None
        weighting = _Weighting(matrix, observations.mean[:, k], magnitudes, names, own, observations.expected)
        found.append(weighting.equal(noise) if equal else weighting.known(noise, basis == "residual"))
    spreads, gains = np.array([one.spread for one in found]), np.array([one.gains for one in found])
    between, ratios = np.array([one.between for one in found]), np.array([one.ratio for one in found])
    pooled = pooled and all(noise.known for noise in noises) and not between.any()
    return OutputsFit(
        observations.channels,
        observations.units,
        observations.labels,
        matrix,
        tuple(one.fit for one in found),
        tuple(noises),
        spreads,
        between,
        ratios,
        acting,
        left,
        _cofactors(gains, noises, spreads, observations.correlation, acting),
        gains,
        pooled,
        _pooled_freedom(matrix, gains, spreads, observations.correlation, moved) if pooled else 0.0,
    )


@dataclass(frozen=True, slots=True)
class _Fitted:
    """One fitted output; see `OutputsFit`. gains: (p, n); spread: (n,)."""

    fit: LinearFit
    gains: Array
    spread: Array
    ratio: float
    between: float = 0.0


@dataclass(frozen=True, slots=True)
class _Weighting:
    """One output's observations (n,) and the effects on them in addition to noise. moved: (n, n), what the effects add to their
    covariance; None where none acts. expected: the means have no noise, so that chi² is put at its expectation."""

    matrix: Array
    observed: Array
    magnitudes: Array
    names: Sequence[str]
    moved: Array | float | None = None
    expected: bool = False

    def known(self, noise: WithinSegmentNoise, residual: bool) -> _Fitted:
        """By noise and effects; residual: with a part between segments where the residuals ask for it."""
        spread, between = noise.sigma, 0.0
        found = self._fit(spread)
        ratio = found.variance_factor
        if residual and (noise.unequal or self.moved is not None) and exceeds_noise(found, noise):
            between = between_segments(self._fit, spread)
            spread = np.hypot(spread, between)
            found = self._fit(spread)
        covariance = self._covariance(spread)
        variances = spread[:, None] ** 2
        weighted = self.matrix / variances if covariance is None else np.linalg.solve(covariance, self.matrix)
        return _Fitted(found, found.cofactor @ weighted.T, spread, ratio, between)  # (AᵀV⁻¹A)⁻¹·AᵀV⁻¹

    def equal(self, noise: WithinSegmentNoise) -> _Fitted:
        """All segments alike. How large the residuals are for what is known is judged by the fit that weights them by it: of residuals of
        unlike size a few would decide."""
        spread = np.full(len(self.observed), np.sqrt(np.mean(noise.sigma**2)))
        found = least_squares.fit(self.matrix, self.observed, spread, self.magnitudes, self.names)
        found = replace(found, chi_squared=self._fit(spread).chi_squared)
        gains = found.cofactor @ (self.matrix / spread[:, None] ** 2).T
        return _Fitted(found, gains, spread, self._fit(noise.sigma).variance_factor)

    def _fit(self, spread: Array) -> LinearFit:
        covariance = self._covariance(spread)
        found = least_squares.fit(self.matrix, self.observed, spread, self.magnitudes, self.names, covariance)
        return replace(found, chi_squared=float(found.degrees_of_freedom)) if self.expected else found

    def _covariance(self, spread: Array) -> Array | None:
        return None if self.moved is None else mixed(spread, self.moved)


def _cofactors(
    gains: Array,
    noises: Sequence[WithinSegmentNoise],
    spreads: Array,
    correlation: Array,
    effects: Sequence[CorrelatedError],
) -> dict[str, Array]:
    """By basis. The noise's correlation between outputs is that of the samples on either basis: the residuals of a few segments would
    say next to nothing of it."""
    cofactors = {}
    for name, spread in (("residual", spreads), ("within_segment", np.array([noise.sigma for noise in noises]))):
        roots = gains * spread[:, None, :]
        m, p, n = roots.shape
        products = roots.reshape(-1, n) @ roots.reshape(-1, n).T
        cofactors[name] = products.reshape(m, p, m, p) * correlation[:, None, :, None]
    if effects:
        functionals = functionals_of(gains)
        moved = sum(effect.through(functionals).covariance for effect in effects)
        cofactors["residual"] = cofactors["residual"] + np.reshape(moved, cofactors["residual"].shape)
    return cofactors


def _pooled_freedom(
    matrix: Array, gains: Array, spreads: Array, correlation: Array, moved: Mapping[tuple[int, int], Array | float]
) -> float:
    """Of the mean of the outputs' variance factors: that of a chi-squared variable with its mean and variance (Satterthwaite). moved: by
    pair of outputs, what the effects add to the covariance of their observations."""
    m, p, n = gains.shape
    if not moved:
        return float((n - p) * m**2 / np.sum(correlation**2))
    # Residuals of weight one of each output: what two outputs' have in common decides how much the second adds.
    white = [
        least_squares.whitened(np.eye(n) - matrix @ own, mixed(spread, moved[k, k]))
        for k, (own, spread) in enumerate(zip(gains, spreads, strict=True))
    ]
    common = 0.0
    for (a, b), added in moved.items():
        joint = np.diag(correlation[a, b] * spreads[a] * spreads[b]) + added
        common += float(np.sum((white[a] @ joint @ white[b].T) ** 2)) * (1 if a == b else 2)
    return (m * (n - p)) ** 2 / common if common else 0.0


def exceeds_noise(found: LinearFit, noise: WithinSegmentNoise) -> bool:
    """Whether the residuals are larger than the noise within the segments explains (F-test)."""
    if not (found.degrees_of_freedom and noise.known and found.variance_factor > 1):
        return False
    from scipy.special import fdtrc

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

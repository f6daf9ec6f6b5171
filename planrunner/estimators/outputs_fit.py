"""Fits several outputs with the same design matrix. Gives the coefficients with their joint covariance and degrees of freedom, for
each of two kinds (bases) of uncertainty.

The prior knowledge about the observations of an output is a covariance V. V contains the noise observed within the segments and the
declared correlated errors (`correlated_errors`), which are called effects below. The fit is generalised least squares with V. The
two bases of uncertainty answer different questions:

    within_segment   V is used as it is. The noise has many degrees of freedom; the effects are added as influences. Unstated
                     changes from segment to segment (switch-on, an incomplete model) are not included.
    residual         Only the proportions of V are used. The scatter of the segments about the model gives one common factor. Unstated
                     effects are included, but there are few degrees of freedom. The noise observed within the segments is a lower
                     bound of the scatter. If the residuals are significantly smaller than this noise, the noise determines the
                     factor and its degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.kept import kept
from planrunner.estimators import least_squares
from planrunner.estimators.drift_fit import NOTHING_FITTED, FittedDrift, fitted_drift, joined, sizes
from planrunner.estimators.least_squares import LinearFit
from planrunner.estimators.unstated_flicker import FlickerEvidence, UnstatedFlicker
from planrunner.observation.correlated_errors import CorrelatedError, explained, functionals_of, mixed, stacked_roots
from planrunner.observation.drift import NO_DRIFT, DriftCourses
from planrunner.observation.observations import SIGNIFICANCE, Observations, WithinSegmentNoise, within_segment_noise
from planrunner.plan.kinds import Choice, key
from planrunner.uncertainty.influences import Influence, InputQuantity

BASES = ("residual", "within_segment")
_ROUNDING = 1e-9  # of a ratio of variances
_MANY = 1e9  # degrees of freedom that count as infinitely many
_WIDEST = 1e9  # of the largest spread: upper limit of the search for a standard deviation between segments


def uncertainty_basis(scatter: str = "segments about the model", within: str = "segments") -> str:
    """Makes the key that states the basis of the uncertainties. `scatter`: the text that completes "the scatter of the" in the
    description of the key. `within`: the text that completes "the noise within the"."""
    stated: str = key(
        Choice(BASES),
        f"Basis of the uncertainties: the scatter of the {scatter}, or the noise within the {within}.",
        "residual",
        default="residual",
    )
    return stated


@dataclass(frozen=True, slots=True)
class OutputsFit:
    """Contains the fit of m outputs to n segments, with p terms for each output. The fit may also contain a drift with q columns.

    `units`: units of the outputs. `labels`: labels of the segments. `matrix`: array of shape (n, p), the columns of the terms.
    `names`: names of the p terms. `fits`: for each output, the fit with all P = p + q columns. `noises`: for each output, the noise
    within the segments. `spreads`: array of shape (m, n), standard uncertainties for the weights, without the effects. The standard
    uncertainties include the noise within the segments and, if needed, an additional standard deviation between segments
    (`between_segments`). `between`: array of shape (m,), the additional standard deviation between segments; 0 if it is not needed.
    `ratios`: array of shape (m,), residual variance divided by the variance expected from noise and effects. `effects`: the
    correlated errors that the weights include. `unweighted`: correlated errors that the weights do not include, because the noise
    of an output is not known. `pooled`: True if one variance factor applies to all outputs, which requires that the proportions of
    the outputs' noise are known beforehand. `pooled_freedom`: degrees of freedom of this variance factor. `drift`: the drift
    functions (powers of the time or recorded temperatures) that are fitted together with the terms. `all_gains`: array of shape (m,
    P, n), derivatives of the coefficients of all P columns with respect to the observations. `all_cofactors`: for each basis, an
    array of shape (m, P, m, P), the covariance of the coefficients of all P columns without the variance factors. `within`: number
    of observations at the end that are not means of segments (`Observations`). `unstated`: effects of unknown size, each described
    for a size of one unit. The fit does not include them. `moving`: as in `Observations`. `alone`: array of shape (m,), variance
    factors of a second fit, which is weighted by the noise alone; None if the first fit is not one with equal weights.
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
    all_cofactors: Mapping[str, Array]
    all_gains: Array
    pooled: bool = False
    pooled_freedom: float = 0.0
    drift: FittedDrift = NOTHING_FITTED
    within: int = 0
    unstated: tuple[CorrelatedError, ...] = ()
    names: tuple[str, ...] = ()
    moving: bool = False
    alone: Array | None = None

    @property
    def columns(self) -> Array:
        """Returns the columns of the terms and of the fitted drift, shape (n, P)."""
        return joined(self.matrix, self.drift.courses)

    @property
    def all_coefficients(self) -> Array:
        """Returns the coefficients of the terms and of the fitted drift, shape (m, P)."""
        return np.array([fit.coefficients for fit in self.fits])

    @property
    def coefficients(self) -> Array:
        """Returns the coefficients of the terms, shape (m, p)."""
        return self.all_coefficients[:, : self.matrix.shape[1]]

    @property
    def gains(self) -> Array:
        """Returns the derivatives of the terms' coefficients with respect to the observations, shape (m, p, n)."""
        return self.all_gains[:, : self.matrix.shape[1]]

    @property
    def drift_spreads(self) -> Array:
        """Returns the standard uncertainties of the amplitudes of the fitted drift, shape (m, q). The weights include the noise and
        all effects. For the basis `residual`, the returned values must be multiplied by the square roots of the variance
        factors."""
        variances = np.einsum("apap->ap", self.all_cofactors["residual"])
        return np.asarray(np.sqrt(variances[:, self.matrix.shape[1] :]))

    def drift_freedom(self, output: int, basis: str) -> float:
        """Returns the degrees of freedom of the drift amplitudes of one output."""
        if basis == "residual" and not self.by_noise[output]:
            return self.pooled_freedom if self.pooled else float(self.freedom)
        return self.noises[output].degrees_of_freedom

    @property
    def freedom(self) -> int:
        """Returns the number of degrees of freedom of each output's residuals."""
        return self.fits[0].degrees_of_freedom

    def available(self, basis: str) -> bool:
        return self.freedom > 0 if basis == "residual" else all(noise.known for noise in self.noises)

    @property
    def variance_factors(self) -> Array:
        """Returns the variance factor of each output, shape (m,): the residual variance divided by the variance that the weights
        predict. If the outputs are pooled, all of them get the mean of these factors. The factor of an output whose residuals are
        too small (`by_noise`) is the share of the noise in the predicted variance."""
        return np.where(self.by_noise, self._noise_shares, self._residual_factors)

    @property
    def by_noise(self) -> NDArray[np.bool_]:
        """Returns True for each output whose residuals are significantly smaller than the noise within the segments (F-test with
        the level `SIGNIFICANCE`), shape (m,). The variance of a mean is at least the variance that this noise causes, so such
        residuals are small by chance, or the segments have a change in common that looks like noise. The noise then gives the
        uncertainties and the degrees of freedom of the output, also for the basis `residual`. If the segments contain motion, their
        scatter is no bound, because the motion is a part of it. An output with additional scatter between segments (`between`) is
        not tested. If all segments have the same weight, the test uses a second fit (`alone`), because F applies only to residuals
        that are divided by their own standard deviations."""
        m = len(self.fits)
        if self.moving or self.within or not self.freedom or not all(noise.known for noise in self.noises):
            return np.zeros(m, dtype=np.bool_)
        noise = np.array([one.degrees_of_freedom for one in self.noises])
        own = np.full(m, self.pooled_freedom if self.pooled else float(self.freedom))
        ratios = self._residual_factors / self._noise_shares if self.alone is None else self.alone
        if self.pooled:
            least = ratios.min() if self.alone is None else ratios.mean()
            noise, ratios = np.full(m, noise.sum()), np.full(m, least)
        if not np.any(ratios < 1 - _ROUNDING):  # predictions, too: `check` imports nothing heavy
            return np.zeros(m, dtype=np.bool_)
        from scipy.special import fdtr

        chances = fdtr(own, np.minimum(noise, _MANY), ratios)
        return np.asarray((chances < SIGNIFICANCE) & (self.between == 0))

    @property
    def _residual_factors(self) -> Array:
        factors = np.array([fit.variance_factor for fit in self.fits])
        return np.full_like(factors, factors.mean()) if self.pooled else factors

    @property
    def _noise_shares(self) -> Array:
        """Returns, for each output, the largest share that the noise has in the variance of a coefficient, shape (m,). The effects
        have the rest. Without effects, the share is 1."""
        p = self.matrix.shape[1]
        within, whole = (
            np.einsum("apap->ap", self.all_cofactors[basis])[:, :p] for basis in ("within_segment", "residual")
        )
        return np.asarray(np.max(within / np.where(whole > 0, whole, np.inf), axis=1))

    def observed(self, output: int, basis: str) -> Array:
        """Returns the covariance of an output's observations for the given kind of uncertainty, shape (n, n), without the variance
        factor."""
        if basis == "within_segment":
            return np.diag(self.noises[output].sigma ** 2)
        return mixed(self.spreads[output], stacked_roots(self.effects, len(self.outputs), len(self.labels))[output])

    def covariance(self, basis: str) -> Array:
        """Returns the covariance of all coefficients, output after output, shape (m·p, m·p)."""
        m, p = self.coefficients.shape
        size = np.sqrt(self.variance_factors) if basis == "residual" else np.ones(m)
        cofactors = self.all_cofactors[basis][:, :p, :, :p]
        covariance: Array = (cofactors * np.outer(size, size)[:, None, :, None]).reshape(m * p, m * p)
        return covariance

    def influences(self, basis: str, functionals: Array | None = None) -> tuple[Influence, ...]:
        """Returns the influences of the effects on the coefficients, which are listed output after output. If functionals (q, m, n)
        are given, returns the influences on these linear functions of the observations instead. If `basis` is `residual`, the
        covariance already includes those effects that the weights include."""
        acting = functionals_of(self.gains) if functionals is None else functionals
        doubted = tuple(one.through(acting) for one in self._doubted_drift())
        weighted = tuple(one.through(acting, basis == "residual") for one in self.effects)
        return (*weighted, *(one.through(acting) for one in self.unweighted), *doubted)

    def _doubted_drift(self) -> Iterator[CorrelatedError]:
        """Yields the doubted drift functions as errors of the observations. These drift functions are not fitted, although there is
        some evidence for them. The size of such an error is computed from the amplitude that a fit of the drift function gives."""
        for one in self.drift.doubted:
            for output, (name, own) in enumerate(zip(self.outputs, one.amplitudes, strict=True)):
                for part, amplitude, column in zip(one.course.parts, own.tolist(), one.course.columns.T, strict=True):
                    label = f"drift {one.course.name} {name} {part}".strip()
                    unit = f"{self.units[output]}/{one.course.per}"
                    source = "fitted drift, not corrected"
                    quantity = InputQuantity(label, 0.0, unit, abs(amplitude), source=source, from_residuals=True)
                    yield CorrelatedError(quantity, {output: column[:, None]})

    def unstated_flicker(self, functionals: Array | None = None) -> tuple[UnstatedFlicker, ...]:
        """Returns how flicker of unstated size changes the coefficients, which are listed output after output. If functionals (q,
        m, n) are given, returns how the flicker changes these linear functions of the observations instead."""
        if not self.unstated:
            return ()
        acting = functionals_of(self.gains) if functionals is None else functionals
        return tuple(
            UnstatedFlicker(error.channel, error.through(acting), self._evidence(output, error))
            for error in self.unstated
            for output in error.changes
        )

    def _evidence(self, output: int, error: CorrelatedError) -> FlickerEvidence | None:
        """Returns what an output's observations show about the size of the flicker; None if the noise of the output is not
        known."""
        noise = self.noises[output]
        if not all(one.known for one in self.noises):
            return None
        return FlickerEvidence(
            self.columns,
            self.fits[output].residuals,
            noise.sigma,
            noise.degrees_of_freedom,
            error.changes[output],
            error.within.get(output, np.zeros(len(noise.sigma))),
            stacked_roots(self.effects, len(self.outputs), len(self.labels))[output],
        )

    def degrees_of_freedom(self, gradients: Array, basis: str) -> Array:
        """Returns the effective degrees of freedom of q quantities, shape (q,). Their gradients with respect to all coefficients
        have the shape (q, m·p).

        The Welch–Satterthwaite formula (JCGM 100:2008, G.4.1) combines the contributions of the outputs. A pooled variance has the
        degrees of freedom of all outputs together, or fewer if the residuals of the outputs are correlated.
        """
        m, p = self.coefficients.shape
        by_noise = self.by_noise if basis == "residual" else np.ones(m, dtype=np.bool_)
        if self.pooled and not by_noise.any():
            return np.full(len(gradients), self.pooled_freedom)
        own = np.where(by_noise, [noise.degrees_of_freedom for noise in self.noises], float(self.freedom))
        g, whole = gradients.reshape(-1, m, p), self.covariance(basis).reshape(m, p, m, p)
        shares = np.einsum("qai,aiaj,qaj->qa", g, whole, g)
        total, squares = shares.sum(axis=1), (shares**2 / own).sum(axis=1)
        return np.asarray(np.where(squares > 0, total**2 / np.where(squares > 0, squares, 1.0), own.min()))


def coefficients_by_noise(matrix: Array, observations: Observations, magnitudes: Array, names: Sequence[str]) -> Array:
    """Fits every observed channel with weights that come only from the noise within the segments. Returns the coefficients, shape
    (m, p). Raises `EstimationError` if the plan or the data are not suitable. `matrix`: array of shape (n, p), design matrix.
    `magnitudes`: array of shape (p,), magnitudes of its columns."""
    sigma = np.array([within_segment_noise(observations, k).sigma for k in range(len(observations.channels))])
    return _coefficients(
        matrix, observations.mean.T, sigma / sigma.max(axis=1, keepdims=True), magnitudes, tuple(names)
    )


@kept(64)
def _coefficients(matrix: Array, observed: Array, weights: Array, magnitudes: Array, names: tuple[str, ...]) -> Array:
    """Fits the coefficients (m, p) of the outputs `observed` (m, n). `matrix`: array of shape (n, p), design matrix. `weights`:
    array of shape (m, n), standard deviations of the noise, of which only the proportions matter. `magnitudes`: array of shape
    (p,), magnitudes of the columns."""
    return np.array([one.coefficients for one in least_squares.fit_each(matrix, observed, weights, magnitudes, names)])


def fit_outputs(
    matrix: Array,
    observations: Observations,
    magnitudes: Array,
    names: Sequence[str],
    basis: str = "within_segment",
    pooled: bool = False,
    equal: bool = False,
    effects: Sequence[CorrelatedError] = (),
    drift: DriftCourses = NO_DRIFT,
    unstated: Sequence[CorrelatedError] = (),
) -> OutputsFit:
    """Fits every observed channel with the same terms. Raises `EstimationError` if the observations do not determine the
    coefficients.

    The weights come from the noise within the segments and from the effects. For the basis `residual`, a standard deviation between
    segments is added to the noise of an output under two conditions. First, noise and effects together do not explain the residuals
    of the output. Second, the noise differs between segments, or there are effects. Without this addition, the segment with the
    least noise would dominate the fit, although its actual error is as large as the errors of the other segments. Outputs are
    pooled only if `pooled` is True, their noise is known, and no standard deviation is added to it.

    `equal`: True if all segments have the same weight. `drift`: the drift functions (powers of the time or recorded temperatures)
    that are fitted too, either always or only if the data show them. `unstated`: effects of unknown size, which are not fitted.
    `matrix`: array of shape (n, p), design matrix. `magnitudes`: array of shape (p,), magnitudes of its columns.
    """
    m = len(observations.channels)
    noises = [within_segment_noise(observations, k) for k in range(m)]
    acting, left = (tuple(effects), ()) if all(noise.known for noise in noises) else ((), tuple(effects))
    noises = [within_segment_noise(observations, k, explained(acting, k)) for k in range(m)]
    roots = stacked_roots(acting, m, len(matrix))
    sigma = np.array([noise.sigma for noise in noises])
    whitening = _whitening(sigma, roots)

    def weighting_of(columns: Array, further: Sequence[str] = ()) -> _Weighting:
        return _Weighting(
            columns,
            observations.mean.T,
            sizes(magnitudes, columns),
            (*names, *further),
            roots,
            sigma,
            whitening,
            observations.expected,
            observations.within,
        )

    def fits(columns: Array) -> Sequence[LinearFit]:
        return weighting_of(columns, ("drift",) * (columns.shape[1] - len(names))).plain()

    drifting = fitted_drift(matrix, magnitudes, names, drift, noises, observations.correlation, fits, basis)
    columns = joined(matrix, drifting.courses)
    weighting = weighting_of(columns, drifting.names)
    found = weighting.equal() if equal else weighting.known(noises, basis == "residual")
    pooled = pooled and all(noise.known for noise in noises) and not found.between.any()
    return OutputsFit(
        observations.channels,
        observations.units,
        observations.labels,
        matrix,
        found.fits,
        tuple(noises),
        found.spreads,
        found.between,
        found.ratios,
        acting,
        left,
        _cofactors(found, noises, observations.correlation, roots),
        found.gains,
        pooled,
        weighting.pooled_freedom(found, observations.correlation) if pooled else 0.0,
        drifting,
        observations.within,
        tuple(unstated),
        tuple(names),
        observations.moving,
        found.alone,
    )


@dataclass(frozen=True, slots=True)
class _Fitted:
    """The fits of m outputs; the fields are described in `OutputsFit`. `whitening`: array of shape (m, n, n), for each output, the
    matrix that makes its observations uncorrelated, each with the variance one; None without effects."""

    fits: tuple[LinearFit, ...]
    gains: Array
    spreads: Array
    between: Array
    ratios: Array
    whitening: Array | None = None
    alone: Array | None = None


@dataclass(frozen=True, slots=True)
class _Weighting:
    """Contains the observations (m, n) of the outputs, with their noise and the effects on them. The weights of all fits are
    computed from these.

    `roots`: array of shape (m, n, r), matrices R for which R·Rᵀ is the covariance due to the effects (`stacked_roots`). `sigma`:
    array of shape (m, n), standard deviations of the noise. `whitening`: array of shape (m, n, n), matrices that make observations
    with noise and effects uncorrelated, each with the variance one; None without effects. The computation of `whitening` takes n³
    operations, so all fits with the same weights share it. `expected`: True if the observations are expected values without noise;
    then χ² is replaced by its expectation. `within`: number of observations at the end that are not means of segments; no scatter
    between segments is added to them.
    """

    matrix: Array
    observed: Array
    magnitudes: Array
    names: Sequence[str]
    roots: Array
    sigma: Array
    whitening: Array | None
    expected: bool = False
    within: int = 0

    def plain(self) -> list[LinearFit]:
        """Returns the fits that are weighted by noise and effects."""
        return self._fits(self.sigma, self.whitening)

    def known(self, noises: Sequence[WithinSegmentNoise], residual: bool) -> _Fitted:
        """Returns the fits that are weighted by noise and effects, with all information that `OutputsFit` needs. `residual`: True
        if a standard deviation between segments may be added to the noise when the residuals require it."""
        spreads, between, whitening = self.sigma.copy(), np.zeros(len(noises)), self.whitening
        found = self.plain()
        ratios = _factors(found)
        for k, noise in enumerate(noises):
            varied = noise.unequal or self.roots[k].any() or self.within
            if residual and exceeds_noise(found[k], noise) and varied:
                means = np.arange(len(self.matrix)) < len(self.matrix) - self.within
                between[k] = between_segments(partial(self._fit_of, k), spreads[k], means)
                spreads[k] = np.hypot(spreads[k], between[k] * means)
                found[k] = self._fit_of(k, spreads[k])
        if between.any():
            whitening = _whitening(spreads, self.roots)
        weighted = self.matrix / spreads[..., None] ** 2
        if whitening is not None:
            weighted = whitening.swapaxes(1, 2) @ (whitening @ self.matrix)
        return _Fitted(tuple(found), _gains(found, weighted), spreads, between, ratios, whitening)

    def equal(self) -> _Fitted:
        """Returns the fits in which all segments have equal weights. The residuals are compared with the noise in a second fit,
        which is weighted by noise and effects, because with equal weights a few large residuals would decide the comparison."""
        spreads = np.broadcast_to(np.sqrt(np.mean(self.sigma**2, axis=1, keepdims=True)), self.sigma.shape)
        whitening = _whitening(spreads, self.roots)
        found = self._fits(spreads, None)
        judged = zip(found, self._fits(spreads, whitening), strict=True)
        fits = tuple(replace(one, chi_squared=by.chi_squared) for one, by in judged)
        gains = _gains(fits, self.matrix / spreads[..., None] ** 2)
        ratios = _factors(self.plain())
        alone = ratios if self.whitening is None else _factors(self._fits(self.sigma, None))
        return _Fitted(fits, gains, spreads, np.zeros(len(fits)), ratios, whitening, alone)

    def pooled_freedom(self, found: _Fitted, correlation: Array) -> float:
        """Returns the degrees of freedom of the mean of the outputs' variance factors. A scaled χ² variable with these degrees of
        freedom has the same mean and variance as this mean (Satterthwaite). `correlation`: array of shape (m, m), correlation
        between the noise of the outputs."""
        m, p, n = found.gains.shape
        if found.whitening is None:
            return float((n - p) * m**2 / np.sum(correlation**2))
        # Whitened residuals of each output: a correlation between two outputs reduces the degrees of freedom.
        white = found.whitening @ (np.eye(n) - self.matrix @ found.gains)
        noise, moved = white * found.spreads[:, None], white @ self.roots
        joint = correlation[..., None, None] * (noise[:, None] @ noise.swapaxes(1, 2))
        joint = joint + moved[:, None] @ moved.swapaxes(1, 2)
        common = float(np.sum(joint**2))
        return (m * (n - p)) ** 2 / common if common else 0.0

    def _fit_of(self, output: int, spread: Array) -> LinearFit:
        """Returns the fit of one output whose noise has the standard deviations `spread` (n,)."""
        one = slice(output, output + 1)
        return self._fits(spread[None], _whitening(spread[None], self.roots[one]), one)[0]

    def _fits(self, spreads: Array, whitening: Array | None, outputs: slice = slice(None)) -> list[LinearFit]:
        observed = self.observed[outputs]
        found = least_squares.fit_each(self.matrix, observed, spreads, self.magnitudes, self.names, whitening)
        return [replace(one, chi_squared=float(one.degrees_of_freedom)) if self.expected else one for one in found]


def _whitening(spreads: Array, roots: Array) -> Array | None:
    """Returns the matrices (m, n, n) that make observations uncorrelated, each with the variance one, for noise with the standard
    deviations `spreads` (m, n) and effects with the roots `roots` (m, n, r). None without effects."""
    return least_squares.whitener(mixed(spreads, roots)) if roots.size else None


def _factors(fits: Sequence[LinearFit]) -> Array:
    return np.array([one.variance_factor for one in fits])


def _gains(fits: Sequence[LinearFit], weighted: Array) -> Array:
    """Returns the matrices (AᵀV⁻¹A)⁻¹·AᵀV⁻¹ (m, p, n), which compute the coefficients from the observations. `weighted`: array of
    shape (m, n, p), the product V⁻¹A."""
    return np.asarray(np.array([one.cofactor for one in fits]) @ weighted.swapaxes(1, 2))


def _cofactors(
    found: _Fitted, noises: Sequence[WithinSegmentNoise], correlation: Array, effects: Array
) -> dict[str, Array]:
    """Returns the covariances of the coefficients for each basis of uncertainty, without the variance factors. The correlation of
    the noise between outputs always comes from the samples, because the residuals of a few segments do not determine it. `effects`:
    array of shape (m, n, r), matrices R for which R·Rᵀ is the covariance of the observations due to the effects."""
    m, p, _ = found.gains.shape

    def products(roots: Array) -> Array:
        own = roots.reshape(m * p, -1)
        return np.asarray(own @ own.T).reshape(m, p, m, p)

    between = correlation[:, None, :, None]
    within = np.array([noise.sigma for noise in noises])
    return {
        "residual": products(found.gains * found.spreads[:, None]) * between + products(found.gains @ effects),
        "within_segment": products(found.gains * within[:, None]) * between,
    }


def exceeds_noise(found: LinearFit, noise: WithinSegmentNoise) -> bool:
    """Returns True if the noise within the segments is too small to explain the residuals (F-test)."""
    if not (found.degrees_of_freedom and noise.known and found.variance_factor > 1):
        return False
    from scipy.special import fdtrc

    return bool(fdtrc(found.degrees_of_freedom, noise.degrees_of_freedom, found.variance_factor) < SIGNIFICANCE)


def between_segments(
    fitted: Callable[[Array], LinearFit], spread: Array, means: NDArray[np.bool_] | bool = True
) -> float:
    """Computes the standard deviation between segments that must be added to the noise `spread` (n,) to make χ²/dof equal to one
    (Mandel and Paule, Anal. Chem. 54, 1982).

    `fitted`: a function that computes the fit for a given spread. `means`: array of shape (n,), True for the observations to which
    the standard deviation is added. χ²/dof decreases as the added deviation grows, so a root search finds the deviation. The result
    is zero if χ²/dof is at most one without an addition, or if no added deviation reduces χ²/dof to one.
    """
    from scipy.optimize import brentq

    def excess(width: float) -> float:
        return fitted(np.hypot(spread, width * means)).variance_factor - 1.0

    if excess(0.0) <= 0:
        return 0.0
    high = float(np.max(spread))
    while excess(high) > 0:
        high *= 4
        if high > _WIDEST * float(np.max(spread)):
            return 0.0
    return float(brentq(excess, 0.0, high, xtol=1e-12 * float(np.min(spread)), rtol=1e-12))

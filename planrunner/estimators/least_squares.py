"""Solves weighted linear least-squares problems and gives the full covariance. All estimators use this module.

The columns are divided by their declared magnitudes, and the augmented matrix [A | y] is reduced by QR. Rank, solution and
covariance follow from the small triangular matrix (Golub and Van Loan, Matrix Computations, 5.3). If the data cannot separate some
terms, an error names these terms, and no minimum-norm solution is returned.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators import rank
from planrunner.observation.refusals import EstimationError, UnfitDataError


@dataclass(frozen=True, slots=True)
class LinearFit:
    """Contains a least-squares fit of p coefficients to n observations.

    `coefficients`: array of shape (p,), fitted values. `cofactor`: array of shape (p, p), the covariance of the coefficients if
    `sigma` is the true standard uncertainty of the observations. If `sigma` is only proportional to the true standard uncertainty,
    the covariance is `cofactor` times `variance_factor`. `residuals`: array of shape (n,), observed values minus fitted values.
    `chi_squared`: the weighted sum of squared residuals. `condition`: condition number of the matrix of scaled and weighted
    columns.
    """

    coefficients: Array
    cofactor: Array
    residuals: Array
    chi_squared: float
    degrees_of_freedom: int
    condition: float

    @property
    def variance_factor(self) -> float:
        """Returns χ² divided by the degrees of freedom; NaN without degrees of freedom. The ratio is about 1 if `sigma` describes
        all errors."""
        return self.chi_squared / self.degrees_of_freedom if self.degrees_of_freedom else float("nan")


def fit(
    matrix: Array,
    observed: Array,
    sigma: Array | None = None,
    magnitudes: Array | None = None,
    names: Sequence[str] = (),
    covariance: Array | None = None,
) -> LinearFit:
    """Fits the coefficients of one output by least squares. `matrix`: array of shape (n, p), design matrix. `observed`: array of
    shape (n,). The other arguments are described in `fit_each`."""
    spread = None if sigma is None else np.asarray(sigma)[None]
    whitening = None if covariance is None else whitener(covariance[None])
    return fit_each(matrix, observed[None], spread, magnitudes, names, whitening)[0]


def fit_each(
    matrix: Array,
    observed: Array,
    sigma: Array | None = None,
    magnitudes: Array | None = None,
    names: Sequence[str] = (),
    whitening: Array | None = None,
) -> tuple[LinearFit, ...]:
    """Fits the coefficients of m outputs by least squares. `matrix`: array of shape (n, p), design matrix. `observed`: array of
    shape (m, n). Each output is fitted separately.

    `sigma`: array of shape (m, n), standard uncertainties, by default all 1. `magnitudes`: array of shape (p,), declared magnitudes
    of the columns, by default the root mean squares of the columns. `whitening`: array of shape (m, n, n), matrices from `whitener`
    for correlated observations, used instead of `sigma`. `names`: names of the terms, which are used in error messages. Raises
    `EstimationError` for too few observations, for values that are not finite, and for terms that cannot be identified.
    """
    n, p = matrix.shape
    names = names or [f"coefficient {k + 1}" for k in range(p)]
    if n < p:
        raise EstimationError(
            f"{n} observations cannot determine {p} coefficients ({', '.join(names)}): add segments or leave terms out"
        )
    scale = (
        np.sqrt(np.einsum("ij,ij->j", matrix, matrix) / n)
        if magnitudes is None
        else np.asarray(magnitudes, dtype=float)
    )
    scale = np.where(scale > 0, scale, 1.0)
    weight = None if sigma is None or whitening is not None else 1.0 / _positive(sigma)
    triangles = _triangles(matrix, observed, weight, whitening, 1.0 / scale)
    if not np.isfinite(triangles).all():
        raise UnfitDataError(
            "an observation or a planned value is not a finite number: check the segments for missing data"
        )
    left, singular, rows = np.linalg.svd(triangles[:, :p, :p])
    for values, own in zip(singular, rows, strict=True):
        if values[-1] <= rank.TOLERANCE * values[0]:
            null = own[int(np.sum(values > rank.TOLERANCE * values[0])) :]
            raise EstimationError(f"the segments cannot separate all terms: {rank.explain(null, names)}")
    inverse = rows.swapaxes(1, 2) / singular[:, None]
    coefficients = (inverse @ (left.swapaxes(1, 2) @ triangles[:, :p, p:]))[..., 0] / scale
    cofactors = (inverse @ inverse.swapaxes(1, 2)) / (scale[:, None] * scale)
    residuals = observed - coefficients @ matrix.T
    chi_squared = (triangles[:, p, p] ** 2).tolist() if n > p else [0.0] * len(observed)
    conditions = (singular[:, 0] / singular[:, -1]).tolist()
    each = zip(coefficients, cofactors, residuals, chi_squared, [n - p] * len(observed), conditions, strict=True)
    return tuple(LinearFit(*one) for one in each)


def whitener(covariance: Array) -> Array:
    """Returns the matrix W with W·V·Wᵀ = 1, shape (…, n, n). Multiplication by W makes observations with the covariance V (…, n, n)
    uncorrelated, each with the variance one."""
    return _triangular_inverse(np.asarray(np.linalg.cholesky(covariance), dtype=np.float64))


def _triangular_inverse(lower: Array) -> Array:
    """Returns the inverses of lower triangular matrices (…, n, n), computed by recursive halving. The recursion is much faster than
    a general inverse."""
    n = lower.shape[-1]
    if n <= _SMALL:
        return np.asarray(np.linalg.inv(lower))
    half = n // 2
    inverse = np.zeros_like(lower)
    inverse[..., :half, :half] = first = _triangular_inverse(lower[..., :half, :half])
    inverse[..., half:, half:] = last = _triangular_inverse(lower[..., half:, half:])
    inverse[..., half:, :half] = -last @ (lower[..., half:, :half] @ first)
    return inverse


_SMALL = 64  # rows of a matrix that is inverted as a whole


def _triangles(matrix: Array, observed: Array, weight: Array | None, whitening: Array | None, scale: Array) -> Array:
    """Returns, for each of m outputs, the matrix R of the QR factorisation of the weighted matrix [matrix·scale | observed], shape
    (m, p + 1, p + 1). With fewer than p + 1 observations, R has as many rows as observations. `whitening`: matrices (m, n, n) that
    are used instead of `weight` if observations are correlated."""
    if whitening is None and len(matrix) >= 2 * _CHUNK:
        weights = [None] * len(observed) if weight is None else list(weight)
        return np.array([_triangle(matrix, one, own, scale) for one, own in zip(observed, weights, strict=True)])
    rows = np.empty((len(observed), len(matrix), len(scale) + 1))
    rows[..., :-1], rows[..., -1] = matrix * scale, observed
    if whitening is not None:
        rows = whitening @ rows
    elif weight is not None:
        rows *= weight[..., None]
    return _r(rows)


_CHUNK = 256  # rows that one factorisation takes
_BATCH = 4  # chunks scaled and reduced at a time, so that all of it stays in the processor's cache


def _triangle(matrix: Array, observed: Array, weight: Array | None, scale: Array) -> Array:
    """Returns the matrix R of the QR factorisation of weight·[matrix·scale | observed], shape (p + 1, p + 1). This function is used
    for a matrix with many rows.

    First, chunks of rows are reduced separately. Then the resulting triangular matrices are reduced together (Demmel et al., SIAM
    J. Sci. Comput. 34, 2012).
    """
    n, p = matrix.shape
    widened = np.append(scale, 1.0)
    whole = n - n % _CHUNK
    buffer = np.empty((_CHUNK * _BATCH, p + 1))

    def scaled(low: int, high: int) -> Array:
        rows = buffer[: high - low]
        rows[:, :p] = matrix[low:high]
        rows[:, p] = observed[low:high]
        rows *= widened
        if weight is not None:
            rows *= weight[low:high, None]
        return rows

    pieces = []
    for low in range(0, whole, _CHUNK * _BATCH):
        rows = scaled(low, min(low + _CHUNK * _BATCH, whole))
        pieces.append(_r(rows.reshape(-1, _CHUNK, p + 1)).reshape(-1, p + 1))
    pieces.append(scaled(whole, n))
    return _r(np.vstack(pieces))


def _r(matrix: Array) -> Array:
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def _positive(sigma: Array) -> Array:
    sigma = np.asarray(sigma, dtype=float)
    if not (np.isfinite(sigma).all() and (sigma > 0).all()):
        raise EstimationError(
            "a standard uncertainty is zero, negative or not a number, so it cannot be used as a weight"
        )
    return sigma

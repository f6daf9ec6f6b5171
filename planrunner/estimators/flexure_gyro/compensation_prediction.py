"""Predicts the residuals after compensation from the positions, their noise, and the uncertainties declared in the bench file.

To first order, the residual of a set of coefficients at a verification position is M⁻¹·(e − x·δ). Here, e is the noise at this
position, x is the row of the design matrix for this position, and δ is the error of the coefficients. All sets of coefficients are
verified with the same noise, so the ratio of two sums of squares scatters less than a ratio of independent sums. Flicker correlates
the errors of calibration and verification, so a slow drift that is equal in both cancels. Errors of the table also cancel if a
verification position is also a calibration position.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.kept import kept


@dataclass(frozen=True, slots=True)
class Prediction:
    """Contains the predicted residuals for several sets of coefficients; the keys are the names of the sets.

    `expected`: the expected residual sum of squares of each set. `ratios`: the quantiles (5 %, median, 95 %) of the ratio of this
    sum to the sum of the first set. `expected` and `ratios` include noise and declared uncertainties. `relative_spread`: half-width
    of the central 68.27 % interval of the sum, divided by the expected sum. `ratio_spread`: half-width of the central 68.27 %
    interval of the ratio. `relative_spread` and `ratio_spread` include noise alone.
    """

    expected: dict[str, float]
    ratios: dict[str, tuple[float, float, float]]
    relative_spread: dict[str, float]
    ratio_spread: dict[str, float]


def noise_maps(verification: Array, sets: Mapping[str, Array], roots: Sequence[Array]) -> dict[str, Array]:
    """Returns, for each set of coefficients, the matrix of a linear map, shape (2·v, z). The map converts z independent inputs with
    the standard deviation 1 to the prediction errors at the v verification positions. A prediction error is the measured output
    minus the output that the set's coefficients predict. The rows of the first output come before the rows of the second output.

    `verification`: array of shape (v, p), design matrix of the verification positions. `sets`: maps the name of a set to matrices
    (2, p, n), which compute the coefficients of each output from the n observations of the calibration. `roots`: for each output, a
    matrix L (N, r) for which L·Lᵀ is the covariance of all N observations of this output. The observations at the verification
    positions come first, followed by the calibration observations of each set.
    """
    found = {}
    for name, maps in _carried(verification, sets).items():
        one, other = (own @ root for own, root in zip(maps, roots, strict=True))
        (v, z), width = one.shape, one.shape[1] + other.shape[1]
        found[name] = np.zeros((2 * v, width))
        found[name][:v, :z], found[name][v:, z:] = one, other
    return found


def expected_sum(maps: Array) -> float:
    """Returns the expected sum of squares of the r results of a linear map. `maps`: matrix (r, z) of the map; its z inputs are
    independent and have the standard deviation 1."""
    return float(np.sum(maps**2))


@kept(64)
def expected_sums(verification: Array, sets: tuple[tuple[Array, Array], ...]) -> tuple[float, ...]:
    """Computes the expected sum of squared residuals for each set of coefficients, due to noise alone. `verification`: array of
    shape (v, p), design matrix of the verification positions, where the noise has the standard deviation 1. `sets`: for each set,
    the design matrix of its calibration positions (n, p), and the standard deviations (2, n) of the noise of both outputs there."""
    noise = np.concatenate([np.ones((2, len(verification))), *(sigma for _, sigma in sets)], axis=1)
    inverses = {str(k): weighted_inverse(matrix, sigma) for k, (matrix, sigma) in enumerate(sets)}
    maps = noise_maps(verification, inverses, [np.diag(sigma) for sigma in noise])
    return tuple(map(expected_sum, maps.values()))


def predict_residuals(noise: Mapping[str, Array], stated: Mapping[str, Array], trials: int, seed: int) -> Prediction:
    """Predicts the residuals by simulating experiments with a given random seed. `noise`: for each set, a matrix (r, z) that maps z
    independent inputs of standard deviation 1 to the r residuals; the inputs represent the noise. `stated`: for each set, a matrix
    (r, s) of the same kind; its s inputs represent the declared uncertainties. In one simulated experiment, all sets have the same
    inputs. `trials`: number of experiments."""
    rng = np.random.default_rng(seed)
    first = next(iter(noise))
    drawn = rng.standard_normal((noise[first].shape[1], trials))
    inputs = rng.standard_normal((stated[first].shape[1], trials))
    alone = {name: np.sum((own @ drawn) ** 2, axis=0) for name, own in noise.items()}
    whole = {name: np.sum((own @ drawn + stated[name] @ inputs) ** 2, axis=0) for name, own in noise.items()}
    others = [name for name in noise if name != first]
    return Prediction(
        {name: expected_sum(own) + expected_sum(stated[name]) for name, own in noise.items()},
        {name: _range(whole[name] / whole[first]) for name in others},
        {name: _half(alone[name]) / expected_sum(own) for name, own in noise.items()},
        {name: _half(alone[name] / alone[first]) for name in others},
    )


def _range(drawn: Array) -> tuple[float, float, float]:
    low, middle, high = np.quantile(drawn, (0.05, 0.5, 0.95))
    return float(low), float(middle), float(high)


def _half(drawn: Array) -> float:
    """Returns the half-width of the central 68.27 % interval of the drawn values."""
    low, high = np.quantile(drawn, (0.158655, 0.841345))
    return float(high - low) / 2


def _carried(verification: Array, sets: Mapping[str, Array]) -> dict[str, list[Array]]:
    """Returns, for each set of coefficients and each output, the matrix (v, N) that computes the residuals at the verification
    positions from all observations."""
    v, total = len(verification), len(verification) + sum(gains.shape[2] for gains in sets.values())
    found, start = {}, v
    for name, gains in sets.items():
        end = start + gains.shape[2]
        found[name] = [np.zeros((v, total)) for _ in gains]
        for own, gain in zip(found[name], gains, strict=True):
            own[:, :v] = np.eye(v)
            own[:, start:end] = -verification @ gain
        start = end
    return found


def weighted_inverse(matrix: Array, sigma: Array) -> Array:
    """Returns the matrices that compute the p coefficients of m outputs from n observations by weighted least squares, shape (m, p,
    n). `sigma`: array of shape (m, n), standard deviations of the observations. `matrix`: design matrix (n, p). Its columns are
    scaled internally, because the matrix is ill-conditioned in SI units."""
    size = np.abs(matrix).max(axis=0)
    size[size == 0] = 1.0
    inverse: Array = np.linalg.pinv(matrix / sigma[..., None] / size) / size[:, None] / sigma[:, None, :]
    return inverse

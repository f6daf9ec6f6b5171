"""Expected residuals after compensation, from the positions, their noise and the uncertainties declared in the bench.

To first order, the residual of a set at a verification position is M⁻¹·(e − x·δ), where e is the noise at this position, x is the
row of the design for this position, and δ is the error of the coefficients. All sets share the verification noise, so the ratio of
two sums scatters less than a ratio of independent sums. Flicker correlates calibration and verification: a slow drift appears in
both and cancels. Errors of the table also cancel if a verification position is also a calibration position.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.kept import kept


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted residuals. expected: set → residual sum of squares. ratios: set → (5 %, median, 95 %) of the ratio of its sum to
    the sum of the first set. `expected` and `ratios` include noise and declared uncertainties. relative_spread: set → half of the
    central 68.27 % interval of the sum, divided by the expected sum. ratio_spread: set → half of the central 68.27 % interval of
    the ratio. `relative_spread` and `ratio_spread` come from noise alone."""

    expected: dict[str, float]
    ratios: dict[str, tuple[float, float, float]]
    relative_spread: dict[str, float]
    ratio_spread: dict[str, float]


def noise_maps(verification: Array, sets: Mapping[str, Array], roots: Sequence[Array]) -> dict[str, Array]:
    """A linear map (2·v, z) for each set. The map converts z independent inputs with standard deviation 1 to the outputs at the v
    verification positions, minus the outputs that the set's coefficients predict there. Rows are ordered output after output.

    verification: (v, p), design of the verification positions. sets: name of the set → (2, p, n), the matrices that compute the
    coefficients of each output from the n observations of the calibration. roots: for each output, L (N, r), where L·Lᵀ is the
    covariance of the observations of this output: first those at the verification positions, then those of each set, in the order
    of the sets.
    """
    found = {}
    for name, maps in _carried(verification, sets).items():
        one, other = (own @ root for own, root in zip(maps, roots, strict=True))
        (v, z), width = one.shape, one.shape[1] + other.shape[1]
        found[name] = np.zeros((2 * v, width))
        found[name][:v, :z], found[name][v:, z:] = one, other
    return found


def expected_sum(maps: Array) -> float:
    """The expected sum of squares of the r results that `maps` (r, z) gives for independent inputs of standard deviation one."""
    return float(np.sum(maps**2))


@kept(64)
def expected_sums(verification: Array, sets: tuple[tuple[Array, Array], ...]) -> tuple[float, ...]:
    """Expected sum of squared residuals of each set, from noise alone. verification: (v, p), design of the verification positions, where
    the noise has the standard deviation 1. sets: for each set, the design of its positions (n, p) and the standard deviations of the
    noise of both outputs there (2, n)."""
    noise = np.concatenate([np.ones((2, len(verification))), *(sigma for _, sigma in sets)], axis=1)
    inverses = {str(k): weighted_inverse(matrix, sigma) for k, (matrix, sigma) in enumerate(sets)}
    maps = noise_maps(verification, inverses, [np.diag(sigma) for sigma in noise])
    return tuple(map(expected_sum, maps.values()))


def predict_residuals(noise: Mapping[str, Array], stated: Mapping[str, Array], trials: int, seed: int) -> Prediction:
    """Predicts the residuals from simulated experiments with a given random seed. noise, stated: set → map (r, z) or (r, s) from
    independent inputs of standard deviation one to the residuals: for the noise, and for the declared uncertainties. All sets have
    the same inputs."""
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
    """Half of the width of the central 68.27 % interval."""
    low, high = np.quantile(drawn, (0.158655, 0.841345))
    return float(high - low) / 2


def _carried(verification: Array, sets: Mapping[str, Array]) -> dict[str, list[Array]]:
    """For each set and output, the matrix (v, N) that maps all observations to the residuals at the verification positions."""
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
    """The matrices that compute the coefficients from the observations, (m, p, n), for m outputs, p coefficients and n positions,
    by weighted least squares. sigma: (m, n), standard deviations of the observations. The columns of the design `matrix` (n, p) are
    scaled internally, because the design in SI units is ill-conditioned."""
    size = np.abs(matrix).max(axis=0)
    size[size == 0] = 1.0
    inverse: Array = np.linalg.pinv(matrix / sigma[..., None] / size) / size[:, None] / sigma[:, None, :]
    return inverse

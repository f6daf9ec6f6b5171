"""What residuals to expect after compensation, from the positions alone.

To first order the residual of a set on a verification position is M⁻¹·(e − x·δ), with e the noise of that position, x its row of the
design and δ the error of the coefficients. M is nearly a multiple of a rotation and drops out of ratios when both outputs have the
same noise. All sets share the verification noise, which is why single ratios scatter less than independent sums would. Flicker ties
calibration and verification together: what drifts slowly is in both and cancels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.uncertainty.monte_carlo import square_root

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Prediction:
    """expected: residual sum of squares by set, in the covariances' units, both outputs.

    ratios: by set, (5 %, median, 95 %, half of the central 68.27 %) of the ratio to the first set. relative_spread: by set, half of the
    central 68.27 % of the sum, over its expectation.
    """

    expected: dict[str, float]
    ratios: dict[str, tuple[float, float, float, float]]
    relative_spread: dict[str, float]


def expected_sums(verification: Array, sets: Mapping[str, Array], covariances: Array) -> dict[str, float]:
    """Expected residual sum of squares of each set over both outputs: what the noise of the verification positions and what that of the
    calibration make of it, exactly.

    verification: (v, p), the verification positions' design. sets: by name, (2, p, n), coefficients from the calibration's observations.
    covariances: (2, N, N), of the observations of each output, first of the v verification positions, then of the sets in their order.
    """
    carried = _carried(verification, sets)
    return {
        name: float(sum(np.trace(own @ covariance @ own.T) for own, covariance in zip(maps, covariances, strict=True)))
        for name, maps in carried.items()
    }


def predict_residuals(
    verification: Array, sets: Mapping[str, Array], covariances: Array, trials: int, seed: int
) -> Prediction:
    """The same with the scatter of the sums and of their ratios, from seeded simulated experiments."""
    rng = np.random.default_rng(seed)
    noise = [square_root(one) for one in covariances]
    drawn = [root @ rng.standard_normal((root.shape[1], trials)) for root in noise]
    expected = expected_sums(verification, sets, covariances)
    sums = {
        name: sum((np.sum((own @ one) ** 2, axis=0) for own, one in zip(maps, drawn, strict=True)), np.zeros(trials))
        for name, maps in _carried(verification, sets).items()
    }
    first = next(iter(sums))
    ratios, spreads = {}, {}
    for name, total in sums.items():
        low, high = np.quantile(total, (0.158655, 0.841345))
        spreads[name] = float(high - low) / 2 / expected[name]
        if name != first:
            five, lower, middle, upper, ninety_five = np.quantile(
                total / sums[first], (0.05, 0.158655, 0.5, 0.841345, 0.95)
            )
            ratios[name] = (float(five), float(middle), float(ninety_five), float(upper - lower) / 2)
    return Prediction(expected, ratios, spreads)


def _carried(verification: Array, sets: Mapping[str, Array]) -> dict[str, list[Array]]:
    """By set, for each output, (v, N): residuals of the verification positions from all observations."""
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
    """Coefficients per unit of each position's standardised noise, shape (p, n). Columns are scaled so that SI units do no harm."""
    size = np.abs(matrix).max(axis=0)
    size[size == 0] = 1.0
    return np.linalg.pinv(matrix / sigma[:, None] / size) / size[:, None]

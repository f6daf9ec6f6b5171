"""What residuals to expect after compensation, from the positions alone.

To first order the residual of a set on a verification position is M⁻¹·(e − x·δ), with e the noise of that position, x its row of the
design and δ the error of the coefficients. M is nearly a multiple of a rotation and drops out of ratios when both outputs have the
same noise. All sets share the verification noise, which is why single ratios scatter less than independent sums would.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SetDesign:
    """One calibration: for each output its matrix (n, p) and the noise (n,) of its positions relative to the verification's."""

    first: tuple[Array, Array]
    second: tuple[Array, Array]


@dataclass(frozen=True, slots=True)
class Prediction:
    """expected: residual sum of squares by set, in units of the verification positions' variance, both outputs.

    ratios: by set, (5 %, median, 95 %, half of the central 68.27 %) of the ratio to the first set. relative_spread: by set, half of the
    central 68.27 % of the sum, over its expectation.
    """

    expected: dict[str, float]
    ratios: dict[str, tuple[float, float, float, float]]
    relative_spread: dict[str, float]


def expected_sum(verification: Array, design: SetDesign) -> float:
    """Expected residual sum of squares over both outputs, in units of the verification positions' variance: their own noise and what
    the calibration's noise makes of it, exactly."""
    carried = [verification @ _weighted_inverse(matrix, sigma) for matrix, sigma in (design.first, design.second)]
    return 2.0 * len(verification) + float(sum(np.sum(one**2) for one in carried))


def predict_residuals(verification: Array, sets: Mapping[str, SetDesign], trials: int, seed: int) -> Prediction:
    """Expected residual sums of squares, exactly, and the scatter of their ratios from seeded simulated experiments.

    verification: (v, p), the verification positions' design, in the units of the sets' matrices.
    """
    rng = np.random.default_rng(seed)
    noise = [rng.standard_normal((trials, len(verification))) for _ in range(2)]
    expected: dict[str, float] = {}
    sums: dict[str, Array] = {}
    for name, design in sets.items():
        total = np.zeros(trials)
        for output, (matrix, sigma) in enumerate((design.first, design.second)):
            carried = verification @ _weighted_inverse(
                matrix, sigma
            )  # verification residual per unit calibration noise
            residual = noise[output] - rng.standard_normal((trials, len(matrix))) @ carried.T
            total += np.einsum("tv,tv->t", residual, residual)
        expected[name], sums[name] = expected_sum(verification, design), total
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


def _weighted_inverse(matrix: Array, sigma: Array) -> Array:
    """Coefficients per unit of each position's standardised noise, shape (p, n). Columns are scaled so that SI units do no harm."""
    size = np.abs(matrix).max(axis=0)
    size[size == 0] = 1.0
    return np.linalg.pinv(matrix / sigma[:, None] / size) / size[:, None]

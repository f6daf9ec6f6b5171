"""Calibrates an accelerometer triad from the magnitude of gravity alone: nine parameters from still poses in unknown attitudes.

The model of the readings is a = b + A·f with |f| = g. Only A·Aᵀ can be determined. The parameters of the model are therefore the
scale factors s_i and biases b_i of three input axes, and the non-orthogonalities γ_ij. The angle between the axes i and j is 90° −
γ_ij:

    (a − b)ᵀ·G⁻¹·(a − b) = g²,    G_ij = s_i·s_j·sin γ_ij (i ≠ j),   G_ii = s_i²

(Shin and El-Sheimy, Z. Vermessung 2002; Frosio et al., IEEE Trans. Instrum. Meas. 58, 2009.) The equations are solved by
Gauss–Newton steps that start from b = 0, s = 1, γ = 0.
"""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import count_of
from planrunner.estimators import rank
from planrunner.estimators.interface import EstimationError, UnfitDataError
from planrunner.uncertainty.derivatives import jacobian

NAMES = ("bias_x", "bias_y", "bias_z", "scale_x", "scale_y", "scale_z", "gamma_xy", "gamma_xz", "gamma_yz")
_PAIRS = ((0, 1), (0, 2), (1, 2))
_ITERATIONS = 50
_WORST_CONDITION = 1e4


@dataclass(frozen=True, slots=True)
class GravityFit:
    """A fit of the magnitude of gravity.

    `values`: array of shape (9,), in the order of `NAMES`; m/s² for biases, ratios for scale factors, rad for angles. `residuals`:
    array of shape (n,) in m/s², residuals of |f| − g. `jacobian`: array of shape (n, 9), derivatives of the residuals with respect
    to the parameters. `directions`: array of shape (n, 3), derivatives of the residuals with respect to the readings. `condition`:
    condition number of the Jacobian after the columns of the biases are divided by g.
    """

    values: Array
    residuals: Array
    jacobian: Array
    directions: Array
    condition: float


def fit_magnitude(readings: Array, gravity: float) -> GravityFit:
    """Fits the nine parameters with equal weights. `readings`: array of shape (n, 3) in m/s², mean readings of n ≥ 9 still poses.
    `gravity`: local gravity, m/s². Raises `EstimationError` if the poses do not determine the parameters."""
    if len(readings) < len(NAMES):
        raise EstimationError(too_few(len(readings)))
    values = np.array([0.0, 0, 0, 1, 1, 1, 0, 0, 0])
    scale = np.array([gravity, gravity, gravity, 1, 1, 1, 1, 1, 1])
    for _ in range(_ITERATIONS):
        residuals, jacobian, _ = _linearise(readings, values, gravity)
        sight = rank.look(jacobian * scale)
        if sight.condition > _WORST_CONDITION:
            raise EstimationError(_too_alike(sight, readings))
        step = -scale * np.linalg.lstsq(jacobian * scale, residuals, rcond=None)[0]
        values = values + step
        if not (np.isfinite(values).all() and np.all(values[3:6] > 0.1) and np.all(np.abs(values[6:]) < 1.0)):
            break
        if np.abs(step / scale).max() < 1e-13:
            residuals, jacobian, directions = _linearise(readings, values, gravity)
            return GravityFit(values, residuals, jacobian, directions, rank.look(jacobian * scale).condition)
    raise UnfitDataError(
        "the readings are not close to a sphere of radius g, so no calibration was found: check the units of the "
        "channels, and whether the sensor was at rest in the spans"
    )


def too_few(count: int) -> str:
    """Returns the message that there are fewer poses than parameters."""
    return f"{count_of(count, 'pose')} cannot determine {len(NAMES)} parameters"


def _too_alike(sight: rank.MatrixRank, readings: Array) -> str:
    if len(sight.null):
        return f"the poses cannot separate all nine parameters: {rank.explain(sight.null, NAMES)}; add poses in other attitudes"
    return (
        f"the {len(readings)} poses are too similar to separate nine parameters (condition {sight.condition:.2g}): "
        "point every axis up and down and add poses in between"
    )


def _linearise(readings: Array, values: Array, gravity: float) -> tuple[Array, Array, Array]:
    """Returns the residuals |f| − g (n,), their Jacobian (n, 9) with respect to the parameters, and their gradient (n, 3) with
    respect to the readings. `readings`: array of shape (n, 3), m/s². `values`: array of shape (9,), the parameters in the order of
    `NAMES`. `gravity`: local gravity, m/s²."""
    size = _magnitude(readings[..., None], values[:, None])[:, 0]
    slopes = jacobian(lambda changed: _magnitude(readings[..., None], changed), values)
    # A residual depends only on the readings of its own pose, so the readings of all poses are changed together.
    by_reading = jacobian(lambda by: _magnitude(readings[..., None] + by, values[:, None]), np.zeros(3))
    return size - gravity, slopes, by_reading


def _magnitude(readings: Array, values: Array) -> Array:
    """Computes |f| from readings (n, 3, k) and parameters `values` (9, k), where either k may be 1. Returns an array of shape (n,
    k)."""
    bias, scale, gamma = values[:3], values[3:6], values[6:]
    cosines = np.broadcast_to(np.eye(3)[..., None], (3, 3, values.shape[1])).astype(values.dtype)
    for (i, j), angle in zip(_PAIRS, gamma, strict=True):
        cosines[i, j] = cosines[j, i] = np.sin(angle)
    gram = np.moveaxis(cosines * scale[:, None] * scale, -1, 0)
    away = np.moveaxis(readings - bias, -1, 0)  # (k, n, 3)
    dual = np.swapaxes(np.linalg.solve(gram, np.swapaxes(away, 1, 2)), 1, 2)  # G⁻¹·(a − b)
    return np.asarray(np.sqrt(np.sum(away * dual, axis=2)).T)

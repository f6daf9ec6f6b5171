"""Relates the physical coefficients of a flexure gyro to the coefficients of its two outputs.

Static model of the torquer outputs (CN100554884C), rows of the design matrix [1, ω_Y, ω_X, a_X, a_Y, a_Z]:

    i_x = U0 + U1·ω_Y + U2·ω_X + U3·a_X + U4·a_Y + U5·a_Z        i_y = V0 + V1·ω_Y + V2·ω_X + V3·a_X + V4·a_Y + V5·a_Z

    U1 =  cos(ε+ξ)/(SF_Y·cos ξ)   U2 = sin(ε+ξ)/(SF_Y·cos ξ)   V1 = −sin ε/(SF_X·cos ξ)   V2 = cos ε/(SF_X·cos ξ)
    [U_k; V_k] = M·[D(X)_k; D(Y)_k],   M = [[U1, U2], [V1, V2]],   k = F, X, Y, Z for columns 0, 3, 4, 5

As in the source, D(X) belongs to the ω_Y column and D(Y) to the ω_X column. D(X) is therefore the drift of the output that senses the
rate about Y. Product terms are further columns k. All values are in SI units: scale factors in rad/s per output unit, angles in rad,
drifts in rad/s and in rad/s per m/s^2 (or per (m/s^2)^2).
"""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.terms import (
    ACCEL_X,
    ACCEL_X_ACCEL_Z,
    ACCEL_Y,
    ACCEL_Y_ACCEL_Z,
    ACCEL_Z,
    BIAS,
    RATE_X,
    RATE_Y,
    ErrorModel,
    Term,
)

PRODUCTS: dict[str, tuple[Term, str]] = {
    "accel_x_accel_z": (ACCEL_X_ACCEL_Z, "XZ"),
    "accel_y_accel_z": (ACCEL_Y_ACCEL_Z, "YZ"),
}
SCALE_FACTORS = ("SF_X", "SF_Y")
_GEOMETRY = (*SCALE_FACTORS, "epsilon", "xi")
_DRIFTS = ("F", "X", "Y", "Z")
_DRIFT_COLUMNS = (0, 3, 4, 5)


def static_model(products: tuple[str, ...] = ()) -> ErrorModel:
    """Returns the static model, which is the same for both outputs: bias, ω_Y, ω_X, a_X, a_Y, a_Z and the chosen `PRODUCTS`."""
    return ErrorModel((BIAS, RATE_Y, RATE_X, ACCEL_X, ACCEL_Y, ACCEL_Z, *(PRODUCTS[name][0] for name in products)))


def physical_names(products: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Returns the names of the physical coefficients, SF_X, SF_Y, epsilon, xi, D_X_F, D_X_X, …, D_Y_F, …: twelve names, and two
    more for each product term."""
    return (*_GEOMETRY, *(f"D_{axis}_{drift}" for axis in "XY" for drift in drifts(products)))


def drifts(products: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Returns the letters of the drift coefficients of one axis: F, X, Y, Z, and one more for each product term."""
    return (*_DRIFTS, *(PRODUCTS[name][1] for name in products))


def output_names(products: tuple[str, ...] = ()) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Returns the names of the output coefficients: (U0, U1, …) and (V0, V1, …)."""
    p = 6 + len(products)
    return tuple(f"U{k}" for k in range(p)), tuple(f"V{k}" for k in range(p))


def _drift_columns(p: int) -> tuple[int, ...]:
    return (*_DRIFT_COLUMNS, *range(6, p))


def output_coefficients(physical: Array) -> Array:
    """Computes the output coefficients [U; V], shape (2, p), SI, from the physical coefficients, shape (4 + 2·(p − 2),), in the
    order of `physical_names`."""
    sf_x, sf_y, epsilon, xi = physical[:4]
    cos_xi = np.cos(xi)
    mixing = np.array(
        [
            [np.cos(epsilon + xi) / (sf_y * cos_xi), np.sin(epsilon + xi) / (sf_y * cos_xi)],
            [-np.sin(epsilon) / (sf_x * cos_xi), np.cos(epsilon) / (sf_x * cos_xi)],
        ]
    )
    drifts = np.asarray(physical[4:], dtype=float).reshape(2, -1)
    result = np.empty((2, drifts.shape[1] + 2))
    result[:, 1:3] = mixing
    result[:, _drift_columns(result.shape[1])] = mixing @ drifts
    return result


def physical_coefficients(outputs: Array) -> Array:
    """Inverts `output_coefficients` in closed form. [U; V] of shape (2, p) gives physical coefficients of shape (4 + 2·(p − 2),); n sets
    of shape (2, p, n) give shape (4 + 2·(p − 2), n). The formula is analytic, so `uncertainty.derivatives` can compute its derivatives.

    The formula uses tan(ε+ξ) = U2/U1 and tan ε = −V1/V2 with both angles within ±90°, so a torquer of reversed polarity gives a
    negative scale factor. Raises ValueError if U1, V2 or the determinant of M is zero.
    """
    mixing, inverse = _mixing(outputs)
    (u1, u2), (v1, v2) = mixing
    sum_, epsilon = np.arctan(u2 / u1), np.arctan(-v1 / v2)
    xi = sum_ - epsilon
    cos_xi = np.cos(xi)
    # v2·√(1 + (v1/v2)²) is the length of (v1, v2) with the sign of v2.
    sf_x = 1 / (v2 * np.sqrt(1 + (v1 / v2) ** 2) * cos_xi)
    sf_y = 1 / (u1 * np.sqrt(1 + (u2 / u1) ** 2) * cos_xi)
    columns = list(_drift_columns(outputs.shape[1]))
    u, v = outputs[0, columns], outputs[1, columns]
    drifts = [inverse[axis, 0] * u + inverse[axis, 1] * v for axis in range(2)]
    return np.concatenate([np.array([sf_x, sf_y, epsilon, xi]), *drifts])


def compensated_rates(outputs: Array, observed: Array, specific_force: Array) -> Array:
    """Computes the rates [ω_Y, ω_X] from the two outputs by the compensation model G0. Returns an array of shape (n, 2) or (n, 2,
    k), in rad/s.

    `outputs`: the output coefficients [U; V], an array of shape (2, p) with p = 6; or k sets of output coefficients, an array of
    shape (2, p, k). `observed`: array of shape (n, 2), the outputs i_x and i_y. `specific_force`: array of shape (n, 3) in m/s^2.
    The product of M⁻¹ and the outputs is [ω_Y + D(X); ω_X + D(Y)]; the module docstring defines M. The drift D(X) = D(X)_F +
    D(X)_X·a_X + D(X)_Y·a_Y + D(X)_Z·a_Z and the corresponding D(Y) are then subtracted.
    """
    _, inverse = _mixing(outputs)
    drifts = physical_coefficients(outputs)[4:].reshape(2, -1, *outputs.shape[2:])
    felt = np.column_stack([np.ones(len(observed)), specific_force])
    return np.asarray(
        np.einsum("ni,ai...->na...", observed, inverse) - np.einsum("nf,af...->na...", felt, drifts[:, :4])
    )


def _mixing(outputs: Array) -> tuple[Array, Array]:
    """Returns the matrix M and its inverse, each of shape (2, 2) or (2, 2, n). `outputs`: the output coefficients [U; V], of shape
    (2, p) or (2, p, n)."""
    mixing = np.asarray(outputs)[:, 1:3]
    determinant = mixing[0, 0] * mixing[1, 1] - mixing[0, 1] * mixing[1, 0]
    scale = np.abs(mixing).max(axis=(0, 1))
    sound = np.isfinite(scale) & (scale > 0) & (np.abs(determinant) >= 1e-12 * scale**2)
    if not np.all(sound & (mixing[0, 0] != 0) & (mixing[1, 1] != 0)):
        raise ValueError(
            "the outputs do not respond to rate like those of a flexure gyro (U1·V2 − "
            "U2·V1 is zero): check the order of the two outputs, and whether one of them is dead"
        )
    inverse = np.array([[mixing[1, 1], -mixing[0, 1]], [-mixing[1, 0], mixing[0, 0]]]) / determinant
    return mixing, inverse

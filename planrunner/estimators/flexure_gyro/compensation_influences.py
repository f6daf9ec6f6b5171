"""Computes the influences of declared inputs on residuals after compensation, and on the sums of squares of these residuals.

Let c be one set of coefficients, X the design matrix of the verification positions, and i the outputs there. The residual is r =
M⁻¹·(i − X·c), where the matrix M is computed from c. An error of an input affects r in two ways. The error acts directly, through
X. The error also acts through c, because c comes from a calibration with the same latitude, gravity, azimuth and table. Both
contributions come from the same error, so they are added with their signs.
"""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model import flexure_gyro
from planrunner.estimators.flexure_gyro.flexure_gyro_static import reported
from planrunner.estimators.interface import Estimate, EstimateRequest
from planrunner.estimators.stated_errors import site_errors, table_errors
from planrunner.observation.correlated_errors import functionals_of
from planrunner.uncertainty.budget import merged
from planrunner.uncertainty.derivatives import jacobian
from planrunner.uncertainty.influences import Aspect, Influence


def residual_influences(
    request: EstimateRequest[object], units: tuple[str, ...], matrix: Array, observed: Array, rate: float
) -> tuple[Influence, ...]:
    """Computes the influences on the residuals of several sets of coefficients at v verification positions. The sets·2·v residuals
    form one sequence, set after set. Within a set, the residuals of the first rate (ω_Y) at all positions come first, then the
    residuals of the second rate (ω_X).

    `units`: units of the outputs. `matrix`: array of shape (v, p), design matrix of the verification positions, SI. `observed`:
    array of shape (v, 2), the measured outputs. `rate`: SI value of the unit of the residuals, rad/s.
    """
    found: list[Influence] = []

    def recovered(flat: Array) -> Array:
        """Computes the rates from the outputs for k sets of coefficients `flat` (2·p, k). Returns an array of shape (2·v, k), in
        the unit of the residuals."""
        rates = flexure_gyro.compensated_rates(flat.reshape(2, -1, flat.shape[1]), observed, matrix[:, 3:6])
        return np.asarray(np.swapaxes(rates, 0, 1).reshape(-1, flat.shape[1]) / rate)

    for place, used in enumerate(request.uses.values()):
        coefficients = np.array(used.extra["coefficients"])
        own = np.eye(len(request.uses))[:, [place]]
        by_outputs = np.asarray(np.kron(own, recovery(coefficients, len(matrix), rate)))
        by_coefficients = np.asarray(np.kron(own, jacobian(recovered, coefficients.ravel())))
        found += [one.through(by_outputs) for one in _here(request, matrix, coefficients)]
        found += [one.through(by_coefficients) for one in _carried(used, units)]
    return merged(found)


def recovery(coefficients: Array, positions: int, rate: float) -> Array:
    """Returns the matrix (2·v, 2·v) that converts differences between measured and predicted outputs to differences of the rates,
    in units of `rate` [rad/s]. `coefficients`: array of shape (2, p), from which the outputs are predicted. `positions`: the number
    v of verification positions. Rows are ordered by rate, then by position; columns are ordered by output, then by position."""
    return np.asarray(np.kron(np.linalg.inv(coefficients[:, 1:3]), np.eye(positions)) / rate)


def sums_and_ratios(residuals: Array, sets: int) -> Array:
    """Computes the residual sum of squares of each set of coefficients, and its ratio to the sum of the first set. `residuals`:
    array of shape (sets·2·v, n), n draws of the residuals of all sets. Returns an array of shape (2·sets − 1, n): first all sums,
    then the ratios of the second and of each later set."""
    sums = np.sum(residuals.reshape(sets, -1, residuals.shape[1]) ** 2, axis=1)
    return np.concatenate([sums, sums[1:] / sums[0]])


def _here(request: EstimateRequest[object], matrix: Array, coefficients: Array) -> list[Influence]:
    """Returns the influences on i − X·c that act through the stimulus at the verification positions. `matrix`: array of shape (v,
    p), design matrix X, SI. `coefficients`: array of shape (2, p), the coefficients c."""
    each = np.array(np.broadcast_to(np.eye(len(matrix)), (2, len(matrix), len(matrix))))
    model, segments = flexure_gyro.static_model(), [recorded.segment for recorded in request.segments]
    site = site_errors(model, segments, request.site, request.setup.inputs, coefficients)
    table = table_errors(model, segments, request.site, request.setup, coefficients)
    return [one.through(functionals_of(each)) for one in (*site, *table)]


def _carried(used: Estimate, units: tuple[str, ...]) -> list[Influence]:
    """Returns the influences that acted on one set of coefficients [U; V], in SI units, during the calibration that gave this set.
    Flicker and resolution are left out, because the simulation of the residuals includes flicker, and the noise includes rounding.
    Errors of the table are not left out, because the simulation does not include their contribution to the calibration."""
    coefficients = np.array(used.extra["coefficients"])
    quantities, factors = reported(units, flexure_gyro.static_model(), ())
    own_noise = {aspect.of(output) for aspect in Aspect for output in used.extra["outputs"]}
    names = [item.name for item in used.coefficients]
    rows = [names.index(one.name) for one in quantities[-coefficients.size :]]
    return [
        Influence(one.quantity, one.sensitivities[rows] * factors[-coefficients.size :, None], False, one.parts)
        for one in used.influences
        if one.quantity.name not in own_noise
    ]

"""How residual sums of squares after compensation follow what is stated of the bench, to first order.

With c the coefficients of a set, X the verification positions' design and i the outputs, the residual is r = M⁻¹·(i − X·c). An input
that is stated wrong reaches it twice: through X, and through c, whose calibration used the same latitude, gravity, azimuth and
table. Both ways stand in the list as influences of the same input, so that the budget adds them with their signs before it squares.
M is a part of c: with X̃, whose rates are those that were recovered (ω + r) instead of the planned ones, dr = −M⁻¹·X̃·dc has both.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.flexure_gyro.flexure_gyro_static import physical_set
from planrunner.estimators.interface import Estimate, EstimateRequest
from planrunner.estimators.observation_effects import functionals_of
from planrunner.estimators.stated_influences import stated_influences
from planrunner.estimators.table_effects import table_effects
from planrunner.physics import flexure_gyro
from planrunner.uncertainty.influences import Influence

Array = NDArray[np.float64]


def compensation_influences(
    request: EstimateRequest, units: tuple[str, ...], matrix: Array, residuals: Mapping[str, Array], rate: float
) -> tuple[Influence, ...]:
    """On the residual sums of squares of the sets, in their order, then on the ratios of the others to the first.

    units: of the outputs; matrix: (v, p) of the verification positions, SI; residuals: by set, (v, 2), in units of `rate` rad/s.
    """
    names = tuple(residuals)
    first = float(np.sum(residuals[names[0]] ** 2))
    found: list[Influence] = []
    for place, name in enumerate(names):
        coefficients = np.array(request.uses[name].extra["coefficients"])
        inverse = np.linalg.inv(coefficients[:, 1:3])
        # ∂RSS/∂(i − X·c), output after output, (2·v,): 2·rᵀ·M⁻¹.
        by_output = 2 * (residuals[name] @ inverse).T.ravel() / rate
        own = float(np.sum(residuals[name] ** 2))
        gradient = np.zeros((2 * len(names) - 1, by_output.size))
        gradient[place] = by_output
        if place:
            gradient[len(names) + place - 1] = by_output / first
        else:
            for other, values in enumerate(names[1:]):
                ratio = float(np.sum(residuals[values] ** 2)) / own
                gradient[len(names) + other] = -by_output * ratio / own
        found += [one.through(gradient) for one in _here(request, matrix, coefficients)]
        recovered = matrix.copy()
        recovered[:, 1:3] += residuals[name] * rate
        found += [one.through(-gradient @ np.kron(np.eye(2), recovered)) for one in _carried(request.uses[name], units)]
    return tuple(found)


def _here(request: EstimateRequest, matrix: Array, coefficients: Array) -> list[Influence]:
    """On i − X·c through the verification positions: what a fit of one coefficient a position would show."""
    each = np.array(np.broadcast_to(np.eye(len(matrix)), (2, len(matrix), len(matrix))))
    model, segments = flexure_gyro.static_model(), [recorded.segment for recorded in request.segments]
    table = table_effects(model, segments, request.site, request.setup, coefficients)
    stated = stated_influences(model, segments, request.site, request.setup.inputs, coefficients, each)
    return [*stated, *(one.through(functionals_of(each)) for one in table)]


def _carried(used: Estimate, units: tuple[str, ...]) -> list[Influence]:
    """On SI [U; V] of a set. What its own scatter showed of the table's errors is not in the scatter simulated here; flicker is."""
    coefficients = np.array(used.extra["coefficients"])
    factors = physical_set(coefficients, units, flexure_gyro.static_model(), ()).factors[-coefficients.size :]
    rows = np.array([item.name[0] in "UV" and item.name[1:].isdigit() for item in used.coefficients])
    return [
        Influence(one.quantity, one.sensitivities[rows] * factors[:, None], False, one.parts)
        for one in used.influences
        if not one.quantity.name.startswith(("resolution ", "bias instability "))
    ]

"""The fit for estimators from positions, weighted by the noise within positions, declared flicker and declared errors of the table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from planrunner.error_model.terms import ErrorModel
from planrunner.estimators.interface import EstimateRequest
from planrunner.estimators.outputs_fit import OutputsFit, coefficients_by_noise, fit_outputs
from planrunner.estimators.table_errors import table_errors
from planrunner.observation.correlated_errors import Array
from planrunner.observation.flicker import flicker_errors
from planrunner.observation.observations import Observations
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Segment


class FittedFromPositions(Protocol):
    """The keys that such an estimator has."""

    @property
    def uncertainty(self) -> str: ...

    @property
    def drift_span(self) -> Quantity: ...


def fit_positions(
    request: EstimateRequest[FittedFromPositions],
    model: ErrorModel,
    segments: Sequence[Segment],
    observations: Observations,
    matrix: Array,
    magnitudes: Array,
    pooled: bool = False,
) -> OutputsFit:
    """Outputs against a linear model. matrix: (n, p), SI; magnitudes: (p,).

    How far the table's errors move an output depends on its coefficients, which a first fit without them gives. Raises `EstimationError`.
    """
    parameters = request.parameters
    about = coefficients_by_noise(matrix, observations, magnitudes, model.names)
    effects = (
        *flicker_errors(observations, request.setup.inputs, parameters.drift_span.value),
        *table_errors(model, segments, request.site, request.setup, about),
    )
    return fit_outputs(matrix, observations, magnitudes, model.names, parameters.uncertainty, pooled, effects=effects)

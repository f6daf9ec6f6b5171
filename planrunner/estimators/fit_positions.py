"""Fits the mean readings of outputs in several positions. All estimators that use positions share this module. The weights of the
fit come from the noise within positions, the declared flicker and the declared errors of the table."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Protocol

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.error_model.terms import ErrorModel
from planrunner.estimators.expected import planned_blocks
from planrunner.estimators.interface import DesignBlock, DesignRequest, EstimateRequest
from planrunner.estimators.outputs_fit import OutputsFit, coefficients_by_noise, fit_outputs
from planrunner.estimators.stated_errors import site_errors, table_errors
from planrunner.observation.correlated_errors import functionals_of
from planrunner.observation.drift import drift_of
from planrunner.observation.flicker import flicker_errors, unstated_flicker
from planrunner.observation.observations import Observations
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Segment
from planrunner.uncertainty.influences import Influence


class FittedFromPositions(Protocol):
    """Declares the plan keys of an estimator that fits mean readings in several positions."""

    @property
    def uncertainty(self) -> str: ...

    @property
    def drift_span(self) -> Quantity: ...

    @property
    def drift(self) -> tuple[str, ...]: ...

    @property
    def temperature_channel(self) -> str | None: ...


@dataclass(frozen=True, slots=True, eq=False)
class PositionsDesign:
    """A linear model for n planned or recorded segments. The check and the fit use the same model. `matrix`: array of shape (n, p)
    in SI units. `magnitudes`: array of shape (p,), declared sizes of the columns."""

    model: ErrorModel
    segments: tuple[Segment, ...]
    matrix: Array
    magnitudes: Array

    def blocks(self, request: DesignRequest[FittedFromPositions], outputs: Sequence[str]) -> tuple[DesignBlock, ...]:
        """Returns the design blocks for the command `check`, one per output. Raises `EstimationError` for an output that the sensor
        does not have."""
        return planned_blocks(request, outputs, self.model.names, self.matrix, self.magnitudes)


def fit_positions(
    request: EstimateRequest[FittedFromPositions],
    design: PositionsDesign,
    observations: Observations,
    recorded: Sequence[RecordedSegment],
    pooled: bool = False,
    shown: Collection[str] = (),
) -> OutputsFit:
    """Fits outputs with a linear model. `recorded`: the recorded segments from which the observations come. `shown`: names of the
    drift functions that other outputs of the same sensor show, or that these outputs show in a previous fit; see `DriftCourses`.

    The effect of the table's errors on an output depends on the coefficients of this output, so a first fit without these errors
    gives approximate coefficients. Raises `EstimationError` if the plan or the data are not suitable. `pooled`: True if one
    variance factor applies to all outputs.
    """
    parameters = request.parameters
    model, matrix, magnitudes = design.model, design.matrix, design.magnitudes
    about = coefficients_by_noise(matrix, observations, magnitudes, model.names)
    effects = (
        *flicker_errors(observations, request.setup.inputs, parameters.drift_span.value),
        *table_errors(model, design.segments, request.site, request.setup, about),
    )
    drift = replace(
        drift_of(parameters.drift, parameters.temperature_channel, observations, recorded, request.segments),
        shown=frozenset(shown),
    )
    basis = parameters.uncertainty
    unstated = unstated_flicker(observations, request.setup.inputs, parameters.drift_span.value)
    return fit_outputs(
        matrix,
        observations,
        magnitudes,
        model.names,
        basis,
        pooled,
        effects=effects,
        drift=drift,
        unstated=unstated,
    )


def site_influences(
    request: EstimateRequest[FittedFromPositions], design: PositionsDesign, fit: OutputsFit
) -> tuple[Influence, ...]:
    """Computes how the latitude and the magnitude of gravity influence the coefficients. The coefficients are listed output after
    output, in the outputs' units per SI unit of the column."""
    errors = site_errors(design.model, design.segments, request.site, request.setup.inputs, fit.coefficients)
    functionals = functionals_of(fit.gains)
    return tuple(error.through(functionals) for error in errors)

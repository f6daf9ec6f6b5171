"""Determines bias, scale factor and misalignment of an accelerometer triad from many positions.

Two references are available:

    orientation         the attitudes are known (a table, a dividing head): a linear fit to the components of gravity for each axis
    gravity_magnitude   the attitudes are unknown (tumbled by hand): nine parameters from |f| = g alone
"""

from __future__ import annotations

import numpy as np

from planrunner.estimators.accelerometer import by_magnitude, by_orientation
from planrunner.estimators.accelerometer.by_magnitude import MagnitudeQuantities
from planrunner.estimators.accelerometer.by_orientation import AxesQuantities
from planrunner.estimators.accelerometer.parameters import AccelerometerMultiPositionParameters
from planrunner.estimators.basis_judgement import planned_basis
from planrunner.estimators.drift_order import planned_drift
from planrunner.estimators.expected import Known
from planrunner.estimators.interface import Design, DesignRequest, EstimateRequest, EstimationError, Foresight
from planrunner.estimators.method import Method, Words, by_expectation
from planrunner.plan.selection import Detection


class AccelerometerMultiPosition(Method[AccelerometerMultiPositionParameters, AxesQuantities | MagnitudeQuantities]):
    """Implements the estimator `accelerometer_multi_position`."""

    name = "accelerometer_multi_position"
    summary = "Bias, scale factor and misalignment of an accelerometer triad from many positions"
    Parameters = AccelerometerMultiPositionParameters
    finds_spans = True

    def design(self, request: DesignRequest[AccelerometerMultiPositionParameters]) -> Design | None:
        """Returns the design of each axis at the planned attitudes, with remarks. If the attitudes are not planned, it returns only
        remarks. Raises `EstimationError` if the keys of the estimate contradict each other or the bench."""
        parameters = request.parameters
        _three(parameters.outputs)
        if parameters.reference == "gravity_magnitude":
            planned_drift(request, ())
            return by_magnitude.design(request)
        _no_spans(request.detection)
        design = by_orientation.design_of(parameters.terms, request.segments, request.site)
        blocks = design.blocks(request, parameters.outputs)
        remarks = (
            *planned_basis(request, blocks, parameters.uncertainty),
            *planned_drift(request, blocks),
        )
        return Design(blocks, remarks=remarks)

    def known(self, request: DesignRequest[AccelerometerMultiPositionParameters]) -> Known:
        """Returns the input axes of the outputs: x, y and z, in the order in which the plan names the outputs."""
        return Known(directions=dict(zip(request.parameters.outputs, np.eye(3), strict=True)))

    def foresee(self, request: DesignRequest[AccelerometerMultiPositionParameters]) -> Foresight:
        """Predicts the coefficients from the schedule if the attitudes are planned."""
        if request.parameters.reference == "gravity_magnitude":
            return by_magnitude.foresee(request, lambda: by_expectation(self, request))
        return by_expectation(self, request)

    def quantities(
        self, request: EstimateRequest[AccelerometerMultiPositionParameters]
    ) -> AxesQuantities | MagnitudeQuantities:
        """Computes the coefficients from the means of the positions or of the still spans. Raises `EstimationError` if the plan or
        the data are not suitable."""
        parameters = request.parameters
        _three(parameters.outputs)
        if parameters.reference == "gravity_magnitude":
            return by_magnitude.quantities(request)
        _no_spans(request.detection)
        return by_orientation.quantities(request)

    def words(
        self,
        request: EstimateRequest[AccelerometerMultiPositionParameters],
        found: AxesQuantities | MagnitudeQuantities,
    ) -> Words:
        """Makes the tables and plots of the residuals, one row or point per position or pose."""
        if isinstance(found, MagnitudeQuantities):
            return by_magnitude.words(request, found)
        return by_orientation.words(request, found)


def _no_spans(detection: Detection | None) -> None:
    if detection is not None:
        raise EstimationError(
            "the attitudes of intervals at rest that are found in the data are unknown: write `reference: gravity_magnitude`"
        )


def _three(outputs: tuple[str, ...]) -> None:
    if len(outputs) != 3 or len(set(outputs)) != 3:
        raise EstimationError(f"a triad has three channels, for x, y and z, but `outputs` names {', '.join(outputs)}")

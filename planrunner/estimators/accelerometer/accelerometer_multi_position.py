"""Bias, scale factor and misalignment of an accelerometer triad from many positions.

Which reference to use when:

    orientation         the attitudes are known (a table, a dividing head): a straight line in gravity's components for each axis
    gravity_magnitude   the attitudes are unknown (tumbled by hand): nine parameters from |f| = g alone
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.accelerometer import by_magnitude, by_orientation
from planrunner.estimators.accelerometer.by_magnitude import MagnitudeQuantities
from planrunner.estimators.accelerometer.by_orientation import AxesQuantities
from planrunner.estimators.basis_judgement import planned_basis
from planrunner.estimators.expected import Known
from planrunner.estimators.interface import (
    Design,
    DesignRequest,
    EstimateRequest,
    EstimationError,
)
from planrunner.estimators.method import Foresight, Method, Words, by_expectation
from planrunner.estimators.outputs_fit import BASES
from planrunner.estimators.planned import planned_blocks
from planrunner.observation.flicker import drift_span
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, Record, key
from planrunner.plan.quantity import Quantity
from planrunner.plan.selection import Detection

Array = NDArray[np.float64]

AXES = ("x", "y", "z")


class AccelerometerMultiPositionParameters(Record):
    """Keys of the estimator accelerometer_multi_position."""

    outputs: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=3),
        "The three accelerometer channels, of x, y and z.",
        ["accel_x", "accel_y", "accel_z"],
        default=("accel_x", "accel_y", "accel_z"),
    )
    reference: str = key(
        Choice(("orientation", "gravity_magnitude")),
        "Reference for the readings: gravity in known attitudes, or only its magnitude.",
        "gravity_magnitude",
        default="orientation",
    )
    terms: tuple[str, ...] = key(
        ListOf(Choice(by_orientation.TERMS), minimum=1),
        "Terms of each axis for the reference 'orientation'; leave out terms that the attitudes cannot determine.",
        ["bias", "accel_x", "accel_z"],
        default=by_orientation.TERMS,
    )
    uncertainty: str = key(
        Choice(BASES),
        "Basis of the uncertainties: the scatter of the positions about the model, or the noise within the positions.",
        "residual",
        default="residual",
    )
    drift_span: Quantity = drift_span()


class AccelerometerMultiPosition(Method[AxesQuantities | MagnitudeQuantities]):
    """The plug-in."""

    name = "accelerometer_multi_position"
    summary = "Bias, scale factor and misalignment of an accelerometer triad from many positions"
    Parameters = AccelerometerMultiPositionParameters
    finds_spans = True

    def design(self, request: DesignRequest) -> Design | None:
        """The design of each axis at the planned attitudes; remarks alone where the attitudes are not planned. Raises `EstimationError`."""
        parameters: AccelerometerMultiPositionParameters = request.parameters
        _three(parameters.outputs)
        if parameters.reference == "gravity_magnitude":
            return by_magnitude.design(request)
        _no_spans(request.detection)
        model = by_orientation.model_of(parameters.terms)
        matrix = by_orientation.matrix_of(model, request.segments, request.site)
        blocks = planned_blocks(request, parameters.outputs, model.names, matrix, model.magnitudes)
        return Design(blocks, remarks=planned_basis(request, blocks, parameters.uncertainty))

    def known(self, request: DesignRequest) -> Known:
        """The axes of the channels, in the order in which the plan names them."""
        return Known(directions=dict(zip(request.parameters.outputs, np.eye(3), strict=True)))

    def foresee(self, request: DesignRequest) -> Foresight:
        """The general way, where the attitudes are planned."""
        if request.parameters.reference == "gravity_magnitude":
            return by_magnitude.foresee(request, lambda: by_expectation(self, request))
        return by_expectation(self, request)

    def quantities(self, request: EstimateRequest) -> AxesQuantities | MagnitudeQuantities:
        """Coefficients from the positions or still spans. Raises `EstimationError`."""
        parameters: AccelerometerMultiPositionParameters = request.parameters
        _three(parameters.outputs)
        if parameters.reference == "gravity_magnitude":
            return by_magnitude.quantities(request)
        _no_spans(request.detection)
        return by_orientation.quantities(request)

    def words(self, request: EstimateRequest, found: AxesQuantities | MagnitudeQuantities) -> Words:
        """Residuals by position or pose."""
        if isinstance(found, MagnitudeQuantities):
            return by_magnitude.words(request, found)
        return by_orientation.words(request, found)


def _no_spans(detection: Detection | None) -> None:
    if detection is not None:
        raise EstimationError(
            "the attitudes of spans found in the data are unknown: write `reference: gravity_magnitude`"
        )


def _three(outputs: tuple[str, ...]) -> None:
    if len(outputs) != 3 or len(set(outputs)) != 3:
        raise EstimationError(f"a triad has three channels, of x, y and z; `outputs` names {', '.join(outputs)}")

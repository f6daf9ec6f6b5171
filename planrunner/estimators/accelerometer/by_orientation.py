"""Calibrates an accelerometer triad with gravity in known attitudes, by a linear fit for each axis.

The fit of F_i = b_i + Σ_j S_ij·f_j to the readings F_i gives three results for each axis i: the bias, the scale factor and the
misalignments. The bias is b_i. The scale factor is the length |S_i| of the row S_i. This length is the sensitivity along the actual
input axis. A constant attitude error does not change it. The misalignments are S_ij/|S_i|; to first order, they are the angles
between the input axis and its planned direction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import said
from planrunner.error_model.terms import ErrorModel, error_model
from planrunner.estimators.accelerometer.parameters import TERMS, AccelerometerMultiPositionParameters
from planrunner.estimators.basis_judgement import judge, require_basis
from planrunner.estimators.declared_axes import AxisResponse, contradictions
from planrunner.estimators.derived import Reported, derived
from planrunner.estimators.expected import matrix_at_rest
from planrunner.estimators.fit_positions import PositionsDesign, fit_positions, site_influences
from planrunner.estimators.fit_tables import drift_tables, mean_and_residual, residual_plot
from planrunner.estimators.interface import EstimateRequest, EstimationError, UnfitDataError
from planrunner.estimators.method import Quantities, Words
from planrunner.estimators.outputs_fit import OutputsFit
from planrunner.estimators.resolution_influences import resolution_influences
from planrunner.estimators.tables import Table, TableColumn, by_columns
from planrunner.estimators.triad import RowFormula, scale_and_misalignments
from planrunner.observation.correlated_errors import functionals_of
from planrunner.observation.observations import Observations, observe, weights_of
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Segment
from planrunner.plan.units import DIMENSIONS, Unit, unit

_AXES = ("x", "y", "z")


def design_of(terms: Sequence[str], segments: Sequence[Segment], site: Site) -> PositionsDesign:
    """Returns the design of each axis. All segments must be at rest. Raises `EstimationError` if a segment moves or its orientation
    is unknown."""
    model, needed = error_model(terms), "an accelerometer can be compared with gravity only at rest"
    matrix = matrix_at_rest(model, segments, site, needed, " (for example `reference: gravity_magnitude`)")
    return PositionsDesign(model, tuple(segments), matrix, model.magnitudes)


@dataclass(frozen=True, slots=True, kw_only=True)
class AxesQuantities(Quantities):
    """Contains the fitted response of each of the three axes to gravity."""

    observations: Observations
    units: tuple[Unit, ...]
    model: ErrorModel
    fit: OutputsFit


def quantities(request: EstimateRequest[AccelerometerMultiPositionParameters]) -> AxesQuantities:
    """Computes bias, scale factor and misalignments of three axes. Raises `EstimationError` if the plan or the data are not
    suitable."""
    parameters = request.parameters
    basis = parameters.uncertainty
    observations = observe(request.segments, parameters.outputs, request.sensor)
    units = _units(observations)
    design = design_of(parameters.terms, [recorded.segment for recorded in request.segments], request.site)
    fit = fit_positions(request, design, observations, request.segments)
    require_basis(fit, basis, request.name)
    rows = [(axis, *row) for axis in range(3) for row in _axis(axis, fit, design.model)]
    factors = np.array([own.factor for own in units])[:, None, None]

    def formula(flat: Array) -> Array:
        values = flat.reshape(3, -1, flat.shape[1]) * factors  # SI: m/s² and ratios
        return np.stack([part(values[axis]) / unit(one.unit).factor for axis, one, part in rows])

    found = derived([one for _, one, _ in rows], formula, fit)
    stated = (
        *site_influences(request, design, fit),
        *resolution_influences(request, parameters.outputs, functionals_of(fit.gains)),
        *fit.influences(basis),
    )
    scatter = [float(np.sqrt(np.sum(one.residuals**2) / max(1, fit.freedom))) for one in fit.fits]
    return AxesQuantities(
        coefficients=found.coefficients(basis),
        covariance=found.covariance(basis),
        influences=found.influences([stated]),
        unstated=found.unstated,
        extra={"root_mean_square": scatter},
        observations=observations,
        units=tuple(units),
        model=design.model,
        fit=fit,
    )


def words(request: EstimateRequest[AccelerometerMultiPositionParameters], found: AxesQuantities) -> Words:
    """Makes the tables and plots of the residuals by position."""
    fit, observations, basis = found.fit, found.observations, request.parameters.uncertainty
    judged = judge(fit, basis)
    notes, warnings = list(judged.texts), list(judged.warnings)
    warnings += contradictions([_row(axis, found) for axis in range(3)])
    left_out = [name for name in TERMS if name not in found.model.names]
    if left_out:
        notes.append(said("Terms that the plan leaves out of the model: {terms}.", terms=tuple(left_out)))
    for axis, name in enumerate(observations.channels):
        rms = np.sqrt(np.sum(fit.fits[axis].residuals ** 2) / max(1, fit.freedom)) * found.units[axis].factor
        notes.append(
            said(
                "{output}: residuals of {rms:.3g} mg rms, corrected for degrees of freedom.",
                output=name,
                rms=rms / unit("mg").factor,
            )
        )
    return Words(
        headline=tuple(item.name for item in found.coefficients),
        settings={
            "reference": "orientation",
            "uncertainty": basis,
            "terms": list(found.model.names),
            "weights": weights_of(observations.channels, fit.noises),
        },
        tables=(_table(observations, fit), *drift_tables([fit], basis)),
        plots=(residual_plot(observations, fit),),
        notes=tuple(notes),
        warnings=tuple(warnings),
        segments=observations.labels,
    )


def _excited(model: ErrorModel) -> dict[int, int]:
    """Finds the axes along which gravity acts in at least one position. Returns a mapping from the index of each such axis to the
    index of its term."""
    return {_AXES.index(name[-1]): k for k, name in enumerate(model.names) if name != "bias"}


def _row(axis: int, found: AxesQuantities) -> AxisResponse:
    fit, own = found.fit, found.units[axis]
    responses = {k: float(fit.coefficients[axis, place]) * own.factor for k, place in _excited(found.model).items()}
    return AxisResponse(fit.outputs[axis], axis, own, responses)


def _axis(axis: int, fit: OutputsFit, model: ErrorModel) -> list[tuple[Reported, RowFormula]]:
    """Returns the reported quantities of one axis, each with a formula that computes it from the axis's coefficients in SI."""
    letter = _AXES[axis]
    seen = _excited(model)
    if axis in seen and not fit.coefficients[axis, list(seen.values())].any():
        raise UnfitDataError(
            f"channel '{fit.outputs[axis]}' shows no response to gravity in any position: check whether this channel is connected"
        )
    found: list[tuple[Reported, RowFormula]] = []
    misalignments: list[tuple[Reported, RowFormula]] = []
    if "bias" in model.names:
        place = model.names.index("bias")
        words = said("Bias of the {axis} axis", axis=letter)
        found.append((Reported(f"bias_{letter}", "mg", words), lambda row: np.asarray(row[place])))
    for direction, part in scale_and_misalignments(seen, axis).items():
        if direction == axis:
            words = said("Scale factor of the {axis} axis, along its own input direction", axis=letter)
            found.append((Reported(f"scale_{letter}", "1", words), part))
        else:
            across = _AXES[direction]
            if axis in seen:
                words = said(
                    "Component of the {axis} axis's input direction along {across}", axis=letter, across=across
                )
            else:  # the axis was never along gravity: cross-axis response for a nominal scale factor of one
                words = said(
                    "Component of the {axis} axis's input direction along {across} times its scale factor",
                    axis=letter,
                    across=across,
                )
            misalignments.append((Reported(f"misalignment_{letter}_{_AXES[direction]}", "mrad", words), part))
    return [*found, *misalignments]


def _units(observations: Observations) -> list[Unit]:
    units = [unit(text) for text in observations.units]
    for name, own in zip(observations.channels, units, strict=True):
        if own.dimension != DIMENSIONS["acceleration"]:
            raise EstimationError(f"channel '{name}' is recorded in {own.text}, which is not a unit of acceleration")
    return units


def _table(observations: Observations, fit: OutputsFit) -> Table:
    return by_columns(
        "Residuals per position",
        (TableColumn("position"), observations.labels),
        *(column for k in range(3) for column in mean_and_residual(observations, fit, k)),
    )

"""An accelerometer triad held against gravity in known attitudes: a linear fit for each axis.

From F_i = b_i + Σ_j S_ij·f_j come the bias, the scale factor as the length of the row S_i (the sensitivity along the axis's own input
direction, whatever the attitude's constant offset from the one that was planned) and the misalignments S_ij/|S_i|, to first order
the angles of the input axis out of the planned frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.basis_judgement import judge, require_basis
from planrunner.estimators.interface import Coefficient, Estimate, EstimateRequest, EstimationError, Table
from planrunner.estimators.linear_influences import linear_influences
from planrunner.estimators.observations import Observations, observe
from planrunner.estimators.outputs_fit import OutputsFit, fit_outputs
from planrunner.estimators.planned import matrix_at_rest
from planrunner.estimators.residual_plot import residual_plot
from planrunner.physics.earth import Site
from planrunner.physics.terms import ACCEL_X, ACCEL_Y, ACCEL_Z, BIAS, ErrorModel
from planrunner.plan.schedule import Segment
from planrunner.plan.units import DIMENSIONS, Unit, unit

Array = NDArray[np.float64]

_TERMS = {term.name: term for term in (BIAS, ACCEL_X, ACCEL_Y, ACCEL_Z)}
_AXES = ("x", "y", "z")


def model_of(terms: Sequence[str]) -> ErrorModel:
    """The error model of one axis."""
    return ErrorModel(tuple(_TERMS[name] for name in terms))


def matrix_of(model: ErrorModel, segments: Sequence[Segment], site: Site) -> Array:
    """The design matrix of positions at rest, SI. Raises `EstimationError`."""
    needed = "an accelerometer is held against gravity at rest"
    return matrix_at_rest(model, segments, site, needed, " (for example `reference: gravity_magnitude`)")


def estimate(request: EstimateRequest) -> Estimate:
    """Bias, scale factor and misalignments of three axes. Raises `EstimationError`."""
    parameters = request.parameters
    basis = parameters.uncertainty
    observations = observe(request.segments, parameters.outputs, request.sensor)
    units = _units(observations)
    model = model_of(parameters.terms)
    matrix = matrix_of(model, [recorded.segment for recorded in request.segments], request.site)
    fit = fit_outputs(matrix, observations, model.magnitudes, model.names, basis)
    require_basis(fit, basis, request.name)
    rows: list[tuple[str, float, str, Array, str]] = []
    for axis in range(3):
        rows += _axis(axis, fit, model, units[axis])
    gradients = np.array([row[3] for row in rows])
    covariance = gradients @ fit.covariance(basis) @ gradients.T
    spreads = np.sqrt(np.diag(covariance).clip(min=0.0))
    freedom = fit.degrees_of_freedom(gradients, basis)
    coefficients = tuple(
        Coefficient(name, value, text, float(u), float(dof), words)
        for (name, value, text, _, words), u, dof in zip(rows, spreads, freedom, strict=True)
    )
    stated = linear_influences(request, model, parameters.outputs, fit.coefficients, fit.gains, basis)
    notes, warnings = judge(fit, basis)
    left_out = [name for name in _TERMS if name not in model.names]
    if left_out:
        notes.append(f"Left out of the model as the plan says: {', '.join(left_out)}.")
    for axis, name in enumerate(observations.channels):
        rms = np.sqrt(np.sum(fit.fits[axis].residuals ** 2) / max(1, fit.freedom)) * units[axis].factor
        notes.append(f"{name}: residuals of {rms / unit('mg').factor:.3g} mg rms, corrected for degrees of freedom.")
    return Estimate(
        request.name,
        "accelerometer_multi_position",
        coefficients,
        covariance,
        tuple(item.name for item in coefficients),
        {
            "reference": "orientation",
            "uncertainty": basis,
            "terms": list(model.names),
            "weights": [n.weighting for n in fit.noises],
        },
        (_table(observations, fit),),
        (residual_plot(observations, fit),),
        tuple(notes),
        tuple(warnings),
        observations.labels,
        {"root_mean_square": [float(np.sqrt(np.sum(one.residuals**2) / max(1, fit.freedom))) for one in fit.fits]},
        tuple(one.through(gradients) for one in stated),
    )


def _axis(axis: int, fit: OutputsFit, model: ErrorModel, own: Unit) -> list[tuple[str, float, str, Array, str]]:
    """(name, value, unit, gradient over all coefficients, words) of one axis."""
    p = len(model.names)
    values = fit.coefficients[axis] * own.factor  # SI: m/s² and ratios
    letter = _AXES[axis]
    seen = [(k, _AXES.index(name[-1])) for k, name in enumerate(model.names) if name != "bias"]
    own_seen = any(direction == axis for _, direction in seen)
    # An axis that was never along gravity shows its response across, per unit of a nominal scale factor of one.
    scale = float(np.sqrt(sum(values[k] ** 2 for k, _ in seen))) if own_seen else 1.0
    if scale == 0:
        raise EstimationError(
            f"channel '{fit.outputs[axis]}' does not respond to gravity at all: check that it is connected"
        )

    def gradient(changes: dict[int, float]) -> Array:
        full = np.zeros(3 * p)
        for k, change in changes.items():
            full[axis * p + k] = change * own.factor
        return full

    found = []
    if "bias" in model.names:
        k = model.names.index("bias")
        mg = unit("mg").factor
        found.append(
            (f"bias_{letter}", float(values[k] / mg), "mg", gradient({k: 1 / mg}), f"Bias of the {letter} axis")
        )
    along = {k: float(values[k]) / scale if own_seen else 0.0 for k, _ in seen}
    if own_seen:
        words = f"Scale factor of the {letter} axis, along its own input direction"
        found.append((f"scale_{letter}", scale, "1", gradient(along), words))
    mrad = unit("mrad").factor
    for k, direction in seen:
        if direction != axis:
            ratio = float(values[k]) / scale
            changes = {j: ((j == k) - ratio * along[j]) / scale / mrad for j, _ in seen}
            name = f"misalignment_{letter}_{_AXES[direction]}"
            words = f"Component of the {letter} axis's input direction along {_AXES[direction]}"
            if not own_seen:
                words += " times its scale factor"
            found.append((name, ratio / mrad, "mrad", gradient(changes), words))
    return found


def _units(observations: Observations) -> list[Unit]:
    units = [unit(text) for text in observations.units]
    for name, own in zip(observations.channels, units, strict=True):
        if own.dimension != DIMENSIONS["acceleration"]:
            raise EstimationError(f"channel '{name}' is recorded in {own.text}, which is no unit of acceleration")
    return units


def _table(observations: Observations, fit: OutputsFit) -> Table:
    columns = ["position"]
    for name, text in zip(observations.channels, observations.units, strict=True):
        columns += [f"{name} mean [{text}]", f"{name} residual [{text}]"]
    rows = []
    for n, label in enumerate(observations.labels):
        values = [v for k in range(3) for v in (float(observations.mean[n, k]), float(fit.fits[k].residuals[n]))]
        rows.append((label, *values))
    return Table("Residuals per position", tuple(columns), tuple(rows))

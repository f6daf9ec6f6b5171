"""An accelerometer triad held against the magnitude of gravity: nine parameters from still spans or segments in unknown attitudes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.accelerometer.gravity_magnitude import NAMES, GravityFit, fit_magnitude
from planrunner.estimators.accelerometer.still_detection import still_spans
from planrunner.estimators.interface import Coefficient, Estimate, EstimateRequest, EstimationError, Plot, Table
from planrunner.estimators.observations import SIGNIFICANCE, observe
from planrunner.plan.units import DIMENSIONS, unit
from planrunner.uncertainty.decision import expanded_uncertainty
from planrunner.uncertainty.influences import Influence

Array = NDArray[np.float64]

_WORDS = {
    "bias": "Bias of the {} axis",
    "scale": "Scale factor of the {} axis",
    "gamma": "Non-orthogonality of the axes {} and {}: 90° less their angle",
}


@dataclass(frozen=True, slots=True)
class _Poses:
    """Mean readings (n, 3), m/s², their standard errors (n, 3), the batches (n,) behind those, and when they were, s."""

    labels: tuple[str, ...]
    mean: Array
    error: Array
    batches: NDArray[np.int64]
    start: Array
    end: Array


def estimate(request: EstimateRequest) -> Estimate:
    """The nine parameters with full covariance. Raises `EstimationError`."""
    basis = request.parameters.uncertainty
    poses = _found(request) if request.detection is not None else _recorded(request)
    fit = fit_magnitude(poses.mean, request.site.gravity)
    within, freedom_within = _within(fit, poses)
    if basis == "residual" and not fit.degrees_of_freedom:
        raise EstimationError(
            f"{request.name}: nine poses leave no residual; record more or write `uncertainty: within_segment`"
        )
    if basis == "within_segment" and within is None:
        raise EstimationError(
            f"{request.name}: the poses are too short to tell the noise within them; write `uncertainty: residual`"
        )
    bases = {
        "residual": (fit.cofactor * fit.root_mean_square**2, float(fit.degrees_of_freedom)),
        "within_segment": (within, freedom_within),
    }
    factors = np.array([unit("mg").factor] * 3 + [1.0] * 3 + [unit("mrad").factor] * 3)
    units = ["mg"] * 3 + ["1"] * 3 + ["mrad"] * 3
    chosen, freedom = bases[basis]
    assert chosen is not None
    covariance = chosen / np.outer(factors, factors)
    values, spreads = fit.values / factors, np.sqrt(np.diag(covariance))
    coefficients = tuple(
        Coefficient(name, float(v), text, float(u), freedom, _describe(name))
        for name, v, text, u in zip(NAMES, values, units, spreads, strict=True)
    )
    notes, warnings = _judge(fit, poses, within, freedom_within, basis, request)
    return Estimate(
        request.name,
        "accelerometer_multi_position",
        coefficients,
        covariance,
        NAMES,
        {
            "reference": "gravity_magnitude",
            "uncertainty": basis,
            "gravity": request.site.gravity,
            **_detection(request),
        },
        (_bases_table(values, units, factors, bases), _pose_table(poses, fit)),
        (
            Plot(
                "Residuals of |f| per pose",
                "pose",
                "residual [m/s^2]",
                poses.labels,
                {"|f| − g": tuple(map(float, fit.residuals))},
            ),
        ),
        tuple(notes),
        tuple(warnings),
        tuple(recorded.label for recorded in request.segments),
        {"root_mean_square": fit.root_mean_square, "poses": len(poses.labels), "condition": fit.condition},
        _influences(fit, request),
    )


def _influences(fit: GravityFit, request: EstimateRequest) -> tuple[Influence, ...]:
    """Readings and biases are in m/s², so that scale factors alone follow the magnitude that they are held against: ∂s/∂g = −s/g."""
    gravity = request.setup.inputs.get("gravity")
    if gravity is None:
        return ()
    sensitivities = np.zeros((len(NAMES), 1))
    sensitivities[3:6, 0] = -fit.values[3:6] / request.site.gravity
    return (Influence(gravity, sensitivities),)


def _found(request: EstimateRequest) -> _Poses:
    """Still spans of all chosen segments."""
    outputs = request.parameters.outputs
    channels = request.detection.channels
    if set(channels) != set(outputs):
        raise EstimationError(
            f"stillness is looked for in {', '.join(channels)}, but the estimate uses {', '.join(outputs)}: "
            "name the same `channels` under `segments`"
        )
    order = [channels.index(name) for name in outputs]
    labels, means, errors, batches, start, end = [], [], [], [], [], []
    for recorded in request.segments:
        factors = _factors({name: recorded.units.get(name, "") for name in outputs})
        for number, span in enumerate(still_spans(recorded, request.detection), start=1):
            labels.append(f"{recorded.label} {number}" if len(request.segments) > 1 else f"still {number}")
            means.append(span.mean[order] * factors)
            errors.append(span.standard_error[order] * factors)
            batches.append(span.batches)
            start.append(span.start)
            end.append(span.end)
    if not labels:
        raise EstimationError(
            f"{request.name}: no still span was found: raise `threshold` or shorten `at_least` under `segments`"
        )
    return _Poses(tuple(labels), np.array(means), np.array(errors), np.array(batches), np.array(start), np.array(end))


def _recorded(request: EstimateRequest) -> _Poses:
    """Whole segments as poses."""
    observations = observe(request.segments, request.parameters.outputs, request.sensor)
    factors = _factors(dict(zip(observations.channels, observations.units, strict=True)))
    start = np.array([recorded.statistics.start for recorded in request.segments])
    end = np.array([recorded.statistics.end for recorded in request.segments])
    error = observations.standard_error * factors
    return _Poses(observations.labels, observations.mean * factors, error, observations.batches, start, end)


def _factors(units: dict[str, str]) -> Array:
    for name, text in units.items():
        if not text or unit(text).dimension != DIMENSIONS["acceleration"]:
            raise EstimationError(
                f"channel '{name}' is {f'recorded in {text}' if text else 'not recorded'}: an acceleration is needed"
            )
    return np.array([unit(text).factor for text in units.values()])


def _within(fit: GravityFit, poses: _Poses) -> tuple[Array | None, float]:
    """Covariance from the noise within the poses (pooled), and its degrees of freedom; None where it cannot be told."""
    variance = np.einsum("ni,ni->n", fit.directions**2, poses.error**2)
    degrees = np.where(np.isfinite(variance), poses.batches - 1, 0)
    usable = (degrees > 0) & (variance > 0)
    if not usable.any():
        return None, 0.0
    total = float(degrees[usable].sum())
    pooled = float(np.sum(degrees[usable] * variance[usable]) / total)
    return fit.cofactor * pooled, total


def _judge(
    fit: GravityFit, poses: _Poses, within: Array | None, freedom: float, basis: str, request: EstimateRequest
) -> tuple[list[str], list[str]]:
    from scipy.special import fdtrc

    notes = [
        f"{len(poses.labels)} poses; residuals of |f| {fit.root_mean_square * 1e3:.3g} mm/s² rms, corrected for "
        f"{fit.degrees_of_freedom} degrees of freedom; condition {fit.condition:.3g}.",
        f"Scale factors are relative to the site's gravity of {request.site.gravity:.6g} m/s².",
        "Uncertainties rest on the residuals of the poses."
        if basis == "residual"
        else "Uncertainties rest on the noise within the poses; how the poses were held is not in them.",
    ]
    warnings = []
    if within is not None and fit.degrees_of_freedom:
        ratio = float(fit.root_mean_square**2 * fit.cofactor[0, 0] / within[0, 0])
        chance = float(fdtrc(fit.degrees_of_freedom, freedom, ratio))
        text = f"The residual variance is {ratio:.3g} times that expected from the noise within the poses"
        if chance < SIGNIFICANCE:
            warnings.append(
                f"{text} (chance of that from noise alone: {chance:.2g}): the within-segment uncertainties are too small."
            )
        else:
            notes.append(f"{text}, which noise alone explains (probability {chance:.2g}).")
    return notes, warnings


def _describe(name: str) -> str:
    kind, axes = name.split("_")
    return _WORDS[kind].format(*axes)


def _detection(request: EstimateRequest) -> dict[str, str]:
    found = request.detection
    if found is None:
        return {}
    return {"window": str(found.window), "threshold": str(found.threshold), "at_least": str(found.at_least)}


def _bases_table(
    values: Array, units: list[str], factors: Array, bases: dict[str, tuple[Array | None, float]]
) -> Table:
    columns, parts = ["coefficient", "unit", "value"], []
    for basis, (covariance, freedom) in bases.items():
        if covariance is not None and freedom:
            shown = basis.replace("_", " ")
            columns += [f"u ({shown})", f"dof ({shown})", f"U 95 % ({shown})"]
            parts.append((np.sqrt(np.diag(covariance)) / factors, freedom))
    rows = []
    for k, name in enumerate(NAMES):
        row: list[object] = [name, units[k], float(values[k])]
        for spreads, freedom in parts:
            row += [float(spreads[k]), freedom, expanded_uncertainty(float(spreads[k]), freedom)]
        rows.append(tuple(row))
    return Table("Uncertainties of the data, on either basis", tuple(columns), tuple(rows))


def _pose_table(poses: _Poses, fit: GravityFit) -> Table:
    columns = ("pose", "start [s]", "end [s]", "x [m/s^2]", "y [m/s^2]", "z [m/s^2]", "residual of |f| [m/s^2]")
    rows = [
        (label, float(poses.start[n]), float(poses.end[n]), *map(float, poses.mean[n]), float(fit.residuals[n]))
        for n, label in enumerate(poses.labels)
    ]
    return Table("Poses and residuals", columns, tuple(rows))

"""Fits the shape of an effect, such as a time constant, to the means of segments by variable projection.

For a given value of the shape, the amplitudes are fitted linearly, so that the χ² of this fit is a function of the shape alone (G.
Golub and V. Pereyra, SIAM J. Numer. Anal. 10, 1973). The fit searches for the smallest χ² within the bounds of the catalogue. In
the final fit, the derivative with respect to the shape is a further column, so that all uncertainties include the uncertainty of
the shape.

An effect with a shape also changes the output within a segment. This change is not noise. The change is estimated by a first fit.
The noise is then computed from the scatter of the samples about this fit, and a second fit uses this noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import ShapedOverSegments, shown_by
from planrunner.error_model.segment_columns import EffectPart
from planrunner.estimators import least_squares
from planrunner.estimators.error_model.outputs import ModelledOutput, Together, with_shape
from planrunner.estimators.interface import UnfitDataError
from planrunner.estimators.least_squares import LinearFit
from planrunner.observation.observations import Observations, about_course, within_segment_noise

_PRECISION = 1e-6  # of the shape's logarithm; the fit then adds a linear step
_LEAST = 3.0  # standard uncertainties: smallest amplitude of an effect whose shape the means determine


def shaped_part(output: ModelledOutput) -> EffectPart | None:
    """Returns the effect in an output's model whose shape must be fitted to the means of segments; None if there is no such
    effect."""
    if output.within is not None:
        return None
    return next((one for one in output.errors.chosen if isinstance(one.effect, ShapedOverSegments)), None)


def with_shapes(
    group: Together, together: Observations, recorded: Sequence[RecordedSegment]
) -> tuple[Together, Observations]:
    """Finds the best value of each shape in the models of a group of outputs. Returns the group with these values, and observations
    whose noise does not include the changes that the effects cause within segments. For each shape, the model gets a further
    column: the derivative with respect to this shape.

    `together`: observations of the group's outputs in the recorded segments. Raises `UnfitDataError` if the observations do not
    determine a shape.
    """
    for k, output in enumerate(group.outputs):
        part = shaped_part(output)
        if part is not None:
            together = _about(*_found(group, k, part, together), k, together, recorded)
            group, _ = _found(group, k, part, together)
    return group, together


def _about(
    group: Together, amplitudes: Array, k: int, together: Observations, recorded: Sequence[RecordedSegment]
) -> Observations:
    """Returns the observations with new standard errors of the k-th output. The standard errors are computed from the scatter of
    the samples about the change that the output's effect causes within each segment. `amplitudes`: amplitudes of the effect, in the
    unit of the output."""
    from scipy.interpolate import PchipInterpolator

    part = shaped_part(group.outputs[k])
    assert part is not None
    along, values = group.model.course(k, part.effect, amplitudes)
    error = together.standard_error.copy()
    for row, (item, own) in enumerate(zip(recorded, values, strict=True)):
        if np.isfinite(error[row, k]):
            seconds = item.statistics.duration
            error[row, k] = about_course(item, group.outputs[k].name, PchipInterpolator((along + 0.5) * seconds, own))
    return replace(together, standard_error=error)


def _found(group: Together, k: int, part: EffectPart, together: Observations) -> tuple[Together, Array]:
    """Returns the group with the best shape of an effect in its k-th output, and the amplitudes of this effect, in the unit of the
    output."""
    from scipy.optimize import minimize_scalar

    effect = part.effect
    assert isinstance(effect, ShapedOverSegments)
    values = group.model.shapes_of(effect)
    name, text = group.outputs[k].name, effect.shape_unit
    where = f"{effect.shape_name} of {effect.id} in {name}"
    if together.expected:
        raise UnfitDataError(f"{where} is only known from a recording")
    sigma = within_segment_noise(together, k).sigma

    def fitted(log: float) -> tuple[ModelledOutput, LinearFit]:
        one = with_shape(group, k, replace(part, shape=math.exp(log))).outputs[k]
        columns = one.columns
        observed = together.mean[:, k] - one.ideal
        return one, least_squares.fit(columns.matrix, observed, sigma, columns.magnitudes, one.names)

    logs = np.log(values)
    best = int(np.argmin([fitted(float(log))[1].chi_squared for log in logs]))
    if best in (0, len(logs) - 1):
        raise UnfitDataError(
            f"{where} is not between {values[0]:g} and {values[-1]:g} {text}: leave the effect out, or record segments that show it "
            f"({shown_by(effect)})"
        )
    bounds = float(logs[best - 1]), float(logs[best + 1])
    log = float(
        minimize_scalar(
            lambda at: fitted(at)[1].chi_squared, bounds=bounds, method="bounded", options={"xatol": _PRECISION}
        ).x
    )
    one, fit = fitted(log)
    at = [place for place, amplitude in enumerate(one.columns.amplitudes) if amplitude.effect is effect]
    u = np.sqrt(
        np.diag(fit.cofactor)[at] * max(fit.variance_factor, 1.0)
        if fit.degrees_of_freedom
        else np.diag(fit.cofactor)[at]
    )
    if not (np.abs(fit.coefficients[at]) > _LEAST * u).any():
        raise UnfitDataError(
            f"{name} shows no {effect.id}: leave the effect out, or record segments that show it ({shown_by(effect)})"
        )
    reported = one.reported(fit.coefficients[:, None])[:, 0]
    sizes = {one.columns.amplitudes[place].name: float(reported[place] * one.coefficients[place].si) for place in at}
    return with_shape(group, k, replace(part, shape=math.exp(log), sizes=sizes)), fit.coefficients[at]

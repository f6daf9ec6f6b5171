"""Estimates the amplitudes of one run. The nominal terms and all effects that are named in any run of the fleet are fitted
together.

The fit is generalised least squares with the noise model of the diagnosis and without priors. The estimates of different runs are
therefore independent. A prior is used only later, in the attribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planrunner.error_model.effects.interface import Column, Effect, PerOrientation, Shaped
from planrunner.error_model.effects.nominal import PARTS
from planrunner.error_model.observed import Observed, orientation_key
from planrunner.gap.evidence.weighing import coefficients_of
from planrunner.gap.hypotheses.candidates import Weighing

_DEPENDENT = 1e-8
"""A direction of the amplitudes is not determined if its singular value, relative to the largest one, is below this limit. The
columns have unit length."""
_UNDETERMINED = 1e-6
"""An amplitude counts as determined if at most this fraction of it lies in undetermined directions."""


@dataclass(frozen=True, slots=True)
class AmplitudeKey:
    """Identifies an amplitude, so that it can be compared between runs. `orientations`: for an effect with separate amplitudes in
    every orientation, the orientations in the order of their numbers; otherwise empty. `shape`: shape of the effect, in the unit of
    the shape; None if the effect has no shape."""

    effect: str
    name: str
    unit: str
    shape: float | None = None
    orientations: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class AmplitudeEstimate:
    """Contains the estimated amplitude of an effect in one run. `value`, `standard_uncertainty`: estimate and standard uncertainty,
    in the unit of the key."""

    key: AmplitudeKey
    value: float
    standard_uncertainty: float


def amplitudes(
    weighing: Weighing, nominal: Sequence[str], effects: Sequence[tuple[Effect, float | None]]
) -> list[AmplitudeEstimate]:
    """Estimates the amplitudes that the data of a run determine. `nominal`: terms that the nominal simulation fits. `effects`:
    further effects, each with the value of its shape, or None if it has no shape."""
    observed = weighing.observed
    listed = [(key, column) for key, column in zip(_terms(observed, nominal), weighing.nominal_columns, strict=True)]
    orientations = tuple(dict.fromkeys(map(orientation_key, observed.attitude)))
    for effect, shape in effects:
        own = orientations if isinstance(effect, PerOrientation) else ()
        for column in _columns(effect, shape, observed):
            listed.append((AmplitudeKey(effect.id, column.name, column.unit, shape, own), column))
    columns = [column for _, column in listed]
    raw = coefficients_of(observed, weighing.spectrum, columns)
    weights = [settings[0] for settings in weighing.weights]
    design = np.vstack([weight.whiten(block) for weight, block in zip(weights, raw, strict=True)])
    readings = weighing.spectrum.values
    data = np.concatenate([weight.whiten(readings[:, [k]])[:, 0] for k, weight in enumerate(weights)])
    size = np.linalg.norm(design, axis=0) + 1e-300
    left, values, right = np.linalg.svd(design / size, full_matrices=False)
    told = values > _DEPENDENT * values.max(initial=0.0)
    inverse = right[told].T / values[told]
    fit, spread = inverse @ (left[:, told].T @ data), np.sqrt((inverse**2).sum(1))
    known = (right[told] ** 2).sum(0) > 1 - _UNDETERMINED
    scales = [column.magnitude / column.factor / own for column, own in zip(columns, size, strict=True)]
    return [
        AmplitudeEstimate(key, float(fit[k] * scales[k]), float(spread[k] * scales[k]))
        for k, (key, column) in enumerate(listed)
        if known[k] and not (column.whole and column.parts and size[k] < 1e-200)
    ]


def _terms(observed: Observed, nominal: Sequence[str]) -> list[AmplitudeKey]:
    """Returns the keys of the nominal columns, in the same order as in `candidates.nominal_columns`."""
    return [
        AmplitudeKey(f"{kind}_{part}", column.name, column.unit)
        for kind in ("gyro", "accel")
        for part, make in PARTS.items()
        if f"{kind}_{part}" in nominal
        for column in make(observed, kind)
    ]


def _columns(effect: Effect, shape: float | None, observed: Observed) -> Sequence[Column]:
    """Returns the columns of an effect whose shape has the given value; empty if the effect cannot act in this run."""
    if isinstance(effect, Shaped):
        return effect.at(observed, shape).columns if shape is not None and len(effect.grid(observed)) else ()
    return next((one.columns for one in effect.variants(observed) if one.shape == shape), ())

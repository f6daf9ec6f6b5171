"""Estimates of the terms that the nominal simulation fits, for comparison with the specification of the sensor."""

from __future__ import annotations

import numpy as np

from planrunner.error_model.effects.nominal import PARTS
from planrunner.gap.answer.parameters import ParameterEstimate
from planrunner.gap.hypotheses.candidates import Weighing

_UNDETERMINED = 1e-6
"""Share of a parameter that may lie in directions that the plan does not determine."""


def nominal_values(weighing: Weighing, nominal: tuple[str, ...]) -> list[ParameterEstimate]:
    """Bias, scale factor and misalignment of every channel by weighted least squares. Terms that the plan does not determine are
    omitted. The field `effect` of each estimate is the term, such as `accel_bias`. The values contain the influence of effects that
    are not in the simulation."""
    terms = [
        f"{kind}_{part}"
        for kind in ("gyro", "accel")
        for part, make in PARTS.items()
        if f"{kind}_{part}" in nominal
        for _ in make(weighing.observed, kind)
    ]
    found = []
    for index, design in enumerate(weighing.whole):
        own = [place for place, column in enumerate(weighing.nominal_columns) if index in column.parts]
        if not own:
            continue
        weight = weighing.weights[index][0]
        columns = weight.whiten(np.hstack([design, weighing.angles[index]]))
        size = np.linalg.norm(columns, axis=0) + 1e-300
        left, values, right = np.linalg.svd(columns / size, full_matrices=False)
        told = values > 1e-8 * values.max(initial=0.0)
        inverse = right[told].T / values[told]
        fit = inverse @ (left[:, told].T @ weight.whiten(weighing.spectrum.values[:, [index]])[:, 0])
        spread, known = np.sqrt((inverse**2).sum(1)), (right[told] ** 2).sum(0)
        for k, place in enumerate(own):
            column = weighing.nominal_columns[place]
            if known[k] > 1 - _UNDETERMINED:
                scale = column.magnitude / column.factor / size[k]
                found.append(
                    ParameterEstimate(
                        terms[place], column.name, float(fit[k] * scale), column.unit, float(spread[k] * scale)
                    )
                )
    return found

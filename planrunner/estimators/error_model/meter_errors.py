"""Computes how errors of the meters for supply voltage, ambient pressure and temperature change the observations of a model.

Each meter for supply voltage or pressure may have two errors that are the same in all segments: a zero error, and a relative error
of the reading. These errors cause no scatter between segments, so their contributions are added to the contribution of the data
(JCGM 100:2008, F.1.2.3). The errors of a meter also act if the plan states the voltage or the pressure, because the stated value
was read from a meter. Each change is computed for a reading that is too large; for a reading that is too small, it has the opposite
sign.

The errors of a thermometer follow from its counts (`thermometer_counts`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.observed import STANDARD_PRESSURE
from planrunner.error_model.segment_columns import ErrorsAtSegments, SegmentStates
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.thermometer_counts import ThermometerCounts
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.plan.quantity import Quantity
from planrunner.uncertainty.influences import InputQuantity

_STEP = 0.01  # K; the columns of effects of temperature are smooth


def meter_errors(
    model: ErrorsAtSegments, estimate: str, parameters: ErrorModelParameters, nominal_supply: float, coefficients: Array
) -> tuple[CorrelatedError, ...]:
    """Computes the errors of the observations that errors of the meters cause. Only meters for which the plan states an uncertainty
    are included.

    `estimate`: name of the estimate in the plan. `nominal_supply`: nominal supply voltage, V. `coefficients`: array of shape (m,
    p), for m outputs and p columns of the model, in the outputs' units per SI unit of each column.
    """
    found = []
    for quantity, low, high in _moved(model.states, estimate, parameters, nominal_supply):
        sides = [replace(model, states=states).columns(model.stimulus) for states in (low, high)]
        slopes = (sides[1] - sides[0]) / (2 * quantity.standard_uncertainty)
        moved = -coefficients @ slopes.T
        if moved.any():
            found.append(CorrelatedError(quantity, dict(enumerate(moved[..., None]))))
    return tuple(found)


def thermometer_errors(
    model: ErrorsAtSegments, counts: ThermometerCounts | None, coefficients: Array
) -> tuple[tuple[CorrelatedError, ...], tuple[CorrelatedError, ...]]:
    """Computes the errors of the observations that the counts of the thermometer cause: first the error that all readings have in
    common, then the rounding errors of separate readings. `coefficients`: the same as in `meter_errors`."""
    if counts is None:
        return (), ()
    states = model.states
    sides = [
        replace(model, states=states.measured(states.celsius + by)).columns(model.stimulus) for by in (-_STEP, _STEP)
    ]
    moved = -coefficients @ (sides[1] - sides[0]).T / (2 * _STEP)
    if not moved.any():
        return (), ()
    common = counts.offset
    rounding = {k: row[:, None] * counts.groups for k, row in enumerate(moved)}
    return (
        () if common is None else (CorrelatedError(common, dict(enumerate(moved[..., None]))),),
        (CorrelatedError(counts.rounding, rounding, counts.parts),) if counts.parts else (),
    )


def _moved(
    states: SegmentStates, estimate: str, parameters: ErrorModelParameters, nominal_supply: float
) -> Iterator[tuple[InputQuantity, SegmentStates, SegmentStates]]:
    """Yields each stated error with two versions of the segments' states. In the first, the reading is too small by the standard
    uncertainty of the error; in the second, it is too large by the same amount."""
    for field, unit, reference, errors in (
        ("overvoltage", "V", nominal_supply, ("supply_zero_uncertainty", "supply_reading_uncertainty")),
        ("overpressure", "Pa", STANDARD_PRESSURE, ("pressure_zero_uncertainty", "pressure_reading_uncertainty")),
    ):
        excess = getattr(states, field)
        for key, text, each in zip(errors, (unit, "1"), (np.ones_like(excess), excess + reference), strict=True):
            stated: Quantity | None = getattr(parameters, key)
            if stated is None or not stated.value:
                continue
            name, source = key.removesuffix("_uncertainty").replace("_", " "), f"plan estimates.{estimate}.{key}"
            quantity = InputQuantity(
                name, 0.0, text, stated.value, source=source, shown=stated.unit.text, shown_factor=stated.unit.factor
            )
            low, high = (replace(states, **{field: excess + sign * stated.value * each}) for sign in (-1, 1))
            yield quantity, low, high

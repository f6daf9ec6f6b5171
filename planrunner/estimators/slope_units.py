"""Units of a scale factor: an output over a rate."""

from __future__ import annotations

from planrunner.estimators.interface import EstimationError
from planrunner.plan.units import Unit, UnknownUnitError, unit


def rate_and_output(rate_unit: str, output_unit: str) -> tuple[Unit, Unit]:
    """The units of the rate and of the output. Raises `EstimationError` for texts that are not units, and for a `rate_unit` that is not
    a unit of angular rate."""
    try:
        rate, own = unit(rate_unit), unit(output_unit)
    except UnknownUnitError as error:
        raise EstimationError(str(error)) from None
    if rate.dimension != unit("rad/s").dimension:
        raise EstimationError(
            f"rate_unit is '{rate_unit}', which is not a unit of angular rate; write for example 'deg/s'"
        )
    return rate, own


def slope_unit(rate: Unit, own: Unit) -> tuple[str, float]:
    """The unit of K, and the factor to it from (output unit)/(rad/s). For an output that is itself a rate, K is a plain ratio."""
    if own.dimension == rate.dimension:
        return "1", own.factor
    return f"({own.text})/({rate.text})", rate.factor

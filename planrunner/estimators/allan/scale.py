"""Converts noise coefficients of an output in pulses or volts to noise coefficients of the sensed quantity, by means of a scale
factor.

The plan states the scale factor as a quantity, such as `0.2012 (deg/h)/(pulse/s)`, or as a coefficient of an estimate in `uses`,
such as `drift.SF_Y`. The unit of the scale factor shows whether it is the sensed quantity divided by the output, or the output
divided by the sensed quantity.

The results are in the units that are usual in the field: deg/√h and deg/h for rates, m/s/√h and µg for accelerations.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, closest
from planrunner.estimators.interface import Coefficient, Design, Estimate, EstimationError
from planrunner.plan import source
from planrunner.plan.kinds import QuantityOf, Schema
from planrunner.plan.quantity import Quantity
from planrunner.plan.units import DIMENSIONS, Dimension, Unit, UnknownUnitError, unit
from planrunner.uncertainty.influences import InputQuantity

_COEFFICIENT = r"[A-Za-z][A-Za-z0-9_-]{0,39}\.[A-Za-z][^ \x00-\x1f]{0,59}"


class ScaleFactorKind:
    """Reads a scale factor in a plan: a quantity, or a name of the form `estimate.coefficient`."""

    what = "a quantity or a coefficient"

    def read(self, node: source.Node, log: Findings) -> Quantity | str | None:
        if isinstance(node, source.Scalar) and re.fullmatch(_COEFFICIENT, node.text):
            return node.text
        quantity: Quantity | None = QuantityOf(None, uncertain=True).read(node, log)
        return quantity

    def schema(self) -> Schema:
        return {
            "anyOf": [QuantityOf(None, uncertain=True).schema(), {"type": "string", "pattern": f"^{_COEFFICIENT}$"}]
        }


@dataclass(frozen=True, slots=True)
class SensedBy:
    """Converts the noise coefficients of an output to noise coefficients of the sensed quantity.

    `units`: for each of Q, N, B and K, the unit of the result, and the factor by which a coefficient of the output is multiplied.
    The unit of a coefficient of the output is the output's unit times s (Q), √s (N), 1 (B) or 1/√s (K). `power`: 1 if these factors
    are proportional to the scale factor, −1 if they are proportional to its reciprocal. `quantity`: the scale factor, in its own
    unit.
    """

    units: Mapping[str, tuple[str, float]]
    power: int
    quantity: InputQuantity


def sensed_by(
    stated: Quantity | str, name: str, output: str, uses: Mapping[str, Estimate] | Mapping[str, Design]
) -> SensedBy:
    """Interprets the scale factor `stated` for the channel `name`, which is recorded in the unit `output`. Raises `EstimationError`
    if `stated` is not a usable scale factor for this channel."""
    if isinstance(stated, Quantity):
        own = stated.unit
        value, u = stated.value / own.factor, stated.standard_uncertainty / own.factor
        freedom, shape = stated.degrees_of_freedom, stated.shape
        said_by = "plan scale_factors"
    else:
        found = _coefficient(stated, uses)
        own = _unit(found.unit)
        value, u = found.value, found.standard_uncertainty
        freedom, shape = found.degrees_of_freedom, "t"
        said_by = f"estimate {stated}"
    if not (math.isfinite(value) and value != 0):
        raise EstimationError(f"the scale factor of '{name}' is {value:g}: this cannot be a scale factor")
    recorded = _unit(output)
    for power in (1, -1):
        named = named_units(_product(recorded, own, power))
        if named is not None:
            factor = recorded.factor * abs(value * own.factor) ** power
            units = {term: (text, factor / unit(text).factor) for term, text in named.items()}
            return SensedBy(
                units, power, InputQuantity(f"scale factor {name}", value, own.text, u, freedom, shape, said_by)
            )
    raise EstimationError(
        f"a scale factor in {own.text} does not convert '{name}', which is recorded in {output}, to a rate or an acceleration; "
        f"write for example 0.2 (deg/h)/({output})"
    )


def _coefficient(stated: str, uses: Mapping[str, Estimate] | Mapping[str, Design]) -> Coefficient:
    estimate, _, wanted = stated.partition(".")
    if estimate not in uses:
        raise EstimationError(f"scale factor '{stated}': write `uses: {estimate}`, so that this estimate comes first")
    used = uses[estimate]
    coefficients = used.coefficients if isinstance(used, Estimate) else _foreseen(used)
    for item in coefficients:
        if item.name == wanted:
            return item
    hint = closest(wanted, [item.name for item in coefficients])
    raise EstimationError(f"scale factor '{stated}': '{estimate}' has no coefficient '{wanted}': {hint}")


def _foreseen(used: Design) -> tuple[Coefficient, ...]:
    """Returns the coefficients from which the prediction of a run takes a scale factor. A coefficient that cannot be predicted gets
    the value 1 in its own unit."""
    return (*used.predicted, *(Coefficient(one.name, 1.0, one.unit, math.nan) for one in used.unpredicted))


def _product(recorded: Unit, scale: Unit, power: int) -> tuple[tuple[str, float], ...]:
    total = dict(recorded.dimension)
    for base, exponent in scale.dimension:
        total[base] = total.get(base, 0.0) + power * exponent
    return tuple(sorted((base, exponent) for base, exponent in total.items() if exponent))


def _unit(text: str) -> Unit:
    try:
        return unit(text)
    except UnknownUnitError as error:
        raise EstimationError(str(error)) from None


_NAMED = {
    DIMENSIONS["angular rate"]: {"Q": "arcsec", "N": "deg/sqrt(h)", "B": "deg/h", "K": "deg/h/sqrt(h)"},
    DIMENSIONS["acceleration"]: {"Q": "m/s", "N": "m/s/sqrt(h)", "B": "ug", "K": "ug/sqrt(h)"},
}
_OTHERWISE = {"Q": "{}*s", "N": "{}*sqrt(s)", "B": "{}", "K": "{}/sqrt(s)"}
_PULSES = {"Q": "pulse", "N": "pulse/sqrt(s)", "B": "pulse/s", "K": "pulse/s/sqrt(s)"}


def named_units(dimension: Dimension) -> Mapping[str, str] | None:
    """Returns the usual unit of each of the coefficients Q, N, B and K if the sensed quantity is an angular rate or an
    acceleration; returns None for any other quantity."""
    return _NAMED.get(dimension)


def coefficient_units(output: str) -> dict[str, tuple[str, float]]:
    """Returns, for each of the coefficients Q, N, B and K, the unit in which it is reported, and the factor that converts the
    coefficient to this unit. The factor applies to a coefficient in the output's unit times s (Q), √s (N), 1 (B) or 1/√s (K).
    Raises `EstimationError` for an unknown unit."""
    try:
        own = unit(output)
    except UnknownUnitError as error:
        raise EstimationError(str(error)) from None
    named = _PULSES if output == "pulse/s" else named_units(own.dimension)
    if named is None:
        whole = output if output.isalpha() else f"({output})"
        texts = {name: text.format(output if name == "B" else whole) for name, text in _OTHERWISE.items()}
        return {name: (text, 1.0) for name, text in texts.items()}
    return {name: (text, own.factor / unit(text).factor) for name, text in named.items()}


def squares_to_coefficients(interval: float) -> dict[str, float]:
    """Returns a factor for each of the coefficients Q, N, B and K. A coefficient is this factor times the square root of its fitted
    square, which is Q²/τ0², N²/τ0, B² or K²·τ0. `interval`: τ0, the time between phase points, s."""
    root = math.sqrt(interval)
    return {"Q": interval, "N": root, "B": 1.0, "K": 1 / root}

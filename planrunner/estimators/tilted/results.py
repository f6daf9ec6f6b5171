"""Gives the names, units and descriptions of the results for tilted axes, and converts the results to an `Estimate` or to
predictions.

The name of a coefficient is `K_x` at the reference temperature; at other temperatures it includes the temperature, such as
`K_x_-40degC`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.estimators.interface import Coefficient, CoefficientRole
from planrunner.estimators.tilted.evaluation import QUANTITIES, Group, TiltedResults
from planrunner.estimators.tilted.mounted_axes import MountedAxes
from planrunner.estimators.tilted.rate_lines import slope_unit
from planrunner.plan.units import ZERO_CELSIUS, Unit
from planrunner.uncertainty.influences import Influence

WORDS = {
    "K": said("scale factor along the axis"),
    "F0": said("offset of the line at zero rate"),
    "nonlinearity": said("largest residual, divided by the largest output"),
    "asymmetry": said("difference between the scale factors at positive and negative rates, divided by their mean"),
    "response": said(
        "change of output between the positive and the negative rate that are closest to zero, divided by the change according to the "
        "line; if all rates have the same sign, the two rates closest to zero are used"
    ),
    "repeatability": said("relative standard deviation of K between repeats"),
    "temperature_coefficient": said("slope of K over temperature, divided by K at the reference temperature"),
    "temperature_sensitivity": said(
        "largest change of K from its value at the reference temperature, divided by K and by the temperature difference"
    ),
}
ROLES = {
    "nonlinearity": CoefficientRole.MAXIMUM,
    "repeatability": CoefficientRole.SCALE,
    "temperature_sensitivity": CoefficientRole.MAXIMUM,
}
ELSEWHERE = ("K", "nonlinearity", "asymmetry")  # also reported at other temperatures; tables show the rest
HEADLINE = ("K", "temperature_coefficient", "nonlinearity", "asymmetry", "repeatability")


@dataclass(frozen=True, slots=True)
class Item:
    """Describes one reported result. `at`: its index in `TiltedResults.vector`. `factor`: the factor that converts it to `unit`.
    `reference`: True for a result at the reference temperature, and for a result over all temperatures."""

    at: int
    quantity: str
    name: str
    unit: str
    factor: float
    description: Said
    reference: bool


def items(
    found: TiltedResults, groups: Sequence[Group], axes: MountedAxes, units: Sequence[tuple[Unit, Unit]], reference: int
) -> tuple[Item, ...]:
    """Returns the results that can be computed. The results at the reference temperature come first. `units`: for each axis, the
    unit of the rate and the unit of the output."""
    listed = [item for k in _order(len(groups), reference) for item in _at(found, groups, axes, units, k, reference)]
    return tuple(item for item in listed if np.isfinite(found.vector[item.at]))


def coefficients(
    found: TiltedResults, kept: Sequence[Item], covariance: Array, freedom: Array
) -> tuple[Coefficient, ...]:
    """Returns the coefficients of the estimate. `covariance`: covariance of `TiltedResults.vector`. `freedom`: degrees of freedom
    of `TiltedResults.vector`."""
    spread = np.sqrt(np.diag(covariance))
    return tuple(
        Coefficient(
            item.name,
            float(found.vector[item.at] * item.factor),
            item.unit,
            float(spread[item.at] * abs(item.factor)),
            float(freedom[item.at]),
            item.description,
            role=ROLES.get(item.quantity, CoefficientRole.LOCATION),
        )
        for item in kept
    )


def over_temperature(
    kept: Sequence[Item], shown: Sequence[Coefficient], groups: Sequence[Group], axes: MountedAxes, reference: int
) -> dict[str, object]:
    """Returns the scale factors at each temperature, in the form that `interface.Estimate` describes for its field `extra`; empty
    if no temperature is known. `reference`: index of the reference temperature."""
    known = [k for k in range(len(groups)) if np.isfinite(groups[k].kelvin)]
    of = {item.name: one for item, one in zip(kept, shown, strict=True)}
    held: dict[str, object] = {}
    for axis in axes.names:
        names = {k: f"K_{axis}" if k == reference else f"K_{axis}_{groups[k].label}" for k in known}
        there = [k for k in known if names[k] in of]
        if there:
            held[f"K_{axis}"] = {
                "temperature_degC": [groups[k].kelvin - ZERO_CELSIUS for k in there],
                "value": [of[names[k]].value for k in there],
                "standard_uncertainty": [of[names[k]].standard_uncertainty for k in there],
                "unit": of[names[there[0]]].unit,
            }
    return held


def shown_covariance(kept: Sequence[Item], covariance: Array) -> Array:
    at = [item.at for item in kept]
    factors = np.array([item.factor for item in kept])
    return np.asarray(covariance[np.ix_(at, at)] * np.outer(factors, factors))


def shown_influences(kept: Sequence[Item], acting: Sequence[Influence]) -> tuple[Influence, ...]:
    at = [item.at for item in kept]
    factors = np.array([item.factor for item in kept])
    return tuple(replace(item, sensitivities=item.sensitivities[at] * factors[:, None]) for item in acting)


def _order(count: int, reference: int) -> list[int]:
    return [reference, *(k for k in range(count) if k != reference)]


def _at(
    found: TiltedResults,
    groups: Sequence[Group],
    axes: MountedAxes,
    units: Sequence[tuple[Unit, Unit]],
    k: int,
    reference: int,
) -> list[Item]:
    g, m, p = found.means.shape
    suffix = "" if k == reference else f"_{groups[k].label}"
    made = []
    for quantity in (*QUANTITIES, "repeatability") if k == reference else ELSEWHERE:
        for axis, name in enumerate(axes.names):
            at = (
                g * m * p + k * m + axis
                if quantity == "repeatability"
                else (k * m + axis) * p + QUANTITIES.index(quantity)
            )
            unit, factor = _unit(quantity, units[axis])
            words = said("{axis}: {quantity}", axis=name, quantity=WORDS[quantity])
            if groups[k].label:
                words = said(
                    "{axis} at {temperature}: {quantity}",
                    axis=name,
                    quantity=WORDS[quantity],
                    temperature=groups[k].label,
                )
            made.append(Item(at, quantity, f"{quantity}_{name}{suffix}", unit, factor, words, k == reference))
    if k == reference:
        for row, quantity in enumerate(("temperature_coefficient", "temperature_sensitivity")):
            for axis, name in enumerate(axes.names):
                at = g * m * (p + 1) + row * m + axis
                words = said("{axis}: {quantity}", axis=name, quantity=WORDS[quantity])
                made.append(Item(at, quantity, f"{quantity}_{name}", "ppm/K", 1e6, words, True))
    return made


def _unit(quantity: str, units: tuple[Unit, Unit]) -> tuple[str, float]:
    if quantity == "K":
        return slope_unit(*units)
    if quantity == "F0":
        return units[1].text, 1.0
    return ("1", 1.0) if quantity == "response" else ("ppm", 1e6)

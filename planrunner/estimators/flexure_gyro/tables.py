"""What a reader needs to judge a flexure gyro's static coefficients: their meaning, the determinant, both bases of uncertainty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.estimators.fit_tables import bases_shown, basis_table
from planrunner.estimators.interface import Table
from planrunner.estimators.outputs_fit import OutputsFit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PhysicalSet:
    """Physical and output coefficients in the field's units with the gradients that carry covariance from SI [U; V].

    values, units: (q,), first the physical ones, then U0 …, V0 …; gradients: (q, 2·p), d(value in its unit)/d(SI coefficient); factors:
    (q,), SI value over value.
    """

    names: tuple[str, ...]
    values: Array
    units: tuple[str, ...]
    gradients: Array
    physical: int
    factors: Array


_WORDS = {
    "SF_X": "Torquer scale factor, x",
    "SF_Y": "Torquer scale factor, y",
    "epsilon": "Angle of the torquer's x axis to the case's x axis, ε",
    "xi": "Angle of the torquer's y axis to the case's y axis, ξ",
}
_DRIFT = {
    "F": "independent of acceleration",
    "X": "per acceleration along x",
    "Y": "per acceleration along y",
    "Z": "per acceleration along z",
    "XZ": "per product of accelerations along x and z",
    "YZ": "per product of accelerations along y and z",
}


def describe(name: str) -> str:
    """A coefficient's name in words."""
    if name in _WORDS:
        return _WORDS[name]
    if name.startswith("D_"):
        _, axis, kind = name.split("_")
        sensed = "ω_Y" if axis == "X" else "ω_X"
        return f"Drift D({axis}), {_DRIFT[kind]}; adds to {sensed}"
    return f"Coefficient {name[1:]} of output i_{'x' if name[0] == 'U' else 'y'}"


def determinant_note(determinant: float, condition: float, positions: int) -> str:
    """The determinant by which sets of positions are compared, with rates in Earth-rate units and accelerations in g."""
    return (
        f"Information matrix of the {positions} positions (rates in Earth-rate units, accelerations in g): "
        f"determinant {determinant:.6g}, condition of the design {condition:.3g}."
    )


def both_bases(found: PhysicalSet, fit: OutputsFit, chosen: str) -> Table:
    """The physical coefficients' uncertainty on the basis that was chosen and on the other, where the data give both."""
    gradients = found.gradients[: found.physical]

    def spread(basis: str) -> tuple[Array, Array]:
        variance = np.einsum("qi,ij,qj->q", gradients, fit.covariance(basis), gradients).clip(min=0.0)
        return np.sqrt(variance), fit.degrees_of_freedom(gradients, basis)

    physical = slice(found.physical)
    spreads = {basis: spread(basis) for basis in bases_shown(chosen, [fit])}
    return basis_table(found.names[physical], found.units[physical], found.values[physical], spreads)

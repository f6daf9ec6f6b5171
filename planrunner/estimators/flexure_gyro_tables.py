"""What a reader needs to judge a flexure gyro's static coefficients: residuals per position and both bases of uncertainty."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planrunner.estimators.interface import Table
from planrunner.estimators.observations import Observations
from planrunner.estimators.outputs_fit import BASES, OutputsFit
from planrunner.uncertainty.decision import expanded_uncertainty

if TYPE_CHECKING:
    from planrunner.estimators.flexure_gyro_static import PhysicalSet

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


def residual_table(observations: Observations, fit: OutputsFit) -> Table:
    """Means, residuals and the within-segment uncertainty, position by position."""
    columns = ["position"]
    for name, its_unit in zip(observations.channels, observations.units, strict=True):
        columns += [f"{name} mean [{its_unit}]", f"{name} residual [{its_unit}]", f"{name} u within [{its_unit}]"]
    rows = []
    for n, label in enumerate(observations.labels):
        row: list[object] = [label]
        for k in range(len(observations.channels)):
            own = observations.standard_error[n, k]
            row += [
                float(observations.mean[n, k]),
                float(fit.fits[k].residuals[n]),
                float(own) if np.isfinite(own) else None,
            ]
        rows.append(tuple(row))
    return Table("Residuals per position", tuple(columns), tuple(rows))


def both_bases(found: PhysicalSet, fit: OutputsFit, chosen: str) -> tuple[Table, ...]:
    """The physical coefficients' uncertainty on the basis that was chosen and on the other, where the data give both."""
    bases = [chosen, *(basis for basis in BASES if basis != chosen and fit.available(basis))]
    columns = ["coefficient", "unit", "value"]
    per_basis = []
    for basis in bases:
        shown = basis.replace("_", " ")
        columns += [f"u ({shown})", f"dof ({shown})", f"U 95 % ({shown})"]
        gradients = found.gradients[: found.physical]
        spread = np.sqrt(np.einsum("qi,ij,qj->q", gradients, fit.covariance(basis), gradients).clip(min=0.0))
        freedom = fit.degrees_of_freedom(gradients, basis)
        wide = [expanded_uncertainty(float(u), float(dof)) for u, dof in zip(spread, freedom, strict=True)]
        per_basis.append((spread, freedom, wide))
    rows = []
    for q in range(found.physical):
        row: list[object] = [found.names[q], found.units[q], float(found.values[q])]
        for spread, freedom, wide in per_basis:
            row += [float(spread[q]), float(freedom[q]), wide[q]]
        rows.append(tuple(row))
    return (Table("Uncertainties of the data, on either basis", tuple(columns), tuple(rows)),)

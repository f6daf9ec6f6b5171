"""Explanations of a flexure gyro's static coefficients: their meaning and the determinant."""

from __future__ import annotations

from planrunner.base.said import Said, said
from planrunner.error_model.flexure_gyro import drifts, output_names
from planrunner.estimators import rank
from planrunner.estimators.fit_positions import PositionsDesign

_GEOMETRY = (
    said("Torquer scale factor, {axis}", axis="x"),
    said("Torquer scale factor, {axis}", axis="y"),
    said("Angle of the torquer's x axis to the case's x axis, ε"),
    said("Angle of the torquer's y axis to the case's y axis, ξ"),
)


def descriptions(products: tuple[str, ...] = ()) -> tuple[Said, ...]:
    """Descriptions, in the order of `flexure_gyro.physical_names` and then of `flexure_gyro.output_names`."""
    of_drifts = (_drift(axis, rate, kind) for axis, rate in (("X", "Y"), ("Y", "X")) for kind in drifts(products))
    of_outputs = (
        said("Coefficient {term} in the model of the torquer current i_{axis}", term=number, axis=axis)
        for axis, names in zip("xy", output_names(products), strict=True)
        for number in range(len(names))
    )
    return (*_GEOMETRY, *of_drifts, *of_outputs)


def _drift(axis: str, rate: str, kind: str) -> Said:
    """Description of a drift coefficient. kind: `F`, or the axes of the accelerations."""
    if kind == "F":
        return said(
            "Part of the drift D({drift}) that is independent of acceleration; D({drift}) adds to the rate ω_{rate}",
            drift=axis,
            rate=rate,
        )
    first, *second = tuple(kind.lower())
    if second:
        return said(
            "Part of the drift D({drift}) that is proportional to the product of the accelerations along {first} and {second}; "
            "D({drift}) adds to the rate ω_{rate}",
            drift=axis,
            first=first,
            second=second[0],
            rate=rate,
        )
    return said(
        "Part of the drift D({drift}) that is proportional to the acceleration along {axis}; D({drift}) adds to the rate ω_{rate}",
        drift=axis,
        axis=first,
        rate=rate,
    )


def information(design: PositionsDesign) -> tuple[dict[str, object], Said]:
    """The values `determinant` and `condition` for comparing sets of positions, with rates in Earth-rate units and accelerations in g;
    and the same values in words."""
    sight = rank.look(design.matrix / design.magnitudes)
    determinant, condition = sight.determinant, sight.condition
    note = said(
        "Information matrix of the {positions} positions (rates in units of the Earth rate, accelerations in g): "
        "determinant {determinant:.6g}; condition number of the design matrix {condition:.3g}.",
        positions=len(design.matrix),
        determinant=determinant,
        condition=condition,
    )
    return {"determinant": determinant, "condition": condition}, note

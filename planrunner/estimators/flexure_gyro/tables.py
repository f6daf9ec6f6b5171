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
        said("Coefficient {term} of output i_{axis}", term=number, axis=axis)
        for axis, names in zip("xy", output_names(products), strict=True)
        for number in range(len(names))
    )
    return (*_GEOMETRY, *of_drifts, *of_outputs)


def _drift(axis: str, rate: str, kind: str) -> Said:
    """kind: `F`, or the axes of the accelerations."""
    if kind == "F":
        return said("Drift D({drift}), independent of acceleration; adds to ω_{rate}", drift=axis, rate=rate)
    first, *second = tuple(kind.lower())
    if second:
        return said(
            "Drift D({drift}), per product of accelerations along {first} and {second}; adds to ω_{rate}",
            drift=axis,
            first=first,
            second=second[0],
            rate=rate,
        )
    return said("Drift D({drift}), per acceleration along {axis}; adds to ω_{rate}", drift=axis, axis=first, rate=rate)


def information(design: PositionsDesign) -> tuple[dict[str, object], Said]:
    """`determinant` and `condition` by which sets of positions are compared, with rates in Earth-rate units and accelerations in g, and
    the same in words."""
    sight = rank.look(design.matrix / design.magnitudes)
    determinant, condition = sight.determinant, sight.condition
    note = said(
        "Information matrix of the {positions} positions (rates in Earth-rate units, accelerations in g): determinant "
        "{determinant:.6g}, condition of the design {condition:.3g}.",
        positions=len(design.matrix),
        determinant=determinant,
        condition=condition,
    )
    return {"determinant": determinant, "condition": condition}, note

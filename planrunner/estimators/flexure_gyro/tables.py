"""Explanations of a flexure gyro's static coefficients: their meaning and the determinant."""

from __future__ import annotations

from planrunner.error_model.flexure_gyro import drifts, output_names
from planrunner.estimators import rank
from planrunner.estimators.fit_positions import PositionsDesign

_GEOMETRY = (
    "Torquer scale factor, x",
    "Torquer scale factor, y",
    "Angle of the torquer's x axis to the case's x axis, ε",
    "Angle of the torquer's y axis to the case's y axis, ξ",
)
_DRIFT = {
    "F": "independent of acceleration",
    "X": "per acceleration along x",
    "Y": "per acceleration along y",
    "Z": "per acceleration along z",
    "XZ": "per product of accelerations along x and z",
    "YZ": "per product of accelerations along y and z",
}


def descriptions(products: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Descriptions, in the order of `flexure_gyro.physical_names` and then of `flexure_gyro.output_names`."""
    of_drifts = (
        f"Drift D({axis}), {_DRIFT[kind]}; adds to {sensed}"
        for axis, sensed in (("X", "ω_Y"), ("Y", "ω_X"))
        for kind in drifts(products)
    )
    of_outputs = (
        f"Coefficient {number} of output i_{axis}"
        for axis, names in zip("xy", output_names(products), strict=True)
        for number in range(len(names))
    )
    return (*_GEOMETRY, *of_drifts, *of_outputs)


def information(design: PositionsDesign) -> tuple[dict[str, object], str]:
    """`determinant` and `condition` by which sets of positions are compared, with rates in Earth-rate units and accelerations in g, and
    the same in words."""
    sight = rank.look(design.matrix / design.magnitudes)
    determinant, condition = sight.determinant, sight.condition
    note = (
        f"Information matrix of the {len(design.matrix)} positions (rates in Earth-rate units, accelerations in g): "
        f"determinant {determinant:.6g}, condition of the design {condition:.3g}."
    )
    return {"determinant": determinant, "condition": condition}, note

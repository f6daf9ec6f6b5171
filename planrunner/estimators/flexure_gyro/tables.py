"""What a reader needs to judge a flexure gyro's static coefficients: their meaning and the determinant."""

from __future__ import annotations

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

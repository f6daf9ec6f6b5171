"""The units in which the field states its noise coefficients: deg/√h and deg/h for rates, m/s/√h and µg for accelerations."""

from __future__ import annotations

import math
from collections.abc import Mapping

from planrunner.estimators.interface import EstimationError
from planrunner.plan.units import DIMENSIONS, Dimension, UnknownUnitError, unit

_NAMED = {
    DIMENSIONS["angular rate"]: {"Q": "arcsec", "N": "deg/sqrt(h)", "B": "deg/h", "K": "deg/h/sqrt(h)"},
    DIMENSIONS["acceleration"]: {"Q": "m/s", "N": "m/s/sqrt(h)", "B": "ug", "K": "ug/sqrt(h)"},
}
_OTHERWISE = {"Q": "{}*s", "N": "{}*sqrt(s)", "B": "{}", "K": "{}/sqrt(s)"}
_PULSES = {"Q": "pulse", "N": "pulse/sqrt(s)", "B": "pulse/s", "K": "pulse/s/sqrt(s)"}


def named_units(dimension: Dimension) -> Mapping[str, str] | None:
    """Maps Q, N, B and K to the field's units for a rate or an acceleration; None for any other quantity."""
    return _NAMED.get(dimension)


def coefficient_units(output: str) -> dict[str, tuple[str, float]]:
    """For each of Q, N, B and K, the text of its unit and the factor to it from the output's unit times s, √s, 1 and 1/√s. Raises
    `EstimationError`."""
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
    """For each of Q, N, B and K, the factor from the square root of Q²/τ0², N²/τ0, B² or K²·τ0 to the coefficient. interval: τ0 [s]."""
    root = math.sqrt(interval)
    return {"Q": interval, "N": root, "B": 1.0, "K": 1 / root}

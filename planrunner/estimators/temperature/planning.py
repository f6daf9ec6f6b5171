"""Checks before a recording that a plan has enough temperatures for a curve, and that the requested coefficients exist."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from planrunner.base.findings import closest
from planrunner.estimators.interface import DesignRequest, Remark
from planrunner.estimators.temperature.curve import FEWEST, groups_of
from planrunner.estimators.temperature.parameters import TemperatureModelParameters
from planrunner.estimators.temperature.points import given_by_temperature
from planrunner.plan.units import ZERO_CELSIUS


def remarks(request: DesignRequest[TemperatureModelParameters]) -> tuple[Remark, ...]:
    """Errors about requests that no recording can fulfil. Cases that are unknown before the recording are not reported: ramps, and
    estimates without a prediction."""
    if request.uses:
        return tuple(_of_estimates(request))
    if any(segment.ramp_to is not None or segment.temperature is None for segment in request.segments):
        return ()
    planned = [segment.temperature for segment in request.segments if segment.temperature is not None]
    return tuple(_too_few(request, "", planned, "segments"))


def _of_estimates(request: DesignRequest[TemperatureModelParameters]) -> list[Remark]:
    given = {name: given_by_temperature(used.expected[0]) for name, used in request.uses.items() if used.expected}
    none = [name for name, own in given.items() if not own]
    if none:
        message = (
            f"'{none[0]}' gives no coefficients over temperature: its segments have no temperature, or different ones"
        )
        hint = "choose segments with the same stated temperature for it, or use another estimate"
        return [Remark("physics-temperatures", message, hint, "uses", error=True)]
    if len(given) < len(request.uses):
        return []
    held: dict[str, list[float]] = {}
    for own in given.values():
        for name, data in own.items():
            celsius = np.atleast_1d(np.asarray(data["temperature_degC"], dtype=float))
            held.setdefault(name, []).extend((celsius + ZERO_CELSIUS).tolist())
    return _of_names(request, held)


def _of_names(request: DesignRequest[TemperatureModelParameters], held: Mapping[str, Sequence[float]]) -> list[Remark]:
    patterns = request.parameters.coefficients
    for place, pattern in enumerate(patterns):
        if not any(fnmatchcase(name, pattern) for name in held):
            message = f"no coefficient over temperature matches '{pattern}'"
            return [Remark("meaning-unknown-quantity", message, closest(pattern, held), f"coefficients[{place}]", True)]
    for name, kelvin in held.items():
        if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns):
            found = _too_few(request, f"{name}: ", kelvin, "uses")
            if found:
                return found
    return []


def _too_few(
    request: DesignRequest[TemperatureModelParameters], what: str, kelvin: Sequence[float], key: str
) -> list[Remark]:
    parameters = request.parameters
    planned: NDArray[np.float64] = np.array(kelvin, dtype=float)
    distinct = int(groups_of(planned, parameters.bin.value).max(initial=-1)) + 1
    needed = FEWEST if parameters.order is None else parameters.order + 1
    if distinct >= needed:
        return []
    order = "an order to be chosen" if parameters.order is None else f"order {parameters.order}"
    count = f"{distinct} planned temperature{'s are' if distinct != 1 else ' is'} too few"
    message = f"{what}{count} for a {parameters.form} of {order}, which needs {needed}"
    return [Remark("physics-temperatures", message, "sweep over more temperatures", key, error=True)]

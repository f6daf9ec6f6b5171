"""Declares the plan keys for coefficients as functions of temperature, and makes the checks that are possible before a recording.
The checks determine whether the plan has enough temperatures for a curve, and whether the requested coefficients exist.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from planrunner.base.findings import closest
from planrunner.estimators.interface import DesignRequest, Remark
from planrunner.estimators.temperature.curve import FEWEST, FORMS, RULES, groups_of
from planrunner.estimators.temperature.points import given_by_temperature
from planrunner.observation.drift import NONE, ORDERS
from planrunner.observation.flicker import drift_span
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, Number, QuantityOf, Record, Text, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.plan.units import ZERO_CELSIUS


class TemperatureModelParameters(Record):
    """Declares the plan keys of the estimator `temperature_model`."""

    coefficients: tuple[str, ...] = key(
        ListOf(Text("", "a coefficient's name or a pattern"), minimum=1, single=True),
        "Names of coefficients of the estimates in `uses`, or patterns with the wildcards * and ?; "
        "by default all coefficients that depend on temperature.",
        "gyro_bias_*",
        default_factory=tuple,
    )
    channels: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=1, single=True),
        "Channels to fit as functions of temperature, in place of coefficients of other estimates.",
        ["gyro_x"],
        default_factory=tuple,
    )
    temperature_channel: str | None = optional(
        CHANNEL,
        "The sensor's own thermometer, for channels along a ramp; by default the planned temperature.",
        "temperature",
    )
    form: str = key(
        Choice(FORMS), "Powers of T − reference, or a natural cubic spline.", "spline", default="polynomial"
    )
    order: int | None = optional(
        Number(0, 12, integer=True),
        "Order of the polynomial, or number of knots of the spline minus one; by default the order is chosen by cross-validation.",
        2,
    )
    highest_order: int = key(Number(1, 12, integer=True), "Highest order to try.", 4, default=4)
    folds: int = key(
        Number(0, 100, integer=True),
        "Number of ranges into which the temperatures are divided. Each range is left out in turn; with 0, each temperature is left out "
        "in turn.",
        5,
        default=0,
    )
    rule: str = key(
        Choice(RULES),
        "Rule for the selection of the curve. Each curve predicts the values that were left out. smallest_error: the curve with the "
        "smallest prediction error. one_standard_error: the simplest curve with an error at most one standard error above the smallest.",
        "smallest_error",
        default="one_standard_error",
    )
    reference: Quantity = key(
        QuantityOf("temperature"),
        "T₀, the temperature at which the polynomial equals its constant term.",
        "20 degC",
        default=parse_quantity("25 degC"),
    )
    bin: Quantity = key(
        QuantityOf("temperature", "positive"),
        "Along a ramp, samples are averaged in bins of this width. In the cross-validation, temperatures that differ by less than this "
        "width are left out together.",
        "2 K",
        default=parse_quantity("1 K"),
    )
    drift: str | None = optional(
        Choice((NONE, *ORDERS)),
        "Drift in time that is fitted together with the curve; each word includes the lower orders. `none` states that there is no drift. "
        "By default, no drift is fitted; a warning is given if the order of the temperatures would hide a drift.",
        "linear",
    )
    drift_span: Quantity = drift_span()
    uncertainty: str = key(
        Choice(("residual", "propagated")),
        "Basis of the uncertainties: the scatter of the values about the curve, or the values' own uncertainties.",
        "propagated",
        default="residual",
    )


def remarks(request: DesignRequest[TemperatureModelParameters]) -> tuple[Remark, ...]:
    """Returns an error for each request in a plan that no recording can fulfil. Ramps and estimates without a prediction cannot be
    judged before the recording, so there are no errors about them."""
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
    wanted = f"for a {parameters.form} of order {parameters.order}"
    if parameters.order is None:
        wanted = f"to choose the order of a {parameters.form}"
    count = f"{distinct} planned temperature{'s are' if distinct != 1 else ' is'} too few"
    message = f"{what}{count} {wanted}, which needs {needed}"
    return [Remark("physics-temperatures", message, "sweep over more temperatures", key, error=True)]

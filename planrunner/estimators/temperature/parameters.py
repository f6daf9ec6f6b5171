"""Keys of a plan for coefficients over temperature."""

from __future__ import annotations

from planrunner.estimators.temperature.curve import FORMS, RULES
from planrunner.observation.drift import NONE, ORDERS
from planrunner.observation.flicker import drift_span
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, Number, QuantityOf, Record, Text, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity


class TemperatureModelParameters(Record):
    """Keys of the estimator temperature_model."""

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
        "Number of contiguous temperature ranges, each of which is held out in turn; with 0, each temperature is held out in turn.",
        5,
        default=0,
    )
    rule: str = key(
        Choice(RULES),
        "one_standard_error: the simplest curve within one standard error of the smallest held-out error; "
        "smallest_error: the curve with the smallest held-out error.",
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
        "Along a ramp, samples are averaged in bins of this width; temperatures closer than this are held out together.",
        "2 K",
        default=parse_quantity("1 K"),
    )
    drift: str | None = optional(
        Choice((NONE, *ORDERS)),
        "Drift in time that is fitted together with the curve; each word includes the lower orders. `none` states that there is no drift. "
        "By default none is fitted, and a warning is given if the order of the temperatures would hide one.",
        "linear",
    )
    drift_span: Quantity = drift_span()
    uncertainty: str = key(
        Choice(("residual", "propagated")),
        "Basis of the uncertainties: the scatter of the values about the curve, or the values' own uncertainties.",
        "propagated",
        default="residual",
    )

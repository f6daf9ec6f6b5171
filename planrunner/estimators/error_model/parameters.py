"""Declares the plan keys of the estimator for catalogue effects."""

from __future__ import annotations

import re

from planrunner.base import plugins
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, closest
from planrunner.estimators.outputs_fit import uncertainty_basis
from planrunner.observation.drift import drift
from planrunner.observation.flicker import drift_span
from planrunner.plan import source
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, MapOf, QuantityOf, Record, Schema, Text, key, optional
from planrunner.plan.quantity import Quantity, anchored

AXES = ("x", "y", "z")
_COLUMN = r"[A-Za-z][A-Za-z0-9_]{0,39}"


@dataclass(frozen=True, slots=True)
class EffectKind:
    """Reads a plan value that names an installed effect or, after a dot, also one of its parameters."""

    what: str = "an effect, or one of its parameters such as `gyro_misalignment.towards_z`"

    def read(self, node: source.Node, log: Findings) -> str | None:
        text = node.value if isinstance(node, source.Scalar) and isinstance(node.value, str) else ""
        effect, dot, column = text.partition(".")
        known = plugins.names(plugins.EFFECTS)
        if effect in known and (not dot or re.fullmatch(_COLUMN, column)):
            return text
        shown = f"no effect '{text[:60]}' is installed" if text else "the name of an effect is expected here"
        log.error("form-choice", node.mark, shown, closest(effect, known))
        return None

    def schema(self) -> Schema:
        names = plugins.names(plugins.EFFECTS)
        parts = anchored(rf"(?:{'|'.join(names)})\.{_COLUMN}")
        return {"anyOf": [{"enum": list(names)}, {"type": "string", "pattern": parts}]}


class ErrorModelParameters(Record):
    """Declares the plan keys of the estimator `error_model`."""

    outputs: dict[str, tuple[str, ...]] = key(
        MapOf(ListOf(EffectKind(), minimum=1), of_channels=True),
        "The outputs, each with the effects that its model consists of.",
        {"gyro_x": ["gyro_bias", "gyro_scale_factor", "gyro_misalignment.towards_z"]},
    )
    axes: dict[str, str] = key(
        MapOf(Choice(AXES)),
        "The axis of the sensor along which an output measures. It is required unless the name of the output contains the letter of "
        "this axis and of no other axis.",
        {"torquer_x": "y"},
        default_factory=dict,
    )
    temperature_channel: str | None = optional(
        CHANNEL,
        "The sensor's own thermometer. Its mean over a segment is used as the temperature of the segment, and its readings are used "
        "for a drift with temperature. By default, a segment has its planned temperature, and a drift with temperature uses the "
        "recorded temperature channel, if there is exactly one.",
        "temperature",
    )
    supply_channel: str | None = optional(
        CHANNEL,
        "Channel of the supply voltage. Its mean over a segment is used; by default `supply_voltage` of the segment.",
        "supply_voltage",
    )
    pressure_channel: str | None = optional(
        CHANNEL,
        "Channel of the ambient pressure. Its mean over a segment is used; by default `ambient_pressure` of the segment.",
        "ambient_pressure",
    )
    supply_zero_uncertainty: Quantity | None = optional(
        QuantityOf("voltage", "not negative"),
        "Standard uncertainty of the zero error of the voltmeter for the supply, common to all segments.",
        "5 mV",
    )
    supply_reading_uncertainty: Quantity | None = optional(
        QuantityOf("ratio", "not negative"),
        "Relative standard uncertainty of the readings of the voltmeter for the supply, common to all segments.",
        "0.1 %",
    )
    pressure_zero_uncertainty: Quantity | None = optional(
        QuantityOf("pressure", "not negative"),
        "Standard uncertainty of the zero error of the barometer, common to all segments.",
        "0.3 hPa",
    )
    pressure_reading_uncertainty: Quantity | None = optional(
        QuantityOf("ratio", "not negative"),
        "Relative standard uncertainty of the readings of the barometer, common to all segments.",
        "500 ppm",
    )
    angle_channel: str | None = optional(
        CHANNEL,
        "The encoder of the table, for outputs that are fitted to samples; by default the planned angle.",
        "table_angle",
    )
    expected: dict[str, dict[str, str]] = key(
        MapOf(MapOf(Text(), pattern=_COLUMN), pattern=r"[a-z][a-z0-9_]{0,59}"),
        "Expected parameters of effects that have a shape parameter (such as a time constant): for each effect, the name and the value "
        "of each parameter, as in the driver `added_effects`. `check` predicts the uncertainties for these values; the estimate does "
        "not use them.",
        {"gyro_bandwidth": {"tau": "5 ms"}, "gyro_warm_up": {"tau": "600 s", "a_x": "0.01 deg/s"}},
        default_factory=dict,
    )
    uncertainty: str = uncertainty_basis()
    drift_span: Quantity = drift_span()
    drift: tuple[str, ...] = drift()

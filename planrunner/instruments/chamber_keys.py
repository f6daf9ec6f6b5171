"""Declares the bench-file keys that every chamber has, whether simulated or real: its range, its ramp and its declared
uncertainty."""

from __future__ import annotations

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.models import ChamberModel
from planrunner.plan.kinds import QuantityOf, Record, key
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.plan.units import ZERO_CELSIUS


class ChamberKeys(Record):
    """Declares the bench-file keys that all chambers have in common; planning uses them."""

    lowest: Quantity = key(QuantityOf("temperature"), "Lowest temperature of the chamber.", "-55 degC")
    highest: Quantity = key(QuantityOf("temperature"), "Highest temperature of the chamber.", "85 degC")
    ramp: Quantity = key(QuantityOf("temperature rate", "positive"), "Rate of change of the setpoint.", "3 K/min")
    ambient: Quantity = key(
        QuantityOf("temperature"),
        "Temperature at the start of a run; at the end of the run the chamber returns to it.",
        "25 degC",
        default=parse_quantity("25 degC"),
    )
    lag: Quantity = key(
        QuantityOf("time", "positive"),
        "Time constant with which the air temperature follows the setpoint.",
        "2 min",
        default=parse_quantity("2 min"),
    )
    tolerance: Quantity = key(
        QuantityOf("temperature", "positive"),
        "The setpoint is reached if the air temperature differs from it by no more than this.",
        "0.5 K",
        default=parse_quantity("0.5 K"),
    )
    temperature_uncertainty: Quantity = key(
        QuantityOf("temperature", "not negative"),
        "Declared standard uncertainty of the air temperature, in addition to the tolerance.",
        "0.1 K",
        default=parse_quantity("0 K"),
    )

    def model(self) -> ChamberModel:
        return ChamberModel(
            self.lowest.value,
            self.highest.value,
            self.ramp.value,
            self.ambient.value,
            self.lag.value,
            self.tolerance.value,
            self.temperature_uncertainty.value,
        )

    def check_reach(self, kelvin: float) -> None:
        """Raises `InstrumentError` if a temperature is outside the chamber's range."""
        if not self.lowest.value <= kelvin <= self.highest.value:
            shown, low, high = (value - ZERO_CELSIUS for value in (kelvin, self.lowest.value, self.highest.value))
            raise InstrumentError(f"{shown:g} degC is outside the chamber's range of {low:g} to {high:g} degC")

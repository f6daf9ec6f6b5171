"""The virtual temperature chamber: a ramped setpoint and air that lags behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.instruments.models import ChamberModel
from planrunner.instruments.virtual import thermal
from planrunner.instruments.virtual.world import World
from planrunner.plan.kinds import QuantityOf, Record, key
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.plan.units import ZERO_CELSIUS


class VirtualChamberParameters(Record):
    """A simulated chamber."""

    lowest: Quantity = key(QuantityOf("temperature"), "Lowest temperature it reaches.", "-55 degC")
    highest: Quantity = key(QuantityOf("temperature"), "Highest temperature it reaches.", "85 degC")
    ramp: Quantity = key(QuantityOf("temperature rate", "positive"), "Rate of its setpoint.", "3 K/min")
    ambient: Quantity = key(
        QuantityOf("temperature"), "Temperature it starts from and is left at.", "25 degC", parse_quantity("25 degC")
    )
    lag: Quantity = key(
        QuantityOf("time", "positive"),
        "Time constant of the air behind the setpoint.",
        "2 min",
        parse_quantity("2 min"),
    )
    tolerance: Quantity = key(
        QuantityOf("temperature", "positive"),
        "How near the air must be to count as there.",
        "0.5 K",
        parse_quantity("0.5 K"),
    )
    temperature_uncertainty: Quantity = key(
        QuantityOf("temperature", "not negative"),
        "Declared standard uncertainty of the air's temperature, beside the tolerance.",
        "0.1 K",
        parse_quantity("0 K"),
    )


class VirtualChamber:
    """A simulated chamber in the virtual world."""

    role = "chamber"
    Parameters = VirtualChamberParameters

    def __init__(self, parameters: VirtualChamberParameters, world: World):
        self.parameters = parameters
        self.world = world
        world.lags = replace(world.lags, ramp=parameters.ramp.value, air=parameters.lag.value)
        world.command = thermal.Command.resting(parameters.ambient.value)

    @classmethod
    def model(cls, parameters: VirtualChamberParameters) -> ChamberModel:
        p = parameters
        return ChamberModel(
            p.lowest.value,
            p.highest.value,
            p.ramp.value,
            p.ambient.value,
            p.lag.value,
            p.tolerance.value,
            p.temperature_uncertainty.value,
        )

    @classmethod
    def connect(cls, parameters: VirtualChamberParameters, surroundings: Surroundings) -> VirtualChamber:
        if parameters.lowest.value >= parameters.highest.value:
            raise InstrumentError("the chamber's lowest temperature is not below its highest")
        return cls(parameters, World.of(surroundings))

    def set_temperature(self, kelvin: float) -> float:
        p = self.parameters
        if not p.lowest.value <= kelvin <= p.highest.value:
            shown, low, high = (value - ZERO_CELSIUS for value in (kelvin, p.lowest.value, p.highest.value))
            raise InstrumentError(f"{shown:g} degC is beyond the chamber, which reaches {low:g} to {high:g} degC")
        self.world.head_for(kelvin)
        return thermal.time_to_reach(self.world.command, self.world.lags, p.tolerance.value)

    def at_temperature(self) -> bool:
        within = self.parameters.tolerance.value + 1e-6
        return abs(self._air() - self.world.command.target) <= within

    def read(self) -> Mapping[str, float]:
        return {"air_degC": self._air() - ZERO_CELSIUS}

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": "planrunner", "model": "virtual temperature chamber"}

    def make_safe(self) -> None:
        if self.world.command.target != self.parameters.ambient.value:
            self.world.head_for(self.parameters.ambient.value)

    def close(self) -> None:
        """Nothing is held open."""

    def checkpoint(self) -> Mapping[str, Any]:
        return self.world.thermal_state()

    def restore(self, state: Mapping[str, Any]) -> None:
        self.world.restore_thermal(state)

    def _air(self) -> float:
        return float(self.world.air(np.array([self.world.now()]))[0])

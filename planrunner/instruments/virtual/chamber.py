"""The virtual temperature chamber: its setpoint changes at a limited rate, and its air lags behind the setpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from planrunner.base.documents import Json
from planrunner.instruments.chamber_keys import ChamberKeys
from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.instruments.models import ChamberModel
from planrunner.instruments.virtual import thermal
from planrunner.plan.units import ZERO_CELSIUS

if TYPE_CHECKING:
    from planrunner.instruments.virtual.world import World


class VirtualChamberParameters(ChamberKeys):
    """Declares the bench-file keys of a simulated chamber."""


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
        return parameters.model()

    @classmethod
    def connect(cls, parameters: VirtualChamberParameters, surroundings: Surroundings) -> VirtualChamber:
        if parameters.lowest.value >= parameters.highest.value:
            raise InstrumentError("the chamber's lowest temperature is not below its highest")
        from planrunner.instruments.virtual.world import World  # a check needs only the model

        return cls(parameters, World.of(surroundings))

    def set_temperature(self, kelvin: float) -> float:
        self.parameters.check_reach(kelvin)
        self.world.head_for(kelvin)
        return thermal.time_to_reach(self.world.command, self.world.lags, self.parameters.tolerance.value)

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
        """Does nothing, because there are no open resources."""

    def checkpoint(self) -> Mapping[str, Json]:
        return self.world.thermal_state()

    def restore(self, state: Mapping[str, Json]) -> None:
        self.world.restore_thermal(state)

    def _air(self) -> float:
        return float(self.world.air(np.array([self.world.now()]))[0])

"""Contains what all real chambers share: checking the temperature range, deciding when the air has reached the setpoint, and
bringing the chamber to its safe state.

A separate file for each controller implements `AirCommands`; this file does not depend on a manufacturer. In the safe state, the
chamber holds the ambient temperature. The chamber is not switched off, because moisture could then condense on a cold sensor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, TypeVar

from planrunner.instruments.chamber_keys import ChamberKeys
from planrunner.instruments.interfaces import Condition, InstrumentError, OwnLimits, Surroundings
from planrunner.instruments.models import ChamberModel
from planrunner.instruments.wire.links import Commanded, CommandedDriver, Commands, LinkKeys
from planrunner.plan.schedule import Segment
from planrunner.plan.units import ZERO_CELSIUS

MARGIN = 5.0
"""Distance [K] beyond the temperature range of the bench file at which a chamber stops automatically, if it supports this."""


class WiredChamberKeys(LinkKeys, ChamberKeys):
    """Declares the bench-file keys that all real chambers have in common."""


K = TypeVar("K", bound=WiredChamberKeys)


class AirCommands(Commands, Protocol):
    """The operations that the commands of a chamber controller provide. Temperatures are in degC. Every failure is an
    `InstrumentError`."""

    def prepare(self, ramp: float) -> None:
        """Sets the units, and the rate of change of the setpoint to `ramp` [K/min], if the controller has these settings."""

    def limit(self, coldest: float, hottest: float) -> Sequence[str]:
        """Sets the temperatures at which the chamber stops by itself. Returns one line of text for each limit that was set.
        `coldest`, `hottest`: these temperatures, degC."""

    def head_for(self, celsius: float) -> None:
        """Changes the setpoint to `celsius` and starts the chamber."""

    def air(self) -> float: ...
    def faults(self) -> Sequence[str]:
        """Returns the reasons why the chamber cannot continue, in words; empty if there is no fault."""


class WiredChamber(Commanded[AirCommands]):
    """A real chamber, controlled through its `AirCommands`."""

    def __init__(self, commands: AirCommands, keys: ChamberKeys):
        super().__init__(commands)
        self.keys = keys
        self._target: float | None = None
        self._prepared = self._limited = False

    def limit(self, limits: OwnLimits) -> Sequence[str]:
        coldest = self.keys.lowest.value - MARGIN if limits.coldest is None else limits.coldest
        hottest = self.keys.highest.value + MARGIN if limits.hottest is None else limits.hottest
        told = self.commands.limit(coldest - ZERO_CELSIUS, hottest - ZERO_CELSIUS)
        self._limited = True
        return told

    def foresee(self, segments: Sequence[Segment]) -> None:
        """Checks the chamber before a run. Raises `InstrumentError` if the chamber reports a fault."""
        self._raise(self.commands.faults())

    def set_temperature(self, kelvin: float) -> float:
        self.keys.check_reach(kelvin)
        self._raise(self.commands.faults())
        self._prepare()
        if not self._limited:
            self.limit(OwnLimits())
        away = kelvin - ZERO_CELSIUS - self.commands.air()
        self.commands.head_for(kelvin - ZERO_CELSIUS)
        self._target = kelvin
        return self.keys.model().seconds_to_change(away)

    def at_temperature(self) -> bool:
        condition = self.watch()
        self._raise(condition.faults)
        return (
            self._target is not None
            and abs(condition.values["temperature"] - self._target) <= self.keys.tolerance.value
        )

    def watch(self) -> Condition:
        faults = tuple(self.commands.faults())
        return Condition({"temperature": self.commands.air() + ZERO_CELSIUS}, faults)

    def read(self) -> Mapping[str, float]:
        return {"air_degC": self.commands.air()}

    def make_safe(self) -> None:
        self._target = None
        ambient = self.keys.ambient.value - ZERO_CELSIUS
        try:
            self._prepare()
            self.commands.head_for(ambient)
        except InstrumentError:  # a connection that was lost unnoticed is opened anew
            self._prepare()
            self.commands.head_for(ambient)

    def _prepare(self) -> None:
        if not self._prepared:
            self.commands.prepare(self.keys.ramp.value * 60)
            self._prepared = True

    def _raise(self, faults: Sequence[str]) -> None:
        if faults:
            raise InstrumentError("the chamber: " + "; ".join(faults))


class ChamberDriver(CommandedDriver[K, AirCommands]):
    """Base class for drivers of real chambers.

    K is the record with the keys of the chamber. Derived drivers define `Parameters` and `commands_of`."""

    role = "chamber"

    @classmethod
    def model(cls, parameters: K) -> ChamberModel:
        return parameters.model()

    @classmethod
    def connect(cls, parameters: K, surroundings: Surroundings) -> WiredChamber:
        return WiredChamber(cls.identified(parameters), parameters)

"""Simulates a Watlow F4T chamber controller: it knows SCPI commands for one control loop, and does not reply to a write."""

from __future__ import annotations

import math
import re

from planrunner.plan.units import ZERO_CELSIUS
from planrunner.simulators.chamber_plant import FULL_RAMP, ChamberPlant
from planrunner.simulators.interface import Conversation
from planrunner.simulators.live_world import LiveWorld
from planrunner.simulators.message_port import NotUnderstoodError, number

_LOOP = re.compile(r":?(?:SOURCE|SOUR):CLOOP1:(\w+)(\?)?\s*(\S*)", re.IGNORECASE)
_OUTPUT = re.compile(r":?OUTPUT1:STATE(\?)?\s*(\S*)", re.IGNORECASE)
_UNIT = re.compile(r":?UNIT:TEMPERATURE(\?)?\s*(\S*)", re.IGNORECASE)
_SECONDS = {"MINUTES": 60.0, "HOURS": 3600.0}
_ACTIONS = ("OFF", "STARTUP", "SETPOINT", "BOTH")


class WatlowF4t:
    """Control loop 1 and output 1 of a simulated chamber. The chamber ignores messages that it does not understand."""

    identity = "WATLOW,F4T,simulated,4.07"

    def __init__(self, plant: ChamberPlant):
        self.plant = plant
        self.unit = "C"
        self.action, self.scale, self.rate = "OFF", "MINUTES", 0.0

    def answer(self, message: str) -> str | None:
        try:
            return self._answer(message.strip())
        except NotUnderstoodError:
            return None

    def later(self) -> list[str]:
        return []

    def watch(self) -> None:
        self.plant.air()

    def _answer(self, message: str) -> str | None:
        if message.upper() == "*IDN?":
            return self.identity
        if found := _LOOP.fullmatch(message):
            name = found[1].upper()
            if found[2]:
                return self._ask(name)
            self._tell(name, found[3].upper())
            return None
        if found := _OUTPUT.fullmatch(message):
            if found[1]:
                return "ON" if self.plant.running else "OFF"
            self._switch(found[2].upper())
            return None
        if found := _UNIT.fullmatch(message):
            if found[1]:
                return self.unit
            if found[2].upper() not in ("C", "F"):
                raise NotUnderstoodError(message)
            self.unit = found[2].upper()
            return None
        raise NotUnderstoodError(message)

    def _switch(self, state: str) -> None:
        if state in ("ON", "1"):
            self.plant.regulate()
        elif state in ("OFF", "0"):
            self.plant.stop()
        else:
            raise NotUnderstoodError(state)

    def _ask(self, name: str) -> str:
        if name == "PVALUE":
            return f"{self._out(self.plant.air()):.3f}"
        if name == "SPOINT":
            return f"{self._out(self.plant.setpoint):.3f}"
        if name == "ERROR":
            return "ERROR" if self.plant.alarms else "NONE"
        told = {"RACTION": self.action, "RSCALE": self.scale, "RRATE": f"{self.rate:g}"}
        if name not in told:
            raise NotUnderstoodError(name)
        return told[name]

    def _tell(self, name: str, argument: str) -> None:
        if name == "SPOINT":
            kelvin = self._in(number(argument))
            if not self.plant.model.lowest <= kelvin <= self.plant.model.highest:
                raise NotUnderstoodError(argument)
            self.plant.set_only(kelvin)
            return
        if name == "RACTION" and argument in _ACTIONS:
            self.action = argument
        elif name == "RSCALE" and argument in _SECONDS:
            self.scale = argument
        elif name == "RRATE" and number(argument) > 0:
            self.rate = number(argument)
        else:
            raise NotUnderstoodError(name)
        degree = 1.0 if self.unit == "C" else 5 / 9
        ramped = self.action in ("SETPOINT", "BOTH") and self.rate > 0
        self.plant.set_ramp(self.rate * degree / _SECONDS[self.scale] if ramped else FULL_RAMP)

    def _out(self, kelvin: float) -> float:
        celsius = kelvin - ZERO_CELSIUS
        return celsius if self.unit == "C" else celsius * 9 / 5 + 32

    def _in(self, value: float) -> float:
        if not math.isfinite(value):
            raise NotUnderstoodError(str(value))
        return (value if self.unit == "C" else (value - 32) * 5 / 9) + ZERO_CELSIUS


def simulated(keys: object, live: LiveWorld) -> Conversation:
    """Makes the simulated instrument for a bench file."""
    return Conversation(WatlowF4t(ChamberPlant(live)))

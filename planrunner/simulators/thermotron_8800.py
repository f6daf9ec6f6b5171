"""Simulates a Thermotron 8800 chamber controller: queries on channel 1, operations to which the reply is a code, and a stop code."""

from __future__ import annotations

import math
import re

from planrunner.plan.units import ZERO_CELSIUS
from planrunner.simulators.chamber_plant import ChamberPlant
from planrunner.simulators.interface import Conversation
from planrunner.simulators.live_world import LiveWorld
from planrunner.simulators.message_port import Manner, NotUnderstoodError, number

DONE, UNKNOWN, INCORRECT, OUT_OF_RANGE = "0", "1", "2", "5"
_RUNNING, _STOPPED_REMOTELY, _ALARM = 1, 5, 7
_OPERATION = re.compile(r"([A-Z]+)1,(\S+)")


class Thermotron8800:
    """Simulates a controller whose channel 1 is the temperature of the air in degC; ramps are in K/min."""

    identity = "8800"

    def __init__(self, plant: ChamberPlant):
        self.plant = plant

    def answer(self, message: str) -> str | None:
        message = message.strip().upper()
        asked = {
            "IDEN?": lambda: self.identity,
            "PVAR1?": lambda: f"{self.plant.air() - ZERO_CELSIUS:.2f}",
            "SETP1?": lambda: f"{self.plant.setpoint - ZERO_CELSIUS:.2f}",
            "MRMP1?": lambda: f"{self.plant.ramp * 60:g}",
            "SCOD?": lambda: str(self._stop_code()),
            "ALRM1?": lambda: str(sum(1 << number for number in set(self.plant.alarms))),
        }
        if message in asked:
            return asked[message]()
        try:
            return self._operate(message)
        except NotUnderstoodError:
            return UNKNOWN

    def later(self) -> list[str]:
        return []

    def watch(self) -> None:
        self.plant.air()

    def _operate(self, message: str) -> str:
        if message == "RUNM":
            self.plant.regulate()
            return DONE if self.plant.running else INCORRECT
        if message in ("STOP", "HOLD"):
            if message == "STOP":
                self.plant.stop()
            return DONE
        found = _OPERATION.fullmatch(message)
        if found is None:
            raise NotUnderstoodError(message)
        value = number(found[2])
        if found[1] == "SETP":
            kelvin = value + ZERO_CELSIUS
            if not self.plant.model.lowest <= kelvin <= self.plant.model.highest:
                return OUT_OF_RANGE
            self.plant.set_only(kelvin)
        elif found[1] == "MRMP":
            if not (value >= 0 and math.isfinite(value)):
                return OUT_OF_RANGE
            self.plant.set_ramp(value / 60)
        else:
            raise NotUnderstoodError(message)
        return DONE

    def _stop_code(self) -> int:
        if self.plant.alarms:
            return _ALARM
        return _RUNNING if self.plant.running else _STOPPED_REMOTELY


def simulated(keys: object, live: LiveWorld) -> Conversation:
    """Makes the simulated instrument for a bench file."""
    return Conversation(Thermotron8800(ChamberPlant(live)), Manner(b"\r", b"\r"))

"""A simulated table with SCPI-like commands. The commands are the same as in the example of the bench reference. Errors are stored
in a queue."""

from __future__ import annotations

import math
import re

from planrunner.simulators.interface import Conversation
from planrunner.simulators.live_world import LiveWorld
from planrunner.simulators.message_port import NotUnderstoodError, number, shown
from planrunner.simulators.table_plant import TablePlant

_AXIS = re.compile(r"AXIS(\d+):(POS|RATE|STOP|DRIVE|LIM:RATE|LIM:ACC)(\?)?\s*(\S*)", re.IGNORECASE)
_NOTHING = '0,"No error"'


class ScpiTable:
    """A simulated table with SCPI-like commands. The axes of the table are numbered from 1, and angles are in degrees. An unknown
    or impossible command adds an error to the queue."""

    identity = "Example,One-axis table,simulated,1.0"

    def __init__(self, plant: TablePlant):
        self.plant = plant
        self.rates = [math.degrees(axis.model.max_rate) for axis in plant.axes]
        self.accelerations = [math.degrees(axis.model.max_acceleration) for axis in plant.axes]
        self.errors: list[str] = []

    def answer(self, message: str) -> str | None:
        try:
            return self._answer(message.strip())
        except NotUnderstoodError as error:
            self.errors.append(str(error))
            return None

    def later(self) -> list[str]:
        return []

    def watch(self) -> None:
        for index in range(len(self.rates)):
            self.plant.state(index)

    def _answer(self, message: str) -> str | None:
        upper = message.upper()
        if upper == "*IDN?":
            return self.identity
        if upper == "SYST:ERR?":
            return self.errors.pop(0) if self.errors else _NOTHING
        found = _AXIS.fullmatch(message)
        if found is None or not 1 <= int(found[1]) <= len(self.rates):
            raise NotUnderstoodError('-113,"Undefined header"')
        index, what = int(found[1]) - 1, found[2].upper()
        if found[3]:
            return self._ask(index, what)
        self._tell(index, what, found[4])
        return None

    def _ask(self, index: int, what: str) -> str:
        angle, rate, _ = self.plant.state(index)
        told = {
            "POS": math.degrees(angle),
            "RATE": math.degrees(rate),
            "LIM:RATE": self.rates[index],
            "LIM:ACC": self.accelerations[index],
        }
        if what == "DRIVE":
            return "ON" if self.plant.axes[index].powered else "OFF"
        if what not in told:
            raise NotUnderstoodError('-113,"Undefined header"')
        return shown(told[what])

    def _tell(self, index: int, what: str, argument: str) -> None:
        axis = self.plant.axes[index]
        if what == "STOP":
            self.plant.stop(index, math.radians(self.accelerations[index]))
        elif what == "DRIVE":
            self._drive(index, argument.upper())
        elif what.startswith("LIM:"):
            held = self.rates if what == "LIM:RATE" else self.accelerations
            most = math.degrees(axis.model.max_rate if what == "LIM:RATE" else axis.model.max_acceleration)
            value = self._value(argument)
            if not 0 < value <= most * (1 + 1e-9):
                raise NotUnderstoodError('-222,"Data out of range"')
            held[index] = value
        elif not axis.powered:
            raise NotUnderstoodError('-221,"Settings conflict; drive off"')
        else:
            rate, acceleration = math.radians(self.rates[index]), math.radians(self.accelerations[index])
            value = math.radians(self._value(argument))
            if what == "POS":
                self.plant.go(index, value, rate, acceleration)
            else:
                self.plant.turn(index, value, rate, acceleration)

    def _drive(self, index: int, argument: str) -> None:
        axis = self.plant.axes[index]
        if argument == "ON":
            if self.plant.interlock_open:
                raise NotUnderstoodError('-221,"Settings conflict; interlock open"')
            self.plant.reset()
            axis.powered = True
        elif argument == "OFF":
            if axis.powered:
                self.plant.stop(index)
            axis.powered = False
        else:
            raise NotUnderstoodError('-224,"Illegal parameter value"')

    def _value(self, word: str) -> float:
        try:
            value = number(word)
        except NotUnderstoodError:
            raise NotUnderstoodError('-104,"Data type error"') from None
        if not math.isfinite(value):
            raise NotUnderstoodError('-222,"Data out of range"')
        return value


def simulated(keys: object, live: LiveWorld) -> Conversation:
    """Makes the simulated instrument for a bench file."""
    return Conversation(ScpiTable(TablePlant(live)))

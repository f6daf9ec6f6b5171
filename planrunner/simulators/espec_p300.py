"""A simulated Espec P300 / SCP220 chamber controller. The controller answers every message with `OK:` and the command, or with
`NA:` and the reason."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Protocol

from planrunner.plan.units import ZERO_CELSIUS
from planrunner.simulators.chamber_plant import ChamberPlant
from planrunner.simulators.interface import Conversation
from planrunner.simulators.live_world import LiveWorld
from planrunner.simulators.message_port import Manner, NotUnderstoodError, number

_ADDRESSED = re.compile(r"(\d+),(.*)", re.DOTALL)
_MARGIN = 20.0  # K beyond the chamber's range that its limits may lie
UNKNOWN, OUT_OF_RANGE, NOT_READY = "NA:CMD ERR", "NA:DATA OUT OF RANGE", "NA:CHB NOT READY"


class EspecP300:
    """A simulated P300 controller. `address`: address of the chamber on RS-485; messages to other addresses are ignored. On TCP and
    RS-232, `address` is None."""

    identity = "T,T,S2,140.0"

    def __init__(self, plant: ChamberPlant, address: int | None = None):
        self.plant = plant
        self.address = address
        self.mode = "STANDBY"

    def answer(self, message: str) -> str | None:
        message = message.strip()
        if self.address is not None:
            found = _ADDRESSED.fullmatch(message)
            if found is None or int(found[1]) != self.address:
                return None
            message = found[2].strip()
        asked: dict[str, Callable[[], str]] = {
            "TEMP?": self._temperatures,
            "MON?": self._monitor,
            "MODE?": self.mode_now,
        }
        asked |= {"TYPE?": lambda: self.identity, "ALARM?": self._alarms}
        if message.upper() in asked:
            return asked[message.upper()]()
        words = message.upper().split(",")
        try:
            refused = self._tell(words[0], words[1:])
        except NotUnderstoodError:
            refused = UNKNOWN
        return refused or f"OK:{message}"

    def later(self) -> list[str]:
        return []

    def watch(self) -> None:
        self.plant.air()

    def mode_now(self) -> str:
        return self.mode

    def _temperatures(self) -> str:
        kelvin = (self.plant.air(), self.plant.setpoint, self.plant.highest, self.plant.lowest)
        return ",".join(_tenths(value) for value in kelvin)

    def _monitor(self) -> str:
        return f"{_tenths(self.plant.air())},,{self.mode_now()},{len(self.plant.alarms)}"

    def _alarms(self) -> str:
        return ",".join(map(str, (len(self.plant.alarms), *self.plant.alarms)))

    def _tell(self, word: str, arguments: list[str]) -> str | None:
        """Executes a command; returns the reason if it is refused, otherwise None."""
        if word == "TEMP" and arguments:
            return self._limits([(argument[:1], number(argument[1:])) for argument in arguments])
        if word == "POWER" and arguments in (["ON"], ["OFF"]):
            return self._enter("STANDBY" if arguments == ["ON"] else "OFF") if self.mode != "CONSTANT" else None
        if word == "MODE" and arguments in (["CONSTANT"], ["STANDBY"], ["OFF"]):
            return self._enter(arguments[0])
        raise NotUnderstoodError(word)

    def _enter(self, mode: str) -> str | None:
        if mode == "CONSTANT" and self.plant.alarms:
            return NOT_READY
        self.mode = mode
        if mode == "CONSTANT":
            self.plant.regulate()
        else:
            self.plant.stop()
        return None

    def _limits(self, given: list[tuple[str, float]]) -> str | None:
        plant = self.plant
        wanted = {"S": plant.setpoint, "H": plant.highest, "L": plant.lowest}
        for letter, celsius in given:
            if letter not in wanted:
                raise NotUnderstoodError(letter)
            kelvin = celsius + ZERO_CELSIUS
            beyond = 1e-6 if letter == "S" else _MARGIN
            if not plant.model.lowest - beyond <= kelvin <= plant.model.highest + beyond:
                return OUT_OF_RANGE
            wanted[letter] = kelvin
        if not wanted["L"] <= wanted["S"] <= wanted["H"]:
            return OUT_OF_RANGE
        plant.lowest, plant.highest = wanted["L"], wanted["H"]
        plant.set_only(wanted["S"])
        return None


def _tenths(kelvin: float) -> str:
    return f"{kelvin - ZERO_CELSIUS:.1f}"


class EspecP300Keys(Protocol):
    station: int


def simulated(keys: EspecP300Keys, live: LiveWorld) -> Conversation:
    """Makes the simulated instrument for a bench file, with the address that the bench file states."""
    controller = EspecP300(ChamberPlant(live), address=keys.station)
    return Conversation(controller, Manner(b"\r\n", b"\r\n"))

"""Simulates an Ideal Aerosmith table on a serial line. Commands are mnemonics of three letters; the table answers each command with
a line and a prompt.

The answer to a long motion (`JOG`, a sine) is sent when the motion ends. `STO` has no answer.
"""

from __future__ import annotations

import math
import re

from planrunner.simulators.interface import Conversation
from planrunner.simulators.live_world import LiveWorld
from planrunner.simulators.message_port import Manner, NotUnderstoodError, number, shown
from planrunner.simulators.table_plant import TablePlant

_COMMAND = re.compile(r"([A-Za-z]{3})\s*(\S*)")


class Aerosmith:
    """A simulated table with one axis. Angles are in degrees."""

    identity = "Ideal Aerosmith, simulated"

    def __init__(self, plant: TablePlant):
        self.plant = plant
        model = plant.axes[0].model
        plant.axes[0].powered = True
        self.rate, self.acceleration = math.degrees(model.max_rate), math.degrees(model.max_acceleration)
        self.amplitude, self.frequency = 0.0, 1.0
        self.cycles = 0.0
        self.lasting = False

    def answer(self, message: str) -> str | None:
        if not message.strip():
            return ""
        try:
            found = _COMMAND.fullmatch(message.strip())
            if found is None:
                raise NotUnderstoodError(message)
            return self._answer(found[1].upper(), found[2])
        except NotUnderstoodError:
            return "?"

    def later(self) -> list[str]:
        """Returns the answer to a long motion that has ended since the last call."""
        if self.lasting and self.plant.paths.still(self.plant.live.now()):
            self.lasting = False
            return [""]
        return []

    def watch(self) -> None:
        self.plant.state(0)

    def _answer(self, word: str, argument: str) -> str | None:
        angle, rate, _ = self.plant.state(0)
        fault = 1 if self.plant.interlock_fault or self.plant.axes[0].faults else 0
        asked = {"PPO": shown(math.degrees(angle)), "PVE": shown(math.degrees(rate)), "STA": str(fault)}
        if word in asked and not argument:
            return asked[word]
        acceleration = math.radians(self.acceleration)
        if word == "STO":
            self.plant.stop(0, acceleration)
            return None
        if word == "SGO":
            self._may_move()
            phase, limits = 0.0, (math.radians(self.rate), acceleration)
            self.plant.swing(0, math.radians(self.amplitude), self.frequency, phase, *limits)
            self.lasting = True
            return None
        return self._set(word, 0.0 if word == "HOM" else number(argument))

    def _set(self, word: str, value: float) -> str | None:
        if not math.isfinite(value):
            raise NotUnderstoodError(word)
        rate, acceleration = math.radians(self.rate), math.radians(self.acceleration)
        if word == "JOG":
            self._may_move()
            self.plant.turn(0, math.radians(value), rate, acceleration)
            self.lasting = True
            return None
        if word in ("MOV", "HOM"):
            self._may_move()
            self.plant.go(0, math.radians(value), rate, acceleration)
            return ""
        names = {"VEL": "rate", "ACL": "acceleration", "AMP": "amplitude", "FRQ": "frequency", "CYC": "cycles"}
        if word not in names or value < 0 or (value == 0 and word in ("VEL", "ACL", "FRQ")):
            raise NotUnderstoodError(word)
        setattr(self, names[word], value)
        return ""

    def _may_move(self) -> None:
        if self.plant.interlock_fault or self.plant.axes[0].faults:
            raise NotUnderstoodError("the table is switched off")


def simulated(keys: object, live: LiveWorld) -> Conversation:
    """Makes the simulated instrument for a bench file."""
    return Conversation(Aerosmith(TablePlant(live)), Manner(b"\r\n", b"\r", "prompt"))

"""Drives single-axis tables of Ideal Aerosmith over a serial line, in their table language ATL. The driver is experimental.

The only sources of this driver are open-source drivers. A command consists of a mnemonic and a number; the reply consists of a line
and a prompt. The controller replies to commands for jogging and rocking only when the motion ends; this driver does not wait for
that reply. The open-source drivers do not mention limits at which the table stops by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.tables.axis_commands import AxisBounds, AxisCommands, AxisState, Sine
from planrunner.instruments.tables.axis_table import LinkedTableKeys, TableDriver
from planrunner.instruments.wire.links import Incoming, LinkedCommands, LinkFailure, LinkSettings, MessageLink, shown
from planrunner.instruments.wire.replies import number, written

PROMPT = b">"
END = b"\r"


class PromptedLines:
    """Reads the reply to a command: a line, then a line that contains only the prompt. `telling`: True to skip empty replies. When
    a motion ends, the controller sends an empty reply, which may arrive between a query and its reply."""

    def __init__(self, *, telling: bool = False):
        self.telling = telling

    def read(self, incoming: Incoming) -> bytes:
        while True:
            line = incoming.until(END)
            prompt = incoming.until(END).strip()
            if prompt != PROMPT:
                raise LinkFailure(f"answers with {shown(prompt)} instead of its prompt")
            if line.strip() or not self.telling:
                return line


TELLING = PromptedLines(telling=True)


class AerosmithParameters(LinkedTableKeys):
    """Declares the bench-file keys of a single-axis table of Ideal Aerosmith."""


class Aerosmith(TableDriver[AerosmithParameters]):
    """A single-axis table of Ideal Aerosmith, over a serial line (experimental)."""

    Parameters = AerosmithParameters

    @classmethod
    def commands_of(cls, parameters: AerosmithParameters) -> AxisCommands:
        if len(parameters.axes) != 1:
            raise InstrumentError(f"the bench file declares {len(parameters.axes)} axes for this single-axis table")
        return AerosmithCommands(parameters)


class AerosmithCommands(LinkedCommands):
    """Translates the operations of `AxisCommands` to commands of an Ideal Aerosmith table."""

    rocks = True

    def __init__(self, parameters: AerosmithParameters):
        settings = LinkSettings(
            parameters.address, parameters.timeout.value, "\r\n", baud=parameters.baud, idle=b"\r\n >"
        )
        self.link = MessageLink(settings, PromptedLines())

    def identify(self) -> Mapping[str, str]:
        return {
            "manufacturer": "Ideal Aerosmith",
            "model": "table language ATL",
            "status": self.link.query("STA", framing=TELLING),
        }

    def limit(self, axis: int, bounds: AxisBounds) -> Sequence[str]:
        self._do(f"ACL{written(bounds.acceleration)}")
        self._do(f"VEL{written(bounds.rate)}")
        return [
            f"moves at {bounds.rate:g} deg/s and {bounds.acceleration:g} deg/s^2; this table does not trip by itself"
        ]

    def energise(self) -> None:
        """Does nothing, because the table is always ready."""

    def go_to(self, positions: Mapping[int, float], here: Mapping[int, float]) -> None:
        for position in positions.values():
            self._do(f"MOV{written(position)}")

    def turn(self, axis: int, rate: float) -> None:
        self.link.write("STO" if rate == 0.0 else f"JOG{written(rate)}")

    def rock(self, sines: Mapping[int, Sine]) -> None:
        for sine in sines.values():
            if sine.amplitude == 0.0:
                self.stop()
                continue
            if sine.phase % 360 != 0.0:
                raise InstrumentError("this table can begin rocking only at phase zero")
            self._do(f"AMP{written(abs(sine.amplitude))}")
            self._do(f"FRQ{written(sine.frequency)}")
            self._do("CYC0")
            self.link.write("SGO")

    def state(self, axis: int) -> AxisState:
        return AxisState(number(self.link, "PPO", TELLING), number(self.link, "PVE", TELLING))

    def faults(self) -> Sequence[str]:
        return []

    def stop(self) -> None:
        self.link.write("STO")

    def switch_off(self) -> None:
        """Does nothing, so the servo stays on. The caller checks whether the table is at rest."""

    def _do(self, command: str) -> None:
        if self.link.query(command, again=False) == "?":
            raise InstrumentError(f"the table rejects '{command}'")

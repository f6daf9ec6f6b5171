"""Drives chambers with an Espec P300 or SCP-220 controller, over TCP (port 10001) or a serial line.

The controller answers every command with `OK:` and the command, or with `NA:` and the reason. Before the chamber first runs, its
upper and lower temperature alarms are set, so that the chamber stops by itself outside these limits. Sources: P300 communication
manual; the open library of the manufacturer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planrunner.instruments.chambers.wired_chamber import AirCommands, ChamberDriver, WiredChamberKeys
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire.links import LineAnswers, LinkedCommands, LinkSettings, MessageLink
from planrunner.instruments.wire.replies import parsed
from planrunner.plan.kinds import Number, optional

REASONS = {
    "CMD ERR": "it does not know the command",
    "ADDR ERR": "the address is wrong",
    "DATA OUT OF RANGE": "the value is beyond its range",
    "PROTECT ON": "its settings are protected at the panel",
    "CHB NOT READY": "the chamber is not ready, as after an alarm",
}


class EspecP300Parameters(WiredChamberKeys):
    """Declares the bench-file keys of a chamber with an Espec P300 or SCP-220 controller."""

    station: int | None = optional(
        Number(1, 16, integer=True), "Address of the chamber on a line that several chambers share (RS-485).", 1
    )


class EspecP300(ChamberDriver[EspecP300Parameters]):
    """A chamber with an Espec P300 or SCP-220 controller, over TCP or a serial line."""

    Parameters = EspecP300Parameters

    @classmethod
    def commands_of(cls, parameters: EspecP300Parameters) -> AirCommands:
        return EspecP300Commands(parameters)


class EspecP300Commands(LinkedCommands):
    """Translates the operations of `AirCommands` to commands of a P300 controller."""

    def __init__(self, parameters: EspecP300Parameters):
        self.parameters = parameters
        settings = LinkSettings(parameters.address, parameters.timeout.value, "\r\n", baud=parameters.baud)
        self.link = MessageLink(settings, LineAnswers(b"\r\n"))
        self.station = "" if parameters.station is None else f"{parameters.station},"

    def identify(self) -> Mapping[str, str]:
        """Returns the type of the chamber: its sensors, controller and highest temperature. The controller reports neither
        manufacturer nor serial number."""
        said = self._ask("TYPE?")
        self.parameters.check_identity(said, "")
        if said.count(",") not in (2, 3):
            raise InstrumentError(
                f"{self.parameters.address} answers 'TYPE?' with '{said[:60]}', which is not an answer of a P300: check the address"
            )
        return {"manufacturer": "Espec", "model": "P300 or SCP-220", "type": said}

    def prepare(self, ramp: float) -> None:
        """Prepares operation at a constant setpoint, which the chamber approaches at its largest rate."""

    def limit(self, coldest: float, hottest: float) -> Sequence[str]:
        self._do(f"TEMP,H{hottest:.1f}")
        self._do(f"TEMP,L{coldest:.1f}")
        return [f"the chamber gives an alarm below {coldest:.1f} and above {hottest:.1f} degC"]

    def head_for(self, celsius: float) -> None:
        self._do(f"TEMP,S{celsius:.1f}")
        self._do("POWER,ON")
        self._do("MODE,CONSTANT")

    def air(self) -> float:
        return parsed(self._ask("TEMP?"), "TEMP?", 4, self.parameters.address)[0]

    def faults(self) -> Sequence[str]:
        said = self._ask("MON?")
        alarms = said.split(",")[-1].strip()
        if not alarms.isdecimal():
            raise InstrumentError(
                f"{self.parameters.address} answers 'MON?' with '{said[:60]}', without a number of alarms"
            )
        return [] if int(alarms) == 0 else [f"alarms of the P300 (number, codes): {self._ask('ALARM?')[:60]}"]

    def _do(self, command: str) -> None:
        said = self._ask(command, again=False)
        if said.replace(" ", "").casefold() != f"OK:{command}".casefold():
            raise InstrumentError(
                f"{self.parameters.address} answers '{command}' with '{said[:60]}' instead of OK:{command}"
            )

    def _ask(self, text: str, again: bool = True) -> str:
        said = self.link.query(self.station + text, again=again)
        if said.startswith("NA:"):
            reason = REASONS.get(said[3:].strip(), "see the manual of the controller for the reason")
            raise InstrumentError(f"{self.parameters.address} refuses '{text}' with '{said[:60]}': {reason}")
        return said

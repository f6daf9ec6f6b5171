"""Drives chambers with a Thermotron 8800 controller, over TCP (port 8888).

A reply of 0 means that the controller accepted an operation. The stop code shows that the chamber runs, or why it stopped. The
limits of the chamber are set at its panel. Source: Thermotron, 8800 interface command descriptions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planrunner.instruments.chambers.wired_chamber import AirCommands, ChamberDriver, WiredChamberKeys
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire.links import LineAnswers, LinkedCommands, LinkSettings, MessageLink
from planrunner.instruments.wire.replies import number, written
from planrunner.plan.kinds import Number, key

RUNNING = 1
STOP_CODES = {
    0: "it was started with empty memory",
    2: "its stop key was pressed",
    3: "its test ended",
    4: "an external input stopped it",
    5: "it was stopped from a computer",
    6: "a sensor is open",
    7: "a process alarm",
    8: "its system monitor tripped",
    9: "the power failed",
    10: "Therm-Alarm tripped",
}
TRIPS = {6, 7, 8, 10}
"""Alarms that must be cleared before the chamber can run again."""
ALARMS = {0: "low deviation", 1: "high deviation", 4: "low process", 5: "high process"}
"""Bits of the alarm status."""


class Thermotron8800Parameters(WiredChamberKeys):
    """Declares the bench-file keys of a chamber with a Thermotron 8800 controller."""

    channel: int = key(Number(1, 4, integer=True), "Channel of the air temperature.", 1, default=1)


class Thermotron8800(ChamberDriver[Thermotron8800Parameters]):
    """A chamber with a Thermotron 8800 controller, over TCP."""

    Parameters = Thermotron8800Parameters

    @classmethod
    def commands_of(cls, parameters: Thermotron8800Parameters) -> AirCommands:
        return Thermotron8800Commands(parameters)


class Thermotron8800Commands(LinkedCommands):
    """Translates the operations of `AirCommands` to commands of an 8800 controller."""

    def __init__(self, parameters: Thermotron8800Parameters):
        self.parameters = parameters
        settings = LinkSettings(parameters.address, parameters.timeout.value, "\r", baud=parameters.baud)
        self.link = MessageLink(settings, LineAnswers(b"\r"))
        self._started = False

    def identify(self) -> Mapping[str, str]:
        said = self.link.query("IDEN?")
        self.parameters.check_identity(said, "8800")
        return {"manufacturer": "Thermotron", "model": said}

    def prepare(self, ramp: float) -> None:
        self._do(f"MRMP{self.parameters.channel},{written(ramp)}")

    def limit(self, coldest: float, hottest: float) -> Sequence[str]:
        return []

    def head_for(self, celsius: float) -> None:
        self._do(f"SETP{self.parameters.channel},{written(celsius)}")
        if self._stop_code() != RUNNING:
            self._do("RUNM")
        self._started = True

    def air(self) -> float:
        return number(self.link, f"PVAR{self.parameters.channel}?")

    def faults(self) -> Sequence[str]:
        code, found = self._stop_code(), []
        if code in TRIPS or (self._started and code != RUNNING):
            found.append(f"the 8800 has stopped: {STOP_CODES.get(code, f'code {code}')}")
        status = int(number(self.link, f"ALRM{self.parameters.channel}?"))
        found += [
            f"{what} alarm of channel {self.parameters.channel}" for bit, what in ALARMS.items() if status >> bit & 1
        ]
        return found

    def _stop_code(self) -> int:
        return int(number(self.link, "SCOD?"))

    def _do(self, command: str) -> None:
        said = self.link.query(command, again=False)
        if said != "0":
            raise InstrumentError(
                f"{self.parameters.address} answers '{command}' with '{said[:40]}' instead of 0: look at its panel"
            )

"""Drives chambers with a Watlow F4T controller, over its SCPI port (TCP 5025).

The controller does not reply to a write, so setpoints are read back. Limits are set at the panel; SCPI has no command for them.
Source: F4T setup and operation manual, SCPI commands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planrunner.instruments.chambers.wired_chamber import AirCommands, ChamberDriver, WiredChamberKeys
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire.links import LinkedCommands, LinkSettings, MessageLink
from planrunner.instruments.wire.replies import identification, number, written
from planrunner.plan.kinds import Number, key

PACE = 0.1
"""Time between two messages, s; other drivers also wait between writes."""


class WatlowF4tParameters(WiredChamberKeys):
    """Declares the bench-file keys of a chamber with a Watlow F4T controller."""

    loop: int = key(Number(1, 4, integer=True), "Control loop of the air temperature.", 1, default=1)
    output: int = key(Number(1, 12, integer=True), "Output, or event, that switches conditioning on.", 1, default=1)


class WatlowF4t(ChamberDriver[WatlowF4tParameters]):
    """A chamber with a Watlow F4T controller, over SCPI."""

    Parameters = WatlowF4tParameters

    @classmethod
    def commands_of(cls, parameters: WatlowF4tParameters) -> AirCommands:
        return WatlowF4tCommands(parameters)


class WatlowF4tCommands(LinkedCommands):
    """Translates the operations of `AirCommands` to commands of an F4T controller."""

    def __init__(self, parameters: WatlowF4tParameters):
        self.parameters = parameters
        self.link = MessageLink(LinkSettings(parameters.address, parameters.timeout.value, "\n", PACE, parameters.baud))
        self.loop = f":SOURCE:CLOOP{parameters.loop}"

    def identify(self) -> Mapping[str, str]:
        said = self.link.query("*IDN?")
        self.parameters.check_identity(said, "F4T")
        return identification(said)

    def prepare(self, ramp: float) -> None:
        self.link.write(":UNIT:TEMPERATURE C")
        unit = self.link.query(":UNIT:TEMPERATURE?")
        if unit.upper() != "C":
            message = (
                f"the F4T keeps the temperature unit '{unit[:20]}', although C was commanded: set the unit at its panel"
            )
            raise InstrumentError(message)
        self.link.write(f"{self.loop}:RSCALE MINUTES")
        self.link.write(f"{self.loop}:RRATE {written(ramp)}")
        self.link.write(f"{self.loop}:RACTION SETPOINT")

    def limit(self, coldest: float, hottest: float) -> Sequence[str]:
        return []

    def head_for(self, celsius: float) -> None:
        self.link.write(f"{self.loop}:SPOINT {written(celsius)}")
        kept = number(self.link, f"{self.loop}:SPOINT?")
        if abs(kept - celsius) > 0.1:
            raise InstrumentError(
                f"the F4T keeps the set point {kept:g} instead of {celsius:g} degC: check its set point limits"
            )
        self.link.write(f":OUTPUT{self.parameters.output}:STATE ON")

    def air(self) -> float:
        return number(self.link, f"{self.loop}:PVALUE?")

    def faults(self) -> Sequence[str]:
        said = self.link.query(f"{self.loop}:ERROR?")
        return [] if said.upper() == "NONE" else [f"control loop {self.parameters.loop} of the F4T reports {said[:40]}"]

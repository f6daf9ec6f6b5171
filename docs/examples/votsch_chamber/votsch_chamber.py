"""Chambers with the ASCII-2 protocol, such as those of Vötsch: one query returns all values, one command sets all values."""

from planrunner.instruments.chambers.wired_chamber import ChamberDriver, WiredChamberKeys
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire.links import LineAnswers, LinkedCommands, LinkSettings, MessageLink
from planrunner.plan.kinds import Number, key

RUNNING = 1  # index of the bit that starts and stops the chamber


class VotschParameters(WiredChamberKeys):
    """A chamber with the ASCII-2 protocol."""

    station: int = key(Number(1, 99, integer=True), "Number of the chamber on the line.", 1, default=1)


class Votsch(ChamberDriver):
    """A chamber with the ASCII-2 protocol, such as one of Vötsch."""

    Parameters = VotschParameters

    @classmethod
    def commands_of(cls, parameters):
        return VotschCommands(parameters)


class VotschCommands(LinkedCommands):
    """Commands of an ASCII-2 chamber; implements `AirCommands`."""

    def __init__(self, parameters):
        settings = LinkSettings(
            parameters.address, parameters.timeout.value, "\r\n", baud=parameters.baud, idle=b"\r\n 0"
        )
        self.link = MessageLink(settings, LineAnswers(b"\r\n"))
        self.station = f"${parameters.station:02d}"

    def identify(self):
        self._values()  # the protocol has no identification, but no other instrument replies in this form
        return {"manufacturer": "Vötsch", "model": "ASCII-2"}

    def prepare(self, ramp):
        """The ramp is set at the panel."""

    def limit(self, coldest, hottest):
        return []  # the limits of the chamber are set at its panel

    def head_for(self, celsius):
        values, bits = self._values()
        wanted = [celsius, *values[2::2]]  # set points only; those of the other channels stay
        bits = bits[:RUNNING] + "1" + bits[RUNNING + 1 :]
        self.link.write(" ".join([f"{self.station}E", *(f"{value:06.1f}" for value in wanted), bits]))
        kept, bits = self._values()
        if abs(kept[0] - celsius) > 0.1 or bits[RUNNING] != "1":
            raise InstrumentError(f"the chamber stays at set point {kept[0]:g} degC: is it in remote operation?")

    def air(self):
        return self._values()[0][1]

    def faults(self):
        return []  # the alarm bits differ from model to model

    def _values(self):
        """Set point and measured value of each channel in turn, and the bits."""
        said = self.link.query(f"{self.station}I")
        *values, bits = said.split() or [""]
        try:
            if len(values) < 2 or len(values) % 2 or set(bits) - {"0", "1"} or len(bits) <= RUNNING:
                raise ValueError
            return [float(value) for value in values], bits
        except ValueError:
            raise InstrumentError(f"'{said[:60]}' is not an ASCII-2 reply: check address and station") from None

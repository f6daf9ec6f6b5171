"""A monitor: the latest temperature that another program writes into a text file, one reading per line."""

from pathlib import Path

from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Record, Text, key


class LoggedThermometerParameters(Record):
    file: str = key(Text(), "Text file whose last line is the latest temperature in degC.", "room.txt")


class LoggedThermometer:
    """A thermometer that another program reads and logs."""

    role = "monitor"
    Parameters = LoggedThermometerParameters

    def __init__(self, file):
        self.file = file

    @classmethod
    def connect(cls, parameters, surroundings):
        thermometer = cls(Path(parameters.file))
        thermometer.read()  # fails now, before anything moves
        return thermometer

    def identify(self):
        return {"model": "logged thermometer", "file": str(self.file)}

    def read(self):
        try:
            return {"air_degC": float(self.file.read_text(encoding="utf-8").split()[-1])}
        except (OSError, ValueError, IndexError) as error:
            raise InstrumentError(f"no temperature in {self.file} ({error}): is its logger running?") from None

    def make_safe(self):
        """Nothing to do: reading moves nothing."""

    def close(self):
        """Nothing to do: nothing stays open."""

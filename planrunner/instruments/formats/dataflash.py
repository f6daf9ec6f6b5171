"""Reads dataflash logs of ArduPilot, in their binary form (.bin) and as text (.log), with pymavlink.

A recording takes all its columns from one kind of message, because each kind has its own times. A column has the name of the field,
such as `GyrX`.
"""

from __future__ import annotations

import contextlib
import io
from array import array
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.findings import closest
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats.file import FormatFile, HeldRows, SampleRows, TimeStamps, open_samples
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Number, Record, Text, key
from planrunner.plan.span import Span

MAX_LOG = 1_000_000_000
"""Maximum size of a log in bytes. pymavlink keeps the position of every message of the log in memory."""
MAX_HELD = 60_000_000
"""Maximum number of numbers in the messages that are read. These numbers are kept in memory."""
BINARY = b"\xa3\x95\x80"
"""First bytes of a binary log: the start of a message FMT, which describes the fields of one kind of message."""
TEXT = rb"FMT,\s*128,\s*89,"
_NUMBERS = "bBhHiIfdcCeELMqQ"
"""Letters for the types of numeric fields in the descriptions of the messages."""
_INERTIAL = ("IMU", "GYR", "ACC")
_UNITS = {"Gyr": "rad/s", "Acc": "m/s^2", "TimeUS": "us"}
"""Units of fields of the inertial messages, by the start of their names (ArduPilot, Onboard Message Log Messages)."""
_LAST = 1_000_000_000  # largest number of an instance


class MessageForm(Protocol):
    """The description of a message in a log. `format`: one letter for the type of each field. `instance_field`: the field that
    states which of several sensors sent the message; None if there is no such field."""

    name: str
    format: str
    columns: Sequence[str]
    instance_field: str | None


class LogReader(Protocol):
    """A log as pymavlink opens it."""

    formats: Mapping[object, MessageForm]

    def recv_match(self, *, type: str) -> object | None: ...


class DataflashKeys(Record):
    """Declares the bench-file keys of a dataflash log."""

    message: str = key(Text(r"[A-Za-z0-9_]{1,16}", "a message's name"), "Kind of message.", "IMU", default="IMU")
    instance: int = key(
        Number(0, _LAST, integer=True),
        "Number of the sensor, counted from 0, if the messages of several sensors have the same name.",
        1,
        default=0,
    )


class DataflashFile(FormatFile[DataflashKeys]):
    """Reads the messages of one kind from a dataflash log."""

    Parameters = DataflashKeys

    def __init__(
        self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: DataflashKeys
    ):
        super().__init__(path, name, stamps, channels, parameters)
        self._fields: dict[str, Array] | None = None

    def columns(self) -> list[str]:
        return list(self._held())

    def units(self) -> Mapping[str, str]:
        fields = self._held() if self.parameters.message.startswith(_INERTIAL) else {}
        return {name: unit for name in fields for start, unit in _UNITS.items() if name.startswith(start)}

    def rows_about(self) -> int:
        return max(map(len, self._held().values()), default=0)

    def place(self, row: int) -> str:
        return f"message {self.parameters.message} number {row}"

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        held = self._held()
        for begin in range(0, self.rows_about(), format_file.BATCH):
            part = {name: held[name][begin : begin + format_file.BATCH] for name in self.wanted}
            yield begin + 1, HeldRows(len(next(iter(part.values()))), part)

    def _held(self) -> dict[str, Array]:
        if self._fields is None:
            with open_samples(self.path, self.name) as file:
                start = file.read(1 << 16)
                size = file.seek(0, 2)
            if size > MAX_LOG:
                message = f"the log has {size / 1e6:.0f} MB, more than {MAX_LOG / 1e6:g} MB"
                raise InstrumentError(f"{self.name}: {message}; write its messages {self.parameters.message} as CSV")
            if not start.startswith(BINARY) and b"FMT," not in start:
                raise InstrumentError(f"{self.name} is not a dataflash log: it describes no messages at its start")
            self._fields = self._loaded(is_binary=start.startswith(BINARY))
        return self._fields

    def _loaded(self, *, is_binary: bool) -> dict[str, Array]:
        """Reads all messages of the kind that the bench file names."""
        try:
            from pymavlink.DFReader import DFReader_binary, DFReader_text
        except ImportError:
            message = "reading dataflash logs needs the package pymavlink; install it with: pip install 'planrunner[recordings]'"
            raise InstrumentError(f"{self.name}: {message}") from None
        columns: dict[str, array[float]] = {}
        known: list[str] = []
        try:
            # pymavlink prints remarks about damaged logs, and leaves a file open if it refuses the file
            with contextlib.redirect_stdout(io.StringIO()), contextlib.ExitStack() as stack:
                made = DFReader_binary if is_binary else DFReader_text
                log: LogReader = made.__new__(made)
                stack.callback(_close, log)
                made.__init__(log, str(self.path))
                known = [form.name for form in log.formats.values()]
                for values in self._messages(log):
                    for name, value in values.items():
                        columns.setdefault(name, array("d")).append(value)
        except InstrumentError:
            raise
        except Exception as error:  # pymavlink raises Exception itself, too
            reason = (str(error).splitlines() or [""])[0][:150] or type(error).__name__
            raise InstrumentError(f"{self.name} cannot be read as a dataflash log: {reason}") from None
        if not columns:
            own, number = self.parameters.message, self.parameters.instance
            hint = closest(own, [name for name in known if name != own])
            if own in known:
                hint = "the log describes this message, but does not contain it; check `message` and `instance`"
            raise InstrumentError(f"{self.name} has no messages {own} of instance {number}; {hint}")
        return {name: np.frombuffer(values, np.float64) for name, values in columns.items()}

    def _messages(self, log: LogReader) -> Iterator[dict[str, float]]:
        """Yields the numeric fields of each message of this kind."""
        form, names, instance, count = None, [], None, 0
        while (message := log.recv_match(type=self.parameters.message)) is not None:
            if form is None:
                form = next(one for one in log.formats.values() if one.name == self.parameters.message)
                kinds = zip(form.columns, form.format, strict=False)
                names = [name for name, kind in kinds if kind in _NUMBERS]
                instance = form.instance_field or ("I" if "I" in form.columns else None)
            if instance is not None and int(getattr(message, instance)) != self.parameters.instance:
                continue
            count += len(names)
            if count > MAX_HELD:
                text = f"its messages {self.parameters.message} contain more than {MAX_HELD / 1e6:g} million numbers"
                raise InstrumentError(f"{self.name}: {text}; divide the log, or write these messages as CSV")
            yield {name: float(getattr(message, name)) for name in names}


def _close(log: LogReader) -> None:
    """Closes a log, even if it could not be opened completely."""
    for name in ("filehandle", "data_map"):
        with contextlib.suppress(AttributeError, BufferError):  # not opened, or still held by an exception
            getattr(log, name).close()

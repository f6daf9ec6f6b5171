"""Reads the text logs of raw IMU data that NovAtel receivers write: RAWIMU, RAWIMUS, RAWIMUX and RAWIMUSX.

After the header, which ends with a semicolon, a message contains the GPS week, the seconds of the week, the status of the IMU, and
the counts of the accelerometers and the gyros in the order z, −y, x (NovAtel, OEM7 Commands and Logs Reference Manual, RAWIMU). The
counts are increments of velocity and angle over one sample. Their scale depends on the type of the IMU.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from planrunner.base.findings import count_of
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats.file import (
    FormatFile,
    HeldRows,
    NoKeys,
    SampleRows,
    TimeStamps,
    open_samples,
)
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.span import Span

WEEK = 604_800
"""Seconds of a GPS week."""
COLUMNS = ("time_s", "status", "accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")
"""`time_s` is GPS time in s: week · 604800 s + seconds of the week."""
MOST_WRONG = 0.1
"""Share of messages with a wrong checksum above which the file is refused."""
_LONGEST = 1_000  # bytes of a line
_MESSAGE = re.compile(
    rb"(?P<body>[%#]RAWIMUS?(?P<x>X)?A,[^;*]*;(?(x)[0-9a-fA-F]+,\d+,)(?P<week>\d+),(?P<seconds>\d+(?:\.\d*)?),(?P<status>[0-9a-fA-F]+),"
    rb"(?P<counts>-?\d+(?:,-?\d+){5}))\*(?P<crc>[0-9a-fA-F]{8})\s*"
)
_START = re.compile(rb"[%#]RAWIMUS?X?A,")


def is_raw_imu(start: bytes) -> bool:
    """Returns True if the first bytes of a file contain the start of a message with raw IMU data."""
    return re.search(rb"(?m)^" + _START.pattern, start) is not None


def checksum(body: bytes) -> int:
    """Returns the 32-bit CRC of a message without its first character: reflected polynomial 0xEDB88320, start value 0, no final
    inversion (NovAtel, OEM7 Commands and Logs Reference Manual, "32-Bit CRC")."""
    return zlib.crc32(body[1:], 0xFFFFFFFF) ^ 0xFFFFFFFF


class NovatelFile(FormatFile[NoKeys]):
    """Reads the messages of raw IMU data in a log, and ignores all other messages. Messages with a wrong checksum are left out."""

    def __init__(self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: NoKeys):
        super().__init__(path, name, stamps, channels, parameters)
        self._wrong, self._first_wrong = 0, 0

    @property
    def remarks(self) -> tuple[str, ...]:
        if not self._wrong:
            return ()
        return (
            f"{count_of(self._wrong, 'message')} with a wrong checksum or form, the first in line {self._first_wrong}",
        )

    def columns(self) -> list[str]:
        return list(COLUMNS)

    def rows_about(self) -> int:
        with open_samples(self.path, self.name) as file:
            start = file.read(1 << 20)
            found = len(re.findall(rb"(?m)^" + _START.pattern, start))
            return file.seek(0, 2) * found // max(len(start), 1)

    def place(self, row: int) -> str:
        line = next((line for k, (line, _) in enumerate(self._messages(), start=1) if k == row), None)
        return super().place(row) if line is None else f"{super().place(row)} (line {line})"

    def hint(self, column: str, known: list[str]) -> str:
        return f"the columns of such a log are {', '.join(COLUMNS)}"

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        rows: list[tuple[float, ...]] = []
        first = 1
        for _, values in self._messages():
            rows.append(values)
            if len(rows) == format_file.BATCH:
                yield first, _held(rows)
                first, rows = first + len(rows), []
        if self._wrong > MOST_WRONG * (first - 1 + len(rows)):
            message = f"{self._wrong} of {self._wrong + first - 1 + len(rows)} messages have a wrong checksum or form"
            hint = "check how the file was transferred, or convert the original log again"
            raise InstrumentError(f"{self.name}: {message}, the first in line {self._first_wrong}; {hint}")
        if rows:
            yield first, _held(rows)

    def _messages(self) -> Iterator[tuple[int, tuple[float, ...]]]:
        """Yields the messages of raw IMU data: the number of the line, and the values of `COLUMNS`."""
        self._wrong = self._first_wrong = 0
        with open_samples(self.path, self.name) as file:
            number = 0
            while line := file.readline(_LONGEST):
                number += 1
                if not _START.match(line):
                    continue
                found = _MESSAGE.fullmatch(line)
                if found is None or checksum(found["body"]) != int(found["crc"], 16):
                    self._first_wrong = self._first_wrong or number
                    self._wrong += 1
                    continue
                accel_z, minus_accel_y, accel_x, gyro_z, minus_gyro_y, gyro_x = map(float, found["counts"].split(b","))
                time = int(found["week"]) * WEEK + float(found["seconds"])
                axes = (accel_x, -minus_accel_y, accel_z, gyro_x, -minus_gyro_y, gyro_z)
                yield number, (time, float(int(found["status"], 16)), *axes)


def _held(rows: list[tuple[float, ...]]) -> SampleRows:
    return HeldRows(len(rows), dict(zip(COLUMNS, np.array(rows).T, strict=True)))

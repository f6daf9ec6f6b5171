"""Reads files of binary records of constant length. The records follow each other directly, or are frames with sync bytes and a
checksum."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from planrunner.base.findings import Findings
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats.file import FormatFile, HeldRows, SampleRows, TimeStamps, open_samples
from planrunner.instruments.frame_keys import (
    CHECKSUMS,
    LONGEST,
    SYNC,
    TYPES,
    ChecksumOfFrame,
    ScaledNumber,
    field_of,
    framing_of,
)
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire.columns import numbers
from planrunner.instruments.wire.framing import Framer, Frames, Framing, Piece
from planrunner.plan.kinds import MapOf, Number, Record, RecordOf, key, optional
from planrunner.plan.span import Span


class BinaryKeys(Record):
    """Declares the bench-file keys of a file of binary records."""

    length: int = key(Number(1, LONGEST, integer=True), "Length of a record in bytes, including sync and checksum.", 56)
    fields: dict[str, ScaledNumber] = key(
        MapOf(RecordOf(ScaledNumber)),
        "Column → its position in the record.",
        {"time": {"at": 0, "type": "f64", "little_endian": True}},
    )
    skip: int = key(Number(0, 2**31, integer=True), "Number of bytes before the first record.", 64, default=0)
    sync: str | None = optional(
        SYNC,
        "The bytes that every record begins with. Without it, the records follow each other without gaps.",
        "A5 5A",
    )
    checksum: ChecksumOfFrame | None = optional(
        RecordOf(ChecksumOfFrame),
        "Checksum at the end of the record, with `sync`. Records with a wrong checksum are left out and counted.",
        {"type": "sum16"},
    )

    @property
    def framing(self) -> Framing:
        """Returns the framing of the records."""
        return framing_of(self.sync or "", self.length, self.checksum)


def check_binary(keys: BinaryKeys, log: Findings) -> None:
    """Adds an error for each contradiction between the keys: a number outside the record, or a checksum without frames."""
    check = keys.length - len(bytes.fromhex(keys.sync or ""))
    if keys.checksum is not None:
        check -= CHECKSUMS[keys.checksum.type].width // 8
        if keys.sync is None:
            message = "a checksum is verified only in records that begin with sync bytes"
            log.error("meaning-range", keys.at("checksum"), message, "add `sync`, or leave `checksum` out")
        elif check <= 0 or keys.checksum.start >= keys.length - CHECKSUMS[keys.checksum.type].width // 8:
            message = f"the checksum of a record of {keys.length} bytes covers no bytes"
            log.error(
                "meaning-range",
                keys.checksum.at("from"),
                message,
                "check `length`, and let the covered part begin earlier",
            )
    if not keys.fields:
        hint = "add for example `fields: {gyro_x: {at: 2, type: i16, scale: 0.02}}`"
        log.error("form-size", keys.at("fields"), "a record without fields gives no samples", hint)
    for name, item in keys.fields.items():
        width = TYPES[item.type][0]
        if item.place + width > keys.length:
            message = f"'{name}' ends after the record of {keys.length} bytes"
            hint = f"`at` is counted from 0 and can be at most {keys.length - width}"
            log.error("meaning-range", item.at("at"), message, hint)


class BinaryFile(FormatFile[BinaryKeys]):
    """Reads a file of binary records of numbers. An incomplete last record is left out. Frames with a wrong checksum, and bytes
    between frames, are skipped and counted."""

    Parameters = BinaryKeys

    def __init__(self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: BinaryKeys):
        super().__init__(path, name, stamps, channels, parameters)
        self._remarks: tuple[str, ...] = ()

    def columns(self) -> list[str]:
        return list(self.parameters.fields)

    def rows_about(self) -> int:
        with open_samples(self.path, self.name) as file:
            return max(file.seek(0, 2) - self.parameters.skip, 0) // self.parameters.length

    @property
    def remarks(self) -> tuple[str, ...]:
        return self._remarks

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        length = self.parameters.length
        if self.rows_about() == 0:
            held = (
                f"{self.parameters.skip} bytes and a record of {length} bytes"
                if self.parameters.skip
                else f"a record of {length} bytes"
            )
            raise InstrumentError(
                f"{self.name} is shorter than {held}; check `length` and `skip` of `format` in the bench file"
            )
        chosen = [self.parameters.fields[name] for name in self.wanted]
        fields = [field_of(item, item.scale) for item in chosen]
        first = 1
        for frames in self._frames():
            found = numbers(frames, fields)
            values = {name: row + item.zero for name, row, item in zip(self.wanted, found, chosen, strict=True)}
            yield first, HeldRows(len(frames), values)
            first += len(frames)
        if first == 1:
            raise InstrumentError(
                f"{self.name} has no complete record that begins with {self.parameters.sync}; check `format` in the bench file"
            )

    def _frames(self) -> Iterator[Frames]:
        """Yields the frames in pieces that are at most as large as a batch."""
        keys = self.parameters
        framing, length = keys.framing, keys.length
        with open_samples(self.path, self.name) as file:
            file.seek(keys.skip)
            framer = Framer(framing) if framing.sync else None
            while data := file.read(format_file.BATCH * length):
                if framer is not None:
                    frames = framer.push([Piece(0.0, data)])
                    for begin in range(0, len(frames), format_file.BATCH):
                        yield frames.of(np.arange(begin, min(begin + format_file.BATCH, len(frames))))
                elif count := len(data) // length:
                    yield Frames(
                        np.frombuffer(data, np.uint8, count * length),
                        np.arange(count, dtype=np.int64) * length,
                        np.full(count, length, np.int64),
                        np.zeros(count),
                    )
            if framer is not None:
                self._remarks = tuple(
                    f"{count} {what}"
                    for count, what in (
                        (framer.corrupt, "records that are corrupt or not where they are expected"),
                        (framer.skipped, "bytes outside of good records"),
                    )
                    if count
                )

"""Declares the bench-file keys for frames and binary records: positions and encoding of the numbers, and the checksum."""

from __future__ import annotations

from typing import Protocol

from planrunner.instruments.wire import checksums
from planrunner.instruments.wire.codes import FLOAT, SIGNED, UNSIGNED
from planrunner.instruments.wire.columns import Field
from planrunner.instruments.wire.framing import Framing
from planrunner.plan.kinds import Boolean, Choice, Number, Record, Text, key

TYPES = {
    f"{letter}{8 * width}": (width, kind)
    for letter, kind in (("u", UNSIGNED), ("i", SIGNED))
    for width in (1, 2, 3, 4, 8)
}
TYPES |= {"f32": (4, FLOAT), "f64": (8, FLOAT)}
WHOLE = tuple(name for name in TYPES if name[0] == "u" and name != "u64")
CHECKSUMS = {
    "crc32": checksums.CRC32,
    "crc32_mpeg2": checksums.CRC32_MPEG2,
    "crc16_modbus": checksums.CRC16_MODBUS,
    "crc16_xmodem": checksums.CRC16_XMODEM,
    "crc16_ccitt_false": checksums.CRC16_CCITT_FALSE,
    "crc8": checksums.CRC8,
    "sum8": checksums.SUM8,
    "sum16": checksums.SUM16,
    "zero_sum8": checksums.ZERO_SUM8,
    "xor8": checksums.XOR8,
}
LONGEST = 4096


class ScaledNumber(Record):
    """Declares the bench-file keys of a number in a frame or in a record of a file."""

    place: int = key(
        Number(0, LONGEST - 1, integer=True), "Position of its first byte, counted from 0 at the sync.", 2, name="at"
    )
    type: str = key(Choice(tuple(TYPES)), "Type: u unsigned, i signed or f floating point, and number of bits.", "i16")
    scale: float = key(Number(), "Factor by which the raw value is multiplied.", 0.02, default=1.0)
    zero: float = key(Number(), "Offset that is then added.", 25.0, default=0.0)
    little_endian: bool = key(Boolean(), "True if the low byte comes first.", True, default=False)


class ChecksumOfFrame(Record):
    """Declares the bench-file keys of the checksum at the end of a frame."""

    type: str = key(Choice(tuple(CHECKSUMS)), "Algorithm of the checksum.", "crc16_modbus")
    start: int = key(
        Number(0, LONGEST - 1, integer=True), "First byte that the checksum covers.", 2, default=0, name="from"
    )
    little_endian: bool = key(Boolean(), "True if the low byte comes first.", True, default=False)


SYNC = Text(r"[0-9A-Fa-f]{2}( ?[0-9A-Fa-f]{2}){0,15}", "bytes in hexadecimal", "put them in quotes, such as 'A5 5A'")


class PlacedNumber(Protocol):
    """Declares the bench-file keys that describe where a number is in a frame, and how it is encoded."""

    @property
    def place(self) -> int: ...
    @property
    def type(self) -> str: ...
    @property
    def little_endian(self) -> bool: ...


def field_of(item: PlacedNumber, scale: float = 1.0) -> Field:
    """Returns the field that describes a number in a frame, from the keys of the number. `scale`: factor that converts the raw
    number to the value."""
    width, kind = TYPES[item.type]
    return Field(item.place, width, kind, scale, item.little_endian)


def framing_of(sync: str, length: int, checksum: ChecksumOfFrame | None) -> Framing:
    """Returns the framing of frames of constant length, from their keys."""
    start = bytes.fromhex(sync)
    if checksum is None:
        return Framing(start, length)
    kind = CHECKSUMS[checksum.type]
    return Framing(
        start,
        length,
        checksum=kind,
        check_bytes=kind.width // 8,
        covered_from=checksum.start,
        little=checksum.little_endian,
    )

"""Checksums against published check values, the standard library and a division bit by bit."""

from __future__ import annotations

import binascii
import zlib
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planrunner.instruments.wire import checksums
from planrunner.instruments.wire.checksums import Checksum
from planrunner.instruments.wire.codes import CRC
from planrunner.instruments.wire.framing import Framer, Framing, Piece

# Values for the nine digits, as the catalogue of parametrised CRC algorithms (reveng) prints them.
PUBLISHED = {
    "CRC32_MPEG2": 0x0376E6E7,
    "CRC32": 0xCBF43926,
    "CRC16_XMODEM": 0x31C3,
    "CRC16_CCITT_FALSE": 0x29B1,
    "CRC16_MODBUS": 0x4B37,
    "CRC8": 0xF4,
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_check_values(name: str) -> None:
    assert getattr(checksums, name).of(b"123456789") == PUBLISHED[name]


def by_hand(data: bytes, width: int, polynomial: int, initial: int) -> int:
    """The remainder of a division of polynomials, bit by bit."""
    register = initial
    for byte in data:
        for bit in range(7, -1, -1):
            carry = (register >> (width - 1) & 1) ^ (byte >> bit & 1)
            register = (register << 1 & (1 << width) - 1) ^ (polynomial if carry else 0)
    return register


@pytest.mark.parametrize("length", range(26))
def test_every_length_as_bit_by_bit(length: int) -> None:
    data = np.random.default_rng(length).bytes(length)
    assert checksums.CRC32_MPEG2.of(data) == by_hand(data, 32, 0x04C11DB7, 0xFFFFFFFF)
    assert Checksum(CRC, 8, 0x07, 0xFF).of(data) == by_hand(data, 8, 0x07, 0xFF)
    assert Checksum(CRC, 24, 0x864CFB, 0xB704CE).of(data) == by_hand(data, 24, 0x864CFB, 0xB704CE)
    assert checksums.CRC32.of(data) == zlib.crc32(data)
    assert checksums.CRC16_XMODEM.of(data) == binascii.crc_hqx(data, 0)


def test_sums() -> None:
    data = bytes([250, 7, 9])
    assert checksums.SUM8.of(data) == 10
    assert checksums.ZERO_SUM8.of(data) == 246
    assert checksums.ZERO_SUM8.of(bytes(3)) == 0
    assert checksums.XOR8.of(data) == 250 ^ 7 ^ 9


def test_many_frames_at_once_with_zeros_appended() -> None:
    data = np.random.default_rng(1).integers(0, 256, 1000, dtype=np.uint8)
    starts = np.array([0, 17, 400, 937])
    for padding in range(4):
        found = checksums.CRC32_MPEG2.over(data, starts, 59, padding)
        want = [checksums.CRC32_MPEG2.of(data[start : start + 59].tobytes() + bytes(padding)) for start in starts]
        assert found.tolist() == want


ALGORITHMS = [
    checksums.CRC32_MPEG2, checksums.CRC32, checksums.CRC16_XMODEM, checksums.CRC16_CCITT_FALSE,
    checksums.CRC16_MODBUS, checksums.CRC8, Checksum(CRC, 8, 0x07, 0xFF), Checksum(CRC, 24, 0x864CFB, 0xB704CE),
]  # fmt: skip


def remainder(check: Checksum, data: bytes) -> int:
    """Bit by bit, as catalogues describe an algorithm: bytes and result in reverse where it is reflected."""

    def mirrored(number: int, bits: int) -> int:
        return int(f"{number:0{bits}b}"[::-1], 2)

    fed = bytes(mirrored(byte, 8) for byte in data) if check.reflected else data
    found = by_hand(fed, check.width, check.polynomial, check.initial)
    return (mirrored(found, check.width) if check.reflected else found) ^ check.final


@given(check=st.sampled_from(ALGORITHMS), data=st.binary(min_size=1, max_size=80), padding=st.integers(0, 5))
def test_a_table_for_each_byte_gives_the_division_bit_by_bit(check: Checksum, data: bytes, padding: int) -> None:
    rows, base = check.by_position(len(data), padding)
    found = base
    for row, byte in zip(rows, data, strict=True):
        found ^= int(row[byte])
    assert found == remainder(check, data + bytes(padding))


@settings(max_examples=40)
@given(
    check=st.sampled_from(ALGORITHMS),
    bodies=st.lists(st.binary(min_size=9, max_size=9), min_size=1, max_size=6),
    data=st.data(),
)
def test_frames_of_one_length_are_found_by_their_check_and_by_nothing_else(
    check: Checksum, bodies: list[bytes], data: st.DataObject
) -> None:
    size, little, padding = check.width // 8, data.draw(st.booleans()), data.draw(st.integers(0, 3))
    framing = Framing(
        b"\x7e", 10 + size, checksum=check, check_bytes=size, covered_from=1, padding=padding, little=little
    )
    order: Literal["little", "big"] = "little" if little else "big"
    frames = [b"\x7e" + body + remainder(check, body + bytes(padding)).to_bytes(size, order) for body in bodies]
    spoilt = data.draw(st.integers(0, len(frames) - 1))
    place, bit = data.draw(st.integers(1, 9 + size)), data.draw(st.integers(0, 7))
    wrong = bytearray(frames[spoilt])
    wrong[place] ^= 1 << bit
    stream = b"".join([*frames[:spoilt], bytes(wrong), *frames[spoilt + 1 :]])
    found = Framer(framing).push([Piece(0.0, stream)])
    at = set((found.starts // (10 + size)).tolist()) if not (found.starts % (10 + size)).any() else None
    assert Framer(framing).push([Piece(0.0, b"".join(frames))]).starts.size == len(frames)
    assert at is None or spoilt not in at

"""Checksums against published check values, the standard library and a division bit by bit."""

from __future__ import annotations

import binascii
import zlib

import numpy as np
import pytest

from planrunner.instruments.wire import checksums
from planrunner.instruments.wire.checksums import CRC, Checksum

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
    assert checksums.CRC8_FF.of(data) == by_hand(data, 8, 0x07, 0xFF)
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

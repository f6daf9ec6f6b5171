"""Computes checksums of many frames in one call: cyclic redundancy checks (CRC) of up to 32 bits, sums and exclusive-or.

A CRC is a polynomial division. The CRC is computed in the upper part of a 32-bit register, so that CRC-8, CRC-16 and CRC-32 use the
same kernel with different tables. Each step processes eight bytes ("slicing by 8": Kounavis and Berry, A systematic approach to
building high performance, software-based CRC generators, ISCC 2005). If all frames have the same length, there is a separate table
for every byte position, so that bytes can be processed independently of each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planrunner.instruments.wire.codes import CRC, NEGATIVE_SUM, NONE, SUM, XOR

Bytes = NDArray[np.uint8]
_ALL = 0xFFFFFFFF


@dataclass(frozen=True)
class Checksum:
    """Describes a method to compute a check value of `width` bits from bytes.

    `kind`: CRC; SUM, the sum of the bytes mod 2^width; NEGATIVE_SUM, the value that makes the sum zero; or XOR. The other
    attributes apply to a CRC and are defined as in catalogues of CRCs: `polynomial` (without its leading one), `initial`,
    `reflected` (least significant bit first) and `final` (exclusive-or at the end).
    """

    kind: int
    width: int = 8
    polynomial: int = 0
    initial: int = 0
    reflected: bool = False
    final: int = 0

    @cached_property
    def tables(self) -> NDArray[np.uint32]:
        """Returns the tables (8, 256). Row k contains, for each byte value, the remainder of this byte followed by k zero bytes."""
        rows = np.zeros((8, 256), np.uint32)
        top = self.polynomial << (32 - self.width)
        for byte in range(256):
            register = byte << 24
            for _ in range(8):
                register = ((register << 1) ^ (top if register >> 31 else 0)) & _ALL
            rows[0, byte] = register
        for row in range(1, 8):
            before = rows[row - 1]
            rows[row] = (before << np.uint32(8)) ^ rows[0][before >> np.uint32(24)]
        return rows

    def by_position(self, length: int, padding: int = 0) -> tuple[NDArray[np.uint32], int]:
        """Returns a table and a constant for the CRC of exactly `length` bytes followed by `padding` zero bytes. The table has the
        shape (length, 256). The CRC is the exclusive-or of the constant and one entry of the table for each byte. The entry for
        byte k is in row k, and its index is the value of the byte. Such tables are possible because the division of polynomials is
        linear."""
        rows = np.zeros((length, 256), np.uint32)
        lowest, initial = self.tables[0], np.array([(self.initial << (32 - self.width)) & _ALL], np.uint32)
        registers = lowest
        for later in range(length + padding):
            if later >= padding:
                rows[length - 1 - (later - padding)] = registers
            registers = (registers << np.uint32(8)) ^ lowest[registers >> np.uint32(24)]
            initial = (initial << np.uint32(8)) ^ lowest[initial >> np.uint32(24)]
        if self.reflected:
            rows = rows[:, _mirrored(np.arange(256, dtype=np.uint32), 8)]
        rows, initial = rows >> np.uint32(32 - self.width), initial >> np.uint32(32 - self.width)
        if self.reflected:
            rows, initial = _mirrored(rows, self.width), _mirrored(initial, self.width)
        return np.ascontiguousarray(rows), int(initial[0]) ^ self.final

    def of(self, data: bytes) -> int:
        """Returns the check value of `data`."""
        from planrunner.instruments.wire.kernels import value

        return int(value(np.frombuffer(data, np.uint8), 0, len(data), 0, *self.arguments))

    def over(self, data: Bytes, starts: NDArray[np.int64], length: int, padding: int = 0) -> NDArray[np.uint32]:
        """Computes the check values of `length` bytes from each start in `starts`, as if `padding` zero bytes followed. The result
        has the shape of `starts`."""
        from planrunner.instruments.wire.kernels import values

        found: NDArray[np.uint32] = values(data, starts, length, padding, *self.arguments)
        return found

    @property
    def arguments(self) -> tuple[int, int, NDArray[np.uint32], int, bool, int]:
        """Returns the fields as arguments of the compiled kernels."""
        return self.kind, self.width, self.tables, self.initial, self.reflected, self.final


def _mirrored(numbers: NDArray[np.uint32], bits: int) -> NDArray[np.uint32]:
    """Returns the numbers with the order of their lowest `bits` bits reversed."""
    found = np.zeros_like(numbers)
    for bit in range(bits):
        found |= ((numbers >> np.uint32(bit)) & np.uint32(1)) << np.uint32(bits - 1 - bit)
    return found


UNCHECKED = Checksum(NONE, 0)
CRC32_MPEG2 = Checksum(CRC, 32, 0x04C11DB7, 0xFFFFFFFF)
CRC32 = Checksum(CRC, 32, 0x04C11DB7, 0xFFFFFFFF, reflected=True, final=0xFFFFFFFF)
CRC16_XMODEM = Checksum(CRC, 16, 0x1021)
CRC16_CCITT_FALSE = Checksum(CRC, 16, 0x1021, 0xFFFF)
CRC16_MODBUS = Checksum(CRC, 16, 0x8005, 0xFFFF, reflected=True)
CRC8 = Checksum(CRC, 8, 0x07)
SUM8 = Checksum(SUM)
SUM16 = Checksum(SUM, 16)
ZERO_SUM8 = Checksum(NEGATIVE_SUM)
XOR8 = Checksum(XOR)

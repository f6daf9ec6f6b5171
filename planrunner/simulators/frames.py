"""Makes frames of simulated sensors: encodes numbers as columns of bytes, with one row per frame, and computes check values bit by
bit from their polynomials.

A cyclic redundancy check is the remainder of the message after division by a generator; both are polynomials over GF(2). The
register processes one byte of every frame at a time; a table with the effect of each byte value is computed by shifting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Values = NDArray[np.floating | np.integer]
"""Readings, as floating-point numbers or integers."""
Order = Literal["big", "little"]


def integers(
    values: NDArray[np.generic] | Sequence[float], width: int, order: Order = "big", signed: bool = True
) -> Bytes:
    """Encodes integers (n,) in two's complement. Returns the bytes, shape (n, width). Values outside the range are clipped to the
    limits of the range."""
    bits = 8 * width
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    whole = np.asarray(values)
    if whole.dtype.kind == "f":
        whole = np.rint(np.nan_to_num(whole))
    whole = np.clip(whole, low, high).astype(np.int64 if signed or bits < 64 else np.uint64)
    places = np.arange(width - 1, -1, -1) if order == "big" else np.arange(width)
    shifts = (8 * places).astype(whole.dtype)  # numpy shifts unsigned numbers of 64 bits by their like only
    parts: NDArray[np.uint8] = ((whole[:, None] >> shifts) & whole.dtype.type(0xFF)).astype(np.uint8)
    return parts


def floats(values: NDArray[np.generic] | Sequence[float], width: int = 4, order: Order = "big") -> Bytes:
    """Encodes n numbers as IEEE 754 numbers of 4 or 8 bytes. Returns the bytes, shape (n, width)."""
    kind = ("<" if order == "little" else ">") + f"f{width}"
    return np.ascontiguousarray(values, dtype=kind).reshape(-1, 1).view(np.uint8)


def constant(data: bytes, count: int) -> Bytes:
    """Returns a column in which every row has the same bytes."""
    return np.broadcast_to(np.frombuffer(data, dtype=np.uint8), (count, len(data)))


def joined(*parts: Bytes) -> Bytes:
    """Joins columns side by side."""
    return np.concatenate(parts, axis=1)


_REVERSED = np.packbits(
    np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1), axis=1, bitorder="little"
).ravel()
"""For every byte value, the byte with its bits in reverse order."""


@dataclass(frozen=True)
class Crc:
    """A cyclic redundancy check.

    `width`: number of bits, 8 to 32. `start`: content of the register before the first byte. `reflected`: True if every byte, and
    the result, starts with its lowest bit. `inverted`: True if the bits of the result are inverted.
    """

    width: int
    polynomial: int
    start: int
    reflected: bool = False
    inverted: bool = False

    @cached_property
    def _table(self) -> NDArray[np.uint64]:
        top, mask = 1 << (self.width - 1), (1 << self.width) - 1
        found = []
        for byte in range(256):
            register = byte << (self.width - 8)
            for _ in range(8):
                register = ((register << 1) ^ (self.polynomial if register & top else 0)) & mask
            found.append(register)
        return np.array(found, dtype=np.uint64)

    def of(self, frames: Bytes) -> NDArray[np.uint64]:
        """Returns the check values (n,) of frames (n, length)."""
        register = np.full(len(frames), self.start, dtype=np.uint64)
        shift, mask = np.uint64(self.width - 8), np.uint64((1 << self.width) - 1)
        for column in (_REVERSED[frames] if self.reflected else frames).T:
            register = self._table[(register >> shift) ^ column] ^ ((register << np.uint64(8)) & mask)
        if self.reflected:
            bits = np.uint64(1) << np.arange(self.width, dtype=np.uint64)
            register = ((register[:, None] & bits) != 0) @ bits[::-1]
        return register ^ mask if self.inverted else register

    def of_text(self, text: str) -> int:
        """Returns the check value of one line."""
        return int(self.of(np.frombuffer(text.encode("ascii"), dtype=np.uint8)[None, :])[0])


CRC_32 = Crc(32, 0x04C11DB7, 0xFFFFFFFF)
CRC_16 = Crc(16, 0x1021, 0)
CRC_8 = Crc(8, 0x07, 0xFF)


def sum_to_zero(frames: Bytes) -> Bytes:
    """Returns, for each frame, the byte that makes the sum of the frame a multiple of 256, shape (n,). The frames have the shape
    (n, length)."""
    total: Bytes = (-frames.sum(axis=1, dtype=np.int64) & 0xFF).astype(np.uint8)
    return total


def exclusive_or(frames: Bytes) -> Bytes:
    """Returns the exclusive-or of all bytes of each frame, shape (n,). The frames have the shape (n, length)."""
    folded: Bytes = np.bitwise_xor.reduce(frames, axis=1)
    return folded

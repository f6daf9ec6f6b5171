"""Finds frames in a stream of bytes by their sync bytes, length and checksum. Bytes that are not part of a frame are skipped and
counted.

A frame is valid if its checksum is correct. If the checksum of a frame is wrong, or if no frame is found where one is expected, a
corrupt frame is counted. The search then continues one byte later, so that a frame after a false sync is never skipped. Between two
calls, only an incomplete frame is kept, which is shorter than the longest frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from planrunner.instruments.wire.checksums import UNCHECKED, Bytes, Checksum
from planrunner.instruments.wire.codes import CRC, FIXED

MOST_TABLES = 256  # of one KiB each: more would not stay close to the processor


@dataclass(frozen=True)
class Framing:
    """Describes the format of the frames in a stream.

    `sync`: the first bytes of a frame. `rule`: FIXED means that every frame has `longest` bytes. XBUS means that the length is in
    the byte at offset 3 or, if this byte is FF, in the next two bytes. LINE means that a frame ends with a line feed. With the
    rules XBUS and LINE, frames have at most `longest` bytes. `trailer`: bytes that may follow a frame. The checksum covers the
    frame from the byte `covered_from` up to the checksum, followed by `padding` zero bytes. The checksum is in the last
    `check_bytes` bytes of the frame, low byte first if `little` is True. With the rule LINE, the checksum covers the text between
    `$` and `*`, and is written after `*` as two hexadecimal digits.
    """

    sync: bytes
    longest: int
    rule: int = FIXED
    checksum: Checksum = UNCHECKED
    check_bytes: int = 0
    covered_from: int = 0
    padding: int = 0
    little: bool = False
    trailer: bytes = b""


@dataclass(frozen=True, slots=True)
class Piece:
    """Bytes that arrived together. `received`: time at which the read operation ended, in s, by the bench's clock."""

    received: float
    data: bytes


@dataclass(frozen=True, slots=True)
class Frames:
    """The valid frames in `data`. `starts`, `lengths`: arrays of shape (n,), start and length of each frame. `received`: array of
    shape (n,) in s. `received` is the time at which the last byte of each frame was read, minus the transmission time of the
    frame."""

    data: Bytes
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]
    received: NDArray[np.float64]

    def __len__(self) -> int:
        return int(self.starts.size)

    def of(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Frames:
        """Returns the selected frames."""
        return Frames(self.data, self.starts[chosen], self.lengths[chosen], self.received[chosen])


@dataclass
class Framer:
    """Takes pieces of a stream and returns the frames that they complete.

    `byte_time`: transmission time of one byte, s. `good`, `corrupt`: numbers of valid and of corrupt frames. `skipped`: number of
    bytes outside frames. `length`: mean number of bytes per frame in the last call that found frames.
    """

    framing: Framing
    byte_time: float = 0.0
    good: int = 0
    corrupt: int = 0
    skipped: int = 0
    length: float = field(init=False)
    _rest: bytes = b""
    _expected: int = -1
    _positions: tuple[NDArray[np.uint32], int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.length = float(self.framing.longest)
        self._positions = _positions(self.framing)

    def push(self, pieces: Sequence[Piece]) -> Frames:
        """Returns the frames that these pieces complete, in order."""
        from planrunner.instruments.wire.kernels import find

        parts = [piece.data for piece in pieces]
        joined = b"".join([self._rest, *parts] if self._rest else parts)  # a single part is not copied
        data = np.frombuffer(joined, np.uint8)
        framing = self.framing
        starts, lengths, place, self._expected, corrupt, skipped = find(
            data,
            np.frombuffer(framing.sync, np.uint8),
            np.frombuffer(framing.trailer, np.uint8),
            (framing.rule, framing.longest, self._expected),
            (framing.covered_from, framing.padding, framing.check_bytes, framing.little),
            *self._positions,
            *framing.checksum.arguments,
        )
        received = np.empty(0)
        if starts.size:
            received = self._arrivals(pieces, starts + lengths) - self.byte_time * lengths
            self.length = float(framing.longest if framing.rule == FIXED else np.mean(lengths))
        self._rest = joined[place:]
        self.good += int(starts.size)
        self.corrupt += corrupt
        self.skipped += skipped
        return Frames(data, starts, lengths, received)

    def _arrivals(self, pieces: Sequence[Piece], ends: NDArray[np.int64]) -> NDArray[np.float64]:
        """Returns, for each of n frames, the time at which the piece that contains its last byte was read, shape (n,). `ends`:
        array of shape (n,), index of the byte after each frame."""
        if len(pieces) == 1:
            return np.full(ends.size, pieces[0].received)
        behind = len(self._rest) + np.cumsum([len(piece.data) for piece in pieces])
        times: NDArray[np.float64] = np.array([piece.received for piece in pieces])[np.searchsorted(behind, ends)]
        return times


@lru_cache(maxsize=32)
def _positions(framing: Framing) -> tuple[NDArray[np.uint32], int]:
    """Returns the tables of `Checksum.by_position` for the bytes that the checksum covers. The tables are empty if the frames have
    different lengths, or if the checksum is not a CRC."""
    covered = framing.longest - framing.check_bytes - framing.covered_from
    if framing.rule != FIXED or framing.checksum.kind != CRC or not 0 < covered <= MOST_TABLES:
        return np.empty((0, 256), np.uint32), 0
    return framing.checksum.by_position(covered, framing.padding)

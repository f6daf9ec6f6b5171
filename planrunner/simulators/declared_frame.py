"""Makes the frames of a simulated sensor that only the bench file describes. The frames contain sync bytes, numbers at given
positions, a counter, and a checksum at the end."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.findings import InputError, closest
from planrunner.instruments.interfaces import Block
from planrunner.plan.kinds import Origin
from planrunner.plan.units import unit
from planrunner.simulators.frames import CRC_32, Bytes, Crc, Order, exclusive_or, floats, integers, sum_to_zero
from planrunner.simulators.live_world import LiveWorld, SensorFeed
from planrunner.simulators.sensor_units import SensorUnit


@dataclass(frozen=True, slots=True)
class FieldPlace:
    """States the position and the encoding of a number in a frame. `kind`: number format, such as `i24`, `u16` or `f32`. A value v
    in `unit` is sent as the number (v − zero)/scale."""

    at: int
    kind: str
    order: Order = "big"
    scale: float = 1.0
    zero: float = 0.0
    unit: str = "1"

    def column(self, values: Array) -> Bytes:
        sent = (values - self.zero) / self.scale
        width = int(self.kind[1:]) // 8
        if self.kind.startswith("f"):
            return floats(sent, width, self.order)
        return integers(sent, width, self.order, signed=self.kind.startswith("i"))


@dataclass(frozen=True, slots=True)
class Running:
    """Describes the counter of a frame: its position, the counts per frame, and the value at which it restarts."""

    place: FieldPlace
    step: int
    modulus: float


@dataclass(frozen=True, slots=True)
class FrameCheck:
    """Describes the checksum of a frame: its algorithm, its number of bytes, and the first byte that it covers."""

    of: Callable[[Bytes], NDArray[np.generic]]
    width: int
    covered_from: int
    order: Order


def _sum(frames: Bytes) -> NDArray[np.generic]:
    low: NDArray[np.int64] = frames.sum(axis=1, dtype=np.int64) & 0xFF
    return low


def _long_sum(frames: Bytes) -> NDArray[np.generic]:
    low: NDArray[np.int64] = frames.sum(axis=1, dtype=np.int64) & 0xFFFF
    return low


CHECKS: Mapping[str, tuple[Callable[[Bytes], NDArray[np.generic]], int]] = {
    "crc32": (Crc(32, 0x04C11DB7, 0xFFFFFFFF, reflected=True, inverted=True).of, 4),
    "crc32_mpeg2": (CRC_32.of, 4),
    "crc16_modbus": (Crc(16, 0x8005, 0xFFFF, reflected=True).of, 2),
    "crc16_xmodem": (Crc(16, 0x1021, 0).of, 2),
    "crc16_ccitt_false": (Crc(16, 0x1021, 0xFFFF).of, 2),
    "crc8": (Crc(8, 0x07, 0).of, 1),
    "sum8": (_sum, 1),
    "sum16": (_long_sum, 2),
    "zero_sum8": (sum_to_zero, 1),
    "xor8": (exclusive_or, 1),
}
"""Checksums, by their names in bench files. Each entry states the algorithm and the number of bytes."""


@dataclass(frozen=True, slots=True)
class DeclaredFrame:
    """Describes a frame: its sync bytes, length [bytes], numbers, counter, checksum and constant bytes."""

    sync: bytes
    length: int
    fields: Mapping[str, FieldPlace]
    running: Running | None = None
    check: FrameCheck | None = None
    steady: Sequence[tuple[int, bytes]] = ()
    """Bytes at given positions that are the same in all frames, such as a status word."""

    def frames(self, channels: Mapping[str, Array], numbers: Array) -> Bytes:
        """Makes frames (n, length) from the channels (n,), which are in the units of the fields. `numbers`: array of shape (n,),
        running numbers of the frames."""
        frames = np.zeros((numbers.size, self.length), dtype=np.uint8)
        frames[:, : len(self.sync)] = np.frombuffer(self.sync, dtype=np.uint8)
        for at, data in self.steady:
            frames[:, at : at + len(data)] = np.frombuffer(data, dtype=np.uint8)
        for name, place in self.fields.items():
            _put(frames, place.at, place.column(channels[name]))
        if self.running is not None:
            counts = np.mod(numbers * self.running.step, self.running.modulus)
            _put(frames, self.running.place.at, self.running.place.column(counts))
        if self.check is not None:
            end = self.length - self.check.width
            values = self.check.of(frames[:, self.check.covered_from : end])
            _put(frames, end, integers(values, self.check.width, self.check.order, signed=False))
        return frames


def _put(frames: Bytes, at: int, column: Bytes) -> None:
    frames[:, at : at + column.shape[1]] = column


@dataclass(frozen=True, slots=True)
class Alarms:
    """Describes the status word of a frame: its position, width and byte order, the meaning of its bits, and whether a set bit
    means that there is no fault."""

    at: int
    width: int
    order: Order
    bits: Mapping[str, int]
    set_is_good: bool

    def told(self, ails: Collection[str]) -> tuple[int, bytes]:
        """Returns the position of the status word, and its bytes. `ails`: faults of the sensor. A fault affects the bits whose
        meaning contains the name of the fault or, if there are no such bits, all bits."""
        wrong = {text for text in self.bits if any(word in text for word in ails)} or set(self.bits if ails else ())
        high = set(self.bits) - wrong if self.set_is_good else wrong
        return self.at, sum(1 << self.bits[text] for text in high).to_bytes(self.width, self.order)


@dataclass(slots=True)
class DeclaredUnit:
    """Simulates the electronics of a sensor that the bench file describes.

    `units`: units of the channels of the virtual sensor. `words`: for each command line that the sensor knows, the mode to which it
    switches. `switch`: function that is called with the new mode.
    """

    units: Mapping[str, str]
    form: DeclaredFrame
    words: Mapping[bytes, str] = field(default_factory=dict)
    switch: Callable[[str], None] = lambda mode: None
    alarms: Alarms | None = None
    next: int = 0
    heard: bytes = b""
    ails: frozenset[str] = frozenset()

    def frames(self, block: Block) -> Bytes:
        numbers = np.arange(self.next, self.next + block.time.size, dtype=float)
        self.next += block.time.size
        channels = {name: self._in_unit(block, name, place.unit) for name, place in self.form.fields.items()}
        form = self.form if self.alarms is None else replace(self.form, steady=[self.alarms.told(self.ails)])
        return form.frames(channels, numbers)

    def hear(self, data: bytes) -> bytes:
        """Receives bytes; switches the mode if they contain one of the command lines. There is no reply to such a line."""
        self.heard += data
        for word, mode in self.words.items():
            if word in self.heard:
                self.heard = self.heard.replace(word, b"")
                self.switch(mode)
        self.heard = self.heard[-200:]
        return b""

    def _in_unit(self, block: Block, name: str, wanted: str) -> Array:
        values = block.channels[name]
        if self.units[name] == wanted:
            return values
        own, other = unit(self.units[name]), unit(wanted)
        return (values * own.factor + own.offset - other.offset) / other.factor


_WORD_BYTES = {"u8": 1, "u16": 2, "u24": 3, "u32": 4}


class PartKeys(Protocol):
    """Declares the keys of a part of the frame."""

    type: str
    little_endian: bool


class PlacedKeys(PartKeys, Protocol):
    place: int


class FieldKeys(PlacedKeys, Protocol):
    scale: float
    zero: float
    unit: str


class CounterKeys(PlacedKeys, Protocol):
    step: int
    modulus: int | None


class StatusKeys(PlacedKeys, Protocol):
    bits: Mapping[str, int]
    set_is_good: bool


class ChecksumKeys(PartKeys, Protocol):
    start: int


class DeclaredFrameKeys(Protocol):
    origin: Origin
    sync: str
    length: int
    fields: Mapping[str, FieldKeys]
    counter: CounterKeys | None
    checksum: ChecksumKeys | None
    status: StatusKeys | None
    modes: Mapping[str, str]


def simulated(keys: DeclaredFrameKeys, live: LiveWorld, feed: SensorFeed) -> SensorUnit:
    """Makes the sensor that the bench file describes; its frames contain the outputs of the virtual sensor with the same names.
    Raises `InputError` if the virtual sensor does not have such an output."""
    own = feed.sensor.channels()
    missing = [name for name in keys.fields if name not in own]
    if missing:
        message = f"the virtual sensor has no output '{missing[0]}', only {', '.join(own)}"
        raise InputError.at(keys.origin.mark, "meaning-simulation", message, closest(missing[0], own))
    fields = {
        name: FieldPlace(item.place, item.type, _order(item), item.scale, item.zero, item.unit)
        for name, item in keys.fields.items()
    }
    running = check = None
    alarms = None
    if (counter := keys.counter) is not None:
        modulus = float(counter.modulus or 2 ** (8 * _WORD_BYTES[counter.type]))
        running = Running(FieldPlace(counter.place, counter.type, _order(counter)), counter.step, modulus)
    if (declared := keys.checksum) is not None:
        check = FrameCheck(*CHECKS[declared.type], declared.start, _order(declared))
    if (status := keys.status) is not None:
        alarms = Alarms(status.place, _WORD_BYTES[status.type], _order(status), status.bits, status.set_is_good)
    form = DeclaredFrame(bytes.fromhex(keys.sync), keys.length, fields, running, check)
    words = {text.encode("ascii") + b"\r": mode for mode, text in keys.modes.items()}
    return DeclaredUnit(own, form, words, feed.set_mode, alarms)


def _order(item: PartKeys) -> Order:
    return "little" if item.little_endian else "big"

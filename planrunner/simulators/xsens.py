"""Makes the messages of an Xsens MTi on the Xbus: MTData2 packets, changes of state, and errors. Each message ends with the byte
that makes its sum zero."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planrunner.base.arrays import Array
from planrunner.simulators.frames import Bytes, Values, constant, floats, integers, joined, sum_to_zero

MTDATA2 = 0x36
PACKET_COUNTER, SAMPLE_TIME_FINE, STATUS_WORD, TEMPERATURE, UTC = 0x1020, 0x1060, 0xE020, 0x0810, 0x1010
_INTEGERS = {PACKET_COUNTER: 2, SAMPLE_TIME_FINE: 4, STATUS_WORD: 4}
_UTC = (4, 2, 1, 1, 1, 1, 1, 1)  # bytes of ns, year, month, day, hour, minute, second, flags
_COMPONENTS = {0x4020: 3, 0x4010: 3, 0x8020: 3, 0x8030: 4, 0x2010: 4, TEMPERATURE: 1}
_FINE_TICKS = 10_000.0  # of SampleTimeFine in a second


@dataclass(frozen=True, slots=True)
class Xsens:
    """The packets of an Xsens MTi. `items`: data identifiers in the order of the packet; their low bits state the format of the
    real numbers (0 f32, 1 12.20, 2 16.32, 3 f64)."""

    items: Sequence[int] = (PACKET_COUNTER, SAMPLE_TIME_FINE, 0x4020, 0x8020, TEMPERATURE, STATUS_WORD)

    def length(self) -> int:
        """Returns the number of bytes of a packet on the line."""
        payload = sum(3 + self._size(item) for item in self.items)
        return payload + (5 if payload < 255 else 7)

    def _size(self, item: int) -> int:
        whole = item & 0xFFF0
        if item == UTC:
            return sum(_UTC)
        return _INTEGERS.get(item) or _COMPONENTS[whole] * (4, 4, 6, 8)[item & 3]

    def frames(self, columns: Mapping[int, Values]) -> Bytes:
        """Makes packets (n, length). `columns`: maps each identifier, without the bits of its format, to its values: arrays of shape
        (n,) or (n, components), in SI units and degC."""
        count = len(next(iter(columns.values())))
        parts = []
        for item in self.items:
            parts.append(constant(item.to_bytes(2, "big") + bytes([self._size(item)]), count))
            if item in _INTEGERS:
                width = _INTEGERS[item]
                parts.append(integers(columns[item] % (1 << 8 * width), width, signed=False))
                continue
            if item == UTC:
                parts += [integers(part, width, signed=False) for part, width in zip(columns[UTC].T, _UTC, strict=True)]
                continue
            values = np.reshape(columns[item & 0xFFF0], (count, -1))
            parts += [_real(component, item & 3) for component in values.T]
        payload = joined(*parts)
        return message(MTDATA2, payload)


def known(item: int) -> bool:
    """Returns True if data with this identifier, which includes a format, can be sent."""
    return item in _INTEGERS or ((item & 0xFFF0) in _COMPONENTS and item & 0xF < 4)


def _real(values: Values, form: int) -> Bytes:
    """Encodes real numbers (n,): IEEE 754, or fixed point with 20 or 32 bits after the binary point. With 32 bits, the bits of the
    fraction are sent first. `form`: code of the format, from the low bits of the identifier."""
    if form == 1:
        return integers(np.rint(values * 2.0**20), 4)
    if form == 2:
        whole = np.floor(values)
        fraction = np.minimum(np.rint((values - whole) * 2.0**32), 2.0**32 - 1)
        return joined(integers(fraction, 4, signed=False), integers(whole, 2))
    return floats(values, 8 if form == 3 else 4)


def message(identifier: int, payload: Bytes) -> Bytes:
    """Makes messages (n, length) of one kind that contain the payloads (n, m)."""
    size = payload.shape[1]
    length = bytes([size]) if size < 255 else b"\xff" + size.to_bytes(2, "big")
    covered = joined(constant(bytes([0xFF, identifier]) + length, len(payload)), payload)
    return joined(constant(b"\xfa", len(payload)), covered, sum_to_zero(covered)[:, None])


def short_message(identifier: int, payload: bytes = b"") -> bytes:
    """Returns a single message, such as an acknowledgement or an error."""
    return message(identifier, constant(payload, 1)).tobytes()


def fine_time(seconds: Array) -> Array:
    """Returns the value of SampleTimeFine at these times [s]."""
    return np.floor(np.asarray(seconds) * _FINE_TICKS)

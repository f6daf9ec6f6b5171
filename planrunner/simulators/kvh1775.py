"""Makes the frames of a KVH 1775 IMU and a DSP-1760 gyro: formats A, B and C with CRC-32. Also answers a request for the built-in
test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planrunner.simulators.frames import CRC_32, Bytes, Values, constant, floats, integers, joined

_HEADERS = {"A": b"\xfe\x81\xff\x55", "B": b"\xfe\x81\xff\x56", "C": b"\xfe\x81\xff\x57"}
_LENGTHS = {"A": 36, "B": 40, "C": 38}
ALL_VALID = 0x77
MODULUS = 128  # of the sequence number


@dataclass(frozen=True, slots=True)
class Kvh1775:
    """Makes frames of one format.

    `format`: A; B, which adds a time stamp of 4 bytes; or C, which adds a floating-point number (temperature or magnetic field)."""

    format: str = "A"

    def length(self) -> int:
        """Returns the number of bytes of a frame on the line."""
        return _LENGTHS[self.format]

    def frames(self, columns: Mapping[str, Values], sequence: Values) -> Bytes:
        """Makes frames (n, length). `columns`: the values (n,) by name. `gyro_x` … are sent unchanged (in rad or deg, as rate or as
        angle); `acc_x` … are in g; `temperature` is in whole degrees or in hundredths of a degree. `status` and, for format B,
        `time_stamp` are further columns."""
        count = sequence.size
        parts = [constant(_HEADERS[self.format], count)]
        parts += [floats(columns[f"{name}_{axis}"]) for name in ("gyro", "acc") for axis in "xyz"]
        if self.format == "B":
            parts.append(integers(columns.get("time_stamp", np.zeros(count)), 4, signed=False))
        if self.format == "C":
            parts.append(floats(columns["temperature"]))
        parts.append(integers(columns.get("status", np.full(count, ALL_VALID)), 1, signed=False))
        parts.append(integers(sequence % MODULUS, 1, signed=False))
        if self.format != "C":
            parts.append(integers(columns["temperature"], 2))
        body = joined(*parts)
        return joined(body, integers(CRC_32.of(body), 4, signed=False))


def built_in_test(results: bytes) -> bytes:
    """Returns the answer to `?bit`: 6 bytes with results, followed by the sum of all preceding bytes."""
    answer = b"\xfe\x81\x00\xaa" + results
    return answer + bytes([sum(answer) & 0xFF])

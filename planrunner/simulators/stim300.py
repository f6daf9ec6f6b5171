"""Makes the frames of a STIM300 (Safran TS1524): datagrams of normal mode with CRC-32, for every datagram identifier.

A datagram consists of its identifier, the clusters that the identifier names (always the gyros; also accelerometers or
inclinometers), the temperatures of the clusters, PPS or AUX, a counter, a latency and a CRC. For the CRC, the datagram is padded to
whole words of four bytes with zero bytes, which are not sent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planrunner.simulators.frames import CRC_32, Bytes, Values, constant, integers, joined

GYRO, ACCELEROMETER, INCLINOMETER = "gyro", "acc", "incl"
_TWO, _INCLINED, _ALL = (GYRO, ACCELEROMETER), (GYRO, INCLINOMETER), (GYRO, ACCELEROMETER, INCLINOMETER)
_PLAIN = (((GYRO,), False), (_TWO, False), (_INCLINED, False), (_ALL, False))
_WARM = (((GYRO,), True), (_TWO, True), (_INCLINED, True), (_ALL, True))
_FAMILIES: Mapping[str, tuple[int, ...]] = {
    "": (0x90, 0x91, 0x92, 0x93, 0x94, 0xA5, 0xA6, 0xA7),
    "pps": (0xF0, 0xF1, 0xF2, 0xF3, 0xF4, 0xF5, 0xF6, 0xF7),
    "aux": (0x98, 0x99, 0x9A, 0x9B, 0x9C, 0xAD, 0xAE, 0xAF),
}
DATAGRAMS = {
    identifier: (clusters, warm, extra)
    for extra, identifiers in _FAMILIES.items()
    for identifier, (clusters, warm) in zip(identifiers, _PLAIN + _WARM, strict=True)
}
"""Contents of each datagram, by its identifier: the clusters, whether their temperatures follow, and `pps`, `aux` or nothing."""
_PER_G = {5: 2.0**20, 10: 2.0**19, 30: 2.0**18, 80: 2.0**16}
_PER_DEGREE, _PER_TILT, _PER_KELVIN = 2.0**14, 2.0**22, 2.0**8
_PER_INCREMENT = 2.0**21
INTERNAL_RATE = 2000.0  # Hz, what the counter counts


@dataclass(frozen=True, slots=True)
class Stim300:
    """The configuration of a STIM300.

    `acceleration_range`: range of the accelerometers, g. `increments`: True if outputs are angles instead of rates. `crlf`: True if
    CR LF ends a datagram.
    """

    datagram: int = 0xA7
    acceleration_range: int = 10
    increments: bool = False
    crlf: bool = False

    def length(self) -> int:
        """Returns the number of bytes of a datagram on the line."""
        clusters, warm, extra = DATAGRAMS[self.datagram]
        return 8 + len(clusters) * (17 if warm else 10) + (4 if extra else 0) + (2 if self.crlf else 0)

    def frames(self, columns: Mapping[str, Values], counter: Values, latency: Values) -> Bytes:
        """Makes datagrams (n, length).

        `columns`: the values (n,) by name: `gyro_x` … in deg/s (in deg for increments); `acc_x` … and `incl_x` … in g; `gyro_T_x` …
        in degC; `pps` or `aux` as raw numbers; `gyro_status` and other status bytes where they are not zero. `counter`: array of
        shape (n,), number of internal samples. `latency`: latency in µs.
        """
        clusters, warm, extra = DATAGRAMS[self.datagram]
        count = counter.size
        nothing = np.zeros(count)
        scales = {
            GYRO: _PER_INCREMENT if self.increments else _PER_DEGREE,
            ACCELEROMETER: _PER_G[self.acceleration_range],
            INCLINOMETER: _PER_TILT,
        }
        parts = [constant(bytes([self.datagram]), count)]
        for name in clusters:
            parts += [integers(columns[f"{name}_{axis}"] * scales[name], 3) for axis in "xyz"]
            parts.append(integers(columns.get(f"{name}_status", nothing), 1, signed=False))
        for name in clusters if warm else ():
            parts += [integers(columns[f"{name}_T_{axis}"] * _PER_KELVIN, 2) for axis in "xyz"]
            parts.append(integers(columns.get(f"{name}_T_status", nothing), 1, signed=False))
        if extra:
            parts += [integers(columns.get(extra, nothing), 3)]
            parts += [integers(columns.get(f"{extra}_status", nothing), 1, signed=False)]
        parts += [integers(counter % 256, 1, signed=False), integers(latency, 2, signed=False)]
        body = joined(*parts)
        padding = constant(bytes(-body.shape[1] % 4), count)
        check = integers(CRC_32.of(joined(body, padding)), 4, signed=False)
        return joined(body, check, constant(b"\r\n" if self.crlf else b"", count))

"""Makes the messages of a VectorNav VN-100: binary outputs with CRC-16, and lines of text whose checksum is the exclusive-or of
their bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planrunner.simulators.frames import CRC_16, Bytes, Values, constant, exclusive_or, floats, integers, joined

_NANOSECONDS = 0
_COMMON = {
    "time_startup": (0, _NANOSECONDS),
    "yaw_pitch_roll": (3, 3),
    "quaternion": (4, 4),
    "angular_rate": (5, 3),
    "acceleration": (8, 3),
    "imu": (9, 6),
    "mag_pres": (10, 5),
}
"""Outputs of the common group, by name. Each entry states the bit in the field word and the number of floats. The time is one
8-byte integer instead."""


@dataclass(frozen=True, slots=True)
class VectorNav:
    """The binary messages of a VectorNav. `fields`: names of the outputs of the common group."""

    fields: Sequence[str] = ("time_startup", "imu", "mag_pres")

    def length(self) -> int:
        """Returns the number of bytes of a message on the line."""
        return 6 + sum(4 * _COMMON[name][1] or 8 for name in self.fields)

    def frames(self, columns: Mapping[str, Values]) -> Bytes:
        """Makes messages (n, length). `columns`: the values of each output, (n,) or (n, components), in ns, deg, rad/s, m/s^2,
        gauss, degC or kPa."""
        count = len(next(iter(columns.values())))
        chosen = sorted((_COMMON[name][0], name) for name in self.fields)
        word = sum(1 << bit for bit, _ in chosen)
        parts = [constant(b"\x01" + word.to_bytes(2, "little"), count)]
        for _, name in chosen:
            if _COMMON[name][1] == _NANOSECONDS:
                parts.append(integers(columns[name].astype(np.uint64), 8, "little", signed=False))
            else:
                parts += [floats(part, 4, "little") for part in np.reshape(columns[name], (count, -1)).T]
        covered = joined(*parts)
        check = integers(CRC_16.of(covered), 2, signed=False)
        return joined(constant(b"\xfa", count), covered, check)


def line(body: str) -> bytes:
    """Returns the line of text that sends a command. For the command `VNRRG,8`, it is `$VNRRG,8*4B` CR LF."""
    check = exclusive_or(np.frombuffer(body.encode("ascii"), dtype=np.uint8)[None, :])[0]
    return f"${body}*{check:02X}\r\n".encode("ascii")


def measurement(
    magnetic: Sequence[float] | Values,
    accel: Sequence[float] | Values,
    rate: Sequence[float] | Values,
    ypr: Sequence[float] | Values,
    kind: str = "VNYMR",
) -> bytes:
    """Writes a line of text with measurements, which are arrays of shape (3,). `VNYMR` contains attitude [deg] (`ypr`: yaw, pitch,
    roll), magnetic field [gauss], acceleration [m/s^2] and rate [rad/s]; `VNYPR`, `VNACC` and `VNGYR` contain only the attitude,
    the acceleration or the rate."""
    parts = {
        "VNYPR": [f"{value:+08.3f}" for value in ypr],
        "magnetic": [f"{value:+08.4f}" for value in magnetic],
        "VNACC": [f"{value:+07.3f}" for value in accel],
        "VNGYR": [f"{value:+010.6f}" for value in rate],
    }
    written = [word for part in parts.values() for word in part] if kind == "VNYMR" else parts[kind]
    return line(",".join([kind, *written]))

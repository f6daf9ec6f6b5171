"""Dataflash logs of ArduPilot, written here byte by byte: the tests do not use the library that reads them."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence

FORMS = (
    ("FMT", 128, "BBnNZ", "Type,Length,Name,Format,Columns"),
    ("FMTU", 129, "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
    ("PARM", 130, "QNf", "TimeUS,Name,Value"),
    ("IMU", 131, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    ("BARO", 132, "Qfc", "TimeUS,Alt,Temp"),
)
"""Name, number, types of the fields and names of the fields of each kind of message."""
_STRUCTS = {"B": "B", "n": "4s", "N": "16s", "Z": "64s", "Q": "Q", "f": "f", "c": "h"}
Fields = Sequence[object]


def _body(kind: str) -> str:
    return "<" + "".join(_STRUCTS[one] for one in next(form[2] for form in FORMS if form[0] == kind))


def messages(samples: Iterable[Fields]) -> Iterable[tuple[str, Fields]]:
    """All messages of a log with two IMUs: descriptions, a parameter, and the samples of the first IMU (time in us, and six numbers).
    The second IMU measures 1 ms later, always the same, and the temperature of the barometer is in hundredths."""
    for name, number, kinds, columns in FORMS:
        yield "FMT", (128, number, struct.calcsize(_body(name)) + 3, name, kinds, columns)[1:]
    yield "FMTU", (0, 131, "s#EEEooo", "F-000000")
    yield "PARM", (0, "LOG_DISARMED", 1.0)
    for k, (time, *numbers) in enumerate(samples):
        yield "IMU", (time, 0, *numbers)
        yield "IMU", (int(time) + 1000, 1, *[0.5] * 6)  # type: ignore[call-overload]
        if k % 10 == 0:
            yield "BARO", (time, 1.5, 2371)


def binary(samples: Iterable[Fields]) -> bytes:
    numbers = {name: number for name, number, *_ in FORMS}
    parts = []
    for kind, fields in messages(samples):
        stored = [one.encode() if isinstance(one, str) else one for one in fields]
        parts.append(struct.pack("<BBB", 0xA3, 0x95, numbers[kind]) + struct.pack(_body(kind), *stored))
    return b"".join(parts)


def text(samples: Iterable[Fields]) -> bytes:
    lines = []
    for kind, fields in messages(samples):
        shown = [f"{one:.9g}" if isinstance(one, float) else str(one) for one in fields]
        shown = [*shown[:-1], "23.71"] if kind == "BARO" else shown
        lines.append(", ".join([kind, *shown]))
    return "\n".join([*lines, ""]).encode()

"""Compares the decoding of sensor streams, from bytes to checked columns, with a `struct` loop that checks the same CRC.

There are two loops. One computes the CRC with a table in Python, as drivers usually do. The other uses the compiled functions of the
standard library where they exist; no such loop is faster.
"""

from __future__ import annotations

import binascii
import struct
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from planrunner.instruments.sensors import kvh1775, stim300, vectornav, xsens
from planrunner.instruments.sensors.samples import Decoder
from planrunner.instruments.wire.framing import Framer, Piece
from planrunner.plan.quantity import parse_quantity
from planrunner.simulators import kvh1775 as kvh_unit
from planrunner.simulators import stim300 as stim_unit
from planrunner.simulators import vectornav as vectornav_unit
from planrunner.simulators import xsens as xsens_unit

WIRE_RATE = 2000.0  # Hz, STIM300


@dataclass(frozen=True, slots=True)
class Size:
    frames: int
    turns: int


FULL, SMALL = Size(2000, 20), Size(50, 1)  # 2000: as many as a second of the fastest sensor has
MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def _table() -> list[int]:
    found = []
    for byte in range(256):
        register = byte << 24
        for _ in range(8):
            register = (register << 1 ^ (0x04C11DB7 if register >> 31 else 0)) & 0xFFFFFFFF
        found.append(register)
    return found


TABLE = _table()


def crc32_by_table(data: bytes) -> int:
    register = 0xFFFFFFFF
    for byte in data:
        register = (register << 8 & 0xFFFFFFFF) ^ TABLE[register >> 24 ^ byte]
    return register


def crc32_by_zlib(data: bytes) -> int:
    """Computes the same CRC with zlib, whose bits have the reverse order."""
    found = zlib.crc32(data.translate(MIRRORED)) ^ 0xFFFFFFFF
    return int.from_bytes(found.to_bytes(4, "little").translate(MIRRORED), "big")


def crc16_by_steps(data: bytes) -> int:
    """Computes the CRC bit by bit, without a table, as drivers often do."""
    crc = 0
    for byte in data:
        crc = (crc >> 8 | crc << 8 & 0xFFFF) ^ byte
        crc ^= (crc & 0xFF) >> 4
        crc ^= crc << 12 & 0xFFFF
        crc ^= (crc & 0xFF) << 5
    return crc


def crc16_by_library(data: bytes) -> int:
    return binascii.crc_hqx(data, 0)


def sum_in_python(data: bytes) -> int:
    total = 0
    for byte in data:
        total = total + byte & 0xFF
    return total


def sum_by_library(data: bytes) -> int:
    return sum(data) & 0xFF


def stim_loop(stream: bytes, check: Callable[[bytes], int]) -> np.ndarray:
    rows, place = [], 0
    counts = struct.Struct(">BH")
    while place + 63 <= len(stream):
        if stream[place] != 0xAF or check(stream[place : place + 59] + b"\0") != int.from_bytes(
            stream[place + 59 : place + 63], "big"
        ):
            place += 1
            continue
        row = [int.from_bytes(stream[place + at : place + at + 3], "big", signed=True) * 2.0**-14 for at in (1, 4, 7)]
        row += [
            int.from_bytes(stream[place + at : place + at + 3], "big", signed=True) * 2.0**-19 for at in (11, 14, 17)
        ]
        row += [
            int.from_bytes(stream[place + at : place + at + 3], "big", signed=True) * 2.0**-22 for at in (21, 24, 27)
        ]
        for at in (31, 38, 45):
            row += [value * 2.0**-8 for value in struct.unpack_from(">3h", stream, place + at)]
        row.append(int.from_bytes(stream[place + 52 : place + 55], "big", signed=True) * 5.0 * 2.0**-24)
        counter, latency = counts.unpack_from(stream, place + 56)
        rows.append([*row, counter, latency * 1e-6, stream[place + 10] | stream[place + 20] | stream[place + 30]])
        place += 63
        place += 2 if stream[place : place + 2] == b"\r\n" else 0
    return np.array(rows)


def kvh_loop(stream: bytes, check: Callable[[bytes], int]) -> np.ndarray:
    layout, rows, place = struct.Struct(">I6fBBhI"), [], 0
    while place + 36 <= len(stream):
        found = layout.unpack_from(stream, place)
        if found[0] != 0xFE81FF55 or found[10] != check(stream[place : place + 32]):
            place += 1
            continue
        rows.append(found[1:10])
        place += 36
    return np.array(rows)


def xsens_loop(stream: bytes, check: Callable[[bytes], int]) -> np.ndarray:
    rows, place = [], 0
    while place + 5 <= len(stream):
        size = stream[place + 3] + 5
        if stream[place : place + 3] != b"\xfa\xff\x36" or check(stream[place + 1 : place + size]) != 0:
            place += 1
            continue
        at, found = place + 4, {}
        while at < place + size - 1:
            kind, length = struct.unpack_from(">HB", stream, at)
            if kind == 0x1020:
                found[kind] = struct.unpack_from(">H", stream, at + 3)
            elif kind in (0x4020, 0x8020, 0x0810):
                found[kind] = struct.unpack_from(f">{length // 4}f", stream, at + 3)
            elif kind == 0xE020:
                found[kind] = struct.unpack_from(">I", stream, at + 3)
            at += 3 + length
        rows.append([value for kind in (0x4020, 0x8020, 0x0810, 0x1020, 0xE020) for value in found[kind]])
        place += size
    return np.array(rows)


def vectornav_loop(stream: bytes, check: Callable[[bytes], int]) -> np.ndarray:
    layout, rows, place = struct.Struct("<BBHQ11f"), [], 0
    size = layout.size + 2
    while place + size <= len(stream):
        found = layout.unpack_from(stream, place)
        stored = int.from_bytes(stream[place + size - 2 : place + size], "big")
        if found[:3] != (0xFA, 1, 0x0601) or check(stream[place + 1 : place + size - 2]) != stored:
            place += 1
            continue
        rows.append(found[3:])
        place += size
    return np.array(rows)


def lines_loop(stream: bytes, check: Callable[[bytes], int]) -> np.ndarray:
    rows = []
    for line in stream.split(b"\r\n"):
        body, star, told = line.partition(b"*")
        if star and body.startswith(b"$VNYMR,") and check(body[1:]) == int(told, 16):
            rows.append([float(text) for text in body.split(b",")[1:]])
    return np.array(rows)


def xor_in_python(data: bytes) -> int:
    found = 0
    for byte in data:
        found ^= byte
    return found


def streams(
    frames: int,
) -> dict[str, tuple[Decoder, bytes, Callable[..., np.ndarray], Callable[[bytes], int], Callable[[bytes], int] | None]]:
    """Returns, for each sensor: the decoder, the stream, the loop, and the check of the loop in Python and by the library."""
    draw, index = np.random.default_rng(0), np.arange(frames)
    columns = {f"{name}_{axis}": draw.uniform(-1, 1, frames) for name in ("gyro", "acc", "incl") for axis in "xyz"}
    columns |= {f"{name}_T_{axis}": draw.uniform(0, 50, frames) for name in ("gyro", "acc", "incl") for axis in "xyz"}
    columns |= {"aux": np.zeros(frames), "temperature": draw.integers(0, 50, frames).astype(float)}
    stim = stim_unit.Stim300(0xAF, crlf=True).frames(columns, index % 256, np.full(frames, 300)).tobytes()
    kvh = kvh_unit.Kvh1775("A").frames(columns, index).tobytes()
    packets = {
        0x4020: draw.uniform(-9, 9, (frames, 3)),
        0x8020: draw.uniform(-9, 9, (frames, 3)),
        0x0810: np.full(frames, 25.0),
    }
    packets |= {0x1020: index, 0xE020: np.ones(frames)}
    mti = xsens_unit.Xsens([0x1020, 0x4020, 0x8020, 0x0810, 0xE020]).frames(packets).tobytes()
    outputs = {"time_startup": index * 2_500_000.0, "imu": draw.uniform(-9, 9, (frames, 6))}
    outputs["mag_pres"] = draw.uniform(-1, 1, (frames, 5))
    binary = vectornav_unit.VectorNav().frames(outputs).tobytes()
    lines = b"".join(vectornav_unit.measurement([0.1] * 3, [9.8] * 3, [-0.01] * 3, [k % 90] * 3) for k in range(frames))
    told = kvh1775.Kvh1775Parameters(port="", sample_rate=parse_quantity("1000 Hz"))
    return {
        "STIM300": (
            stim300.layout(0xAF, 2.0**-19, 2.0**-14, WIRE_RATE),
            stim,
            stim_loop,
            crc32_by_table,
            crc32_by_zlib,
        ),
        "KVH 1775": (kvh1775.layout(told), kvh, kvh_loop, crc32_by_table, crc32_by_zlib),
        "Xsens MTi": (
            xsens.MtData2(("acceleration", "rate", "temperature"), 400.0),
            mti,
            xsens_loop,
            sum_in_python,
            sum_by_library,
        ),
        "VN-100": (
            vectornav.binary(("time_startup", "imu", "mag_pres"), 400.0),
            binary,
            vectornav_loop,
            crc16_by_steps,
            crc16_by_library,
        ),
        "VN-100 text": (vectornav.LineDecoder("VNYMR", 40.0), lines, lines_loop, xor_in_python, None),
    }


def best(work: Callable[[], object], turns: int) -> float:
    seconds = []
    for _ in range(turns):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def decode(decoder: Decoder, stream: bytes) -> int:
    return len(decoder.decode(Framer(decoder.framing).push([Piece(0.0, stream)])))


def run(size: Size = FULL) -> dict[str, object]:
    figures: dict[str, object] = {}
    for name, (decoder, stream, loop, check, library) in streams(size.frames).items():
        assert decode(decoder, stream) == size.frames == len(loop(stream, check))
        ours = best(partial(decode, decoder, stream), size.turns)
        theirs = best(partial(loop, stream, check), size.turns)
        figures[f"{name} [frames/s]"] = size.frames / ours
        figures[f"{name} [MB/s]"] = len(stream) / ours / 1e6
        figures[f"{name} / loop (target ≥ 30)"] = theirs / ours
        if library is not None:
            fastest = best(partial(loop, stream, library), size.turns)
            figures[f"{name} / loop with a compiled check"] = fastest / ours
        if name == "STIM300":
            figures["STIM300 / frame rate of the sensor, 2 kHz (target ≥ 100)"] = size.frames / ours / WIRE_RATE
    return figures

"""Streams of frames with bytes changed, cut out, doubled and put in, many at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planrunner.simulators import kvh1775, stim300, vectornav, xsens
from planrunner.simulators.frames import Values, sum_to_zero

FRAMES = 4


def seeds() -> dict[str, tuple[str, bytes]]:
    """Kind of stream → keys of the sensor that reads it, and some good frames."""
    draw = np.random.default_rng(2)
    columns = {f"{name}_{axis}": draw.uniform(-1, 1, FRAMES) for name in ("gyro", "acc", "incl") for axis in "xyz"}
    columns |= {f"{name}_T_{axis}": draw.uniform(0, 50, FRAMES) for name in ("gyro", "acc", "incl") for axis in "xyz"}
    columns |= {"aux": np.zeros(FRAMES), "pps": np.zeros(FRAMES), "temperature": np.zeros(FRAMES)}
    index = np.arange(FRAMES)
    stim = stim300.Stim300(0xAF, crlf=True).frames(columns, index * 4, np.full(FRAMES, 300)).tobytes()
    rate = stim300.Stim300(0x90).frames(columns, index, np.full(FRAMES, 300)).tobytes()
    packets: dict[int, Values] = {
        0x4020: draw.uniform(-9, 9, (FRAMES, 3)),
        0x8020: draw.uniform(-9, 9, (FRAMES, 3)),
        0x1020: index,
        0xE020: index,
    }
    mti = xsens.Xsens([0x1020, 0x4021, 0x8022, 0xE020]).frames(packets).tobytes()
    binary = vectornav.VectorNav(("time_startup", "imu")).frames(
        {"time_startup": index * 10**7, "imu": draw.uniform(-9, 9, (FRAMES, 6))}
    )
    lines = b"".join(vectornav.measurement([0.1] * 3, [9.8] * 3, [-0.01] * 3, [k] * 3) for k in range(FRAMES))
    body = draw.integers(0, 256, (FRAMES, 10), dtype=np.uint8)
    declared = np.concatenate([np.full((FRAMES, 1), 0xA5, np.uint8), body, sum_to_zero(body)[:, None]], axis=1)
    keys = (
        "driver: declared_frame; sample_rate: 100 Hz; sync: A5; length: 12; checksum: {type: zero_sum8, from: 1}; "
        "fields: {a: {at: 1, type: f32, unit: V}, b: {at: 5, type: i24, unit: V}}; counter: {at: 8}; status: {at: 9, bits: {bad: 3}}"
    )
    return {
        "stim300 all": ("driver: stim300; sample_rate: 500 Hz; datagram: 0xAF", stim),
        "stim300 rate": ("driver: stim300; sample_rate: 2000 Hz; datagram: 0x90", rate),
        "kvh A": ("driver: kvh_1775; sample_rate: 1000 Hz", kvh1775.Kvh1775("A").frames(columns, index).tobytes()),
        "kvh C": (
            "driver: kvh_1775; sample_rate: 1000 Hz; format: C",
            kvh1775.Kvh1775("C").frames(columns, index).tobytes(),
        ),
        "xsens": ("driver: xsens_mti; sample_rate: 100 Hz", mti),
        "vectornav": ("driver: vectornav; sample_rate: 100 Hz; fields: [time_startup, imu]", binary.tobytes()),
        "vectornav lines": ("driver: vectornav; sample_rate: 40 Hz; output: VNYMR", lines),
        "declared": (keys, declared.tobytes()),
    }


def mutations(seed: bytes, count: int, draw: np.random.Generator) -> Iterator[bytes]:
    """`count` streams: up to six bytes of each changed (to anything, or to what syncs and lengths are made of), then a stretch cut out,
    doubled, or put in."""
    size = len(seed)
    rows = np.tile(np.frombuffer(seed, np.uint8), (count, 1))
    telling = np.array(
        [0, 255, 0xFA, 0x36, 0xFE, 0x81, 0xAF, 0x90, 0xA5, 10, 13, ord("$"), ord("*"), ord(","), ord("9")], np.uint8
    )
    for _ in range(6):
        chosen = np.flatnonzero(draw.random(count) < 0.5)
        places = draw.integers(0, size, chosen.size)
        new = np.where(
            draw.random(chosen.size) < 0.5, draw.choice(telling, chosen.size), draw.integers(0, 256, chosen.size)
        )
        rows[chosen, places] = new
    kinds, begins, lengths = draw.integers(0, 4, count), draw.integers(0, size, count), draw.integers(0, 40, count)
    noise = draw.bytes(4096)
    for row, kind, begin, length in zip(rows, kinds.tolist(), begins.tolist(), lengths.tolist(), strict=True):
        stream = row.tobytes()
        if kind == 1:
            stream = stream[:begin] + stream[begin + length :]
        elif kind == 2:
            stream = stream[: begin + length] + stream[begin:]
        elif kind == 3:
            stream = stream[:begin] + noise[begin : begin + length] + stream[begin:]
        yield stream

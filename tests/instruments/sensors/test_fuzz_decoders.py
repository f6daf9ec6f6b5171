"""Decoders fed with mutated streams: no exception, nothing held that grows, and no sample that its frame's checksum does not vouch for."""

from __future__ import annotations

import gc
import tracemalloc
from functools import cache

import numpy as np
import pytest
from bench_entries import bench_of, parameters_of
from hypothesis import given, settings
from hypothesis import strategies as st
from mutated_streams import mutations, seeds

from planrunner.bench.model import driver_of
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.sensors import kvh1775, vectornav
from planrunner.instruments.wire.checksums import XOR8
from planrunner.instruments.wire.framing import Framer, Piece

KINDS = tuple(seeds())
STREAMS = 1_000_000
REPLIES = 40_000


@cache
def entry_of(kind: str):
    """Driver, parameters and good frames."""
    keys, good = seeds()[kind]
    return driver_of(bench_of(keys).instruments["imu"]), parameters_of(keys), good


def opened(kind: str):
    """A fresh decoder, and good frames of its sensor."""
    driver, parameters, good = entry_of(kind)
    return driver.decoder_of(parameters), good


def fed(kind: str, count: int, seed: int) -> tuple[int, int]:
    """Streams and good frames. One framer reads them all, as one stream that never ends, up to eight at once."""
    (decoder, good), draw = opened(kind), np.random.default_rng(seed)
    framer, streams = Framer(decoder.framing), 0
    pieces: list[Piece] = []
    together = draw.integers(1, 9, count).tolist()
    for stream in mutations(good, count, draw):
        streams += 1
        pieces.append(Piece(float(streams), stream))
        if len(pieces) < together[streams - len(pieces)] and streams < count:
            continue
        samples = decoder.decode(framer.push(pieces))
        pieces = []
        assert all(values.size == len(samples) and np.isfinite(values).all() for values in samples.channels.values())
        assert len(framer._rest) < max(decoder.framing.longest, 8)
    return streams, framer.good


@pytest.mark.parametrize("kind", KINDS)
def test_some_mutated_streams(kind: str) -> None:
    streams, good = fed(kind, 400, 3)
    assert streams == 400
    assert 100 < good < 4 * 400 * 1.6  # some survive, none come from nowhere


@pytest.mark.slow
def test_a_million_mutated_streams() -> None:
    count = -(-STREAMS // len(KINDS))
    tracemalloc.start()
    fed(KINDS[0], 1000, 4)
    before = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    total = sum(fed(kind, count, 100 + place)[0] for place, kind in enumerate(KINDS))
    assert total >= STREAMS
    tracemalloc.start()
    fed(KINDS[0], 1000, 4)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert after < before + 200_000


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=60, deadline=None)
@given(parts=st.lists(st.one_of(st.binary(max_size=60), st.integers(0, 400)), max_size=8))
def test_anything_at_all(kind: str, parts: list[bytes | int]) -> None:
    decoder, good = opened(kind)
    framer = Framer(decoder.framing)
    for part in parts:
        stream = part if isinstance(part, bytes) else good[part % len(good) :]
        samples = decoder.decode(framer.push([Piece(0.0, stream)]))
        assert all(bool(np.isfinite(values).all()) for values in samples.channels.values())


def test_memory_does_not_grow_with_the_stream() -> None:
    """Frames of the MTi whose packets always differ are the worst: each shape is remembered."""
    decoder, good = opened("xsens")
    framer, draw = Framer(decoder.framing), np.random.default_rng(8)

    def shapes(count: int) -> None:
        for _ in range(count):
            data = b"".join(
                bytes([*draw.bytes(2), size, *draw.bytes(size)]) for size in draw.integers(0, 30, 5).tolist()
            )
            body = bytes([0xFF, 0x36, len(data)]) + data
            decoder.decode(framer.push([Piece(0.0, b"\xfa" + body + bytes([-sum(body) & 0xFF]) + good)]))

    shapes(100)
    tracemalloc.start()
    shapes(20)
    before = tracemalloc.get_traced_memory()[0]
    shapes(200)
    gc.collect()  # what waits for collection is not kept
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert after < before + 100_000


@settings(max_examples=300, deadline=None)
@given(data=st.one_of(st.binary(max_size=80), st.text(max_size=40).map(lambda text: b"$VN" + text.encode() + b"*00")))
def test_replies_raise_only_what_is_documented(data: bytes) -> None:
    for parse in (vectornav.body_of, kvh1775.built_in_test):
        try:
            parse(data)
        except InstrumentError:
            continue


@pytest.mark.slow
def test_many_mutated_replies() -> None:
    draw = np.random.default_rng(5)
    good = 0
    for reply, parse in (
        (b"$VNWRG,75,1,4,01,0100*", vectornav.body_of),
        (bytes.fromhex("fe8100aa7f7f7e7b7f7f1e"), kvh1775.built_in_test),
    ):
        if reply.startswith(b"$"):
            reply += f"{XOR8.of(reply[1:-1]):02X}\r\n".encode()
        for mutated in mutations(reply, REPLIES // 2, draw):
            try:
                parse(mutated)
                good += 1
            except InstrumentError:
                continue
    assert 0 < good < REPLIES / 4

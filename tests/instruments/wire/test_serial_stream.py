"""Ports that stream: bulk reads, a ring with an end, ports that are not there or go away."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import pytest

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire.framing import Piece
from planrunner.instruments.wire.serial_stream import NEWEST, Ring, SerialStream

pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals")


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    """The far end of a serial line, and the name of the near one."""
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    os.close(master)


def collect(stream: SerialStream, count: int, seconds: float = 60.0) -> bytes:
    data, until = b"", time.monotonic() + seconds
    while len(data) < count and time.monotonic() < until:
        data += b"".join(piece.data for piece in stream.take())
        time.sleep(0.005)
    return data


def test_what_is_sent_arrives_whole(line: tuple[int, str]) -> None:
    master, name = line
    stream = SerialStream.open(name, 921600, time.monotonic)
    stream.ring.follow(True)
    sent = bytes(range(256)) * 200
    for begin in range(0, len(sent), 3000):
        os.write(master, sent[begin : begin + 3000])
        time.sleep(0.01)
    assert collect(stream, len(sent)) == sent
    assert stream.ring.dropped == 0
    stream.write(b"hello\r")
    assert os.read(master, 10) == b"hello\r"
    stream.close()
    stream.close()


def test_a_port_that_is_not_there(tmp_path) -> None:
    with pytest.raises(InstrumentError, match=r"tty-none cannot be opened .* plugged in"):
        SerialStream.open(str(tmp_path / "tty-none"), 921600, time.monotonic)


def test_a_url_that_nobody_answers() -> None:
    with pytest.raises(InstrumentError, match="cannot be opened"):
        SerialStream.open("socket://127.0.0.1:1", 921600, time.monotonic)


class Unplugged:
    """A port that gives some bytes and is gone."""

    in_waiting = 3

    def __init__(self) -> None:
        self.data = [b"abc"]

    def read(self, size: int) -> bytes:
        if not self.data:
            raise OSError("device gone")
        return self.data.pop()

    def write(self, data: bytes) -> None:
        raise OSError("device gone")

    def close(self) -> None:
        raise OSError("device gone")


def test_an_unplugged_port_gives_what_it_had_and_is_reported() -> None:
    stream = SerialStream(Unplugged(), "COM7", time.monotonic)
    assert collect(stream, 3) == b"abc"
    with pytest.raises(InstrumentError, match=r"COM7 is no longer available \(device gone\).*unplugged"):
        collect(stream, 1)
    with pytest.raises(InstrumentError, match="does not accept commands"):
        stream.write(b"x")
    stream.close()


def test_a_full_ring_counts_what_it_drops() -> None:
    ring = Ring(capacity=100)
    ring.follow(True)
    for number in range(12):
        ring.put(Piece(number, bytes(10)))
    assert ring.dropped == 20
    assert sum(len(piece.data) for piece in ring.take()) == 100
    ring.put(Piece(20, bytes(10)))
    assert [piece.received for piece in ring.take()] == [20]
    ring.follow(True)
    assert ring.dropped == 0


def test_a_ring_that_nobody_follows_keeps_the_newest() -> None:
    ring = Ring(capacity=100)
    for number in range(200):
        ring.put(Piece(number, bytes(1000)))
    pieces = ring.take()
    assert pieces[-1].received == 199
    assert NEWEST - 1000 <= sum(len(piece.data) for piece in pieces) <= NEWEST
    assert ring.dropped == 0

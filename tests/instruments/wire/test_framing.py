"""Frames in streams: whole, in pieces, behind noise, corrupt; every byte is a frame's, a trailer's, counted, or still held."""

from __future__ import annotations

import struct
import zlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planrunner.instruments.wire.checksums import CRC32, UNCHECKED, XOR8, ZERO_SUM8
from planrunner.instruments.wire.codes import LINE, XBUS
from planrunner.instruments.wire.framing import Framer, Framing, Piece

FIXED_FRAMES = Framing(b"\xa5\x5a", 12, checksum=CRC32, check_bytes=4, trailer=b"\r\n")
XBUS_FRAMES = Framing(b"\xfa\xff", 300, XBUS, ZERO_SUM8, 1, 1)
LINES = Framing(b"$AB,", 40, LINE, XOR8)


def frame(number: int) -> bytes:
    body = b"\xa5\x5a" + struct.pack(">HI", number, number * 7919)
    return body + struct.pack(">I", zlib.crc32(body))


def xbus(data: bytes) -> bytes:
    length = bytes([len(data)]) if len(data) < 255 else b"\xff" + struct.pack(">H", len(data))
    body = b"\xff\x36" + length + data
    return b"\xfa" + body + bytes([-sum(body) & 0xFF])


def line(text: str) -> bytes:
    check = 0
    for character in text.encode():
        check ^= character
    return f"${text}*{check:02X}\r\n".encode()


def pushed(framing: Framing, stream: bytes, cuts: list[int]) -> tuple[list[bytes], Framer]:
    framer, found = Framer(framing), []
    for begin, end in pairwise(sorted({0, len(stream), *cuts})):
        frames = framer.push([Piece(0.0, stream[begin:end])])
        found += [frames.data[s : s + n].tobytes() for s, n in zip(frames.starts, frames.lengths, strict=True)]
    return found, framer


def test_frames_back_to_back_and_with_trailers() -> None:
    frames = [frame(number) for number in range(5)]
    for separator in (b"", b"\r\n"):
        found, framer = pushed(FIXED_FRAMES, separator.join(frames) + separator, [])
        assert found == frames
        assert (framer.good, framer.corrupt, framer.skipped) == (5, 0, 0)


def test_noise_before_the_first_frame_is_skipped_and_no_corrupt_frame() -> None:
    found, framer = pushed(FIXED_FRAMES, b"\xa5noise\xa5\x5a" + frame(3), [])
    assert found == [frame(3)]
    assert (framer.corrupt, framer.skipped) == (0, 8)


def test_each_corrupt_frame_is_counted_once() -> None:
    bad_body = bytearray(frame(1))
    bad_body[4] ^= 1
    bad_sync = bytearray(frame(2))
    bad_sync[0] ^= 1
    stream = b"\r\n".join([frame(0), bytes(bad_body), bytes(bad_sync), frame(3), bytes(bad_body), frame(4)])
    found, framer = pushed(FIXED_FRAMES, stream, [])
    assert found == [frame(0), frame(3), frame(4)]
    assert framer.corrupt == 3


def test_a_trailer_that_is_cut_is_waited_for() -> None:
    stream = frame(0) + b"\r\n" + frame(1) + b"\r\n"
    for cut in range(len(stream)):
        found, framer = pushed(FIXED_FRAMES, stream, [cut])
        assert (found, framer.corrupt, framer.skipped) == ([frame(0), frame(1)], 0, 0), cut


def test_a_frame_behind_a_false_sync_is_not_jumped_over() -> None:
    found, framer = pushed(FIXED_FRAMES, frame(0) + b"\xa5\x5a\x00" + frame(1), [])
    assert found == [frame(0), frame(1)]
    assert framer.skipped == 3


def test_a_cut_frame_costs_itself_only() -> None:
    found, framer = pushed(FIXED_FRAMES, frame(0) + frame(1)[:7] + frame(2) + frame(3), [])
    assert found == [frame(0), frame(2), frame(3)]
    assert (framer.corrupt, framer.skipped) == (1, 7)


def test_xbus_lengths_short_and_long() -> None:
    messages = [xbus(b""), xbus(bytes(range(100))), xbus(bytes(254)), xbus(bytes(255)), xbus(bytes(280))]
    found, framer = pushed(XBUS_FRAMES, b"".join(messages), [])
    assert found == messages
    assert (framer.corrupt, framer.skipped) == (0, 0)


def test_xbus_that_claims_to_be_too_long_does_not_hold_the_stream_up() -> None:
    found, framer = pushed(XBUS_FRAMES, b"\xfa\xff\x36\xff\xff\xff" + xbus(b"abc"), [])
    assert found == [xbus(b"abc")]
    assert framer.skipped == 6


def test_lines_with_and_without_carriage_return() -> None:
    lines = [line("AB,1,2"), line("AB,-3.5").replace(b"\r", b"")]
    stream = line("CD,9") + lines[0] + b"$AB,1*00\r\n" + lines[1] + b"$AB,no end"
    found, framer = pushed(LINES, stream, [])
    assert found == lines
    assert framer.corrupt == 1


def test_lines_of_different_lengths() -> None:
    # Where a second line of 20 bytes would end, a line feed ends the second of two lines of 10.
    long, short = line("AB,12345678901"), line("AB,1")
    assert (len(long), len(short)) == (20, 10)
    lines = [long, short, short, long, line("AB,12"), long, long, short]
    found, framer = pushed(LINES, b"".join(lines), [])
    assert found == lines
    assert (framer.good, framer.corrupt, framer.skipped) == (8, 0, 0)


def test_a_line_without_end_is_given_up() -> None:
    found, framer = pushed(LINES, b"$AB," + b"7" * 100 + line("AB,1"), [])
    assert found == [line("AB,1")]
    assert framer.skipped == 104


def test_frames_know_when_their_last_byte_was_read_less_their_time_on_the_line() -> None:
    framer = Framer(FIXED_FRAMES, byte_time=0.001)
    stream = frame(0) + frame(1) + frame(2)
    frames = framer.push([Piece(1.0, stream[:12]), Piece(2.0, stream[12:23]), Piece(3.0, stream[23:])])
    assert frames.received.tolist() == pytest.approx([0.988, 2.988, 2.988])


noise = st.one_of(st.binary(max_size=30), st.sampled_from([b"\xa5", b"\xa5\x5a", b"\xfa\xff\x36", b"$AB,", b"\r\n"]))
numbered = st.integers(0, 65535)
streams = {
    "fixed": (FIXED_FRAMES, st.lists(st.one_of(noise, numbered.map(frame)), max_size=12)),
    "xbus": (XBUS_FRAMES, st.lists(st.one_of(noise, st.binary(max_size=40).map(xbus)), max_size=12)),
    "line": (LINES, st.lists(st.one_of(noise, numbered.map(lambda n: line(f"AB,{n}"))), max_size=12)),
    "unchecked": (Framing(b"\xa5\x5a", 12, checksum=UNCHECKED), st.lists(noise, max_size=12)),
}


@pytest.mark.parametrize("kind", streams)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_how_a_stream_is_cut_makes_no_difference(kind: str, data: st.DataObject) -> None:
    framing, parts = streams[kind]
    stream = b"".join(data.draw(parts))
    whole, at_once = pushed(framing, stream, [])
    pieces, in_pieces = pushed(framing, stream, data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    assert pieces == whole
    assert (in_pieces.corrupt, in_pieces.skipped) == (at_once.corrupt, at_once.skipped)
    held = len(at_once._rest)
    assert held < framing.longest
    taken = sum(map(len, whole)) + at_once.skipped + held
    trailers = (
        len(framing.trailer) * stream.count(framing.trailer) if framing.trailer else 0
    )  # one frame may have several
    assert taken <= len(stream) <= taken + trailers


def test_what_is_held_stays_short_however_long_the_stream() -> None:
    framer = Framer(XBUS_FRAMES)
    noisy = np.random.default_rng(0).choice(np.frombuffer(b"\xfa\xff\x36\x10", np.uint8), 200_000)
    for begin in range(0, noisy.size, 1000):
        framer.push([Piece(0.0, noisy[begin : begin + 1000].tobytes())])
        assert len(framer._rest) <= XBUS_FRAMES.longest

"""One segment from frames to blocks: what is lost, corrupt, sent twice or too late is counted, and time never runs backwards."""

from __future__ import annotations

import numpy as np
import pytest
from bench_entries import parameters_of

from planrunner.instruments.sensors.segment_stream import SegmentStream
from planrunner.instruments.sensors.stim300 import Stim300
from planrunner.instruments.wire.framing import Piece
from planrunner.instruments.wire.serial_stream import Ring
from planrunner.simulators.stim300 import Stim300 as Unit

RATE, SECONDS, START = 2000, 3.0, 100.0
COUNT = round(RATE * (SECONDS + 1))
KEYS = "driver: stim300; sample_rate: 2000 Hz; datagram: 0x90; baud: 921600"
DELAY = 0.0006  # the sensor's own, s


@pytest.fixture(scope="module")
def frames() -> list[bytes]:
    """Frames that hold their number in gyro_x."""
    zeros = np.zeros(COUNT)
    columns = {"gyro_x": np.arange(COUNT) * 2.0**-6, "gyro_y": zeros, "gyro_z": zeros, "gyro_status": zeros.astype(int)}
    columns["gyro_status"][1000:1010] = 0x10
    rows = Unit(0x90).frames(columns, np.arange(COUNT) % 256, np.full(COUNT, DELAY * 1e6))
    return [row.tobytes() for row in rows]


def number(block_values: np.ndarray) -> np.ndarray:
    return np.rint(block_values * 2.0**6).astype(int)


class Feed:
    """A port from which frames come at their times, a piece every 4 ms."""

    def __init__(self, sent: list[tuple[float, bytes]]):
        self.sent = sent
        self.ring = Ring()
        self.now = START

    def take(self) -> list[Piece]:
        due = [item for item in self.sent if item[0] <= self.now]
        self.sent = self.sent[len(due) :]
        grid: dict[float, list[bytes]] = {}
        for when, data in due:
            grid.setdefault(np.ceil(when / 0.004) * 0.004, []).append(data)
        return [Piece(when, b"".join(parts)) for when, parts in grid.items()]


def streamed(sent: list[tuple[float, bytes]]) -> tuple[SegmentStream, np.ndarray, np.ndarray]:
    feed = Feed(sent)
    stream = SegmentStream(
        Stim300.decoder_of(parameters_of(KEYS)), feed, START, round(RATE * SECONDS), 10 / 921600, 0.0
    )
    times, numbers = [np.empty(0)], [np.empty(0, int)]
    while not stream.over and feed.now < START + SECONDS + 1:
        feed.now += 0.05
        block = stream.advance()
        times.append(block.time)
        numbers.append(number(block.channels["gyro_x"]))
    return stream, np.concatenate(times), np.concatenate(numbers)


def on_time(frames: list[bytes], chosen: np.ndarray) -> list[tuple[float, bytes]]:
    """Frame k is taken at START + (k + ½)/RATE and comes when it has told its delay and been on the line."""
    line = len(frames[0]) * 10 / 921600
    return [(START + (k + 0.5) / RATE + DELAY + line, frames[k]) for k in chosen]


def test_a_whole_segment(frames: list[bytes]) -> None:
    stream, times, numbers = streamed(on_time(frames, np.arange(COUNT)))
    assert numbers.tolist() == list(range(round(RATE * SECONDS)))
    assert np.max(np.abs(times - (START + (numbers + 0.5) / RATE))) < 1 / RATE  # pieces end with whole frames
    counts = stream.counts()
    assert (counts.received, counts.lost, counts.corrupt, counts.overflowed, counts.skipped_bytes) == (6000, 0, 0, 0, 0)
    assert counts.details["doubtful_frames"] == 10
    assert stream.take_doubts() == ("gyro: overload",)
    assert counts.details["latency_s"] == pytest.approx(DELAY + 18 * 10 / 921600 + counts.details["usual_delay_s"])
    assert abs(counts.details["clock_skew_ppm"]) < 100


def test_lost_frames_are_gaps_in_time(frames: list[bytes]) -> None:
    chosen = np.setdiff1d(np.arange(COUNT), [*range(1000, 1700), 3000, 3001, 4000])
    stream, times, numbers = streamed(on_time(frames, chosen))
    assert numbers.tolist() == [k for k in chosen if k < RATE * SECONDS]
    assert stream.counts().lost == 703
    assert np.max(np.abs(times - (START + (numbers + 0.5) / RATE))) < 1 / RATE  # pieces end with whole frames


@pytest.mark.parametrize("share", [0.01, 0.5])
def test_corrupt_frames_are_counted_and_left_out(frames: list[bytes], share: float) -> None:
    draw = np.random.default_rng(7)
    hit = np.flatnonzero(draw.random(COUNT) < share)
    spoilt = list(frames)
    for k in hit:
        row = bytearray(frames[k])
        row[draw.integers(len(row))] ^= 1 << draw.integers(8)
        spoilt[k] = bytes(row)
    stream, times, numbers = streamed(on_time(spoilt, np.arange(COUNT)))
    good = np.setdiff1d(np.arange(round(RATE * SECONDS)), hit)
    assert numbers.tolist() == good.tolist()
    assert np.all(np.diff(times) > 0)
    assert stream.counts().corrupt >= np.count_nonzero(hit < RATE * SECONDS) - 1
    assert stream.counts().lost + good.size == round(RATE * SECONDS) - good[0]


def test_nothing_but_corrupt_frames(frames: list[bytes]) -> None:
    spoilt = [bytes([row[0], row[1] ^ 1]) + row[2:] for row in frames]
    stream, times, _ = streamed(on_time(spoilt, np.arange(COUNT)))
    assert times.size == 0 and not stream.over
    assert stream.counts().received == 0
    assert stream.counts().skipped_bytes > 18 * 6000


def test_frames_twice_and_out_of_order(frames: list[bytes]) -> None:
    sent = on_time(frames, np.arange(COUNT))
    for k in (500, 900, 2000):
        sent[k], sent[k + 1] = (sent[k][0], sent[k + 1][1]), (sent[k + 1][0], sent[k][1])
    sent[3000] = (sent[3000][0], sent[3000][1] * 2)
    stream, times, numbers = streamed(sent)
    assert np.all(np.diff(times) > 0)
    assert numbers.tolist() == [k for k in range(round(RATE * SECONDS)) if k not in (500, 900, 2000)]
    counts = stream.counts()
    assert (counts.lost, counts.details["disordered_frames"], counts.details["repeated_frames"]) == (3, 3, 1)


def test_what_a_full_ring_dropped_is_counted_in_frames(frames: list[bytes]) -> None:
    stream, _, _ = streamed(on_time(frames, np.arange(COUNT)))
    stream._link.ring.follow(True)
    stream._link.ring.capacity = 0
    stream._link.ring.put(Piece(0.0, b"".join(frames[:7])))
    assert stream.counts().overflowed == 7


def test_a_segment_shorter_than_what_the_clock_needs(frames: list[bytes]) -> None:
    feed = Feed(on_time(frames, np.arange(COUNT)))
    stream = SegmentStream(Stim300.decoder_of(parameters_of(KEYS)), feed, START, 40, 10 / 921600, 0.0)
    rows = 0
    while not stream.over:
        feed.now += 0.05
        rows += stream.advance().time.size
    assert rows == 40

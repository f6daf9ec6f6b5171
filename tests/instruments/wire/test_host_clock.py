"""Counters on the computer's clock: truth known, readings late, the computer asleep, frames lost by the hundred."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire.host_clock import FrameCounter, HostClock, Unwrapping, line_under

RATE = 2000.0
COUNTER = FrameCounter(1 / RATE, 1, 256)


def readings(taken: np.ndarray, seed: int, sleeps: float = 0.0) -> np.ndarray:
    """When a computer that reads every 3 to 6 ms, and now and then sleeps, has read what was sent at `taken`."""
    draw = np.random.default_rng(seed)
    count = int(np.ptp(taken) / 0.004) + 1000
    steps = draw.uniform(0.003, 0.006, count) + (draw.random(count) < sleeps) * draw.exponential(0.15, count)
    grid = taken[0] + np.cumsum(steps)
    return grid[np.searchsorted(grid, taken)]


def batches(received: np.ndarray, raw: np.ndarray, unwrapping: Unwrapping, seconds: float = 0.05):
    """Indices as they are decided while frames come in."""
    waiting = np.empty(0, np.int64)
    place = 0
    for now in np.arange(received[0], received[-1] + 2 * seconds, seconds):
        end = int(np.searchsorted(received, now))
        waiting = np.arange(place, end) if waiting.size == 0 else np.concatenate([waiting, np.arange(place, end)])
        place = end
        index = unwrapping.resolve(received[waiting], raw[waiting])
        yield waiting[: index.size], index
        waiting = waiting[index.size :]
    index = unwrapping.resolve(received[waiting], raw[waiting], final=True)
    yield waiting, index


def test_skew_and_times_while_the_computer_sleeps_and_frames_are_lost() -> None:
    skew, seconds = 35e-6, 90
    count = int(RATE * seconds)
    kept = np.ones(count, bool)
    kept[50_000:53_000] = False  # 1.5 s, several turns of the counter
    kept[90_000 : 90_000 + 512] = False  # exactly two turns: the counter does not tell
    kept[np.random.default_rng(1).integers(1, count, 40)] = False
    index = np.flatnonzero(kept)
    taken = 10 + index / RATE * (1 + skew)
    received = readings(taken, 2, sleeps=0.001)
    clock = HostClock(COUNTER)
    found, times = np.empty(index.size, np.int64), np.empty(index.size)
    for places, part in batches(received, (index + 77) % 256, Unwrapping(COUNTER)):
        found[places] = part
        times[places] = clock.stamp(part, received[places])
    assert np.array_equal(found, index)
    assert clock.skew == pytest.approx(skew, abs=2e-6)
    assert np.all(np.diff(times) > 0)
    assert np.max(np.abs(times - taken)) < 1e-3  # 35 ppm in 20 s, until the skew is known
    assert np.max(np.abs(times - taken)[60_000:]) < 3e-4
    assert 0.001 < clock.usual_delay < 0.005
    assert clock.worst_delay > 0.1


def test_a_sleeping_computer_is_not_taken_for_a_loss() -> None:
    index = np.arange(8000)
    received = 5 + index / RATE
    received[2000:3000] = received[3000]  # half a second, four turns, then all at once
    found = np.concatenate([part for _, part in batches(received, index % 256, Unwrapping(COUNTER))])
    assert np.array_equal(found, index)


def test_steps_back_and_repetitions() -> None:
    sent = np.array([0, 1, 2, 4, 3, 5, 5, 6])
    found = Unwrapping(COUNTER).resolve(1 + np.arange(8) / RATE, (sent + 254) % 256, final=True)
    assert found.tolist() == sent.tolist()


@pytest.mark.parametrize(
    ("counter", "before"), [(FrameCounter(0.01, 1, 1 << 16), 3000), (FrameCounter(1e-9, 1e7, 1 << 62), 10**13)]
)
def test_a_counter_that_was_set_anew_is_reported(counter: FrameCounter, before: int) -> None:
    count = np.arange(200)
    raw = np.where(count < 100, before + count * int(counter.step), (count - 100) * int(counter.step))
    received = 1 + count.astype(float) * 0.01
    unwrapping = Unwrapping(counter)
    assert unwrapping.resolve(received[:100], raw[:100]).size == 100
    with pytest.raises(
        InstrumentError, match="ahead of the received frames: check whether the sensor was switched off"
    ):
        unwrapping.resolve(received[100:], raw[100:])


def test_frames_lost_while_the_computer_slept_are_no_jump() -> None:
    """The buffer keeps the oldest, the rest is lost, and all is read at once afterwards."""
    sent = np.concatenate([np.arange(1000), np.arange(9000, 12_000)])
    taken = 5 + sent / RATE
    received = np.where((sent >= 500) & (sent < 1000), taken[1000], taken)
    found = np.concatenate(
        [part for _, part in batches(received, sent % 65536, Unwrapping(FrameCounter(1 / RATE, 1, 65536)))]
    )
    assert np.array_equal(found, sent)


def test_a_counter_that_counts_more_than_frames() -> None:
    counter = FrameCounter(1 / 2000, 4, 256)
    sent = 4 * np.array([0, 1, 2, 10, 11])
    received = 1 + sent / 2000
    assert Unwrapping(counter).resolve(received, (sent + 250) % 256, final=True).tolist() == sent.tolist()


def test_without_a_counter_only_silences_reveal_losses() -> None:
    counter = FrameCounter(0.01)
    sent = np.concatenate([np.arange(100), np.arange(150, 250)])
    found = Unwrapping(counter).resolve(3 + sent * 0.01, np.zeros(200, np.int64), final=True)
    assert found.tolist() == sent.tolist()


def test_the_line_under_points_is_the_one_of_linear_programming() -> None:
    linprog = pytest.importorskip("scipy.optimize").linprog
    draw = np.random.default_rng(4)
    for _ in range(20):
        x = np.sort(draw.uniform(0, 600, 80))
        y = 3e-5 * x + 2 + draw.exponential(0.01, 80)
        slope, offset = line_under(np.column_stack([x, y]))
        best = linprog([-x.mean(), -1.0], A_ub=np.column_stack([x, np.ones(80)]), b_ub=y, bounds=[(None, None)] * 2)
        assert np.all(slope * x + offset <= y + 1e-12)
        assert slope * x.mean() + offset == pytest.approx(-best.fun, abs=1e-9)


def test_a_skew_that_is_known_holds_from_the_first_sample() -> None:
    index = np.arange(0, 4000)
    taken = index / RATE * (1 + 1e-4)
    times = HostClock(COUNTER, skew=1e-4).stamp(index, taken + 0.002)
    assert times == pytest.approx(taken + 0.002, abs=1e-9)

"""Measures speed and memory of the virtual IMU at rest, cycling, rocking and on a carrier, and the time in which numpy draws the noise.

Seven channels of noise and counts are computed in blocks, and nothing is written. Only the cycling run lasts the full 72 h (52 million
samples); the others are shorter.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.measuring import counted, peak_memory

CHANNELS, BLOCK, RATE = 7, 100_000, 200.0


@dataclass(frozen=True, slots=True)
class Size:
    """Numbers of samples: of a short run, and of the cycle that lasts for days."""

    piece: int
    long: int


FULL, SMALL = Size(4_000_000, 72 * 3600 * 200), Size(100_000, 200_000)


def stream(motion: Any, samples: int, carried: bool = False) -> float:
    """Returns the time to stream `samples` samples of the bench `virtual_imu`, s."""
    from planrunner.bench.model import read_bench
    from planrunner.bench.opening import open_bench
    from planrunner.instruments.virtual.imu import VirtualImu
    from planrunner.instruments.virtual.imu_keys import VirtualImuParameters
    from planrunner.instruments.virtual.table import VirtualTable
    from planrunner.instruments.virtual.track import Track, TrackProgress
    from planrunner.plan.schedule import Segment

    segment = Segment(0, "long", np.eye(3), "", motion, samples / RATE)
    bench = read_bench("virtual_imu")[0]
    keys = bench.instruments["imu"].parameters
    assert isinstance(keys, VirtualImuParameters)
    imu = replace(bench.instruments["imu"], parameters=replace(keys, reference=False))
    bench = replace(bench, instruments={**bench.instruments, "imu": imu})
    with open_bench(bench) as opened:
        table, sensor = opened.table, opened.sensor
        assert isinstance(table, VirtualTable) and isinstance(sensor, VirtualImu)
        if carried:
            site = opened.site
            sensor.world.track = Track(site.latitude, site.longitude, 0.0, 0.5, TrackProgress(10.0))
        opened.clock.sleep(table.begin_motion(motion, segment.dwell or 0.0))
        began = time.perf_counter()
        count = sum(block.time.size for block in sensor.stream(segment))
        taken = time.perf_counter() - began
    assert count == samples
    return taken


def draw(samples: int) -> float:
    generator = np.random.Generator(np.random.SFC64(1))
    began = time.perf_counter()
    for _ in range(samples // BLOCK * CHANNELS):
        generator.standard_normal(BLOCK)
    return time.perf_counter() - began


def run(size: Size = FULL) -> dict[str, object]:
    from planrunner.plan.schedule import Cycle, Move, Rest, Rock

    quarter = math.pi / 2
    moves = [("A", 2, "C"), ("C", 1, "D"), ("D", -2, "B"), ("B", -1, "A")]
    moves += [("A", -2, "C"), ("C", -1, "B"), ("B", 2, "D"), ("D", 1, "A")]
    positions = {name: k * quarter for k, name in enumerate("ABCD")}
    turns = tuple(Move(start, turns * quarter, end) for start, turns, end in moves)
    cycle = Cycle(positions, turns, math.radians(10), 300.0)
    rock = Rock(math.radians(1), 0.2, (0.0,), math.inf)
    noise = draw(size.piece)

    def cost(seconds: float, samples: int) -> float:
        return seconds / samples / CHANNELS * 1e9

    rows: dict[str, object] = {"drawing the noise with numpy alone [ns/sample/channel]": cost(noise, size.piece)}
    for name, motion, carried in (
        ("standing", Rest(), False),
        ("four-position cycle", cycle, False),
        ("rocking all the time", rock, False),
        ("cycle on a carrier", cycle, True),
    ):
        rows[f"{name} [ns/sample/channel]"] = cost(stream(motion, size.piece, carried), size.piece)
    before = peak_memory()
    seconds = stream(cycle, size.long)
    hours = size.long / RATE / 3600
    rows[f"{hours:.3g} h of the cycle, {counted(size.long)} samples [s]"] = seconds
    rows[f"additional memory for {hours:.3g} h, compared with the short runs [MB]"] = peak_memory() - before
    return rows

"""Measures the memory for recording and statistics of 10⁶ and 10⁸ samples × 3 channels, and how often the samples are read."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.measuring import Figures, counted, figures_of, peak_memory
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Rest, Schedule, Segment

CHANNELS = {"x": "V", "y": "V", "z": "V"}
BLOCK = 100_000
RATE = 1000.0


@dataclass(frozen=True, slots=True)
class Size:
    few: int
    many: int
    separate: bool = True


FULL, SMALL = Size(10**6, 10**8), Size(10**4, 3 * 10**5, separate=False)


def blocks(samples: int) -> Iterator[Block]:
    noise = np.random.default_rng(0)
    for start in range(0, samples, BLOCK):
        count = min(BLOCK, samples - start)
        values = noise.standard_normal((3, count))
        yield Block((start + np.arange(count)) / RATE, dict(zip(CHANNELS, values, strict=True)))


def record(samples: int) -> Figures:
    """Records samples and computes statistics. Returns the times of both [s], the peak memory [MB], and the number of times that
    each file was opened."""
    segment = Segment(0, "long", None, "unknown", Rest(), samples / RATE)
    opened: list[str] = []
    watching = False

    def watch(event: str, details: tuple[object, ...]) -> None:
        if watching and event == "open" and str(details[0]).endswith(".parquet"):
            opened.append(str(details[0]))

    sys.addaudithook(watch)
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        with RunWriter.create(Path(folder), "memory", b"", b"", {}, "flushed") as writer:
            writer.begin(segment, 0.0, CHANNELS)
            for block in blocks(samples):
                writer.append(block, 0.0)
            writer.acknowledge(0.0, {}, {})
            writer.finish()
        recorded = time.perf_counter()
        watching = True
        (long,) = RunReader.open(writer.path).recording(Schedule((segment,), segment.dwell or 0.0))
        read = time.perf_counter()
        watching = False
        stored = len(list((writer.path / "segments").iterdir()))
    assert long.statistics.count == samples
    seconds = {"record": recorded - began, "statistics": read - recorded}
    return {"peak": peak_memory(), **seconds, "times": len(opened) / stored}


def run(size: Size = FULL) -> dict[str, object]:
    short, long = (figures_of(record, samples, separate=size.separate) for samples in (size.few, size.many))
    few, many = counted(size.few), counted(size.many)
    return {
        f"peak memory at {few} samples [MB]": short["peak"],
        f"peak memory at {many} samples [MB]": long["peak"],
        "difference [MB] (target ≤ 50)": long["peak"] - short["peak"],
        f"recording {many} samples [s]": long["record"],
        f"statistics of {many} samples [s]": long["statistics"],
        "number of times that each file was opened for the statistics (target 1)": long["times"],
    }

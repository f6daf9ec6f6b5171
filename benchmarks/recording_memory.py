"""Memory of recording and of statistics at 10⁶ and at 10⁸ samples × 3 channels, and how often the samples are read."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Rest, Schedule, Segment

CHANNELS = {"x": "V", "y": "V", "z": "V"}
BLOCK = 100_000
RATE = 1000.0


def blocks(samples: int) -> Iterator[Block]:
    noise = np.random.default_rng(0)
    for start in range(0, samples, BLOCK):
        count = min(BLOCK, samples - start)
        values = noise.standard_normal((3, count))
        yield Block((start + np.arange(count)) / RATE, dict(zip(CHANNELS, values, strict=True)))


def peak_memory() -> float:
    """Largest resident size of this process, MB. Linux's `ru_maxrss` remembers the parent's size, so `VmHWM` is read there."""
    import resource

    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def record(samples: int) -> None:
    """In a process of its own: record, take statistics, print figures as JSON."""
    segment = Segment(0, "long", None, "unknown", Rest(), samples / RATE)
    taken = 0
    read_bytes = Path.read_bytes

    def counting(path: Path) -> bytes:
        nonlocal taken
        data = read_bytes(path)
        taken += len(data) if path.suffix == ".parquet" else 0
        return data

    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        with RunWriter.create(Path(folder), "memory", b"", b"", {}, "flushed") as writer:
            writer.begin(segment, 0.0, CHANNELS)
            for block in blocks(samples):
                writer.append(block, 0.0)
            writer.acknowledge(0.0, {}, {})
            writer.finish()
        recorded = time.perf_counter()
        Path.read_bytes = counting  # type: ignore[method-assign]
        (long,) = RunReader.open(writer.path).recording(Schedule((segment,), segment.dwell or 0.0))
        read = time.perf_counter()
        stored = sum(path.stat().st_size for path in (writer.path / "segments").iterdir())
    assert long.statistics.count == samples
    seconds = {"record": recorded - began, "statistics": read - recorded}
    print(json.dumps({"peak": peak_memory(), **seconds, "times": taken / stored}))


def run() -> dict[str, object]:
    figures = {}
    for samples in (10**6, 10**8):
        command = [sys.executable, "-m", "benchmarks.recording_memory", str(samples)]
        figures[samples] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    short, long = figures[10**6], figures[10**8]
    return {
        "peak memory at 10⁶ samples [MB]": short["peak"],
        "peak memory at 10⁸ samples [MB]": long["peak"],
        "difference [MB] (target ≤ 50)": long["peak"] - short["peak"],
        "recording 10⁸ samples [s]": long["record"],
        "statistics of 10⁸ samples [s]": long["statistics"],
        "times that the samples were read for them (target 1)": long["times"],
    }


if __name__ == "__main__":
    record(int(sys.argv[1]))

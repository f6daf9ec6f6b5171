"""What simulating costs: a virtual run's samples against numpy drawing the same noise and pyarrow writing the same
bytes.

The simulated gyro streams 10⁷ samples of three channels, and every block is written to Parquet. Beside it, in the
same process and taking turns, numpy draws as many standard normal numbers with the same generator, and pyarrow writes
the blocks that the gyro made. Memory is the growth of the peak from 10⁶ to `LONG` samples that are streamed and
dropped.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from planrunner.bench.model import read_bench
from planrunner.bench.opening import OpenBench, open_bench
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Rest, Segment

SAMPLES = 10_000_000
LONG = 100_000_000
CHANNELS = 3
TURNS = 5


def _segment(samples: int, rate: float = 100.0) -> Segment:
    return Segment(0, "long", np.eye(3), "x east, y north, z up", Rest(), samples / rate)


def _open() -> OpenBench:
    return open_bench(read_bench("virtual")[0], seed=1)


def _write(blocks: Iterable[Block], path: Path) -> int:
    """Blocks to one Parquet file, uncompressed and without dictionaries: the writer's own work is the same for all
    numbers.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    writer = None
    rows = 0
    for block in blocks:
        table = pa.table({"time": block.time, **block.channels})
        if writer is None:
            writer = pq.ParquetWriter(path, table.schema, compression="none", use_dictionary=False)
        writer.write_table(table)
        rows += block.time.size
    assert writer is not None
    writer.close()
    return rows


def _simulate_and_write(samples: int, folder: Path) -> float:
    with _open() as bench:
        begin = time.perf_counter()
        rows = _write(bench.sensor.stream(_segment(samples)), folder / "simulated.parquet")
        taken = time.perf_counter() - begin
    assert rows == samples
    return taken


def _draw(samples: int, block: int) -> float:
    draw = np.random.Generator(np.random.SFC64(1))
    begin = time.perf_counter()
    for _ in range(samples // block):
        for _ in range(CHANNELS):
            draw.standard_normal(block)
    return time.perf_counter() - begin


def _write_the_same(samples: int, folder: Path) -> float:
    """Write as many rows as the run has, of a block that was simulated before the clock starts."""
    with _open() as bench:
        block = next(iter(bench.sensor.stream(_segment(samples))))
    begin = time.perf_counter()
    _write((block for _ in range(samples // block.time.size)), folder / "plain.parquet")
    return time.perf_counter() - begin


def _peak_memory(samples: int) -> float:
    """Peak memory [MB] of a new process that streams `samples` and drops them."""
    code = (
        "import resource, sys; sys.path.insert(0, '.'); from benchmarks.virtual_stream import _open, _segment\n"
        f"with _open() as bench:\n    n = sum(b.time.size for b in bench.sensor.stream(_segment({samples})))\n"
        "print(n, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    root = Path(__file__).resolve().parent.parent
    out = subprocess.run([sys.executable, "-c", code], cwd=root, check=True, capture_output=True, text=True).stdout
    count, peak = map(int, out.split())
    assert count == samples
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def run(samples: int = SAMPLES, long: int = LONG) -> dict[str, float]:
    """Seconds and their ratio (the least of several turns each), and peak memory in MB. The ratio is to be at most
    2.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _simulate_and_write(samples // 100, folder)  # imports and first use
        simulated, drawn, written = [], [], []
        for _ in range(TURNS):
            simulated.append(_simulate_and_write(samples, folder))
            drawn.append(_draw(samples, 100_000))
            written.append(_write_the_same(samples, folder))
    floor = min(drawn) + min(written)
    short = _peak_memory(1_000_000)
    return {
        "samples": samples,
        "simulate_and_write_s": min(simulated),
        "draw_s": min(drawn),
        "write_s": min(written),
        "ratio": min(simulated) / floor,
        "peak_memory_1e6_MB": short,
        "memory_growth_MB": _peak_memory(long) - short,
        "memory_samples": long,
    }


if __name__ == "__main__":
    print(json.dumps(run(), indent=1))

"""Compares a virtual run of one long segment with the time in which numpy draws the same noise and pyarrow writes the same bytes.

The run is complete: simulated gyro, executor, run folder with digests and journal, in flushed mode. In the same process, alternating
with the run, numpy draws as many standard normal numbers with the same generator, and pyarrow writes the columns that the run
recorded, with the same settings. The smallest of several measurements counts.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.measuring import Figures, counted, figures_of, peak_memory

CHANNELS, BLOCK = 3, 100_000


@dataclass(frozen=True, slots=True)
class Size:
    """Number of samples of the timed runs, number of measurements, and the two numbers of samples whose memory is compared."""

    samples: int
    turns: int
    few: int
    many: int
    separate: bool = True


FULL, SMALL = Size(10**7, 5, 10**6, 10**8), Size(10**5, 1, 10**4, 10**5, separate=False)
SETTINGS = {
    "compression": "snappy",
    "use_dictionary": False,
    "write_statistics": False,
}  # as in archive/segment_file.py


def record(samples: int, folder: Path) -> tuple[float, Path]:
    """Executes a run. Returns the time from the first move to the sealed run folder [s], and the folder."""
    from planrunner.archive.run_folder import RunWriter
    from planrunner.bench.model import read_bench
    from planrunner.bench.opening import open_bench
    from planrunner.execution.executor import execute
    from planrunner.execution.stopping import StopRequest
    from planrunner.plan.schedule import Rest, Schedule, Segment

    segment = Segment(0, "long", np.eye(3), "x east, y north, z up", Rest(), samples / 100.0)
    with open_bench(read_bench("virtual")[0], seed=1) as bench:
        began = time.perf_counter()
        with RunWriter.create(folder, "long", b"", b"", {}, "flushed") as writer:
            outcome = execute(Schedule((segment,), segment.dwell or 0.0), bench, writer, stop=StopRequest())
        taken = time.perf_counter() - began
    assert outcome.ok, outcome
    return taken, writer.path


def draw(samples: int) -> float:
    generator = np.random.Generator(np.random.SFC64(1))
    began = time.perf_counter()
    for _ in range(samples // BLOCK * CHANNELS):
        generator.standard_normal(BLOCK)
    return time.perf_counter() - began


def write_again(run: Path, folder: Path) -> float:
    """Returns the time in which pyarrow alone writes the columns of the run from memory, one file for each part, s."""
    import pyarrow.parquet as pq

    taken = 0.0
    for part in sorted((run / "segments").iterdir()):
        table = pq.read_table(part)
        options = pq.ParquetFile(part).metadata
        assert options.row_group(0).column(0).compression == "SNAPPY"
        began = time.perf_counter()
        rows = options.row_group(0).num_rows
        pq.write_table(table, folder / part.name, row_group_size=rows, **SETTINGS)
        taken += time.perf_counter() - began
        (folder / part.name).unlink()
    return taken


def memory(samples: int) -> Figures:
    """Returns the peak memory of a run, MB."""
    with tempfile.TemporaryDirectory() as name:
        record(samples, Path(name))
    return {"peak": peak_memory()}


def run(size: Size = FULL) -> dict[str, object]:
    runs, draws, writes = [], [], []
    for turn in range(size.turns + 1):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            taken, path = record(size.samples if turn else size.samples // 100, folder / "runs")
            if turn:  # the first is for imports
                runs.append(taken)
                draws.append(draw(size.samples))
                writes.append(write_again(path, folder))
    floor = min(draws) + min(writes)
    few, many = (figures_of(memory, samples, separate=size.separate)["peak"] for samples in (size.few, size.many))
    return {
        f"virtual run of {counted(size.samples)} samples × 3 channels [s]": min(runs),
        "drawing the noise with numpy alone [s]": min(draws),
        "writing the bytes with pyarrow alone [s]": min(writes),
        "ratio (target ≤ 2)": min(runs) / floor,
        f"peak memory at {counted(size.few)} samples [MB]": few,
        f"peak memory at {counted(size.many)} samples [MB]": many,
        "difference [MB] (target ≤ 50)": many - few,
    }

"""Measures the index of an archive: building it from more and more run folders, refreshing it, and querying the history of a device.

The run folders are copies of a hundred sealed runs with one analysis of eight coefficients each, made without executing plans. The
histories are queried from an index of 10⁵ runs that is filled without folders: a hundred devices with a thousand runs each.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

from benchmarks.measuring import Figures


@dataclass(frozen=True, slots=True)
class Size:
    """archives: number of run folders of each archive whose index is rebuilt. runs, devices: numbers of runs and devices in the
    index that is queried. turns: number of queries."""

    archives: tuple[int, ...]
    runs: int
    devices: int
    turns: int


FULL = Size((1000, 10_000, 100_000), 100_000, 100, 50)
SMALL = Size((5, 10), 100, 10, 2)


def run(size: Size = FULL) -> Figures:
    figures: Figures = {}
    for number in size.archives:
        figures |= rebuilt(number)
    return figures | asked(size)


def rebuilt(number: int) -> Figures:
    """Rebuilds the index. One process reads the runs."""
    from planrunner.base.workers import ALONE
    from planrunner.night.history.index import Index

    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "runs"
        fill(archive, number)
        with Index.open(archive, str(Path(folder) / "index.sqlite")) as index:
            began, used = time.perf_counter(), time.process_time()
            done = index.refresh(rebuild=True, workers=ALONE)
            took, used = time.perf_counter() - began, time.process_time() - used
            assert done.read == number == index.count() and not done.faults
            began = time.perf_counter()
            index.refresh(workers=ALONE)
            again = time.perf_counter() - began
    return {
        f"rebuilding the index of {number} runs [s]": took,
        f"time per run, {number} runs [ms]": 1000 * took / number,
        f"processor time per run, {number} runs [ms]": 1000 * used / number,
        f"refreshing the unchanged index of {number} runs [s]": again,
    }


def fill(archive: Path, number: int) -> None:
    """Fills the index with archives of 1000 folders each, as one night or month makes them. All folders are older than a day."""
    from tests.night.history.made_runs import MadeRun, make_run

    values = {f"c{k}": (float(k), 0.1) for k in range(8)}
    first = min(100, number)
    for k in range(first):
        make_run(archive / "0", MadeRun(device=f"D{k % 10}", days=k, values=values, limit=(-1, 1)), k)
    for path in sorted(archive.rglob("*"), reverse=True):
        os.utime(path, (path.stat().st_atime - 1e6, path.stat().st_mtime - 1e6))
    originals = sorted((archive / "0").iterdir())
    for k in range(first, number):
        shutil.copytree(originals[k % first], archive / str(k // 1000) / f"{k:06d}")


def asked(size: Size) -> Figures:
    from planrunner.night.history.index import Index
    from planrunner.night.history.reading import read_run
    from planrunner.night.history.rows import RunFilter
    from tests.night.history.made_runs import MadeRun, make_run

    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "runs"
        values = {f"c{k}": (float(k), 0.1) for k in range(8)}
        make_run(archive, MadeRun(values=values, limit=(-1, 1)))
        read = read_run(archive, "0000-calibration")
        assert read.run is not None
        with Index.open(archive, str(Path(folder) / "index.sqlite")) as index:
            batch = []
            for k in range(size.runs):
                day = f"20{k // 12000 % 100:02d}-{1 + k // 1000 % 12:02d}-01T00:00:{k % 60:02d}.000000+00:00"
                row = replace(read.run, folder=str(k), device=f"D{k % size.devices}", created=day)
                batch.append(replace(read, folder=str(k), run=row))
                if len(batch) == 1000 or k == size.runs - 1:
                    index._write(batch)
                    batch = []
            histories, processor, lists = [], [], []
            for turn in range(size.turns):
                began, used = time.perf_counter(), time.process_time()
                points = index.history(f"D{turn % size.devices}", "drift.c3")
                histories.append(time.perf_counter() - began)
                processor.append(time.process_time() - used)
                assert len(points) == size.runs // size.devices
                began = time.perf_counter()
                assert len(index.runs(RunFilter(limit=50))) == 50
                lists.append(time.perf_counter() - began)
    return {
        f"query of a history of {size.runs // size.devices} values in an index of {size.runs} runs (target ≤ 20) [ms]": 1000
        * median(histories),
        "processor time of this query [ms]": 1000 * median(processor),
        "query of the newest 50 runs in this index [ms]": 1000 * median(lists),
    }

"""Measures processor time and memory of commands for archives with more and more runs, and for runs with more and more segments.

docs/scaling.md uses the slopes. Each command runs in a separate process and computes in this process only. Each slope belongs to
the least-squares line over the sizes.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.made_archive import make_archive, plan
from benchmarks.measuring import Figures, figures_of, peak_memory


@dataclass(frozen=True, slots=True)
class Size:
    """Sizes that are measured. runs: numbers of runs in the archives, each with 10 segments. segments: numbers of segments in the
    single runs."""

    runs: tuple[int, ...]
    segments: tuple[int, ...]
    separate: bool = True


FULL = Size((50, 200, 800), (100, 400, 1600))
SMALL = Size((2, 3, 4), (10, 20, 30), separate=False)


def run(size: Size = FULL) -> Figures:
    figures: Figures = {}
    with tempfile.TemporaryDirectory() as folder:
        for number in size.runs:
            make_archive(Path(folder) / str(number), number, dwell="0.2 s", analysed=True)
        for name, function in OF_ARCHIVES.items():
            found = [figures_of(function, str(Path(folder) / str(n)), separate=size.separate) for n in size.runs]
            figures |= slopes(name, "run", size.runs, found)
        for number in size.segments:
            make_archive(Path(folder) / f"s{number}", 1, number, "0.2 s")
        for name, of_run in OF_RUNS.items():
            found = [figures_of(of_run, str(Path(folder) / f"s{n}"), n, separate=size.separate) for n in size.segments]
            figures |= slopes(name, "segment", size.segments, found)
    return figures


def slopes(name: str, one: str, sizes: tuple[int, ...], found: list[Figures]) -> Figures:
    """Returns the figures at each size, and the cost of one more run or segment."""
    rows: Figures = {}
    for number, figures in zip(sizes, found, strict=True):
        rows[f"{name}, {number} {one}s [s]"] = figures["seconds"]
        rows[f"{name}, {number} {one}s, peak memory [MB]"] = figures["memory"]
    rows[f"{name}: time per additional {one} [ms]"] = 1e3 * float(
        np.polyfit(sizes, [one["seconds"] for one in found], 1)[0]
    )
    rows[f"{name}: memory per additional {one} [kB]"] = 1e3 * float(
        np.polyfit(sizes, [one["memory"] for one in found], 1)[0]
    )
    return rows


def _timed(work: Callable[[], object]) -> Figures:
    began = time.process_time()
    work()
    return {"seconds": time.process_time() - began, "memory": peak_memory()}


def _command(*words: str) -> Figures:
    """Executes a command as a user calls it, but without its output."""
    import contextlib
    import io

    from planrunner.cli import main

    def work() -> None:
        with contextlib.redirect_stdout(io.TextIOWrapper(io.BytesIO(), encoding="utf-8")):
            assert main([*words]) == 0

    return _timed(work)


def verify(archive: str) -> Figures:
    return _command("verify", "--all", archive)


def estimate(archive: str) -> Figures:
    return _command("estimate", "--all", archive)


def index(archive: str) -> Figures:
    return _command("runs", archive, "--rebuild", "--quiet", "--index", f"{archive}.sqlite")


def site(archive: str) -> Figures:
    return _command("site", archive, f"{archive}-site", "--quiet", "--index", f"{archive}.sqlite")


def check(archive: str, segments: int) -> Figures:
    from planrunner.tasks.check import check_plan

    return _timed(lambda: check_plan(plan(segments, "0.2 s")).sound())


def verify_run(archive: str, _: int) -> Figures:
    return verify(archive)


def estimate_run(archive: str, _: int) -> Figures:
    return estimate(archive)


OF_ARCHIVES = {"verify": verify, "estimate": estimate, "rebuild the index": index, "site": site}
OF_RUNS = {"check": check, "verify": verify_run, "estimate": estimate_run}

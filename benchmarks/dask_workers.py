"""Estimates of all runs of an archive on two Dask workers against one, each a process of its own on this machine."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.made_archive import make_archive
from benchmarks.measuring import Figures, peak_memory
from planrunner.base.workers import ALONE, Workers, results_in_order, results_of
from planrunner.tasks.run import evaluate_run
from tests.dask_cluster import Cluster, dask_cluster


@dataclass(frozen=True, slots=True)
class Size:
    """turns: of which the fastest counts. dwell: of each of the ten segments of a run."""

    runs: int
    turns: int
    dwell: str


FULL, SMALL = Size(40, 2, "2 min"), Size(4, 1, "1 s")


def run(size: Size = FULL) -> Figures:
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "runs"
        make_archive(archive, size.runs)
        runs = sorted(archive.iterdir())
        alone, _ = estimated(runs, ALONE)
        with dask_cluster(Path(folder), 1) as cluster:
            first = fastest(runs, cluster, size)
            cluster.add_worker()
            second = fastest(runs, cluster, size)
            memory = max(peak_of(worker.pid) for worker in cluster.workers)
    return {
        f"{size.runs} runs in this process [runs/s]": size.runs / alone,
        "on one worker [runs/s]": size.runs / first,
        "on two workers [runs/s]": size.runs / second,
        "two workers / one (target ≥ 1.8)": first / second,
        "one worker / this process": alone / first,
        "peak memory of a worker [MB]": memory,
        "peak memory of the command [MB]": peak_memory(),
    }


def estimated(runs: list[Path], workers: Workers) -> tuple[float, int]:
    """Seconds, and the number of results. They are not stored: storing is work of the command alone."""
    began = time.perf_counter()
    count = sum(1 for _ in results_in_order(evaluate_run, runs, workers))
    return time.perf_counter() - began, count


def fastest(runs: list[Path], cluster: Cluster, size: Size) -> float:
    """Seconds of the fastest turn. Before it, every worker computes something: its imports and compiled kernels are then there."""
    workers = Workers(1, cluster.address)
    while len(set(results_of(process, range(4 * len(cluster.workers)), workers))) < len(cluster.workers):
        time.sleep(0.1)
    estimated([*runs] * (4 * len(cluster.workers) // len(runs) + 1), workers)
    return min(estimated(runs, workers)[0] for _ in range(size.turns))


def process(_: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def peak_of(pid: int) -> float:
    """Largest resident size of another process [MB]; 0 where the system does not tell."""
    status = Path(f"/proc/{pid}/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((int(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM")), 0.0)

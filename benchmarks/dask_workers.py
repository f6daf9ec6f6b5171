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


FULL, SMALL = Size(200, 3, "2 min"), Size(4, 1, "1 s")


def run(size: Size = FULL) -> Figures:
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "runs"
        make_archive(archive, size.runs)
        runs = sorted(archive.iterdir())
        estimated(runs[:1], ALONE)
        alone = estimated(runs, ALONE)
        with dask_cluster(Path(folder), 1) as cluster:
            one = fastest(runs, cluster, size)
            cluster.add_worker()
            two = fastest(runs, cluster, size)
            memory = max(peak_of(worker.pid) for worker in cluster.workers)
    return {
        f"{size.runs} runs in this process [runs/s]": size.runs / alone,
        "on one worker [runs/s]": size.runs / one.seconds,
        "on two workers [runs/s]": size.runs / two.seconds,
        "two workers / one (target ≥ 1.8)": one.seconds / two.seconds,
        "processor time of the one worker / of the busier of two": one.busiest / two.busiest if two.busiest else 0.0,
        "peak memory of a worker [MB]": memory,
        "peak memory of the command [MB]": peak_memory(),
    }


@dataclass(frozen=True, slots=True)
class Turn:
    """seconds: of the turn. busiest: processor time of the worker that used most [s]; unlike the first, it hardly depends on what else the
    machine does."""

    seconds: float
    busiest: float


def estimated(runs: list[Path], workers: Workers) -> float:
    """Seconds. The results are not stored: storing is work of the command alone."""
    began = time.perf_counter()
    for _ in results_in_order(evaluate_run, runs, workers):
        pass
    return time.perf_counter() - began


def fastest(runs: list[Path], cluster: Cluster, size: Size) -> Turn:
    """Of the turns. Before them, every worker computes something: its imports and compiled kernels are then there."""
    workers = Workers(1, cluster.address)
    while len(set(results_of(process, range(4 * len(cluster.workers)), workers))) < len(cluster.workers):
        time.sleep(0.1)
    estimated([*runs] * (4 * len(cluster.workers) // len(runs) + 1), workers)
    turns = []
    for _ in range(size.turns):
        before = [processor_time(worker.pid) for worker in cluster.workers]
        seconds = estimated(runs, workers)
        used = [processor_time(one.pid) - then for one, then in zip(cluster.workers, before, strict=True)]
        turns.append(Turn(seconds, max(used)))
    return Turn(min(turn.seconds for turn in turns), min(turn.busiest for turn in turns))


def process(_: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def processor_time(pid: int) -> float:
    """Of another process so far [s]; 0 where the system does not tell."""
    status = Path(f"/proc/{pid}/stat")
    if not status.exists():
        return 0.0
    fields = status.read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def peak_of(pid: int) -> float:
    """Largest resident size of another process [MB]; 0 where the system does not tell."""
    status = Path(f"/proc/{pid}/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((int(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM")), 0.0)

"""Estimates all runs of an archive on one and on two Dask workers. Each worker is a process on this machine.

Clusters with one and with two workers are measured alternately. The speed of a machine may change from minute to minute; alternate
measurements are affected equally.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.made_archive import make_archive
from benchmarks.measuring import Figures, peak_memory
from planrunner.base.workers import ALONE, Workers, results_in_order, results_of
from planrunner.tasks.estimate import evaluate_run
from tests.dask_cluster import Cluster, dask_cluster


@dataclass(frozen=True, slots=True)
class Size:
    """turns: number of measurements of each cluster. dwell: duration of each of the ten segments of a run."""

    runs: int
    turns: int
    dwell: str


FULL, SMALL = Size(200, 5, "2 min"), Size(4, 1, "1 s")
_IDLE = 5.0
"""Time for which the processes of a cluster without work are observed, s."""


def run(size: Size = FULL) -> Figures:
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "runs"
        make_archive(archive, size.runs)
        runs = sorted(archive.iterdir())
        estimated(runs[:1], ALONE)
        alone = estimated(runs, ALONE)
        with (
            dask_cluster(_folder(folder, "one"), 1) as single,
            dask_cluster(_folder(folder, "two"), 2) as double,
        ):
            for cluster in (single, double):
                warm_up(runs, cluster)
            idle = idle_time(double)
            pairs = [(turn(runs, single), turn(runs, double)) for _ in range(size.turns)]
            memory = max(peak_of(worker.pid) for worker in double.workers)
    ratios = sorted(one.seconds / two.seconds for one, two in pairs)
    return {
        f"{size.runs} runs in this process [runs/s]": size.runs / alone,
        "on one worker [runs/s]": size.runs / statistics.median(one.seconds for one, _ in pairs),
        "on two workers [runs/s]": size.runs / statistics.median(two.seconds for _, two in pairs),
        f"two workers / one, median of {size.turns} turns (target ≥ 1.8)": statistics.median(ratios),
        "lowest ratio in a turn": ratios[0],
        "highest ratio in a turn": ratios[-1],
        "processor time of scheduler and command / processor time of two workers": statistics.median(
            two.handing_over for _, two in pairs
        ),
        "processor time of a scheduler and two idle workers / elapsed time": idle,
        "peak memory of a worker [MB]": memory,
        "peak memory of the command [MB]": peak_memory(),
    }


@dataclass(frozen=True, slots=True)
class Turn:
    """One measurement. seconds: its duration. handing_over: processor time of the scheduler and of this process, divided by the
    processor time of the workers."""

    seconds: float
    handing_over: float


def _folder(parent: str, name: str) -> Path:
    """Makes a new folder."""
    folder = Path(parent) / name
    folder.mkdir()
    return folder


def estimated(runs: list[Path], workers: Workers) -> float:
    """Returns the duration of the estimates, s. The results are not stored, because only the command itself stores results."""
    began = time.perf_counter()
    for _ in results_in_order(evaluate_run, runs, workers):
        pass
    return time.perf_counter() - began


def warm_up(runs: list[Path], cluster: Cluster) -> None:
    """Lets every worker compute something, so that its modules are imported and its kernels compiled."""
    workers = Workers(1, cluster.address)
    while len(set(results_of(process, range(4 * len(cluster.workers)), workers))) < len(cluster.workers):
        time.sleep(0.1)
    estimated([*runs] * (4 * len(cluster.workers) // len(runs) + 1), workers)


def turn(runs: list[Path], cluster: Cluster) -> Turn:
    def used() -> tuple[float, float]:
        computing = sum(processor_time(worker.pid) for worker in cluster.workers)
        return time.process_time() + processor_time(cluster.scheduler.pid), computing

    before = used()
    seconds = estimated(runs, Workers(1, cluster.address))
    handing, computing = (now - then for now, then in zip(used(), before, strict=True))
    return Turn(seconds, handing / computing if computing else 0.0)


def idle_time(cluster: Cluster) -> float:
    """Returns the processor time that a cluster without work uses, divided by the elapsed time."""
    processes = [cluster.scheduler, *cluster.workers]
    before = sum(processor_time(one.pid) for one in processes)
    time.sleep(_IDLE)
    return (sum(processor_time(one.pid) for one in processes) - before) / _IDLE


def process(_: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def processor_time(pid: int) -> float:
    """Returns the processor time that another process has used so far, s; 0 if the system does not report it."""
    status = Path(f"/proc/{pid}/stat")
    if not status.exists():
        return 0.0
    fields = status.read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def peak_of(pid: int) -> float:
    """Returns the largest resident size of another process, MB; 0 if the system does not report it."""
    status = Path(f"/proc/{pid}/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((int(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM")), 0.0)

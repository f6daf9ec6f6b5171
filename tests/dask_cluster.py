"""A Dask cluster for tests: a scheduler and workers, each a process of its own on the loopback interface."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.conftest import ROOT

_LONG = 300.0  # s


@dataclass
class Cluster:
    """address: of the scheduler; workers: the processes that compute."""

    address: str
    folder: Path
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def add_worker(self, environment: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1", "--death-timeout", "60")
        command = [sys.executable, "-m", "distributed.cli.dask_worker", self.address, *options]
        environment = {**_environment(), **(environment or {})}
        worker = subprocess.Popen(command, stderr=subprocess.DEVNULL, cwd=self.folder, env=environment)
        self.workers.append(worker)
        return worker


@contextmanager
def dask_cluster(folder: Path, workers: int = 2, allowed_failures: int = 3) -> Iterator[Cluster]:
    """A scheduler and so many workers; ended with the context. folder: for the address of the scheduler, and to run in. allowed_failures:
    lost workers after which an item is not tried again."""
    file = folder / "scheduler.json"
    options = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", *options]
    environment = {**_environment(), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(allowed_failures)}
    scheduler = subprocess.Popen(command, stderr=subprocess.DEVNULL, cwd=folder, env=environment)
    cluster = Cluster("", folder, scheduler)
    try:
        cluster.address = _address(file, scheduler)
        for _ in range(workers):
            cluster.add_worker()
        yield cluster
    finally:
        for process in (*cluster.workers, scheduler):
            process.kill()
            process.wait()


QUIET = {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False", "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s"}
"""Settings that `docs/scaling.md` recommends. Without them, a process of Dask that has nothing to do uses 2 to 4 % of a processor."""


def _environment() -> dict[str, str]:
    """With the modules of the tests."""
    return {**os.environ, **QUIET, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "OPENBLAS_NUM_THREADS": "1"}


def _address(file: Path, scheduler: subprocess.Popen[bytes]) -> str:
    end = time.monotonic() + _LONG
    while time.monotonic() < end:
        assert scheduler.poll() is None, "the scheduler ended"
        try:
            return str(json.loads(file.read_text())["address"])
        except (OSError, ValueError):  # not there, or not complete
            time.sleep(0.05)
    raise TimeoutError("the scheduler did not start")

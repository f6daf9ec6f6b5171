"""A process that makes, verifies and reads run after run holds no more descriptors than after the first."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

from planrunner.archive.run_reader import RunReader
from planrunner.execution.stopping import StopRequest
from planrunner.tasks import run as running
from planrunner.tasks.check import check_plan
from planrunner.tasks.estimate import analyse_run

PLAN = Path(__file__).parent / "agreement" / "corpus" / "counts_that_alternate.yaml"
OPEN = Path("/proc/self/fd")


@pytest.mark.skipif(not OPEN.is_dir(), reason="this system does not list a process's descriptors")
def test_runs_give_back_what_they_open(tmp_path: Path) -> None:
    sound = check_plan(PLAN).sound()
    held = []
    for _ in range(4):
        folder, outcome = running.start(sound, info={}, runs=tmp_path, stop=StopRequest(), durability="flushed")
        assert outcome.ok
        analyse_run(folder)
        for _ in range(5):
            reader = RunReader.open(folder)
            reader.check_digests()
            assert reader.sealed
        del reader
        gc.collect()
        held.append(len(os.listdir(OPEN)))
    assert held[1:] == held[:1] * 3

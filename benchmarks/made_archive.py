"""Makes an archive for benchmarks. Some runs execute one plan on a simulated gyro with different random numbers; the other runs are
copies of these."""

from __future__ import annotations

import shutil
from pathlib import Path

from planrunner.execution.stopping import StopRequest
from planrunner.tasks import run as running
from planrunner.tasks.check import Document, check_plan
from planrunner.tasks.estimate import analyse_run

ORIGINALS = 4
_PLAN = """\
planrunner: 1
title: scale factor
bench: virtual_mems
sensor: {{kind: imu, outputs: [gyro_z]}}
defaults: {{orientation: {{x: east, y: north, z: up}}, dwell: {dwell}, settle: 0 s, sample_rate: 100 Hz}}
segments:
  - for_each: {{rate: "±10, ±50, ±100, ±200, ±240 deg/s"}}
    repeat: {repeat}
estimates:
  sf: {{estimator: scale_factor, segments: "*", outputs: gyro_z}}
report: [summary.md]
"""


def plan(segments: int, dwell: str) -> Document:
    """Returns a plan with this number of segments, a multiple of ten."""
    return Document(_PLAN.format(dwell=dwell, repeat=segments // 10).encode(), "scale_factor.yaml")


def make_archive(archive: Path, runs: int, segments: int = 10, dwell: str = "30 s", analysed: bool = False) -> None:
    """Makes the archive. analysed: True if each run has an analysis, as in an archive with an index."""
    sound = check_plan(plan(segments, dwell)).sound()
    originals = []
    for seed in range(min(ORIGINALS, runs)):
        folder, outcome = running.start(
            sound, info={}, runs=archive, stop=StopRequest(), durability="flushed", seed=seed
        )
        assert outcome.ok
        if analysed:
            analyse_run(folder)
        originals.append(folder)
    for number in range(len(originals), runs):
        original = originals[number % len(originals)]
        shutil.copytree(original, archive / f"{original.name}-{number}")

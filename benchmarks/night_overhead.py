"""Compares a night of equal tests on one simulated bench with the same processes started one after the other.

Both run the same plan in processes of `planrunner run` with the same arguments, alternately. The overhead of a plan (timetable,
journal with fsync, record, reports) is the difference of the two times, without the start and check of the suite (once per night),
divided by the number of tests. The smallest of several measurements counts.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measuring import Figures

PLAN = """\
planrunner: 1
title: Two positions
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
record: {device_serial: required}
defaults: {temperature: 25 degC, dwell: 1 min}
segments:
  - {label: A, orientation: {x: up, y: north}}
  - {label: B, orientation: {x: down, y: north}}
"""


@dataclass(frozen=True, slots=True)
class Size:
    """Number of tests in a night, and number of measurements."""

    tests: int
    turns: int


FULL, SMALL = Size(10, 3), Size(2, 1)


def one_by_one(folder: Path, tests: int) -> float:
    """Returns the time of the plans in processes that are started one after the other, s."""
    began = time.perf_counter()
    for number in range(tests):
        _planrunner(folder, "run", "p.yaml", "--set", f"device_serial={number}", "--unattended", "--json")
    return time.perf_counter() - began


def as_a_night(folder: Path, tests: int) -> float:
    """Returns the time of the same plans as a night, s. The time includes the start of the night's process and the check of the
    suite."""
    values = ", ".join(f'"{number}"' for number in range(tests))
    suite = "planrunner_suite: 1\ntitle: n\nbenches: {a: {bench: virtual}}\n"
    (folder / "night.yaml").write_text(
        f"{suite}plans: {{x: {{plan: p.yaml, matrix: {{device_serial: [{values}]}}}}}}\n", encoding="utf-8"
    )
    began = time.perf_counter()
    _planrunner(folder, "night", "night.yaml", "--new")
    return time.perf_counter() - began


def _planrunner(folder: Path, *words: str) -> None:
    command = [sys.executable, "-m", "planrunner", *words, "--quiet", "--runs", "runs"]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)


def run(size: Size = FULL) -> Figures:
    alone, nights, starts = [], [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "p.yaml").write_text(PLAN, encoding="utf-8")
        one_by_one(folder, 1)  # the first compiles the modules
        for _ in range(size.turns):
            nights.append(as_a_night(folder, size.tests))
            alone.append(one_by_one(folder, size.tests))
            began = time.perf_counter()
            subprocess.run(
                [sys.executable, "-m", "planrunner", "check", "night.yaml"],
                cwd=folder,
                check=True,
                stdout=subprocess.DEVNULL,
            )
            starts.append(time.perf_counter() - began)
    return {
        f"{size.tests} plans as a night, including start and check [s]": min(nights),
        f"{size.tests} plans in separate processes, one after the other [s]": min(alone),
        "start and check of the suite, once per night [s]": min(starts),
        "overhead of the night per plan [s] (target ≤ 0.2)": (min(nights) - min(alone) - min(starts)) / size.tests,
        "overhead per plan, including its share of the start and check [s]": (min(nights) - min(alone)) / size.tests,
    }

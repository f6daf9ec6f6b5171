"""Measures `check`: 100 distinct plans in one process, the same plans with one command, and one plan in its own process."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measuring import ROOT, Figures, figures_of
from planrunner.base.processes import processors

COMPILED = {"PYTHONDONTWRITEBYTECODE": ""}
"""Environment in which modules are compiled once, as in an installation, even if the present environment does not store compiled
modules."""
PLAN = ROOT / "plans" / "flexure_gyro_eight_position.yaml"


@dataclass(frozen=True, slots=True)
class Size:
    """turns: number of processes of each kind. The fastest one counts."""

    plans: int
    turns: int
    separate: bool = True


FULL, SMALL = Size(100, 7), Size(3, 1, separate=False)


def distinct(count: int, folder: Path) -> list[Path]:
    """Writes copies of the flagship plan that differ in title, dwell and temperature."""
    text = PLAN.read_text(encoding="utf-8")
    paths = []
    for number in range(count):
        own = text.replace("title: ", f"title: {number} ").replace("dwell: 2 min", f"dwell: {100 + number} s")
        own = re.sub(r"temperature: 25 degC", f"temperature: {20 + number / 10} degC", own)
        paths.append(folder / f"plan{number:03d}.yaml")
        paths[-1].write_text(own, encoding="utf-8")
    return paths


OPTIONAL = [
    "fqdn",
    "idna",
    "isoduration",
    "jsonpointer",
    "rfc3339_validator",
    "rfc3986_validator",
    "rfc3987",
    "rfc3987_syntax",
    "uri_template",
    "webcolors",
]
BARE = f"import sys; sys.modules.update(dict.fromkeys({OPTIONAL!r})); import yaml, jsonschema"
"""Program that imports yaml and jsonschema without the optional modules. jsonschema imports these modules if other programs have
installed them. planrunner does not need them, and the import of one of them takes seconds."""


def process(turns: int, *command: str) -> float:
    """Returns the shortest duration of several runs of a process, s."""
    times = []
    for _ in range(turns):
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, env=os.environ | COMPILED)
        times.append(time.perf_counter() - began)
    return min(times)


def together(count: int) -> Figures:
    """Checks distinct plans in this process, before it has checked any other plan: first with the predictions for the limits, then
    again with all predictions."""
    from planrunner.tasks.check import check_plan

    with tempfile.TemporaryDirectory() as folder:
        paths = distinct(count, Path(folder))
        began = time.perf_counter()
        sound = sum(check_plan(path).ok for path in paths)
        limits = time.perf_counter() - began
        began = time.perf_counter()
        predicted = sum(all(design.known for design in check_plan(path).designs.values()) for path in paths)
        shown = time.perf_counter() - began
    assert sound == predicted == count
    return {"limits": limits, "shown": shown}


def run(size: Size = FULL) -> Figures:
    inside = [figures_of(together, size.plans, separate=size.separate, environment=COMPILED) for _ in range(size.turns)]
    limits, shown = (min(one[name] for one in inside) for name in ("limits", "shown"))
    with tempfile.TemporaryDirectory() as folder:
        paths = distinct(size.plans, Path(folder))
        command = [sys.executable, "-m", "planrunner", "check", *map(str, paths), "--jobs"]
        by_one, by_all = (process(size.turns, *command, jobs) for jobs in ("1", str(processors())))
    whole = process(size.turns, sys.executable, "-m", "planrunner", "check", str(PLAN))
    imports = process(size.turns, sys.executable, "-c", BARE)
    return {
        f"{size.plans} distinct plans in one process [s] (target ≤ 0.5)": limits,
        "the same plans, with all predictions [s]": shown,
        f"`planrunner check` of {size.plans} plans, whole command with imports and output, --jobs 1 [s]": by_one,
        f"the same, --jobs {processors()} (all processors) [s]": by_all,
        "`planrunner check` of one plan, whole process [s]": whole,
        '`python -c "import yaml, jsonschema"` [s]': imports,
        "ratio (target ≤ 2.5)": whole / imports,
    }

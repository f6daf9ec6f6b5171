"""Reading plans stays cheap: nothing heavy is imported for it, and a hundred plans cost no more than a hundred times one."""

from __future__ import annotations

import subprocess
import sys

from planrunner.plan.expand import expand
from planrunner.plan.meaning import check_meaning
from planrunner.plan.model import parse_plan
from tests.counted_calls import calls

from .mutation import SHIPPED_PLANS

HEAVY = ("pint", "jsonschema", "scipy", "rich", "pyarrow", "matplotlib", "jinja2")
PROGRAM = """
import sys
from pathlib import Path
from planrunner.plan.expand import expand
from planrunner.plan.meaning import check_meaning
from planrunner.plan.model import parse_plan
heavy, paths = sys.argv[1].split(","), sys.argv[2:]
for path in paths:
    plan, log = parse_plan(Path(path).read_text(encoding="utf-8"), path)
    assert plan is not None, list(map(str, log))
    check_meaning(plan, expand(plan, log), ["report.html", "summary.md"], log)
    print(Path(path).stem, *(name for name in heavy if name in sys.modules))
"""


def test_reading_the_shipped_plans_imports_nothing_heavy() -> None:
    """All in one process: the first plan after whose reading something is named is the one that imports it."""
    command = [sys.executable, "-c", PROGRAM, ",".join(HEAVY), *map(str, SHIPPED_PLANS)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines() == [path.stem for path in SHIPPED_PLANS]


def test_a_hundred_distinct_plans_cost_a_hundred_times_one() -> None:
    """And one takes no more than 50 ms, at ten million calls a second. Seconds are for the benchmark `check_speed`."""
    text = next(path for path in SHIPPED_PLANS if path.stem == "flexure_gyro_eight_position").read_text(
        encoding="utf-8"
    )

    def read(number: int) -> None:
        distinct = text.replace("settle: 30 s", f"settle: {130 + number} s").replace("title: ", f"title: {number} ")
        plan, log = parse_plan(distinct, f"{number}.yaml")
        assert plan is not None
        segments = expand(plan, log)
        check_meaning(plan, segments, ["report.html", "summary.md"], log)
        assert len(segments) == 19

    read(100)  # what is looked up once
    first = calls(lambda: read(101))
    assert first < 500_000
    for number in range(102, 200):
        read(number)
    assert calls(lambda: read(200)) < 1.05 * first, "what was read before makes it slower"

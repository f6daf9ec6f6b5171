"""Reading plans stays cheap: nothing heavy is imported for it, and a hundred plans take well below a second."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

from planrunner.plan.expand import expand
from planrunner.plan.meaning import check_meaning
from planrunner.plan.reader import parse_plan

from .mutation import SHIPPED_PLANS

HEAVY = ("pint", "jsonschema", "scipy", "rich", "pyarrow", "matplotlib", "jinja2")
PROGRAM = """
import sys
from pathlib import Path
from planrunner.plan.expand import expand
from planrunner.plan.meaning import check_meaning
from planrunner.plan.reader import load_plan
plan, log = load_plan(Path(sys.argv[1]))
assert plan is not None, list(map(str, log))
check_meaning(plan, expand(plan, log), ["report.html", "summary.md"], log)
print(*(name for name in sys.argv[2:] if name in sys.modules))
"""


@pytest.mark.parametrize("path", SHIPPED_PLANS, ids=lambda path: path.stem)
def test_reading_a_shipped_plan_imports_nothing_heavy(path: object) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(path), *HEAVY], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.split() == []


def test_a_hundred_distinct_plans() -> None:
    text = next(path for path in SHIPPED_PLANS if path.stem == "flexure_gyro_eight_position").read_text(
        encoding="utf-8"
    )
    parse_plan(text, "warm-up")
    texts = [text.replace("settle: 30 s", f"settle: {30 + n} s").replace("title: ", f"title: {n} ") for n in range(100)]
    start = time.process_time()
    for number, plan_text in enumerate(texts):
        plan, log = parse_plan(plan_text, f"{number}.yaml")
        assert plan is not None
        segments = expand(plan, log)
        check_meaning(plan, segments, ["report.html", "summary.md"], log)
        assert len(segments) == 19
    assert time.process_time() - start < 5.0

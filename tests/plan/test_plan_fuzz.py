"""No file, however mangled, may end in anything but findings, or take long, or much memory."""

from __future__ import annotations

import os
import random
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planrunner.tasks.check import check_plan

from .mutation import SHIPPED_PLANS, as_yaml, examples, mutate, mutate_bytes

resource = pytest.importorskip("resource")  # POSIX only

PLANS = SHIPPED_PLANS
SHIPPED = 10.0  # times the slowest shipped plan, checked in the same process: seconds mean little on a busy machine
MEGABYTES = 200
FUZZ = int(os.environ.get("PLANRUNNER_FUZZ", "3000"))


def check(path: Path) -> None:
    """What is under test. Findings are its only way to say no."""
    checked = check_plan(path)
    for finding in checked.findings:
        assert finding.message
        assert finding.mark.line >= 1
        assert finding.mark.column >= 1
        assert "Traceback" not in finding.message


def peak() -> float:
    """Largest resident memory of this process so far, MB."""
    usage: float = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return usage


def seconds(path: Path) -> float:
    """Processor time of one check, s."""
    start = time.process_time()
    check(path)
    return time.process_time() - start


def case(path: Path, draw: random.Random, donors: Any, sources: list[bytes], most: float) -> None:
    """One mangled plan: its structure or its bytes changed at a few places. most: s that its check may take."""
    if draw.random() < 0.5:
        text = as_yaml(mutate(draw.choice(donors), draw, donors, draw.choice((1, 1, 2, 4)))).encode()
    else:
        text = mutate_bytes(draw.choice(sources), draw, draw.choice((1, 1, 2, 8)))
    path.write_bytes(text)
    assert seconds(path) < most


def campaign(path: Path, cases: int) -> None:
    """Hypothesis draws the changes, and finds the least that fails should one fail."""
    donors = examples()
    sources = [plan.read_bytes() for plan in PLANS]
    for plan in PLANS:
        check(plan)  # what is imported on first use is no matter of the file
    most = SHIPPED * max(map(seconds, PLANS))
    before = peak()

    @settings(
        max_examples=cases, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(st.randoms(use_true_random=True))
    def mangle(draw: random.Random) -> None:
        case(path, draw, donors, sources, most)

    mangle()
    assert peak() - before < MEGABYTES


def test_mangled_plans_give_findings_and_nothing_else(tmp_path: Path) -> None:
    campaign(tmp_path / "plan.yaml", 50)


@pytest.mark.slow
def test_mangled_plans_at_length(tmp_path: Path) -> None:
    """`make fuzz` mangles ten times as many."""
    campaign(tmp_path / "plan.yaml", FUZZ)

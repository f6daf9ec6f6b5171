"""Whatever `check` passes runs to its end, and whatever `run` refuses `check` has said.

Hypothesis writes the plans. A few run in the fast suite; `PLANRUNNER_AGREEMENT` and the slow suite draw thousands. Plans that once
disagreed stay in `corpus/`.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, seed, settings

from .carried_out import carried_out, written
from .written_plans import VIRTUAL, Plan, left_to_the_data, plans

CORPUS = sorted((Path(__file__).parent / "corpus").glob("*.yaml"))
CAMPAIGN = int(os.environ.get("PLANRUNNER_AGREEMENT", "5000"))
BATCH = 500  # a batch has a seed of its own, so that one that fails can be drawn again alone


def hold(folder: Path, examples: int, drawn: int) -> Counter[str]:
    """Draws plans and asserts that `check` and `run` agree on each; how many passed and were refused, in all and by bench."""
    counted: Counter[str] = Counter()
    path = folder / "plan.yaml"

    @seed(drawn)
    @settings(max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(plans())
    def agree(plan: Plan) -> None:
        path.write_text(written(plan), encoding="utf-8")
        ended = carried_out(path, folder / "runs")
        counted["passed" if ended.passed else "refused"] += 1
        counted[plan["bench"]] += ended.passed
        told = f"check passed it, and it ended with {ended.code}: {ended.told}\n{written(plan)}"
        assert ended.agrees, told
        counted["unfit"] += ended.unfit
        foreseen = left_to_the_data(plan) or "physics-resolution" in ended.warnings
        assert not ended.unfit or foreseen, told

    agree()
    return counted


def test_a_few_plans(tmp_path: Path) -> None:
    counted = hold(tmp_path, 30, drawn=7)
    assert counted["passed"] >= 5  # else nothing is shown


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.stem)
def test_plans_that_once_disagreed(path: Path, tmp_path: Path) -> None:
    ended = carried_out(path, tmp_path / "runs")
    assert ended.agrees, ended.told


@pytest.mark.slow
@pytest.mark.parametrize("batch", range(max(1, CAMPAIGN // BATCH)))
def test_thousands_of_plans(batch: int, tmp_path: Path) -> None:
    counted = hold(tmp_path, BATCH, drawn=1000 + batch)
    assert counted["passed"] >= BATCH // 5
    assert counted["refused"] >= BATCH // 20
    assert sum(counted[bench] > 0 for bench in VIRTUAL) > len(VIRTUAL) // 2

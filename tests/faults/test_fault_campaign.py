"""Faults by script on a simulated bench, in processes: each ends as its row of the table says, and the resumed run is whole."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator

import pytest
from fault_mixture import trial
from fault_table import FAST, ROWS, SAMPLE, Row
from fault_trial import scripted
from small_bench import SmallBench

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals and fork are POSIX")
ALL = os.environ.get("PLANRUNNER_FAULTS") == "all"
RANDOM = range(int(os.environ.get("PLANRUNNER_RANDOM_FAULTS", "200" if ALL else "6")))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SmallBench]:
    made = SmallBench.start(tmp_path_factory.mktemp("faults"))
    yield made
    made.stop()


def test_the_table_has_a_row_for_each_fault() -> None:
    names = [row.name for row in ROWS]
    assert len(names) == len(set(names)) >= 30
    assert {*FAST, *SAMPLE} <= set(names)


def rows(names: tuple[str, ...]) -> list[Row]:
    return [row for row in ROWS if row.name in names or (ALL and names is SAMPLE)]


@pytest.mark.parametrize("row", rows(FAST), ids=lambda row: row.name)
def test_faults_that_every_change_meets(bench: SmallBench, row: Row) -> None:
    scripted(bench, row)


@pytest.mark.slow
@pytest.mark.parametrize("row", rows(SAMPLE), ids=lambda row: row.name)
def test_faults_by_script(bench: SmallBench, row: Row) -> None:
    scripted(bench, row)


@pytest.mark.slow
@pytest.mark.parametrize("seed", RANDOM)
def test_random_faults(bench: SmallBench, seed: int) -> None:
    """A random moment, instrument, fault and length; what is promised whatever goes wrong is asserted."""
    trial(bench, seed)

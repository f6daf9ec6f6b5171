"""Faults by script on a simulated bench, in processes: each ends as its row of the table says, and the resumed run is whole."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fault_mixture import ROLES, drawn, trial
from fault_table import OF_EVERY_SENSOR, OF_SENSORS, ROWS, SAMPLE, Row
from fault_trial import scripted
from small_bench import SmallBench
from small_sensors import SENSORS

from planrunner.simulators.faults import read_fault

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
    assert set(SAMPLE) <= set(names)


def test_random_faults_are_faults_and_the_same_each_time() -> None:
    kinds = set()
    for seed in range(200):
        assert drawn(seed) == drawn(seed)
        for _, fault in drawn(seed):
            kinds.add(read_fault(fault, ROLES).fault if fault.startswith("{") else fault)
    assert len(kinds) >= 20


@pytest.mark.slow
@pytest.mark.parametrize("row", [row for row in ROWS if ALL or row.name in SAMPLE], ids=lambda row: row.name)
def test_faults_by_script(bench: SmallBench, row: Row) -> None:
    scripted(bench, row)


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_SENSORS)
def test_faults_of_each_sensor(name: str, tmp_path: Path) -> None:
    """The last of its own, where not all are asked for."""
    bench = SmallBench.start(tmp_path, sensor=SENSORS[name])
    try:
        for row in (*OF_SENSORS[name], *OF_EVERY_SENSOR) if ALL else OF_SENSORS[name][-1:]:
            scripted(bench, row)
    finally:
        bench.stop()


@pytest.mark.slow
@pytest.mark.parametrize("seed", RANDOM)
def test_random_faults(bench: SmallBench, seed: int) -> None:
    """A random moment, instrument, fault and length; what is promised whatever goes wrong is asserted."""
    trial(bench, seed)

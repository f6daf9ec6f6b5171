"""A second process on a bench that a run holds: it is refused, and whatever keeps it from running, it touches nothing."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fault_judging import begun, run_folder
from small_bench import PATIENCE, SmallBench, until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals and fork are POSIX"),
]
RUN = ("run", "plan.yaml", "--quiet", "--flushed")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SmallBench]:
    made = SmallBench.start(tmp_path_factory.mktemp("second"))
    yield made
    made.stop()


def turning(bench: SmallBench) -> bool:
    folder = run_folder(bench)
    return folder is not None and begun(folder, "turning") and abs(bench.state()["table"]["rates"][0]) > 0.17


@pytest.mark.parametrize(
    ("elsewhere", "refused_by"),
    [("TMPDIR", "this bench is in use: "), ("PLANRUNNER_LOCKS", "gyro (declared_frame) cannot be connected: ")],
)
def test_a_second_run_leaves_a_turning_table_alone(
    bench: SmallBench, tmp_path: Path, elsewhere: str, refused_by: str
) -> None:
    """Refused by the lock, whatever its folder for temporary files; refused at the serial port where the two see different locks."""
    own = {"PLANRUNNER_LOCKS": ""} if elsewhere == "TMPDIR" else {}
    first = bench.planrunner(*RUN, environment=own)
    until(lambda: first.code is not None or turning(bench), "the table turns")
    assert first.code is None, first.said
    second = bench.planrunner(*RUN, "--runs", "elsewhere", environment={**own, elsewhere: str(tmp_path)})
    code = second.wait(PATIENCE)
    assert refused_by in second.said and code in (2, 3), second.said
    state = bench.state()["table"]
    assert all(state["powered"]) and abs(state["rates"][0]) > 0.17, state
    assert first.wait(PATIENCE) == 0, first.said

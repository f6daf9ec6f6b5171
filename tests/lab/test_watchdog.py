"""The watchdog as planrunner sees it: when it starts, when it may go, and how its absence is noticed. Its work: test_paper_lab_runs."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from paper_lab import PaperChamber, PaperSensor, PaperTable, bench_file, packaged, state

from planrunner.base import plugins
from planrunner.base.findings import InputError
from planrunner.bench import lock, watchdog
from planrunner.bench.lock import bench_lock
from planrunner.bench.model import read_bench
from planrunner.bench.watchdog import Watchdog
from planrunner.instruments.interfaces import InstrumentError


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> bytes:
    monkeypatch.setattr(watchdog, "EVERY", 0.0)
    for name, value in packaged(tmp_path).items():
        monkeypatch.setenv(name, value)
    return bench_file(tmp_path).read_bytes()


def test_a_bench_that_cannot_be_read_keeps_the_run_from_starting(bench: bytes) -> None:
    with pytest.raises(InstrumentError, match=r"does not start: .*unknown driver 'paper_tabel'"):
        Watchdog(bench.replace(b"paper_table", b"paper_tabel"), "lab.yaml", None, 60.0)


def test_once_the_bench_is_safe_it_ends_without_touching_it(bench: bytes, tmp_path: Path) -> None:
    guard = Watchdog(bench, "lab.yaml", None, 60.0)
    guard.report_to(tmp_path)
    for _ in range(3):
        guard.sign_of_life()
    guard.stand_down()
    assert not (tmp_path / "watchdog.txt").exists() and not (tmp_path / "table.json").exists()
    with pytest.raises(ProcessLookupError):
        os.kill(guard.pid, 0)


def signs_of_life(guard: Watchdog, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        guard.sign_of_life()


def test_a_watchdog_that_is_gone_is_noticed(bench: bytes) -> None:
    guard = Watchdog(bench, "lab.yaml", None, 60.0)
    os.kill(guard.pid, signal.SIGTERM)  # not for it
    guard.sign_of_life()
    os.kill(guard.pid, signal.SIGKILL)
    with pytest.raises(InstrumentError, match="watchdog process has ended"):
        signs_of_life(guard)
    guard.stand_down()


def test_a_watchdog_that_stands_still_holds_nobody_up(bench: bytes) -> None:
    """Its pipe is full at some time; that is noticed, not waited for."""
    guard = Watchdog(bench, "lab.yaml", None, 60.0)
    os.kill(guard.pid, signal.SIGSTOP)
    with pytest.raises(InstrumentError, match="watchdog process has ended"):
        signs_of_life(guard)
    os.kill(guard.pid, signal.SIGKILL)
    guard.stand_down()


def test_a_long_bench_file_reaches_it(bench: bytes) -> None:
    """Longer than a pipe holds."""
    guard = Watchdog(bench + b"# " + b"x" * 300_000, "lab.yaml", None, 60.0)
    guard.stand_down()


def test_left_to_act_it_makes_the_bench_safe_and_is_waited_for(bench: bytes, tmp_path: Path) -> None:
    (tmp_path / "table.json").write_text('{"rate": 5.0, "safe": false}', encoding="utf-8")
    guard = Watchdog(bench, "lab.yaml", None, 60.0)
    guard.report_to(tmp_path)
    guard.answer_for({"table"})
    guard.let_act()
    assert state(tmp_path, "table")["safe"] and state(tmp_path, "table")["rate"] == 0.0
    report = (tmp_path / "watchdog.txt").read_text(encoding="utf-8")
    assert "table: safe" in report and "chamber: left as it was, never commanded" in report
    assert not (tmp_path / "chamber.json").exists()  # it was not even connected to


def test_what_its_run_never_commanded_it_leaves_alone(bench: bytes, tmp_path: Path) -> None:
    """A run that ends while it connects has set nothing going: whatever moves was moved by somebody else."""
    turning = '{"rate": 5.0, "safe": false}'
    (tmp_path / "table.json").write_text(turning, encoding="utf-8")
    guard = Watchdog(bench, "lab.yaml", None, 60.0)
    guard.sign_of_life()
    guard.let_act()
    assert (tmp_path / "table.json").read_text(encoding="utf-8") == turning
    assert not (tmp_path / "watchdog.txt").exists()


def test_nobody_gets_the_bench_while_it_lives(bench: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "RESCUE_PATIENCE", 0.2)
    drivers = {"paper_table": PaperTable, "paper_chamber": PaperChamber, "paper_sensor": PaperSensor}
    monkeypatch.setattr(plugins, "names", lambda group: tuple(drivers))
    monkeypatch.setattr(plugins, "load", lambda group, name: drivers[name])
    read = read_bench(str(tmp_path / "paper.yaml"))[0]
    guard = Watchdog(bench, "lab.yaml", None, 60.0)
    with (
        pytest.raises(
            InputError, match=f"the watchdog of another run, which is making the bench safe, process {guard.pid} of"
        ),
        bench_lock(read, "lab.yaml"),
    ):
        pass
    guard.stand_down()
    with bench_lock(read, "lab.yaml"):
        pass


def test_reports_follow_one_another_and_nothing_is_left_beside_them(bench: bytes, tmp_path: Path) -> None:
    """A report appears whole: whoever waits for the file may read it at once."""
    for _ in range(2):
        guard = Watchdog(bench, "lab.yaml", None, 60.0)
        guard.report_to(tmp_path)
        guard.answer_for({"table"})
        guard.let_act()
    assert (tmp_path / "watchdog.txt").read_text(encoding="utf-8").count("table: safe") == 2
    assert [path.name for path in tmp_path.glob("watchdog*")] == ["watchdog.txt"]

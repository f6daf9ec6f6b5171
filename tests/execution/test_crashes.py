"""Crashes: the disk fails or the process dies at every write in turn, and at random moments; then the run goes on.

Nothing acknowledged may be lost, and the resumed run's samples and statistics equal an uninterrupted run's exactly.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_bench import make_bench, mixed_schedule
from killed_run import PART_BYTES

from planrunner.archive import formats
from planrunner.archive.journal import JournalScan
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.archive.storage import Storage
from planrunner.base.findings import InputError
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.execution.executor import execute
from planrunner.execution.stopping import StopRequest

HERE = Path(__file__).parent
OPERATIONS = (
    "make_folder",
    "open_new",
    "open_existing",
    "write",
    "truncate",
    "sync",
    "sync_folder",
    "replace",
    "rename",
    "remove",
)


class PowerCutError(BaseException):
    """The process is gone: nothing that would follow happens."""


def disk_full() -> OSError:
    return OSError(28, "No space left on device")


Fault = Callable[[], BaseException]


class Faulty(Storage):
    """Counts operations; `fails` of them, from the `fail_from`-th on, raise what `error` makes. A write that fails leaves half of its
    data. An exception that is raised anew would keep what every place it was raised at holds open."""

    def __init__(self, fail_from: int, error: Fault, fails: int = 10**9):
        super().__init__("durable")
        self.fail_from, self.error, self.fails = fail_from, error, fails
        self.called: list[str] = []

    def sync(self, file: FileIO) -> None:
        """The tests' disk never loses power, so its syncs need not wait."""

    def sync_folder(self, folder: GuardedFolder) -> None: ...

    def __getattribute__(self, name: str) -> Any:
        found = super().__getattribute__(name)
        if name not in OPERATIONS:
            return found

        def counted(*args: Any) -> Any:
            self.called.append(name)
            if self.fail_from <= len(self.called) < self.fail_from + self.fails:
                if name == "write" and len(self.called) == self.fail_from:
                    found(args[0], args[1][: len(args[1]) // 2])
                raise self.error()
            return found(*args)

        return counted


@contextlib.contextmanager
def process_that_dies(writers: list[RunWriter]) -> Iterator[None]:
    """What a kill leaves: files as they are, descriptors closed and locks gone."""
    try:
        yield
    except PowerCutError:
        pass
    finally:
        for writer in writers:
            with contextlib.suppress(PowerCutError, OSError, KeyboardInterrupt):
                writer.close()


def attempt(root: Path, storage: Storage, run: Path | None = None) -> Path | None:
    """Begin or go on with a run until it ends or its process dies; returns the folder, if there is one."""
    writers: list[RunWriter] = []
    with process_that_dies(writers):
        if run is None:
            writers.append(RunWriter.create(root, "mixed", b"plan", b"bench", {}, storage=storage))
        else:
            writers.append(RunWriter.reopen(run, storage=storage))
        writer = writers[0]
        writer.part_bytes = PART_BYTES
        execute(mixed_schedule(), make_bench(block=20), writer, stop=StopRequest(), start_at=writer.next_segment)
    folders = [path for path in root.iterdir() if not path.name.startswith(".")] if root.is_dir() else []
    return folders[0] if folders else None


def contents(run: Path) -> list[Any]:
    """Everything that must not depend on crashes: samples, statistics, readings."""
    schedule, rows = mixed_schedule(), []
    for item in RunReader.open(run).recording(schedule):
        blocks = list(item.blocks(["x", "y"]))
        x = np.concatenate([block.channels["x"] for block in blocks]).tolist()
        y = np.concatenate([block.channels["y"] for block in blocks]).tolist()
        time_ = np.concatenate([block.time for block in blocks]).tolist()
        statistics = item.statistics
        numbers = (statistics.mean.tolist(), statistics.covariance.tolist(), statistics.standard_error.tolist())
        rows.append((item.label, item.truncated, time_, x, y, numbers, item.readings))
    return rows


def acknowledged(run: Path) -> dict[int, list[str]]:
    """Segment → digests of its files, from the lines of the journal that are whole."""
    found: dict[int, list[str]] = {}
    for event in JournalScan(GuardedFolder.open(run)):
        if event["event"] == "segment":
            found[event["segment"]] = [part["sha256"] for part in event["parts"]]
    return found


def without_last(rows: list[Any]) -> list[Any]:
    """The last segment is kept when it is cut short, so it may be shorter than in an uninterrupted run."""
    return [row for row in rows if row[0] != "last"]


def check_resumed(run: Path, before: dict[int, list[str]], whole: list[Any]) -> None:
    after = acknowledged(run)
    assert all(after[index] == digests for index, digests in before.items()), "an acknowledged segment was lost"
    reader = RunReader.open(run)
    assert reader.sealed
    reader.check_digests()
    got = contents(run)
    assert without_last(got) == without_last(whole)
    last, expected = got[-1], whole[-1]
    if not last[1]:
        assert last == expected
    else:
        assert last[3] == expected[3][: len(last[3])]
    partial = [path.name for path in (run / "segments").iterdir() if path.name.endswith(".partial")]
    assert partial == []


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Any], list[str]]:
    """The contents of a run without faults, and the operations on the disk that it took."""
    storage = Faulty(10**9, OSError)
    run = attempt(tmp_path_factory.mktemp("whole"), storage)
    assert run is not None
    return contents(run), storage.called


def crash_everywhere(root: Path, whole: list[Any], numbers: Iterable[int], error: Fault, fails: int = 10**9) -> None:
    for number in numbers:
        folder = root / str(number)
        folder.mkdir()
        try:
            run = attempt(folder, Faulty(number, error, fails))
        except InputError as refused:  # the disk failed while the folder was made: nothing is there
            if refused.findings[0].code != "runs-unwritable":
                raise
            run = next((path for path in folder.iterdir() if not path.name.startswith(".")), None)
        if run is not None:
            before = acknowledged(run)
            assert (
                attempt(folder, Storage("flushed"), run) == run
                if not RunReader.open(run, to_reopen=True).sealed
                else True
            )
            check_resumed(run, before, whole)
        shutil.rmtree(folder)


def kinds_of_moment(operations: list[str], which: int) -> list[int]:
    """Where in the operations, counted from 1, each kind of moment comes for the first time (0) or the last (-1): what is done there
    and the two operations before it."""
    places: dict[tuple[str, ...], list[int]] = {}
    for number in range(1, len(operations) + 1):
        places.setdefault(tuple(operations[max(0, number - 3) : number]), []).append(number)
    return [numbers[which] for numbers in places.values()]


def test_power_cut_at_operations(tmp_path: Path, uninterrupted: tuple[list[Any], list[str]]) -> None:
    whole, operations = uninterrupted
    assert set(operations) == set(OPERATIONS) - {"truncate", "remove"}  # those are of resuming
    moments = {*kinds_of_moment(operations, 0), *range(50, len(operations), 14)}
    crash_everywhere(tmp_path, whole, sorted(moments), PowerCutError)


def test_disk_full_at_operations(tmp_path: Path, uninterrupted: tuple[list[Any], list[str]]) -> None:
    whole, operations = uninterrupted
    crash_everywhere(tmp_path, whole, kinds_of_moment(operations, -1), disk_full)


def test_one_write_fails_and_the_next_succeeds(tmp_path: Path, uninterrupted: tuple[list[Any], list[str]]) -> None:
    """Space was made just then: a file with a hole in it must not be finished, nor a line be joined to half a line."""
    whole, operations = uninterrupted
    crash_everywhere(tmp_path, whole, kinds_of_moment(operations, 0), disk_full, fails=1)


@pytest.mark.slow
@pytest.mark.parametrize("fails", [10**9, 1])
@pytest.mark.parametrize("error", [PowerCutError, disk_full, KeyboardInterrupt])
def test_crash_at_every_operation(
    tmp_path: Path, uninterrupted: tuple[list[Any], list[str]], error: Fault, fails: int
) -> None:
    whole, operations = uninterrupted
    with contextlib.suppress(KeyboardInterrupt):
        crash_everywhere(
            tmp_path, whole, range(25 if error is KeyboardInterrupt else 1, len(operations) + 1), error, fails
        )
        return
    pytest.fail("an interruption came through")


def test_crash_while_resuming(tmp_path: Path, uninterrupted: tuple[list[Any], list[str]]) -> None:
    """The process dies in the middle, and again at each of the first operations of resuming."""
    whole, operations = uninterrupted
    for number in range(1, 40, 2):
        folder = tmp_path / str(number)
        folder.mkdir()
        run = attempt(folder, Faulty(len(operations) // 2, PowerCutError))
        assert run is not None
        before = acknowledged(run)
        with contextlib.suppress(InputError):
            attempt(folder, Faulty(number, PowerCutError), run)
        assert attempt(folder, Storage("flushed"), run) == run
        check_resumed(run, before, whole)


def test_disk_full_leaves_the_bench_safe(tmp_path: Path) -> None:
    bench, storage = make_bench(), Faulty(60, disk_full)
    with RunWriter.create(tmp_path, "mixed", b"p", b"b", {}, storage=storage) as writer:
        outcome = execute(mixed_schedule(), bench, writer, stop=StopRequest())
    assert "No space left on device" in outcome.failures[0].message
    assert bench.calls[-3:] == ["table.safe", "chamber.safe", "sensor.safe"]


# -- a process that is killed ----------------------------------------------------------------------------------------------


def run_in_process(root: Path, run: str, kill_after: float | None) -> tuple[str, float, bool]:
    """The run's name, how long it went on after its folder stood, and whether it was killed (-9) before it ended."""
    arguments = [sys.executable, str(HERE / "killed_run.py"), str(root), *([run] if run else [])]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        name = process.stdout.readline().strip()
        began = time.perf_counter()
        if kill_after is not None:
            time.sleep(kill_after)
            process.kill()
        process.wait()
        assert kill_after is not None or process.returncode == 0
        return name, time.perf_counter() - began, process.returncode != 0


def kill_and_resume(root: Path, moment: float, rng: random.Random) -> tuple[Path, dict[int, list[str]], int]:
    """Kill the run `moment` seconds after its folder stands, now and then again while it is resumed, then let it end."""
    root.mkdir()
    run, kills = "", 0
    before: dict[int, list[str]] = {}
    while True:
        run, _, killed = run_in_process(root, run, moment)
        kills += killed
        before = acknowledged(root / run)
        if not killed or RunReader.open(root / run, to_reopen=True).sealed or rng.random() < 0.7:
            break
        moment = rng.uniform(0.0, moment)
    if not RunReader.open(root / run, to_reopen=True).sealed:
        run_in_process(root, run, None)
    return root / run, before, kills


def test_kill_at_a_few_moments(tmp_path: Path, uninterrupted: tuple[list[Any], list[str]]) -> None:
    rng = random.Random(5)
    for number, moment in enumerate((0.0, 0.03, 0.1)):
        run, before, _ = kill_and_resume(tmp_path / str(number), moment, rng)
        check_resumed(run, before, uninterrupted[0])


@pytest.mark.slow
def test_kill_at_a_hundred_moments(tmp_path: Path, uninterrupted: tuple[list[Any], list[str]]) -> None:
    rng = random.Random(6)
    (tmp_path / "whole").mkdir()
    _, duration, _ = run_in_process(tmp_path / "whole", "", None)
    kills, begun = 0, set()
    for number in range(300):
        run, before, killed = kill_and_resume(tmp_path / str(number), rng.uniform(0.0, 0.9 * duration), rng)
        check_resumed(run, before, uninterrupted[0])
        shutil.rmtree(run)
        kills += killed
        begun.add(len(before))
        if kills >= 100:
            break
    assert kills >= 100
    assert len(begun) >= 6, "the kills came at too few places"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a POSIX resource limit")
def test_file_size_limit_is_an_ordinary_failure(tmp_path: Path) -> None:
    """A real refusal by the operating system: files may not grow beyond 2 kB, less than the journal needs."""
    script = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000)); import killed_run; sys.exit(killed_run.main())"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], cwd=HERE, capture_output=True, text=True, check=False
    )
    assert done.returncode == 3, done.stderr
    assert "Traceback" not in done.stderr
    run = tmp_path / done.stdout.strip()
    assert attempt(tmp_path, Storage("flushed"), run) == run
    assert RunReader.open(run).sealed


def test_events_of_a_crashed_and_resumed_run_fit_the_schema(
    tmp_path: Path, uninterrupted: tuple[list[Any], list[str]]
) -> None:
    run = attempt(tmp_path, Faulty(len(uninterrupted[1]) // 2, PowerCutError))
    assert run is not None
    attempt(tmp_path, Storage("flushed"), run)
    kinds = set()
    for event in JournalScan(GuardedFolder.open(run)):
        assert formats.event_fault(event) is None
        kinds.add(event["event"])
    assert kinds >= {
        "created",
        "instruments",
        "started",
        "begun",
        "part",
        "segment",
        "rejected",
        "reopened",
        "safe",
        "finished",
    }
    for name in ("run", "seal"):
        json.loads((run / f"{name}.json").read_text())

"""Work that several processes share: its results, and what is left when one of the processes ends."""

from __future__ import annotations

import errno
import multiprocessing
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from planrunner.base.processes import shared_out
from tests.conftest import ROOT

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and inherited pipes as on POSIX")

_LONG = 300  # s
_FORKS = "forks are used on Linux only"

_SCRIPT = """
import errno, os, signal, sys
from multiprocessing import parent_process
from planrunner.base import processes
from planrunner.base.interruption import Interruption

def square(item):
    return item, item * item

def fails(item):
    if item >= 5:
        raise ArithmeticError(f"of {item}")
    return item

def dies(item):
    if parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    return item

def waits(item):
    if item == 0:  # before there are others
        return item
    os.write(int(sys.argv[1]), b"w")
    os.read(int(sys.argv[2]), 1)
    return item

def refused():
    raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

def main(work, jobs, items=20):
    with Interruption() as interruption:
        try:
            print(processes.shared_out(work, range(items), jobs))
        except KeyboardInterrupt:
            sys.exit(interruption.tell())
        except Exception as error:
            print(f"{type(error).__name__}: {error}")

if __name__ == "__main__":
    METHOD
    main(CALL)
"""


def _answer(folder: Path, call: str, method: str = "fork") -> str:
    done = subprocess.run(_command(folder, call, method), capture_output=True, text=True, timeout=_LONG, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.strip()


def _command(folder: Path, call: str, method: str = "fork") -> list[str]:
    chosen = {"fork": "pass", "spawn": "processes._may_fork = bool", "refused": "os.fork = refused"}[method]
    path = folder / "script.py"
    path.write_text(_SCRIPT.replace("METHOD", chosen).replace("CALL", call), encoding="utf-8")
    return [sys.executable, str(path)]


@pytest.mark.parametrize("jobs", [1, 2, 3, 40, None])
def test_results_are_in_the_order_of_the_items(tmp_path: Path, jobs: int | None) -> None:
    assert _answer(tmp_path, f"square, {jobs}") == str([(item, item * item) for item in range(20)])


@pytest.mark.parametrize("items", [0, 1, 2])
def test_fewer_items_than_processes(tmp_path: Path, items: int) -> None:
    assert _answer(tmp_path, f"square, 3, {items}") == str([(item, item * item) for item in range(items)])


def test_new_interpreters_give_the_same_results(tmp_path: Path) -> None:
    assert _answer(tmp_path, "square, 2", "spawn") == str([(item, item * item) for item in range(20)])


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_the_first_failure_is_raised(tmp_path: Path, jobs: int) -> None:
    """Item 5 and all later ones fail, in whichever process they are."""
    assert _answer(tmp_path, f"fails, {jobs}") == "ArithmeticError: of 5"


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_process_that_is_killed_is_an_error(tmp_path: Path, method: str) -> None:
    said = _answer(tmp_path, "dies, 3", method)
    assert said.startswith("ProcessEndedError: ") and "SIGKILL" in said


@pytest.mark.skipif(sys.platform != "linux", reason=_FORKS)
def test_a_process_that_cannot_be_started_is_an_error(tmp_path: Path) -> None:
    said = _answer(tmp_path, "square, 3", "refused")
    assert said.startswith("ProcessEndedError: ") and os.strerror(errno.EAGAIN) in said


@dataclass(frozen=True, slots=True)
class _Waiting:
    """A process and its forks, all of which wait. held: a pipe that is at its end as soon as none of them exists."""

    process: subprocess.Popen[str]
    held: int
    release: int


@pytest.fixture
def waiting(tmp_path: Path) -> Iterator[_Waiting]:
    if sys.platform != "linux":
        pytest.skip(_FORKS)
    held, inside = os.pipe()
    wait, release = os.pipe()
    process = subprocess.Popen(
        [*_command(tmp_path, "waits, 3"), str(inside), str(wait)],
        pass_fds=(inside, wait),
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    os.close(inside)
    os.close(wait)
    for _ in range(3):  # until each of the three waits in its first item
        assert _read(held, 1) == b"w"
    yield _Waiting(process, held, release)
    process.kill()
    process.communicate()
    os.close(held)


def _read(pipe: int, most: int) -> bytes:
    assert select.select([pipe], [], [], _LONG)[0]
    return os.read(pipe, most)


def _until_all_are_gone(held: int) -> None:
    while _read(held, 64):
        pass


def test_ctrl_c_ends_all(waiting: _Waiting) -> None:
    """A terminal sends it to all of them."""
    os.killpg(waiting.process.pid, signal.SIGINT)
    out, err = waiting.process.communicate(timeout=_LONG)
    assert (waiting.process.returncode, out, err) == (130, "", "interrupted\n")
    _until_all_are_gone(waiting.held)
    os.close(waiting.release)


def test_the_end_of_the_first_ends_the_others(waiting: _Waiting) -> None:
    """It is killed, without a chance to end them: they end with what they were doing."""
    waiting.process.kill()
    os.close(waiting.release)
    _until_all_are_gone(waiting.held)


def test_sigterm_to_the_first_ends_all(waiting: _Waiting) -> None:
    waiting.process.terminate()
    _, err = waiting.process.communicate(timeout=_LONG)
    assert (waiting.process.returncode, err) == (130, "ended by SIGTERM\n")
    _until_all_are_gone(waiting.held)
    os.close(waiting.release)


def test_a_worker_starts_no_other_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python refuses processes of a daemonic process; workers of this package and of Dask are daemonic."""
    monkeypatch.setitem(vars(multiprocessing.current_process())["_config"], "daemon", True)
    assert shared_out(abs, range(-200, 0), 2) == [*range(200, 0, -1)]

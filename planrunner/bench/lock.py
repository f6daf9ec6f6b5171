"""One run a bench: every real instrument is locked by its address, for all processes of the computer.

Locks are files in one folder of the computer; the operating system gives them back when a process ends, however it ends. A second
computer that reaches the same instrument does not see them.
"""

from __future__ import annotations

import contextlib
import getpass
import hashlib
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from planrunner.bench.model import Bench, driver_of, real_instruments, runs_on_virtual_clock
from planrunner.exclusive import ExclusiveFile, HeldError
from planrunner.instruments.interfaces import Addressed
from planrunner.plan.findings import InputError, Mark

FOLDER = "PLANRUNNER_LOCKS"
"""Environment variable that names another folder for the locks."""
RESCUE = "a watchdog makes it safe"
RESCUE_PATIENCE = 30.0
"""Seconds that a new run waits for the watchdog of one that was killed."""


@contextmanager
def bench_lock(bench: Bench, shown: str, purpose: str = "a run") -> Iterator[None]:
    """Hold the bench's real instruments alone; a bench without any is shared by all.

    shown: the bench's file, for messages; purpose: of holding it, for whoever finds it held. Raises `InputError` when another process
    holds one of them; the lock of a watchdog is waited for.
    """
    held: list[ExclusiveFile] = []
    deadline = time.monotonic() + RESCUE_PATIENCE
    try:
        for what in _locked(bench):
            held.append(_hold(what, shown, purpose, deadline))
        yield
    finally:
        for lock in held:
            lock.release()


def _locked(bench: Bench) -> list[str]:
    """What is locked, in one order for all, so that two runs never wait for each other."""
    if runs_on_virtual_clock(bench):
        return []
    found = set()
    for name in real_instruments(bench):
        driver, parameters = driver_of(bench.instruments[name]), bench.instruments[name].parameters
        if issubclass(driver, Addressed):
            found.add(str(driver.address(parameters)))
        else:
            found.add(f"bench {bench.name}: {name}")
    return sorted(found)


def _hold(what: str, shown: str, purpose: str, deadline: float) -> ExclusiveFile:
    since = datetime.now().astimezone().isoformat(timespec="seconds")
    note = f"{purpose}, process {os.getpid()} of {_user()}, since {since}"
    path = _folder(shown) / f"{hashlib.sha256(what.encode()).hexdigest()[:24]}.lock"
    while True:
        try:
            return ExclusiveFile(path, note, 0o666)
        except HeldError as error:
            if RESCUE in str(error) and time.monotonic() < deadline:
                time.sleep(0.1)
                continue
            message = f"this bench is in use: {what} is held by {str(error) or 'another process'}"
            hint = "wait until that ends, or stop it; a lock ends with its process"
            raise InputError.at(Mark(shown), "bench-in-use", message, hint) from None
        except OSError as error:
            message = f"the bench cannot be locked: {path}: {error.strerror or error}"
            raise InputError.at(Mark(shown), "bench-lock", message, f"name a folder for locks in {FOLDER}") from None


def _folder(shown: str) -> Path:
    folder = Path(os.environ.get(FOLDER) or Path(tempfile.gettempdir()) / "planrunner-locks")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        message = f"the folder for the locks of benches cannot be made: {folder}: {error.strerror or error}"
        raise InputError.at(Mark(shown), "bench-lock", message, f"name another one in {FOLDER}") from None
    with contextlib.suppress(OSError):  # whoever came first made it for all
        folder.chmod(0o1777)
    return folder


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "an unknown user"

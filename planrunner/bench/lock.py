"""Ensures that only one run uses a bench. A process locks every real instrument against all other processes of the computer. The
process locks all names of the instrument's address.

Locks are files in one folder of the computer. This folder does not depend on the folder that a process uses for temporary files.
The operating system releases the locks of a process when the process ends for any reason. The watchdog of a run takes a lock as
well, before the first instrument is connected. Therefore, if a run is killed, no other run can use the bench until the watchdog has
made the bench safe. Locks have no effect on a second computer that uses the same instrument.
"""

from __future__ import annotations

import contextlib
import getpass
import hashlib
import os
import stat
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import datetime
from pathlib import Path

from planrunner.base.exclusive import ExclusiveFile, HeldError
from planrunner.base.findings import InputError, Mark
from planrunner.base.trusted_folders import UntrustedFolderError, computer_data, trusted
from planrunner.bench.model import Bench, driver_of, real_instruments, runs_on_virtual_clock
from planrunner.bench.same_instrument import names_of
from planrunner.instruments.interfaces import Addressed

FOLDER = "PLANRUNNER_LOCKS"
"""Environment variable for a different folder for the locks."""
PLACES = {
    "darwin": ("/Users/Shared", "/private/tmp"),
    "linux": ("/run/planrunner-locks", "/run/lock", "/tmp"),
}
"""Folders for locks, by platform. The first folder that all users share is used, independent of the environment. On Linux, only an
administrator can create the first folder of the list."""
ELSEWHERE = ("/tmp",)
RESCUE_PATIENCE = 30.0
"""Time that a new run waits for the watchdog of a killed run, s."""


@contextmanager
def bench_lock(bench: Bench, shown: str, purpose: str = "a run") -> Iterator[None]:
    """Locks the bench's real instruments. A bench without real instruments needs no lock.

    `shown`: name of the bench file, for messages. `purpose`: the reason for the lock; other users who try to use the bench see the
    reason in a message. Raises `InputError` if another process holds one of the instruments. Waits for the watchdog of a run that
    has ended.
    """
    instruments = _names(bench)
    with ExitStack() as stack:
        _hold_all(stack, instruments, "lock", shown, purpose)
        deadline = time.monotonic() + RESCUE_PATIENCE
        while True:
            try:
                with ExitStack() as looked:
                    _hold_all(looked, instruments, "watchdog", shown, purpose)
                break
            except InUseError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)
        yield


@contextmanager
def watchdog_lock(bench: Bench, shown: str) -> Iterator[None]:
    """Locks the bench's real instruments against every other run, while the watchdog of this run exists. Raises `InputError` if
    another process holds one of these locks."""
    with ExitStack() as stack:
        _hold_all(
            stack, _names(bench), "watchdog", shown, "the watchdog of another run, which is making the bench safe"
        )
        yield


class InUseError(InputError):
    """Reports that another process holds an instrument."""


def lock_folder() -> Path:
    """Returns the folder for locks on this computer. Raises `OSError` if the folder cannot be created, and `UntrustedFolderError`
    if other users could change it."""
    named = os.environ.get(FOLDER)
    if named:
        return _named(Path(named))
    if sys.platform == "win32":
        folder = computer_data() / "planrunner" / "locks"
        folder.mkdir(parents=True, exist_ok=True)
        return trusted(folder)
    for place in map(Path, PLACES.get(sys.platform, ELSEWHERE)):
        with contextlib.suppress(FileNotFoundError):
            mode = place.lstat().st_mode
            if stat.S_ISDIR(mode) and mode & stat.S_ISVTX and mode & stat.S_IWGRP:
                return trusted(place)
    raise OSError("this computer has no folder that all its users share")


def _named(folder: Path) -> Path:
    """Returns the folder for locks that is named by an environment variable. If the folder does not exist, it is created, for all
    users if an administrator runs the program, otherwise for this user alone. Raises `UntrustedFolderError` if the path is relative
    or a link, or if other users could change the folder."""
    if not folder.is_absolute():
        raise UntrustedFolderError(f"{folder} is a different folder for each process: give its absolute path")
    try:
        folder.mkdir(mode=0o700)
    except FileExistsError:
        if folder.is_symlink():
            raise UntrustedFolderError(f"{folder} is a link: give the folder itself") from None
    else:
        if sys.platform != "win32" and os.geteuid() == 0:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                os.fchmod(descriptor, 0o1777)
            finally:
                os.close(descriptor)
    return trusted(folder)


def _names(bench: Bench) -> Mapping[str, str]:
    """Returns all names under which the real instruments can be addressed, each with the address in the bench file. The order of
    the names is the same for all runs, so that two runs never wait for each other."""
    if runs_on_virtual_clock(bench):
        return {}
    found: dict[str, str] = {}
    for name in real_instruments(bench):
        driver, parameters = driver_of(bench.instruments[name]), bench.instruments[name].parameters
        if issubclass(driver, Addressed):
            address = str(driver.address(parameters))
            found |= dict.fromkeys(names_of(address), address)
        else:
            unnamed = f"bench {bench.name}: {name}"
            found[unnamed] = unnamed
    return dict(sorted(found.items()))


def _hold_all(stack: ExitStack, instruments: Mapping[str, str], kind: str, shown: str, purpose: str) -> None:
    """Takes all locks of one kind. Closing `stack` releases the locks. Raises `InUseError` if another process holds one of the
    locks, and `InputError` if the bench cannot be locked."""
    if not instruments:
        return
    folder = _usable_folder(shown)
    since = datetime.now().astimezone().isoformat(timespec="seconds")
    note = f"{purpose}, process {os.getpid()} of {_user()}, since {since}"
    for name, written in instruments.items():
        path = folder / f"planrunner-{hashlib.sha256(name.encode()).hexdigest()[:24]}.{kind}"
        try:
            lock = ExclusiveFile(path, note, 0o666)
        except HeldError as error:
            message = f"this bench is in use: {written} is held by {str(error) or 'another process'}"
            hint = "wait until that process ends, or stop it; the lock ends with the process"
            raise InUseError.at(Mark(shown), "bench-in-use", message, hint) from None
        except OSError as error:
            message = f"the bench cannot be locked: {path}: {error.strerror or error}"
            raise InputError.at(Mark(shown), "bench-lock", message, _ELSEWHERE) from None
        stack.callback(lock.release)


_ELSEWHERE = f"ask an administrator to create a folder with the sticky bit, writable for all users of the bench, and name it in {FOLDER}"


def _usable_folder(shown: str) -> Path:
    try:
        return lock_folder()
    except UntrustedFolderError as error:
        message = f"the folder for bench locks is not safe: {error}"
        raise InputError.at(Mark(shown), "bench-lock", message, _ELSEWHERE) from None
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        message = f"the folder for bench locks cannot be used: {where}{error.strerror or error}"
        raise InputError.at(Mark(shown), "bench-lock", message, _ELSEWHERE) from None


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "an unknown user"

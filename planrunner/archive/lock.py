"""One writer a run folder: a lock that the operating system gives back when the process ends, however it ends."""

from __future__ import annotations

import os
from pathlib import Path

from planrunner.plan.findings import InputError, Mark

NAME = ".lock"


class FolderLock:
    """An exclusive lock on a folder, held from creation to `release`.

    Raises `InputError` when another process, or another writer of this one, holds it.
    """

    def __init__(self, folder: Path):
        self._descriptor: int | None = os.open(folder / NAME, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            _lock(self._descriptor)
        except OSError:
            os.close(self._descriptor)
            self._descriptor = None
            hint = "wait until the other one ends, or stop it"
            raise InputError.at(Mark(str(folder)), "run-in-use", "another planrunner writes this run", hint) from None

    def release(self) -> None:
        if self._descriptor is not None:
            _unlock(self._descriptor)
            os.close(self._descriptor)
            self._descriptor = None


if os.name == "nt":  # pragma: no cover (not the platform of continuous integration)
    import msvcrt

    def _lock(descriptor: int) -> None:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]

    def _unlock(descriptor: int) -> None:
        os.lseek(descriptor, 0, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)  # type: ignore[attr-defined,unused-ignore]

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _unlock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_UN)

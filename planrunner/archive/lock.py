"""One writer a run folder: a lock that the operating system gives back when the process ends, however it ends."""

from __future__ import annotations

from pathlib import Path

from planrunner.exclusive import ExclusiveFile, HeldError
from planrunner.plan.findings import InputError, Mark

NAME = ".lock"


class FolderLock:
    """An exclusive lock on a folder, held from creation to `release`.

    Raises `InputError` when another process, or another writer of this one, holds it.
    """

    def __init__(self, folder: Path):
        try:
            self._file = ExclusiveFile(folder / NAME)
        except HeldError:
            hint = "wait until the other one ends, or stop it"
            raise InputError.at(Mark(str(folder)), "run-in-use", "another planrunner writes this run", hint) from None

    def release(self) -> None:
        self._file.release()

"""Uses a lock to ensure that a run folder has only one writer. When a process ends for any reason, the operating system releases
the lock of this process."""

from __future__ import annotations

from planrunner.base.exclusive import ExclusiveFile, HeldError
from planrunner.base.findings import InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder

NAME = ".lock"


class FolderLock:
    """Locks a folder exclusively, from the creation of this object until `release` is called.

    Raises `InputError` if another process, or another writer of this process, holds the lock. Raises `OSError` if the lock file
    cannot be opened.
    """

    def __init__(self, folder: GuardedFolder):
        try:
            self._file = ExclusiveFile(folder.path / NAME, opened=folder.open_or_make(NAME))
        except HeldError:
            hint = "wait until that process ends, or stop it"
            raise InputError.at(
                Mark(str(folder.path)), "run-in-use", "another planrunner process is writing this run", hint
            ) from None

    def release(self) -> None:
        self._file.release()

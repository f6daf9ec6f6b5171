"""Lets any process request that a run pause at the next segment boundary. The request is a file in the run folder."""

from __future__ import annotations

import os

from planrunner.archive.lock import NAME as LOCK
from planrunner.archive.lock import FolderLock
from planrunner.base.findings import InputError
from planrunner.base.guarded_folder import GuardedFolder

NAME = ".pause"


def ask_to_pause(run: GuardedFolder) -> None:
    """Requests that the run pause at the next segment boundary. Raises `OSError` if the folder cannot be written."""
    os.close(run.open_or_make(NAME))


def asked_to_pause(run: GuardedFolder) -> bool:
    return run.entry(NAME) is not None


def take_back(run: GuardedFolder) -> bool:
    """Ends a requested pause. Returns True if a pause had been requested and a process still writes the run, so that the run
    continues. If the process has ended in the meantime, the run must be resumed."""
    asked = asked_to_pause(run)
    run.remove(NAME)
    return asked and is_written(run)


def is_written(run: GuardedFolder) -> bool:
    """Returns True if a process is writing to the run folder at present."""
    if run.entry(LOCK) is None:
        return False
    try:
        FolderLock(run).release()
    except InputError:
        return True
    return False

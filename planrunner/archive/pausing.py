"""Asking a running run to wait at the next boundary of its segments, from any other process: a file in its folder says so."""

from __future__ import annotations

import os

from planrunner.archive.lock import NAME as LOCK
from planrunner.archive.lock import FolderLock
from planrunner.base.findings import InputError
from planrunner.base.guarded_folder import GuardedFolder

NAME = ".pause"


def ask_to_pause(run: GuardedFolder) -> None:
    """Raises `OSError` when the folder cannot be written."""
    os.close(run.open_or_make(NAME))


def asked_to_pause(run: GuardedFolder) -> bool:
    return run.entry(NAME) is not None


def take_back(run: GuardedFolder) -> bool:
    """End the pause that was asked for; whether a run went on by that. One that has ended meanwhile is to be resumed."""
    asked = asked_to_pause(run)
    run.remove(NAME)
    return asked and is_written(run)


def is_written(run: GuardedFolder) -> bool:
    """Whether a process writes the run now."""
    if run.entry(LOCK) is None:
        return False
    try:
        FolderLock(run).release()
    except InputError:
        return True
    return False

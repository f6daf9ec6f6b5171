"""Asking a running run to wait at the next boundary of its segments, from any other process: a file in its folder says so."""

from __future__ import annotations

import contextlib
from pathlib import Path

from planrunner.archive import journal
from planrunner.archive.lock import FolderLock
from planrunner.plan.findings import InputError

NAME = ".pause"


def ask_to_pause(run: Path) -> None:
    """Raises `OSError` when the folder cannot be written."""
    (run / NAME).touch()


def asked_to_pause(run: Path) -> bool:
    return (run / NAME).exists()


def take_back(run: Path) -> bool:
    """End the pause that was asked for; whether a run went on by that. One that has ended meanwhile is to be resumed."""
    asked = asked_to_pause(run)
    with contextlib.suppress(FileNotFoundError):
        (run / NAME).unlink()
    return asked and is_written(run)


def is_written(run: Path) -> bool:
    """Whether a process writes the run now."""
    if not (run / journal.NAME).is_file():
        return False
    try:
        FolderLock(run).release()
    except InputError:
        return True
    return False

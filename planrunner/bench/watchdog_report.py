"""Writes and reads the watchdog's report in a run folder. The watchdog process writes the report. When the run is resumed, the
report is added to the journal."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from planrunner.base.guarded_folder import GuardedFolder, NotOrdinaryError

NAME = "watchdog.txt"
MOST_BYTES = 2**18
"""Maximum size of a report in bytes."""
_ASIDE = "watchdog.partial"


def append_report(run: Path, text: str) -> None:
    """Appends text to the report atomically. Raises `OSError` if the report cannot be written."""
    folder = GuardedFolder.open(run)
    before = b""
    with contextlib.suppress(FileNotFoundError, NotOrdinaryError):  # an entry that is not a report is replaced
        before = folder.read(NAME, MOST_BYTES)
    with folder.open_new(_ASIDE) as file:
        file.write(before + text.encode("utf-8", "backslashreplace"))
        os.fsync(file.fileno())
    folder.replace(_ASIDE, NAME)


def read_report(run: GuardedFolder) -> str | None:
    """Reads the report; returns None if there is none. Raises `OSError` if the report cannot be read."""
    if run.entry(NAME) is None:
        return None
    return run.read(NAME, MOST_BYTES).decode("utf-8", "replace")

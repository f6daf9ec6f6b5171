"""A computer that fails under planrunner: while the file `disk-full` lies in a folder its disk takes nothing more, and while `clock-step`
or `clock-leap` does its clock is an hour behind or ahead."""

from __future__ import annotations

import errno
import io
import os
import time
from datetime import datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any

import planrunner.archive.journal
import planrunner.archive.run_folder
import planrunner.base.guarded_folder


def break_with(folder: Path) -> None:
    """From now on, in this process."""
    full, true_time = folder / "disk-full", time.time

    def ahead() -> int:
        """Seconds."""
        return 3600 * ((folder / "clock-leap").exists() - (folder / "clock-step").exists())

    class Disk(io.FileIO):
        def write(self, data: Any, /) -> int:
            if full.exists():
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(data)

    class Clock(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Any:
            return datetime.now(tz) + timedelta(seconds=ahead())

    folders, journal, run_folder = (
        planrunner.base.guarded_folder,
        planrunner.archive.journal,
        planrunner.archive.run_folder,
    )
    for module, name, broken in (
        (folders, "FileIO", Disk),
        (journal, "datetime", Clock),
        (run_folder, "datetime", Clock),
    ):
        assert hasattr(module, name)
        setattr(module, name, broken)
    time.time = lambda: true_time() + ahead()

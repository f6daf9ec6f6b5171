"""Writers that are killed (SIGKILL) before each of their operations on the disk, and within each write.

    python -m tests.archive.killed_writers FOLDER EVERY

makes one archive with a log after another in FOLDER, each with a writer that was killed EVERY operations later, until one lives to the end.
A process of its own, which forks while it has a single thread.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from planrunner.archive.run_log import RunLog
from planrunner.archive.storage import Storage
from tests.forging import write_run

OPERATIONS = (
    "make_folder",
    "open_new",
    "open_existing",
    "write",
    "truncate",
    "sync",
    "sync_folder",
    "replace",
    "rename",
    "remove",
)


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def kill_at(number: int, *, within: bool) -> None:
    """From now on, this process dies before its operation of this number, or, if it is a write, after half of it."""
    count = 0

    def wrapped(name: str) -> Callable[..., Any]:
        original = getattr(Storage, name)

        def operation(self: Storage, *arguments: Any) -> Any:
            nonlocal count
            count += 1
            if count == number:
                if within and name == "write":
                    file, data = arguments
                    file.write(memoryview(data)[: len(data) // 2])
                die()
            return original(self, *arguments)

        return operation

    for name in OPERATIONS:
        setattr(Storage, name, wrapped(name))


def main(folder: Path, every: int) -> None:
    """every: 1 for every operation, 5 for each fifth one."""
    for within in (False, True):
        number = 0
        while True:
            number += 1 if number == 0 else every
            archive = folder / f"{'within' if within else 'before'}-{number:03d}"
            RunLog.create(archive)
            child = os.fork()
            if child == 0:
                kill_at(number, within=within)
                write_run(archive, analyses=0)
                os._exit(0)
            _, status = os.waitpid(child, 0)
            if not os.WIFSIGNALED(status):
                if os.waitstatus_to_exitcode(status) != 0:
                    raise SystemExit(f"the writer of {archive} failed")
                break


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))

"""Writers that are killed (SIGKILL) before each of their operations on the disk, and within each write.

    python -m tests.archive.killed_writers FOLDER EVERY STATE

makes one archive with a log after another in FOLDER, each with a writer that was killed EVERY operations later, until one lives to the end.
The writer seals a run, and signs the seal with the key of its bench, which is in the folder STATE.
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
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.bench.model import bench_of, shipped_benches
from planrunner.signing.bench_key import new_bench_key
from planrunner.tasks.bench_signature import sign_seal
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


def signing_bench(state: Path) -> bytes:
    """The virtual bench with a key, which is made in this state folder if it is not there."""
    os.environ["PLANRUNNER_STATE"] = str(state)
    public = state / "signing-keys" / "bench.pem.pub"
    if not public.exists():
        path, key = new_bench_key("bench")
        path.with_name(public.name).write_text(f"{key.public.line}\n")
    text = shipped_benches()["virtual"].read_text(encoding="utf-8")
    return f"{text}signing: {{key: {public.read_text().strip()}}}\n".encode()


def write_signed(archive: Path, bench: bytes) -> None:
    """A sealed run, signed by its bench as the end of a run signs it."""
    run = write_run(archive, analyses=0, bench=bench)
    assert not sign_seal(GuardedFolder.open(run), run.name, bench_of(bench, "bench.yaml"))


def main(folder: Path, every: int, state: Path) -> None:
    """every: 1 for every operation, 5 for each fifth one."""
    bench = signing_bench(state)
    for within in (False, True):
        number = 0
        while True:
            number += 1 if number == 0 else every
            archive = folder / f"{'within' if within else 'before'}-{number:03d}"
            RunLog.create(archive)
            child = os.fork()
            if child == 0:
                kill_at(number, within=within)
                write_signed(archive, bench)
                os._exit(0)
            _, status = os.waitpid(child, 0)
            if not os.WIFSIGNALED(status):
                if os.waitstatus_to_exitcode(status) != 0:
                    raise SystemExit(f"the writer of {archive} failed")
                break


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))

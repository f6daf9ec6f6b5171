"""Contains all write operations on a run folder.

Every write of the archive uses a `Storage`. A `Storage` has one of two modes. In the mode `durable`, a write survives a power
failure, because the file and its folder are synced (fsync). In the mode `flushed`, a write is passed to the operating system. It
survives the end of the process, but may be lost in a power failure. All writes are to a `GuardedFolder`, so that no link can
redirect them.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from io import BufferedReader, FileIO
from typing import Literal

from planrunner.base.guarded_folder import GuardedFolder

Durability = Literal["durable", "flushed"]
ASIDE = ".partial"


class Storage:
    """Performs file operations on a run folder that all have the same durability. Errors are raised as `OSError`, as the operating
    system reports them."""

    def __init__(self, durability: Durability = "durable"):
        if durability not in ("durable", "flushed"):
            raise ValueError(f"durability is 'durable' or 'flushed', not {durability!r}")
        self.durability = durability
        self.durable = durability == "durable"

    def make_folder(self, folder: GuardedFolder, name: str) -> GuardedFolder:
        return folder.make_folder(name)

    def open_new(self, folder: GuardedFolder, name: str) -> FileIO:
        """Opens a new file for writing, unbuffered."""
        return folder.open_new(name)

    def open_existing(self, folder: GuardedFolder, name: str) -> FileIO:
        """Opens a file for reading and writing, unbuffered, positioned at its end."""
        file = folder.open_existing(name)
        file.seek(0, os.SEEK_END)
        return file

    def write(self, file: FileIO, data: bytes | memoryview) -> None:
        """Writes all of `data`."""
        written = file.write(data)
        if written == len(data):
            return
        rest = memoryview(data)[written or 0 :]
        while len(rest):
            rest = rest[file.write(rest) or 0 :]

    def truncate(self, file: FileIO, size: int) -> None:
        file.truncate(size)
        file.seek(size)

    def sync(self, file: FileIO) -> None:
        """In durable mode, waits until the file's content is on the disk."""
        if self.durable:
            os.fsync(file.fileno())

    def sync_folder(self, folder: GuardedFolder) -> None:
        """In durable mode, waits until the names in a folder are on the disk."""
        if self.durable:
            folder.sync()

    def replace(self, folder: GuardedFolder, source: str, target: str) -> None:
        folder.replace(source, target)

    def rename(self, folder: GuardedFolder, source: str, target: str) -> None:
        folder.rename(source, target)

    def remove(self, folder: GuardedFolder, name: str) -> None:
        folder.remove(name)

    def write_whole(self, folder: GuardedFolder, name: str, data: bytes) -> None:
        """Writes a file atomically: it exists completely or not at all, even after a power failure."""
        aside = name + ASIDE
        try:
            with self.open_new(folder, aside) as file:
                self.write(file, data)
                self.sync(file)
            self.replace(folder, aside, name)
        except OSError:
            with contextlib.suppress(OSError):
                self.remove(folder, aside)
            raise
        self.sync_folder(folder)


def digest(data: bytes) -> str:
    """Returns the SHA-256 digest as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def digest_of(file: BufferedReader) -> str:
    """Returns the SHA-256 digest of an open file, which is read in pieces."""
    return hashlib.file_digest(file, "sha256").hexdigest()

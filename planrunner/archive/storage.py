"""The few ways in which a run folder touches the disk, all in one place.

Every write of the archive goes through a `Storage`, which knows whether a write must survive a power cut (`durable`:
fsync of the file and of the folder that names it) or only the end of the process (`flushed`: handed to the operating
system).
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from io import FileIO
from pathlib import Path
from typing import Literal

Durability = Literal["durable", "flushed"]
ASIDE = ".partial"


class Storage:
    """File operations at one durability. Errors are `OSError`, as the operating system gives them."""

    def __init__(self, durability: Durability = "durable"):
        if durability not in ("durable", "flushed"):
            raise ValueError(f"durability is 'durable' or 'flushed', not {durability!r}")
        self.durability = durability
        self.durable = durability == "durable"

    def make_folder(self, path: Path) -> None:
        path.mkdir()

    def open_new(self, path: Path) -> FileIO:
        """Open a file for writing from its beginning, unbuffered."""
        return FileIO(path, "w")

    def open_existing(self, path: Path) -> FileIO:
        """Open a file for reading and writing, unbuffered, at its end."""
        file = FileIO(path, "r+")
        file.seek(0, os.SEEK_END)
        return file

    def write(self, file: FileIO, data: bytes | memoryview) -> None:
        """Write all of `data`."""
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
        """Wait until the file's content is on the disk, in durable mode."""
        if self.durable:
            os.fsync(file.fileno())

    def sync_folder(self, path: Path) -> None:
        """Wait until the names in a folder are on the disk, in durable mode. Windows keeps names by itself and cannot
        be asked."""
        if not self.durable or os.name == "nt":
            return
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def replace(self, source: Path, target: Path) -> None:
        os.replace(source, target)

    def remove(self, path: Path) -> None:
        path.unlink(missing_ok=True)

    def write_whole(self, path: Path, data: bytes) -> None:
        """Write a file so that it is there whole or not at all, whenever the power goes."""
        aside = path.with_name(path.name + ASIDE)
        try:
            with self.open_new(aside) as file:
                self.write(file, data)
                self.sync(file)
            self.replace(aside, path)
        except OSError:
            with contextlib.suppress(OSError):
                self.remove(aside)
            raise
        self.sync_folder(path.parent)


def digest(data: bytes) -> str:
    """SHA-256 as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def digest_file(path: Path) -> str:
    """SHA-256 of a file, read in pieces."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

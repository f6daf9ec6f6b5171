"""An exclusive lock on a file, given back by the operating system when the process ends, however it ends."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


class HeldError(Exception):
    """Another process, or another lock of this one, holds the file; the message is the note that the holder left."""


class ExclusiveFile:
    """A lock on `path`, which is made when absent, held from creation to `release`.

    note: who holds it and for what, for whoever finds it held. mode: permissions of a new file. Raises `HeldError` when it is held,
    `OSError` when the file cannot be opened.
    """

    def __init__(self, path: Path, note: str = "", mode: int = 0o644):
        self._descriptor: int | None = _open(path, mode)
        try:
            _lock(self._descriptor)
        except OSError:
            held = _read_note(self._descriptor)
            self._close()
            raise HeldError(held) from None
        if note:
            _leave_note(self._descriptor, note)

    def release(self) -> None:
        if self._descriptor is not None:
            _unlock(self._descriptor)
            self._close()

    def _close(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


NOTE_AT = 1
"""The note begins behind the byte that is locked, so that it can be read while the lock is held, on Windows too."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0)


def _open(path: Path, mode: int) -> int:
    """Without creating it first: a system may refuse to create what another user has in a shared folder, but lets it be opened."""
    with contextlib.suppress(FileNotFoundError):
        try:
            return os.open(path, os.O_RDWR | NO_LINK)
        except PermissionError:
            return os.open(path, os.O_RDONLY | NO_LINK)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | NO_LINK, mode)
    with contextlib.suppress(OSError, AttributeError):
        os.fchmod(descriptor, mode)  # whatever the process's mask
    return descriptor


def _leave_note(descriptor: int, note: str) -> None:
    with contextlib.suppress(OSError):  # what belongs to another user can be locked, but not written
        os.ftruncate(descriptor, NOTE_AT)
        os.lseek(descriptor, NOTE_AT, os.SEEK_SET)
        os.write(descriptor, note.encode())


def _read_note(descriptor: int) -> str:
    with contextlib.suppress(OSError):
        os.lseek(descriptor, NOTE_AT, os.SEEK_SET)
        return os.read(descriptor, 1000).decode("utf-8", "replace").strip()
    return ""


if os.name == "nt":  # pragma: no cover (not the platform of continuous integration)
    import msvcrt

    def _lock(descriptor: int) -> None:
        os.lseek(descriptor, 0, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]

    def _unlock(descriptor: int) -> None:
        os.lseek(descriptor, 0, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)  # type: ignore[attr-defined,unused-ignore]

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _unlock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_UN)

"""Locks a file exclusively: only one process at a time holds the lock. The operating system releases the lock when the process ends
for any reason."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from pathlib import Path

from planrunner.base.regular_files import open_flags

COMMAND = contextlib.ExitStack()
"""The locks of the running command. `cli.main` releases them when the command ends."""


class HeldError(Exception):
    """The lock on the file is already held, by another process or by another lock of this process. The message is the note that the
    holder wrote into the file."""


class ExclusiveFile:
    """Locks the file `path`, from creation to `release`. The file is created if absent.

    `note`: a text that states who holds the lock and why; others who request the lock see it. `mode`: permissions of the file if it
    is created. `opened`: descriptor of the file if the caller has already opened it; it is closed with the lock. Raises `HeldError`
    if the lock is held, and `OSError` if the file cannot be opened or is not a regular file with exactly one name. These checks are
    important in a folder to which all users may write: through a link, the lock could overwrite another user's file, and the
    opening of a pipe could block for ever.
    """

    def __init__(self, path: Path, note: str = "", mode: int = 0o644, *, opened: int | None = None):
        self._descriptor: int | None = None
        for _ in range(ATTEMPTS):
            self._descriptor = _open(path, mode) if opened is None else opened
            try:
                _lock(self._descriptor)
            except OSError:
                held = _read_note(self._descriptor)
                self._close()
                raise HeldError(held) from None
            if opened is not None or _is_still(self._descriptor, path):
                break
            self._close()  # removed or replaced before it was locked: the next process would lock a different file
        if self._descriptor is None:
            raise OSError(errno.EAGAIN, "another process keeps removing the lock", str(path))
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


ATTEMPTS = 10
NOTE_AT = 1
"""Position at which the note begins. The locked byte precedes the note, so the note can be read while the lock is held, on Windows
too."""
LONGEST_NOTE = 300
NO_LINK = open_flags("O_NOFOLLOW", "O_NONBLOCK", "O_NOCTTY")


def _open(path: Path, mode: int) -> int:
    """Opens the file; creates the file if it does not exist. The first attempt does not have the option to create the file. In a
    shared folder, a system may permit opening an existing file of another user only without this option. `mode`: permissions of the
    file if it is created."""
    with contextlib.suppress(FileNotFoundError):
        _hold(os.lstat(path), path)
        try:
            return _held(os.open(path, os.O_RDWR | NO_LINK), path)
        except PermissionError:
            return _held(os.open(path, os.O_RDONLY | NO_LINK), path)
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | NO_LINK, mode)
    except FileExistsError:  # another process was faster
        return _open(path, mode)
    with contextlib.suppress(OSError, AttributeError):
        os.fchmod(descriptor, mode)  # independent of the umask
    return descriptor


def _held(descriptor: int, path: Path) -> int:
    try:
        _hold(os.fstat(descriptor), path)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _hold(known: os.stat_result, path: Path) -> None:
    """Checks the status of the file. Raises `OSError` if it is not a regular file with exactly one name."""
    if stat.S_ISLNK(known.st_mode):
        raise OSError(errno.ELOOP, "it is a symbolic link", str(path))
    if not stat.S_ISREG(known.st_mode) or known.st_nlink > 1:
        raise OSError(errno.EINVAL, "it is not a regular file with one name", str(path))


def _is_still(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except FileNotFoundError:
        return False


def _leave_note(descriptor: int, note: str) -> None:
    with contextlib.suppress(OSError):  # a file of another user can be locked, but not written
        os.ftruncate(descriptor, NOTE_AT)
        os.lseek(descriptor, NOTE_AT, os.SEEK_SET)
        os.write(descriptor, note.encode())


def _read_note(descriptor: int) -> str:
    """Reads the note without terminal control characters, because another user may have written it."""
    with contextlib.suppress(OSError):
        os.lseek(descriptor, NOTE_AT, os.SEEK_SET)
        text = os.read(descriptor, LONGEST_NOTE).decode("utf-8", "replace").strip()
        return "".join(letter if letter.isprintable() else "?" for letter in text)
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

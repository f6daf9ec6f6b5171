"""Provides access to a folder that is opened once. All access is relative to the open folder, and no entry can lead out of it.

A run folder may come from an untrusted source and may change while it is read. Therefore links in it are not followed. Only regular
files with exactly one name are opened, not pipes or devices, and no file larger than the caller permits. A name is a single path
component, so no path leads out of the folder.

On Linux and macOS, names are opened relative to the open folder, so the file that was checked is the file that is used. Windows
cannot do this. There, the folder and the name are checked before and after a file is opened, and both checks must find the same
file. These two checks are the strictest method available, but they do not detect a change that is undone before the second check.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
import time
import weakref
from dataclasses import dataclass, field
from functools import lru_cache
from io import BufferedReader, FileIO
from pathlib import Path
from typing import Literal

from planrunner.base.regular_files import file_kind, open_flags

RELATIVE = os.open in os.supports_dir_fd and os.rename in os.supports_dir_fd and hasattr(os, "O_NOFOLLOW")
"""True if this system can open names relative to an open folder."""
MOST_ENTRIES = 250_000
"""Largest number of entries of one folder that are read."""

_READ = os.O_RDONLY | open_flags("O_CLOEXEC", "O_BINARY")
_WRITE = os.O_RDWR | open_flags("O_CLOEXEC", "O_BINARY")
_NEVER = open_flags("O_NOFOLLOW", "O_NONBLOCK", "O_NOCTTY")
"""Flags for opening a file: links are not followed, and the call never waits, for example for the other end of a pipe."""
_REPARSE_POINT = 0x400  # FILE_ATTRIBUTE_REPARSE_POINT: links and junctions of Windows
_LOOKS = 3

EntryKind = Literal["file", "folder", "other"]


class NotOrdinaryError(OSError):
    """Reports that an entry is not a regular file (or folder) with exactly one name and of acceptable size. `strerror` gives the
    reason, `filename` the path."""

    def __init__(self, path: Path, what: str):
        super().__init__(errno.EPERM, what, str(path))

    def __reduce__(self) -> tuple[object, ...]:  # the arguments of `OSError` are not those of this class
        return type(self), (Path(self.filename), self.strerror)


@dataclass(frozen=True, slots=True)
class Entry:
    """Describes an entry of a folder: its kind and, for a file, its size in bytes.

    The kind `other` means a link, a pipe, a device, or a file with two names. `modified`: time of the last change of the file's
    content, in ns since 1970 by the clock of the file system."""

    kind: EntryKind
    size: int
    what: str
    modified: int = field(default=0, compare=False)


class GuardedFolder:
    """An open folder. `path`: the path of the folder, for messages. All methods take one name, not a path. They raise `OSError`
    and, for an entry that is not a regular file or folder, `NotOrdinaryError`. They raise ValueError for a name that is a path.

    The folder is closed by `close` or when the object is deleted.
    """

    def __init__(self, path: Path, descriptor: int | None, identity: tuple[int, int]):
        self.path = path
        self._descriptor = descriptor
        self._identity = identity
        self._release = weakref.finalize(self, os.close, descriptor) if descriptor is not None else None

    @classmethod
    def open(cls, path: Path) -> GuardedFolder:
        """Opens a folder that the user named. `path` itself may contain links. Raises `OSError` if the folder cannot be opened."""
        if not RELATIVE:
            status = os.stat(path)
            if not stat.S_ISDIR(status.st_mode):
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
            return cls(path, None, (status.st_dev, status.st_ino))
        descriptor = os.open(path, _READ | os.O_DIRECTORY)
        return cls(path, descriptor, _identity(os.fstat(descriptor)))

    def close(self) -> None:
        if self._release is not None:
            self._release()
            self._descriptor = None
            self._release = None

    # -- looking -----------------------------------------------------------------------------------------------------

    def entries(self) -> dict[str, Entry]:
        """Returns the entries of the folder by name, sorted by name."""
        self._check_place()
        found: dict[str, Entry] = {}
        with os.scandir(self.path if self._descriptor is None else self._descriptor) as listed:
            for item in listed:
                if len(found) >= MOST_ENTRIES:
                    raise NotOrdinaryError(self.path, f"it has more than {MOST_ENTRIES} entries")
                with contextlib.suppress(FileNotFoundError):
                    found[item.name] = _entry(self._status(item.name))
        return dict(sorted(found.items()))

    def entry(self, name: str) -> Entry | None:
        """Returns the entry at a name; None if there is none."""
        self._check_place()
        try:
            return _entry(self._status(_plain(name)))
        except FileNotFoundError:
            return None

    # -- folders -----------------------------------------------------------------------------------------------------

    def folder(self, name: str) -> GuardedFolder:
        """Opens a folder in this folder."""
        path = self.path / _plain(name)
        self._check_place()
        entry = _entry(self._status(name))
        if entry.kind != "folder":
            raise NotOrdinaryError(path, f"it is {entry.what}, but a folder is expected here")
        if self._descriptor is None:
            return GuardedFolder(path, None, _identity(self._status(name)))
        try:
            descriptor = os.open(name, _READ | os.O_DIRECTORY | _NEVER, dir_fd=self._descriptor)
        except OSError as error:
            if error.errno in (errno.ELOOP, errno.EMLINK, errno.ENOTDIR):
                raise NotOrdinaryError(path, "it is a link, but a folder is expected here") from None
            raise
        return GuardedFolder(path, descriptor, _identity(os.fstat(descriptor)))

    def make_folder(self, name: str) -> GuardedFolder:
        self._check_place()
        os.mkdir(self._at(_plain(name)), dir_fd=self._descriptor)
        return self.folder(name)

    def remove_folder(self, name: str) -> None:
        """Removes a folder with its contents, as far as possible. Links in it are removed, but not followed."""
        self._check_place()
        shutil.rmtree(self._at(_plain(name)), ignore_errors=True, dir_fd=self._descriptor)

    # -- files -------------------------------------------------------------------------------------------------------

    def open_file(self, name: str, limit: int) -> BufferedReader:
        """Opens a file of at most `limit` bytes for reading."""
        return os.fdopen(self._open(name, _READ, limit), "rb")

    def read(self, name: str, limit: int) -> bytes:
        """Returns the contents of a file of at most `limit` bytes."""
        with self.open_file(name, limit) as file:
            data = file.read(limit + 1)
        if len(data) > limit:
            raise NotOrdinaryError(self.path / name, f"it grew beyond {limit} bytes while it was being read")
        return data

    def open_existing(self, name: str) -> FileIO:
        """Opens a file for reading and writing, unbuffered, positioned at its start."""
        return FileIO(self._open(name, _WRITE, None), "r+")

    def open_new(self, name: str) -> FileIO:
        """Opens a new file for writing, unbuffered. An existing entry with this name is removed; if it is a link, it is not
        followed."""
        self._check_place()
        where = self._at(_plain(name))
        flags = _WRITE | os.O_CREAT | os.O_EXCL | _NEVER
        try:
            descriptor = os.open(where, flags, 0o666, dir_fd=self._descriptor)
        except FileExistsError:
            os.unlink(where, dir_fd=self._descriptor)
            descriptor = os.open(where, flags, 0o666, dir_fd=self._descriptor)
        return FileIO(descriptor, "w")

    def open_or_make(self, name: str, mode: int = 0o644) -> int:
        """Opens a file for reading and writing, or only for reading if writing is not permitted; returns its descriptor. The file
        is created if it does not exist. `mode`: permissions of the file if it is created."""
        where = self._at(_plain(name))
        with contextlib.suppress(FileNotFoundError):
            try:
                return self._open(name, _WRITE, None)
            except PermissionError as error:
                if isinstance(error, NotOrdinaryError):
                    raise
                return self._open(name, _READ, None)
        with contextlib.suppress(FileExistsError):  # another process was first
            return os.open(where, _WRITE | os.O_CREAT | os.O_EXCL | _NEVER, mode, dir_fd=self._descriptor)
        return self._open(name, _WRITE, None)

    def replace(self, source: str, target: str) -> None:
        """Renames a file to `target`, replacing an existing file."""
        self._check_place()
        os.replace(
            self._at(_plain(source)),
            self._at(_plain(target)),
            src_dir_fd=self._descriptor,
            dst_dir_fd=self._descriptor,
        )

    def rename(self, source: str, target: str) -> None:
        """Renames a file or folder. The system refuses this if `target` is a file or a non-empty folder."""
        self._check_place()
        os.rename(
            self._at(_plain(source)),
            self._at(_plain(target)),
            src_dir_fd=self._descriptor,
            dst_dir_fd=self._descriptor,
        )

    def remove(self, name: str) -> None:
        """Removes a file. A link is removed, not its target. A missing file is not an error."""
        self._check_place()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._at(_plain(name)), dir_fd=self._descriptor)

    def sync(self) -> None:
        """Waits until the names in the folder are on the disk. On Windows, it does nothing, because Windows writes the names itself
        and has no call for this."""
        if self._descriptor is not None:
            os.fsync(self._descriptor)

    # -- how it is guarded -------------------------------------------------------------------------------------------

    def _at(self, name: str) -> str:
        """Returns the name in the form that system calls need: relative to the open folder or, on a system that cannot keep a
        folder open, with the path of the folder."""
        return name if self._descriptor is not None else str(self.path / name)

    def _status(self, name: str) -> os.stat_result:
        return os.stat(self._at(name), dir_fd=self._descriptor, follow_symlinks=False)

    def _check_place(self) -> None:
        """Checks, on a system that cannot keep a folder open, that the path still leads to the same folder."""
        if self._descriptor is None and _identity(os.stat(self.path)) != self._identity:
            raise NotOrdinaryError(self.path, "the folder was replaced by another while it was in use")

    def _open(self, name: str, flags: int, limit: int | None) -> int:
        """Opens a regular file that has one name and at most `limit` bytes; returns its descriptor. `flags`: flags of `os.open`."""
        path = self.path / _plain(name)
        for look in range(_LOOKS):
            self._check_place()
            before = self._status(name)
            _require(path, before, limit)  # checked before opening, because opening a device may start something
            try:
                descriptor = os.open(self._at(name), flags | _NEVER, dir_fd=self._descriptor)
            except OSError as error:
                if error.errno in (errno.ELOOP, errno.EMLINK, errno.ENXIO):
                    raise NotOrdinaryError(path, "it is a link or a pipe, but a file is expected here") from None
                raise
            try:
                status = os.fstat(descriptor)
                _require(path, status, limit)
                if self._descriptor is not None:
                    return descriptor
                self._check_place()
                if _identity(before) == _identity(status) == _identity(self._status(name)):
                    return descriptor
            except BaseException:
                os.close(descriptor)
                raise
            os.close(descriptor)
            time.sleep(0.01 * look)
        raise NotOrdinaryError(path, "the file was replaced while it was being opened")


@lru_cache(maxsize=64)  # the same few names come again at every step of a run
def _plain(name: str) -> str:
    if name in ("", ".", "..") or any(letter in name for letter in "/\\\0") or (os.name == "nt" and ":" in name):
        raise ValueError(f"not a single file name: {name!r}")
    return name


def _identity(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


def _entry(status: os.stat_result) -> Entry:
    what = _what(status)
    kind: EntryKind = "folder" if what == "a folder" else "file" if what == "a file" else "other"
    return Entry(kind, status.st_size, what, status.st_mtime_ns)


def _what(status: os.stat_result) -> str:
    kind = "a link" if getattr(status, "st_file_attributes", 0) & _REPARSE_POINT else file_kind(status)
    return "a file that has a second name (a hard link)" if kind == "a file" and status.st_nlink > 1 else kind


def _require(path: Path, status: os.stat_result, limit: int | None) -> None:
    what = _what(status)
    if what != "a file":
        raise NotOrdinaryError(path, f"it is {what}, but a regular file with only one name is expected here")
    if limit is not None and status.st_size > limit:
        raise NotOrdinaryError(path, f"it has {status.st_size} bytes; at most {limit} are allowed")

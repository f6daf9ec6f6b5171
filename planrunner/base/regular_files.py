"""Opens files that the user names. Only regular files within a size limit are opened; any other file is refused, with the reason.

Everything that planrunner reads (plans, benches, templates, recordings, run folders) is opened here. A pipe without a writer would
block the program for ever, `/dev/zero` would fill the memory, and opening a device can move an instrument. The kind of a file is
therefore checked before it is opened and again afterwards. On Windows, opening a file may block, and links are followed. There,
only the check before opening protects against blocking and links.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO, Literal

FileKind = Literal["a file", "a folder", "a link", "a pipe", "a socket", "a device", "something else"]

_KINDS: tuple[tuple[int, FileKind], ...] = (
    (stat.S_IFREG, "a file"),
    (stat.S_IFDIR, "a folder"),
    (stat.S_IFLNK, "a link"),
    (stat.S_IFIFO, "a pipe"),
    (stat.S_IFSOCK, "a socket"),
    (stat.S_IFCHR, "a device"),
    (stat.S_IFBLK, "a device"),
)


def open_flags(*names: str) -> int:
    """Returns the flags of `os.open` with these names, such as O_NOFOLLOW. Flags that this system does not have are omitted."""
    flags = 0
    for name in names:
        flags |= getattr(os, name, 0)
    return flags


def file_kind(status: os.stat_result) -> FileKind:
    """Returns the kind of a file from the result of `os.stat` or `os.lstat`. The kind is "a link" only if the result describes the
    link itself."""
    kind = stat.S_IFMT(status.st_mode)
    return next((word for number, word in _KINDS if number == kind), "something else")


Refusal = Literal["missing", "folder", "special", "link", "size", "unreadable"]

_READING = os.O_RDONLY | open_flags("O_BINARY", "O_CLOEXEC", "O_NOINHERIT", "O_NOCTTY", "O_NONBLOCK")
_NO_LINK = open_flags("O_NOFOLLOW")


class RefusedFileError(Exception):
    """Reports that a file is refused. `kind`: the reason in one word. `hint`: the remedy. `str()` gives the reason as a sentence
    without the file name."""

    def __init__(self, kind: Refusal, message: str, hint: str):
        super().__init__(message)
        self.kind: Refusal = kind
        self.hint = hint

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.kind, str(self), self.hint)


def open_regular(
    path: Path | str, limit: int | None = None, *, folder: int | None = None, links: bool = True
) -> BinaryIO:
    """Opens a regular file for reading from its beginning.

    `limit`: largest size in bytes, None if the reader sets its own limit. `folder`: descriptor of the open folder to which `path`
    is relative; usable only if the system supports this (`os.open in os.supports_dir_fd`). `links`: True if the last component of
    the path may be a symbolic link. Raises `RefusedFileError`, never `OSError`.
    """
    try:
        _hold(os.stat(path, dir_fd=folder, follow_symlinks=links), limit)
        descriptor = os.open(path, _READING | (0 if links else _NO_LINK), dir_fd=folder)
        try:
            _hold(os.fstat(descriptor), limit)
            return open(descriptor, "rb")
        except BaseException:
            os.close(descriptor)
            raise
    except FileNotFoundError:
        raise RefusedFileError("missing", "there is no such file", "check the path") from None
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        raise _unreadable(error) from None


def read_regular(path: Path | str, limit: int, *, folder: int | None = None, links: bool = True) -> bytes:
    """Returns the contents of a regular file of at most `limit` bytes (see `open_regular`). Raises `RefusedFileError` for any other
    file. `folder`, `links`: the same as in `open_regular`."""
    with open_regular(path, limit, folder=folder, links=links) as file:
        return read_bounded(file, limit)


def read_bounded(file: BinaryIO, limit: int) -> bytes:
    """Returns the rest of an open file, at most `limit` bytes even if the file grows while it is read. Raises `RefusedFileError` if
    the file is larger or cannot be read."""
    try:
        data = file.read(min(limit, _USUAL) + 1)  # a larger buffer is costly, and most files need none
        if data is not None and _USUAL < len(data) <= limit:
            data += file.read(limit + 1 - len(data)) or b""
    except OSError as error:
        raise _unreadable(error) from None
    if data is None:  # a system file that would make the read wait
        raise RefusedFileError("special", "reading from this file could block forever", _SAVE)
    if len(data) > limit:
        raise _too_large(len(data), limit)
    return data


_USUAL = 65_536  # bytes
_SAVE = "save its content to a file, and give that file"


def _hold(known: os.stat_result, limit: int | None) -> None:
    kind = file_kind(known)
    if kind == "a folder":
        raise RefusedFileError("folder", "this is a folder, not a file", "give a file in this folder")
    if kind == "a link":
        raise RefusedFileError("link", "this is a link, not the file itself", "replace the link by the file")
    if kind != "a file":
        raise RefusedFileError("special", f"this is {kind}, not a regular file", _SAVE)
    if limit is not None and known.st_size > limit:
        raise _too_large(known.st_size, limit)


def _too_large(size: int, limit: int) -> RefusedFileError:
    return RefusedFileError("size", f"the file is larger than {_amount(limit)}", f"keep it below {_amount(limit)}")


def _amount(size: int) -> str:
    return f"{size / 1e9:g} GB" if size >= 1e9 else f"{size / 1e6:g} MB" if size >= 1e4 else f"{size} bytes"


def _unreadable(error: Exception) -> RefusedFileError:
    reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return RefusedFileError(
        "unreadable",
        f"the file cannot be read: {reason}",
        "check its permissions, and whether another program has locked it",
    )

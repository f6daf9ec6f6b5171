"""Names the kind of a file system entry by one word, which is the same on all systems, and provides the flags for opening it that a
system has."""

from __future__ import annotations

import os
import stat
from typing import Literal

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
    """The flags of `os.open` with these names, such as O_NOFOLLOW. Flags that this system lacks are omitted."""
    flags = 0
    for name in names:
        flags |= getattr(os, name, 0)
    return flags


def file_kind(status: os.stat_result) -> FileKind:
    """The kind of a file from the result of `os.stat` or `os.lstat`; "a link" only if the result describes the link itself."""
    kind = stat.S_IFMT(status.st_mode)
    return next((word for number, word in _KINDS if number == kind), "something else")

"""Checks that only the user and the administrator can change a folder, along its whole path.

planrunner keeps compiled code and locks outside the folders that it is given. Other users must not be able to place files there,
because cached code is executed when it is read, and a link in place of a lock file would redirect writes. Therefore every folder
from the root down, and every link on the way, must belong to the user or the administrator and must not be writable by others. A
folder to which all users may write is accepted if it has the sticky bit, like `/tmp`. The check also covers access control lists,
because POSIX shows them in the group bits.

Windows has no such permission bits. On Windows, the only accepted folders are the system's data folders for the user or for all
users (`user_data`, `computer_data`). Their access control lists give the same protection. No folder below them may be a link or a
junction.
"""

from __future__ import annotations

import errno
import os
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

_MOST_LINKS = 40
ADMINISTRATOR = 0
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
OTHERS_ENTER = stat.S_IXGRP | stat.S_IXOTH


class UntrustedFolderError(Exception):
    """Reports a folder whose contents another user could change. The message gives the folder and the reason."""


def this_user() -> int:
    """Returns the number of the current user; 0 on Windows, which has no user numbers."""
    return 0 if sys.platform == "win32" else os.geteuid()


def trusted(folder: Path, user: int | None = None) -> Path:
    """Returns the path of the folder with links resolved, if only `user` (by default the current user) and the administrator can
    change it. Raises `UntrustedFolderError` otherwise, and `OSError` for a missing folder."""
    user = this_user() if user is None else user
    walked = list(_components(folder))
    for path, known in walked:
        hold(path, known, user)
    found, known = walked[-1]
    if not stat.S_ISDIR(known.st_mode):
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(found))
    return found


def trusted_within(folder: Path, user: int | None = None) -> None:
    """Checks every entry in a trusted folder: it must be a folder or file of the user or the administrator, and must not be a link.
    Raises `UntrustedFolderError` for any other entry, and `OSError` if the folder cannot be read."""
    user = this_user() if user is None else user
    reachable = bool(folder.lstat().st_mode & OTHERS_ENTER)
    for place, folders, files in os.walk(folder, onerror=_raise):
        for name in (*folders, *files):
            path = Path(place, name)
            try:
                known = path.lstat()
            except FileNotFoundError:  # another process of the user has just put a file in place
                continue
            if not (stat.S_ISREG(known.st_mode) or stat.S_ISDIR(known.st_mode)) or _is_junction(known):
                raise UntrustedFolderError(f"{path} is neither a file nor a folder")
            hold(path, known, user, reachable=reachable)


def hold(path: Path, known: os.stat_result, user: int, *, reachable: bool = True) -> None:
    """Checks one entry. Raises `UntrustedFolderError` if it belongs to another user or if others may write to it. `reachable`:
    False if other users cannot reach the entry. In this case, the function does not check whether others may write to the entry."""
    if sys.platform == "win32":
        return
    if known.st_uid not in (user, ADMINISTRATOR):
        raise UntrustedFolderError(f"{path} belongs to another user (user ID {known.st_uid})")
    if stat.S_ISLNK(known.st_mode) or not reachable:
        return
    if known.st_mode & OTHERS_WRITE and not (stat.S_ISDIR(known.st_mode) and known.st_mode & stat.S_ISVTX):
        raise UntrustedFolderError(f"others may write to {path} (mode {stat.S_IMODE(known.st_mode):o})")


def make_private(folder: Path) -> None:
    """Makes a folder, and missing folders above it, accessible to the user alone. Raises `OSError` if the folder cannot be made."""
    for path in (*reversed(folder.parents), folder):
        if not path.exists():
            path.mkdir(mode=0o700, exist_ok=True)


def computer_data() -> Path:
    """Returns the system's data folder for all users on Windows, independent of environment variables."""
    return _known_folder(0x23)


def user_data() -> Path:
    """Returns the system's folder for this user's local data on Windows, independent of environment variables."""
    return _known_folder(0x1C)


def user_cache(variable: str, name: str) -> Path:
    """Returns the folder for this user's cached data. `variable`: environment variable that may name this folder. If the variable
    is not set, the result is the folder `name` in planrunner's part of the system's folder for caches."""
    stated = os.environ.get(variable)
    if stated:
        return Path(stated)
    if sys.platform == "win32":
        return user_data() / "planrunner" / name
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "planrunner" / name


def _known_folder(number: int) -> Path:  # pragma: no cover (Windows)
    import ctypes

    room = ctypes.create_unicode_buffer(260)
    shell = ctypes.windll.shell32  # type: ignore[attr-defined,unused-ignore]
    if shell.SHGetFolderPathW(None, number, None, 0, room) != 0 or not room.value:
        raise OSError(f"the system does not report the path of its folder {number:#x}")
    return Path(room.value)


def _components(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yields every folder and every link on the path from the root to `folder`, each with its file status."""
    path = Path(os.path.abspath(folder))
    here, ahead, links = Path(path.anchor), list(path.parts[1:]), 0
    yield here, here.lstat()
    while ahead:
        name = ahead.pop(0)
        if name == os.pardir:
            here = here.parent
            continue
        known = (here / name).lstat()
        if not (stat.S_ISLNK(known.st_mode) or _is_junction(known)):
            here = here / name
            yield here, known
            continue
        links += 1
        if links > _MOST_LINKS:
            raise UntrustedFolderError(f"{folder} is an endless chain of links")
        if _is_junction(known):
            raise UntrustedFolderError(f"{here / name} is a junction")
        yield here / name, known
        target = Path(os.readlink(here / name))
        here = Path(target.anchor) if target.is_absolute() else here
        ahead = [*(target.parts[1:] if target.is_absolute() else target.parts), *ahead]


def _is_junction(known: os.stat_result) -> bool:
    attributes: int = getattr(known, "st_file_attributes", 0)
    return bool(attributes & 0x400) and not stat.S_ISLNK(known.st_mode)


def _raise(error: OSError) -> None:
    raise error

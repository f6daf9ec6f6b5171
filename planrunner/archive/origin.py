"""Checks whether this user made a run folder on this computer. The check needs no network and does not trust the folder.

The user's state folder contains a key of 32 random bytes. With this key, an HMAC-SHA-256 of the digest of the journal's first line
is computed and stored in the run folder as `.origin`. The first line of the journal contains the digests of run.json, plan and
bench. `.origin` cannot be made without the key, is valid for one run only, and reveals nothing about the key, the user or the
computer. If there is no state folder, runs are still possible, but their origin is unknown.
"""

from __future__ import annotations

import contextlib
import hmac
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from planrunner.archive.lock import NAME as LOCK
from planrunner.archive.storage import ASIDE
from planrunner.base.exclusive import ExclusiveFile, HeldError
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.base.trusted_folders import UntrustedFolderError, make_private, this_user, trusted, user_data

NAME = ".origin"
STATE = "PLANRUNNER_STATE"
"""Environment variable for a different folder for the key."""
KEY = "origin.key"
KEY_BYTES = 32
PATIENCE = 5.0
"""Longest time [s] to wait while another process makes the key."""
_PURPOSE = b"planrunner run folder 1\n"


class OriginUnknownError(Exception):
    """Reports that the key of this user cannot be read or made. The message gives the reason."""


def state_folder() -> Path:
    """Returns the folder for the key of this user. Raises `OriginUnknownError` if there is no such folder."""
    stated = os.environ.get(STATE)
    try:
        if stated:
            return Path(stated)
        if sys.platform == "win32":
            return user_data() / "planrunner"
        if sys.platform == "darwin":
            return _home() / "Library" / "Application Support" / "planrunner"
        return Path(os.environ.get("XDG_STATE_HOME") or _home() / ".local" / "state") / "planrunner"
    except (RuntimeError, OSError):
        raise OriginUnknownError(f"this user has no home folder; set {STATE} to a folder that belongs to you") from None


def _home() -> Path:
    """Returns the home folder from the environment. An empty HOME counts as missing, because it would mean the current folder,
    which may belong to anyone."""
    if os.environ.get("HOME") == "":
        raise RuntimeError
    return Path.home()


def leave_origin(run: GuardedFolder, first: str) -> None:
    """Marks a new run folder as made by this user on this computer, if a key is available. `first`: digest of the journal's first
    line. Raises `OSError` if the run folder cannot be written."""
    try:
        key = _key(make=True)
    except OriginUnknownError:
        return
    if not key:
        return
    with run.open_new(NAME) as file:
        file.write(_mark(key, first).encode() + b"\n")


def made_here(run: GuardedFolder, first: str) -> bool:
    """Returns True if this user made the run folder on this computer. Raises `OriginUnknownError` if this cannot be determined."""
    key = _key(make=False)
    if not key:
        return False
    try:
        mark = run.read(NAME, 100)
    except OSError:
        return False
    return hmac.compare_digest(mark.strip(), _mark(key, first).encode())


def foreign(run: GuardedFolder, first: str) -> str:
    """Returns the reason why a run folder counts as made elsewhere; empty if this user made it on this computer. The bench file of
    a run that was made elsewhere must not determine the instruments to which planrunner connects, or the data that planrunner
    signs."""
    try:
        return "" if made_here(run, first) else "you did not make this run folder on this computer"
    except OriginUnknownError as error:
        return f"planrunner cannot determine whether this run folder was made on this computer: {error}"


def _mark(key: bytes, first: str) -> str:
    return hmac.new(key, _PURPOSE + first.encode(), "sha256").hexdigest()


def _key(make: bool) -> bytes:
    """Reads the key. If there is no key, the function makes a key if `make` is True; otherwise, it returns empty bytes. Raises
    `OriginUnknownError` if the key cannot be read or made."""
    path = state_folder()
    try:
        if make:
            make_private(path)
        folder = GuardedFolder.open(trusted(path))
        if folder.entry(KEY) is None:
            if not make:
                return b""
            _make_key(folder)
        return _read_key(folder)
    except FileNotFoundError:
        return b""
    except (OSError, UntrustedFolderError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise OriginUnknownError(f"{path}: {why}; set {STATE} to a folder that belongs to you") from None


def _make_key(folder: GuardedFolder) -> None:
    """Makes the key of this user. If two processes try this at the same time, the second process waits and uses the key that the
    first process made."""
    with _alone(folder):
        if folder.entry(KEY) is not None:
            return
        aside = KEY + ASIDE
        with folder.open_new(aside) as file:
            with contextlib.suppress(AttributeError, OSError):
                os.fchmod(file.fileno(), 0o600)
            file.write(os.urandom(KEY_BYTES))
            os.fsync(file.fileno())
        folder.replace(aside, KEY)
        folder.sync()


@contextlib.contextmanager
def _alone(folder: GuardedFolder) -> Iterator[None]:
    """Holds a lock, so that only one process at a time executes the enclosed code. Raises `OSError` if another process does not
    release the lock."""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            lock = ExclusiveFile(folder.path / LOCK, opened=folder.open_or_make(LOCK, 0o600))
            break
        except HeldError:
            if time.monotonic() > deadline:
                raise OSError(f"another process holds {LOCK}") from None
            time.sleep(0.01)
    try:
        yield
    finally:
        lock.release()


def _read_key(folder: GuardedFolder) -> bytes:
    with folder.open_file(KEY, KEY_BYTES) as file:
        status = os.fstat(file.fileno())
        key = file.read(KEY_BYTES + 1)
    if sys.platform != "win32" and (status.st_uid != this_user() or status.st_mode & 0o077):
        raise OriginUnknownError(f"{folder.path / KEY} belongs to another user, or others may read it: remove it")
    if len(key) != KEY_BYTES:
        raise OriginUnknownError(f"{folder.path / KEY} is not a key: remove it")
    return key

"""Functions compiled by numba whose machine code is kept for the next process, in a folder that nobody else can change.

Only modules that hold kernels import this one, and they are imported only where a kernel is needed, because importing numba takes longer
than checking a plan. Kept code is executed when it is read: numba's index and data files are pickles. So it is kept only where every
folder of the path, and everything in it, belongs to the user (or the administrator) and can be written by nobody else; else it is
compiled anew in each process. On Windows that is the folder which the system keeps for the user's own data, and no other. Nothing is
ever kept beside the source.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numba

from planrunner.base.trusted_folders import UntrustedFolderError, make_private, trusted, trusted_within, user_data

KEPT = Path("planrunner") / "compiled"


def cache_folder(environment: Mapping[str, str], user: int | None = None) -> Path | None:
    """Where compiled code may be kept, or None where no folder can be made or written.

    environment: of the process, in which `NUMBA_CACHE_DIR` or `XDG_CACHE_HOME` may name another folder than the user's `~/.cache`, except
    on Windows. user: this one without it. Raises `UntrustedFolderError` where somebody else could have put code.
    """
    try:
        folder = _base(environment) / KEPT
        make_private(folder)
        folder = trusted(folder, user)
        trusted_within(folder, user)
    except (OSError, RuntimeError):
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


def _base(environment: Mapping[str, str]) -> Path:
    if sys.platform == "win32":
        return user_data()
    named = environment.get("NUMBA_CACHE_DIR") or environment.get("XDG_CACHE_HOME")
    return Path(named) if named else Path.home() / ".cache"


@functools.cache
def _cache_folder() -> Path | None:
    """The same, of this process; the reason why code is not kept is reported once."""
    try:
        return cache_folder(os.environ)
    except UntrustedFolderError as error:
        print(
            f"note: compiled code is not kept, which costs some seconds: {error}; make the folder your own alone (chmod go-w), or name "
            "another one in NUMBA_CACHE_DIR",
            file=sys.stderr,
        )
        return None


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator like `numba.njit(**options)` that keeps the machine code for the next process."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        folder = _cache_folder()
        if folder is None:
            alone: Callable[..., Any] = numba.njit(**options)(function)
            return alone
        config: Any = numba.config
        before = config.CACHE_DIR
        try:
            # numba settles where a function's code is kept when it is decorated.
            config.CACHE_DIR = str(folder)
            made: Any = numba.njit(cache=True, **options)(function)
        finally:
            config.CACHE_DIR = before
        if folder not in Path(made.stats.cache_path).parents:  # another setting of numba's has sent it elsewhere
            made = numba.njit(**options)(function)
        kernel: Callable[..., Any] = made
        return kernel

    return decorate

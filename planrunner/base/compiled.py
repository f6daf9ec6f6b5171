"""Compiles functions with numba and keeps their machine code in a folder that no other user can change.

Importing numba takes longer than checking a plan. Therefore only modules with kernels import this module, and such modules are
imported only where a kernel is needed. Reading the cache executes code, because numba's index and data files are pickles. The cache
is therefore used only under one condition: every folder of its path, and everything in it, belongs to the user or the
administrator, and nobody else can write there. Otherwise, each process compiles the functions again. On Windows, only the system's
folder for the user's data meets this condition. Nothing is ever cached next to the source.
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


def cache_folder(environment: Mapping[str, str]) -> Path | None:
    """Returns the folder for compiled code; None if no folder can be made or written to.

    `environment`: the variables of the process; except on Windows, `NUMBA_CACHE_DIR` or `XDG_CACHE_HOME` may replace the user's
    `~/.cache`. Raises `UntrustedFolderError` if another user could write code there.
    """
    try:
        folder = _base(environment) / KEPT
        make_private(folder)
        folder = trusted(folder)
        trusted_within(folder)
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
    """Returns the cache folder of this process. If there is none, the reason is reported once."""
    try:
        return cache_folder(os.environ)
    except UntrustedFolderError as error:
        print(
            f"note: compiled code cannot be cached, so a run starts some seconds later: {error}; make the folder writable for you alone "
            "(chmod go-w), or set NUMBA_CACHE_DIR to another folder",
            file=sys.stderr,
        )
        return None


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Returns a decorator like `numba.njit(**options)` that caches the machine code for later processes."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        folder = _cache_folder()
        if folder is None:
            alone: Callable[..., Any] = numba.njit(**options)(function)
            return alone
        config: Any = numba.config
        before = config.CACHE_DIR
        try:
            # numba decides at decoration where a function's code is cached.
            config.CACHE_DIR = str(folder)
            made: Any = numba.njit(cache=True, **options)(function)
        finally:
            config.CACHE_DIR = before
        if folder not in Path(made.stats.cache_path).parents:  # another setting of numba has chosen a different folder
            made = numba.njit(**options)(function)
        kernel: Callable[..., Any] = made
        return kernel

    return decorate

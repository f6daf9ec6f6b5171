"""Functions compiled by numba whose machine code is kept in the user's cache folder.

Only modules that hold kernels import this one, and they are imported only where a kernel is needed, because importing numba takes longer
than checking a plan. Compiled code is kept in the user's cache folder (never beside the source, which an installed package may not be
able to write) when that can be written, else it is compiled anew in each process.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba


def _cache_folder() -> Path | None:
    """Where compiled code may be kept, or None."""
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or ""
    try:
        folder = (Path(base) if base else Path.home() / ".cache") / "planrunner" / "compiled"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator like `numba.njit(**options)` that keeps the machine code for the next process."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        folder = _cache_folder()
        config: Any = numba.config
        before = config.CACHE_DIR
        try:
            # numba settles where a function's code is kept when it is decorated.
            config.CACHE_DIR = str(folder or "")
            made: Callable[..., Any] = numba.njit(cache=folder is not None, **options)(function)
        finally:
            config.CACHE_DIR = before
        return made

    return decorate

"""Finds the files shipped with planrunner: inside an installed wheel, or at the top of a source tree."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path


@lru_cache(maxsize=8)
def shipped(folder: str) -> Path:
    """Returns the folder `plans`, `schemas`, `templates`, `locales` or `web` of this installation. Raises FileNotFoundError if it
    is missing."""
    package = Path(__file__).resolve().parents[1]
    for path in (package / "_shipped" / folder, package.parent / folder):
        if path.is_dir():
            return path
    raise FileNotFoundError(2, "planrunner was installed without this folder; install it again", folder)


def shipped_bytes(folder: str, name: str) -> bytes:
    """Returns the bytes of a file in one of the shipped folders."""
    return (shipped(folder) / name).read_bytes()

"""Finds plug-ins by name through entry points: instruments and their simulators, estimators, and terms and effects of the error
model.

Built-in and third-party plug-ins are found in the same way; another distribution cannot take the name of a built-in plug-in. The
names of plug-ins are found without importing their modules; a module is imported when the name of its plug-in is used.

The project's own entry points are read from the file in which its installation lists them. `importlib.metadata` is used only for
other names, because it reads the entry points of all distributions and imports 28 further modules.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache, lru_cache, reduce
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from planrunner.base.findings import InputError, Mark, closest
from planrunner.base.regular_files import RefusedFileError, read_regular

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

INSTRUMENTS = "planrunner.instruments"
ESTIMATORS = "planrunner.estimators"
TERMS = "planrunner.terms"
EFFECTS = "planrunner.effects"
SIMULATORS = "planrunner.simulators"
REQUIRED = {ESTIMATORS: ("summary", "Parameters", "design", "estimate")}
"""Attributes that every plug-in of a group must have."""


class _Selectable(Protocol):
    def select(self, *, group: str) -> EntryPoints: ...


@cache
def _installed() -> _Selectable:
    """Returns the entry points of all installed distributions. The function is slow because it reads files of every
    distribution."""
    from importlib.metadata import entry_points

    return entry_points()


@lru_cache(maxsize=8)
def _own(group: str) -> dict[str, str]:
    """Maps the name of each of the project's own plug-ins to its location (`module:attribute`), as listed in one file."""
    return {name: place for where, name, place in _entries() if where == group}


@cache
def _entries() -> tuple[tuple[str, str, str], ...]:
    """Returns the group, name and location (`module:attribute`) of each of the project's own plug-ins; empty if the project is not
    installed."""
    for folder in sys.path:
        try:
            for name in filter(_INFO.fullmatch, os.listdir(folder or ".")):
                data = read_regular(os.path.join(folder, name, "entry_points.txt"), _LARGEST)
                return tuple(_read(data.decode("utf-8").splitlines()))
        except (OSError, RefusedFileError):  # an archive, or not an installation
            continue
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        found = distribution("planrunner").entry_points
    except PackageNotFoundError:
        return ()
    return tuple((entry.group, entry.name, entry.value) for entry in found)


_LARGEST = 1_000_000  # bytes
_INFO = re.compile(r"planrunner(-[^-]+\.dist-info|(-.*)?\.egg-info)")


def _read(lines: Iterable[str]) -> Iterator[tuple[str, str, str]]:
    group = ""
    for line in map(str.strip, lines):
        if line.startswith("["):
            group = line.strip("[]")
        elif "=" in line and line[0] not in "#;":
            name, _, place = line.partition("=")
            yield group, name.strip(), place.strip()


@lru_cache(maxsize=8)
def _table(group: str) -> dict[str, str]:
    found = {entry.name: entry.value for entry in _installed().select(group=group)} | _own(group)
    return dict(sorted(found.items()))


def _found(place: str) -> object:
    """Imports the object at `module:attribute`. Extras in brackets after the attribute are ignored."""
    module, _, attribute = place.partition("[")[0].strip().partition(":")
    return reduce(getattr, attribute.split("."), import_module(module))


def names(group: str) -> tuple[str, ...]:
    """Returns the sorted names of the plug-ins that are installed in a group."""
    return tuple(_table(group))


@lru_cache(maxsize=256)
def load(group: str, name: str) -> Any:
    """Loads the plug-in with this name. Raises `InputError` if it is unknown, cannot be imported, or lacks what its group requires."""
    place = _own(group).get(name) or _table(group).get(name)
    if place is None:
        raise InputError.at(
            Mark("<plug-ins>"), "plugin-unknown", f"no '{name}' in {group}", closest(name, names(group))
        )
    try:
        found = _found(place)
    except Exception as error:
        hint = "reinstall the package that provides it"
        message = f"the plug-in '{name}' ({place}) cannot be loaded: {type(error).__name__}: {error}"
        raise InputError.at(Mark("<plug-ins>"), "plugin-broken", message, hint) from error
    if missing := [attribute for attribute in REQUIRED.get(group, ()) if not hasattr(found, attribute)]:
        message = f"the plug-in '{name}' ({place}) lacks {', '.join(missing)}"
        hint = "its author must add them; the documentation of drivers and estimators lists what a plug-in needs"
        raise InputError.at(Mark("<plug-ins>"), "plugin-broken", message, hint)
    return found

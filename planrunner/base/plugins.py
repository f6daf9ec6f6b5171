"""Plug-ins: instruments and their simulators, estimators, error-model terms and effects, found by name through entry points.

Built-in and third-party plug-ins are found in the same way; another distribution cannot take the name of a built-in one. Names are known
without importing anything; the module of a plug-in is imported when its name is used.
"""

from __future__ import annotations

from functools import cache, lru_cache
from importlib.metadata import EntryPoint, EntryPoints, PackageNotFoundError, distribution, entry_points
from typing import Any, Protocol

from planrunner.base.findings import InputError, Mark, closest

INSTRUMENTS = "planrunner.instruments"
ESTIMATORS = "planrunner.estimators"
TERMS = "planrunner.terms"
EFFECTS = "planrunner.effects"
SIMULATORS = "planrunner.simulators"
REQUIRED = {ESTIMATORS: ("summary", "Parameters", "design", "estimate")}
"""Attributes without which a plug-in of a group cannot be used."""


class _Selectable(Protocol):
    def select(self, *, group: str) -> EntryPoints: ...


@cache
def _installed() -> _Selectable:
    """The entry points of all installed distributions; finding them reads files of every distribution."""
    return entry_points()


@lru_cache(maxsize=8)
def _own(group: str) -> dict[str, EntryPoint]:
    """The project's own, from one file."""
    try:
        found = distribution("planrunner").entry_points
    except PackageNotFoundError:
        return {}
    return {entry.name: entry for entry in found.select(group=group)}


@lru_cache(maxsize=8)
def _table(group: str) -> dict[str, EntryPoint]:
    found = {entry.name: entry for entry in _installed().select(group=group)} | _own(group)
    return dict(sorted(found.items()))


def names(group: str) -> tuple[str, ...]:
    """The names that are installed in a group, sorted."""
    return tuple(_table(group))


@lru_cache(maxsize=256)
def load(group: str, name: str) -> Any:
    """The plug-in of a name. Raises `InputError` if it is unknown, cannot be imported, or lacks what its group requires."""
    entry = _own(group).get(name) or _table(group).get(name)
    if entry is None:
        raise InputError.at(
            Mark("<plug-ins>"), "plugin-unknown", f"no '{name}' in {group}", closest(name, names(group))
        )
    try:
        found = entry.load()
    except Exception as error:
        hint = "reinstall the package that provides it"
        message = f"the plug-in '{name}' ({entry.value}) cannot be loaded: {type(error).__name__}: {error}"
        raise InputError.at(Mark("<plug-ins>"), "plugin-broken", message, hint) from error
    if missing := [attribute for attribute in REQUIRED.get(group, ()) if not hasattr(found, attribute)]:
        message = f"the plug-in '{name}' ({entry.value}) lacks {', '.join(missing)}"
        hint = "its author must add them; the documentation of drivers and estimators lists what a plug-in needs"
        raise InputError.at(Mark("<plug-ins>"), "plugin-broken", message, hint)
    return found

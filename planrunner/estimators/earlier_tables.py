"""Reads tables of results in format 1. Their columns have titles but no roles (a role states the kind of the cells, such as a value
or an uncertainty), so this module derives the roles from the titles and the cells.

No other module interprets titles, because tables in the present format state the roles.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from planrunner.base.documents import Json
from planrunner.estimators.tables import Cell, Role, Table, TableColumn

TERMINAL_TABLES = "terminal_tables"
"""Setting of an estimate that lists the titles of the tables for the terminal."""
_UNCERTAIN = re.compile(r"(?:^|\s)u(?:\s|\(|$)")
_EXPANDED = re.compile(r"(?:^|\s)U(?:\s|\(|$)|^±")
_FREEDOM = re.compile(r"\b(?:dof|d\.o\.f\.?)\b|degrees of freedom", re.IGNORECASE)
_NUMBER = re.compile(
    r"[-+−–]?(?:[0-9][0-9., ]*|∞|inf|nan)?(?:[eE][-+]?[0-9]+)?(?:\s*[%×±].*)?(?:\([^()]*\))?(?:[eE][-+]?[0-9]+)?"
)


def earlier_table(
    title: str, titles: Sequence[str], rows: tuple[tuple[Cell, ...], ...], settings: Mapping[str, Json]
) -> Table:
    """Returns a table of format 1, with roles derived from its titles. `settings`: the settings of the estimate from which the
    table comes."""
    columns = tuple(TableColumn(name, _role(name, [row[k] for row in rows])) for k, name in enumerate(titles))
    return Table(title, columns, rows, title in settings.get(TERMINAL_TABLES, ()))


def _role(title: str, cells: Sequence[Cell]) -> Role:
    if _EXPANDED.search(title):
        return Role.EXPANDED_UNCERTAINTY
    if _UNCERTAIN.search(title):
        return Role.STANDARD_UNCERTAINTY
    if _FREEDOM.search(title):
        return Role.DEGREES_OF_FREEDOM
    return Role.VALUE if cells and all(map(_numeric, cells)) else Role.LABEL


def _numeric(cell: Cell) -> bool:
    return cell is None or (
        _NUMBER.fullmatch(cell.strip()) is not None if isinstance(cell, str) else not isinstance(cell, bool)
    )

"""Makes tables from declared columns. Each column states its heading, its role, and how to make its cell for a row."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar

from planrunner.base.dataclass import dataclass
from planrunner.estimators.tables import Cell, Role, Table, TableColumn

Row = TypeVar("Row")


@dataclass(frozen=True, slots=True)
class Shown(Generic[Row]):
    """One column of a table, and how its cells are made. `cell`: function that makes the column's cell for a row. `idle`: cells
    that carry no information; a column that contains only such cells is omitted."""

    column: TableColumn
    cell: Callable[[Row], Cell]
    idle: tuple[Cell, ...] = ()


def table_of(title: str, columns: Iterable[Shown[Row]], rows: Sequence[Row]) -> Table:
    """Makes the table of all rows, without columns that carry no information; empty if there are no rows."""
    if not rows:
        return Table(title, (), ())
    filled = [(item, [item.cell(row) for row in rows]) for item in columns]
    kept = [(item.column, cells) for item, cells in filled if not item.idle or not set(cells) <= set(item.idle)]
    return Table(title, tuple(column for column, _ in kept), tuple(zip(*(cells for _, cells in kept), strict=True)))


def alike(role: Role, *titles: str, unit: str = "") -> tuple[TableColumn, ...]:
    """Makes columns that have the same role and unit."""
    return tuple(TableColumn(title, role, unit) for title in titles)

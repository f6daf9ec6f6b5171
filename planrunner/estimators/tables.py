"""Defines the tables and plots that reports show, for estimates, design studies, diagnoses and histories.

Tables are made by columns. There are two ways: with the cells of each column (`by_columns`), or with a function that makes the cell
for each row (`Shown` and `table_of`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from enum import StrEnum
from typing import Generic, TypeVar

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass


class Role(StrEnum):
    """States the kind of the cells in a column. Reports use the role, never the title of a column, to round, align and format its
    cells.

    A `VALUE` is rounded according to the first uncertainty column to its right; if there is no such column, it is shown with five
    digits. A `NUMBER` is a setting or a stated number, and has no uncertainty. A `SHARE` is a fraction of 1 that is shown in
    percent. A `LABEL` is text.
    """

    LABEL = "label"
    NUMBER = "number"
    VALUE = "value"
    STANDARD_UNCERTAINTY = "standard uncertainty"
    EXPANDED_UNCERTAINTY = "expanded uncertainty"
    DEGREES_OF_FREEDOM = "degrees of freedom"
    COUNT = "count"
    SHARE = "share"

    @property
    def uncertain(self) -> bool:
        """Returns True if the column contains uncertainties, which determine the rounding of values to its left."""
        return self in (Role.STANDARD_UNCERTAINTY, Role.EXPANDED_UNCERTAINTY)


@dataclass(frozen=True, slots=True)
class TableColumn:
    """A column of a table. `unit`: unit of all cells, which is shown beside the title; empty if there is no unit, or if it differs
    between rows."""

    title: str
    role: Role = Role.LABEL
    unit: str = ""

    @property
    def heading(self) -> str:
        return f"{self.title} [{self.unit}]" if self.unit and self.unit != "1" else self.title


Cell = str | float | None


@dataclass(frozen=True, slots=True)
class Table:
    """A table for readers. `rows`: the rows, each with one cell per column. `terminal`: True if the table is also shown in the
    terminal."""

    title: str
    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[Cell, ...], ...]
    terminal: bool = False

    @property
    def headings(self) -> tuple[str, ...]:
        return tuple(column.heading for column in self.columns)


FilledColumn = tuple[TableColumn, Iterable[Cell] | Array]
"""A column with its cells, one for each row."""


def by_columns(title: str, *columns: FilledColumn) -> Table:
    """Makes a table from columns; each column is given together with its cells."""
    cells = [values.tolist() if isinstance(values, np.ndarray) else values for _, values in columns]
    return Table(title, tuple(column for column, _ in columns), tuple(zip(*cells, strict=True)))


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


def known(values: Array) -> list[float | None]:
    """Converts the values (n,) to cells of a table; a cell is empty if its value is not finite."""
    return [value if math.isfinite(value) else None for value in values.tolist()]


@dataclass(frozen=True, slots=True)
class Plot:
    """Describes a plot of points for readers.

    `series`: maps the name of each series to its values, one for each label or number of `x`. `uncertainties`: maps the names of
    series that have uncertainties to the standard uncertainties of their values. `log`: True if both axes are logarithmic; values
    that are not positive are then left out. `lines`: True if the values are drawn as lines over `x`, without points.
    """

    title: str
    x_title: str
    y_title: str
    x: tuple[float | str, ...]
    series: Mapping[str, tuple[float, ...]]
    uncertainties: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    log: bool = False
    lines: bool = False

"""Reads tables of SQLite files."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planrunner.base.findings import closest
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats.file import FormatFile, HeldRows, SampleRows, few_columns, open_samples
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Record, Text, optional
from planrunner.plan.span import Span

if TYPE_CHECKING:
    import sqlite3


class SqliteKeys(Record):
    """Declares the bench-file keys of a SQLite file."""

    table: str | None = optional(
        Text(r"[^\x00-\x1f]{1,200}", "a table's name"), "The table; by default the only one.", "samples"
    )


class SqliteFile(FormatFile[SqliteKeys]):
    """Reads a table of a SQLite file in the order of its rows. The file is opened for reading only; views and virtual tables are
    refused."""

    Parameters = SqliteKeys

    def faults(self) -> tuple[type[Exception], ...]:
        import sqlite3

        return (*super().faults(), sqlite3.Error)

    @contextlib.contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        import sqlite3

        open_samples(self.path, self.name).close()  # a regular file within the bounds
        connection = sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        try:
            connection.execute("PRAGMA trusted_schema=OFF")
            yield connection
        except sqlite3.Error as error:
            raise self.unreadable(error) from None
        except UnicodeDecodeError:  # sqlite3 shows a part of the file in its message
            raise InstrumentError(f"{self.name} cannot be read: a name in it is not UTF-8 text") from None
        finally:
            connection.close()

    def _table(self, connection: sqlite3.Connection) -> str:
        table = self.parameters.table
        known = connection.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'")
        tables = [
            str(name)
            for name, made in known
            if not str(name).startswith("sqlite_") and not str(made).upper().startswith("CREATE VIRTUAL")
        ]
        if table and table not in tables:
            raise InstrumentError(f"{self.name} has no table '{table}'; {closest(table, tables)}")
        if not table and len(tables) != 1:
            named = f"the tables {', '.join(tables[:8])}" if tables else "no tables"
            example = f"; name one: `format: {{type: sqlite, table: {tables[0]}}}`" if tables else ""
            raise InstrumentError(f"{self.name} has {named}{example}")
        return table or tables[0]

    def columns(self) -> list[str]:
        with self._opened() as connection:
            rows = connection.execute(f"PRAGMA table_info({_quoted(self._table(connection))})")
            found = [str(row[1]) for row in rows]
        few_columns(len(found), self.name)
        return found

    def rows_about(self) -> int:
        with self._opened() as connection:
            (count,) = connection.execute(f"SELECT COUNT(*) FROM {_quoted(self._table(connection))}").fetchone()
            return int(count)

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        with self._opened() as connection:
            named = ", ".join(map(_quoted, self.wanted))
            cursor = connection.execute(f"SELECT {named} FROM {_quoted(self._table(connection))}")
            first = 1
            while rows := cursor.fetchmany(format_file.BATCH):
                columns = dict(zip(self.wanted, zip(*rows, strict=True), strict=True))
                yield (
                    first,
                    HeldRows(len(rows), {name: self._values(name, column, first) for name, column in columns.items()}),
                )
                first += len(rows)

    def _values(self, column: str, values: tuple[object, ...], first: int) -> NDArray[np.generic]:
        if column in self.unconverted:
            return np.array(values, dtype=object)
        return self._numbers(column, values, first)

    def _numbers(self, column: str, values: tuple[object, ...], first: int) -> NDArray[np.float64]:
        try:
            return np.array([np.nan if value is None else float(value) for value in values])  # type: ignore[arg-type]
        except (TypeError, ValueError):
            rows = f"rows {first} to {first + len(values) - 1}"
            raise InstrumentError(
                f"{self.name}: column '{column}' contains a value that is not a number, in {rows}"
            ) from None


def _quoted(name: str) -> str:
    """Returns a name, quoted for SQL."""
    return '"' + name.replace('"', '""') + '"'

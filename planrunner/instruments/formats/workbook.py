"""Reads sheets of Excel workbooks (.xlsx), row by row. Formulas are not computed; the values that Excel stored last are read."""

from __future__ import annotations

import contextlib
import itertools
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, Protocol
from xml.etree.ElementTree import ParseError

import numpy as np
from numpy.typing import NDArray

from planrunner.base.findings import closest
from planrunner.instruments.formats.file import (
    MAX_COLUMNS,
    FormatFile,
    HeldRows,
    SampleRows,
    TimeStamps,
    few_columns,
    open_samples,
)
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import ListOf, Number, Record, Text, key, optional
from planrunner.plan.span import Span

ROWS = 2_048
"""Number of rows in one batch."""
MAX_SHEET = 4_000_000_000
"""Maximum uncompressed size of a sheet in bytes. This size is sufficient for about a million rows of 50 columns."""
MAX_PART = 100_000_000
"""Maximum uncompressed size, in bytes, of any other part of a workbook, such as the table of its texts. These parts are read as a
whole."""
MAX_ROWS = 1_048_576
"""Maximum number of rows of a sheet in Excel."""
_MISSING = ("", "#N/A", "NA", "N/A", "NULL", "nan")
_FAULTS = (
    zipfile.BadZipFile,
    zlib.error,
    ParseError,
    EOFError,
    OSError,
    KeyError,
    ValueError,
    TypeError,
    AttributeError,
    IndexError,
    OverflowError,
    NotImplementedError,
)
"""Exceptions that openpyxl raises for files that are not correct workbooks."""

Cells = tuple[object, ...]


class Sheet(Protocol):
    """A sheet as openpyxl reads it. `max_row`: number of rows that the sheet states; None if it does not state the number."""

    title: str

    @property
    def max_row(self) -> int | None: ...
    def reset_dimensions(self) -> None: ...
    def iter_rows(self, *, values_only: bool) -> Iterator[Cells]: ...


class Book(Protocol):
    """A workbook as openpyxl opens it."""

    @property
    def worksheets(self) -> Sequence[Sheet]: ...
    def close(self) -> None: ...


class WorkbookKeys(Record):
    """Declares the bench-file keys of an Excel workbook."""

    sheet: str | None = optional(
        Text(r"[^\x00-\x1f]{1,100}", "a sheet's name"), "Name of the sheet; by default the only one.", "Run 3"
    )
    skip: int = key(
        Number(0, 10_000, integer=True),
        "Number of rows before the row with the names of the columns, or before the first sample if `names` is given.",
        4,
        default=0,
    )
    names: tuple[str, ...] = key(
        ListOf(Text(r"[^\x00-\x1f]{1,200}", "a column's name"), maximum=MAX_COLUMNS),
        "Names of the columns, in order, of a sheet that has no row with their names.",
        ["time", "gyro_x"],
        default=(),
    )


class WorkbookFile(FormatFile[WorkbookKeys]):
    """Reads a sheet of a workbook. An empty cell is a missing number. Empty rows are omitted."""

    Parameters = WorkbookKeys

    def __init__(
        self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: WorkbookKeys
    ):
        super().__init__(path, name, stamps, channels, parameters)
        self._names: list[str] | None = None

    def columns(self) -> list[str]:
        if self._names is None:
            found = list(self.parameters.names)
            if not found:
                header = next((cells for _, cells in self._sheet_rows()), ())
                found = ["" if cell is None else str(cell).strip() for cell in header]
            few_columns(len(found), self.name)
            self._names = found
        return self._names

    def rows_about(self) -> int:
        with open_workbook(self.path, self.name) as book:
            return _sheet(book, self.parameters.sheet, self.name).max_row or 0

    def place(self, row: int) -> str:
        number = next((number for k, (number, _) in enumerate(self._samples(), start=1) if k == row), None)
        return super().place(row) if number is None else f"row {number} of the sheet"

    def hint(self, column: str, known: list[str]) -> str:
        if known and all(_number(name) is not None for name in known):
            return (
                "its first row contains numbers. Name its columns in the bench file, such as "
                "`format: {type: excel, names: [time, gyro_x]}`, and use the names under `time` and `channels`"
            )
        return closest(column, [name for name in known if name])

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        known = self.columns()
        index = {name: known.index(name) for name in self.wanted}
        samples, first = self._samples(), 1
        while rows := list(itertools.islice(samples, ROWS)):
            values = {}
            for name, position in index.items():
                cells = [cells[position] if position < len(cells) else None for _, cells in rows]
                kept = name in self.unconverted
                values[name] = np.array(cells, dtype=object) if kept else self._numbers(cells, name, rows)
            yield first, HeldRows(len(rows), values)
            first += len(rows)

    def _sheet_rows(self) -> Iterator[tuple[int, Cells]]:
        """Yields the rows of the sheet, beginning with the row of the column names. Each row has its number in the sheet, counted
        from 1."""
        with open_workbook(self.path, self.name) as book:
            for number, cells in sheet_rows(_sheet(book, self.parameters.sheet, self.name), self.name):
                if number > self.parameters.skip:
                    yield number, cells

    def _samples(self) -> Iterator[tuple[int, Cells]]:
        """Yields the rows that contain samples, each with its number in the sheet."""
        rows = self._sheet_rows()
        if not self.parameters.names:
            next(rows, None)
        return ((number, cells) for number, cells in rows if any(cell is not None for cell in cells))

    def _numbers(self, cells: Sequence[object], column: str, rows: Sequence[tuple[int, Cells]]) -> NDArray[np.float64]:
        """Converts the cells of a column to numbers, shape (n,). `rows`: the rows of these cells."""
        try:
            return np.array([np.nan if cell is None else float(cell) for cell in cells])  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            numbers = [_number(cell) for cell in cells]
        wrong = next((index for index, number in enumerate(numbers) if number is None), None)
        if wrong is None:
            return np.array(numbers, np.float64)
        where = f"{self.name}, row {rows[wrong][0]} of the sheet"
        hint = "correct it, or leave the cell empty"
        if not isinstance(cells[wrong], str):
            hint = f"write `time: {{column: {column}, unit: date_time}}` if the column is the time of the recording"
        message = f"'{str(cells[wrong])[:40]}' in column '{column}' is not a number"
        raise InstrumentError(f"{where}: {message}; {hint}")


def _number(cell: object) -> float | None:
    """Returns the number in a cell; NaN for a missing number, and None if the cell contains something else."""
    if cell is None or (isinstance(cell, str) and cell.strip() in _MISSING):
        return float("nan")
    try:
        return float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None


@contextlib.contextmanager
def open_workbook(path: Path, name: str) -> Iterator[Book]:
    """Checks that no part of a workbook is too large, and opens the workbook for reading. `name`: name of the file, used in
    messages. Raises `InstrumentError` if the file cannot be read, or if a package for reading is missing."""
    try:
        import defusedxml  # noqa: F401  openpyxl reads XML with it, so that entities cannot fill the memory
        from openpyxl import load_workbook
    except ImportError:
        message = "reading Excel workbooks needs the packages openpyxl and defusedxml; install them with: "
        raise InstrumentError(f"{name}: {message}pip install 'planrunner[recordings]'") from None
    with open_samples(path, name) as opened:
        try:
            _check_parts(opened, name)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about styles and extensions, which are not read
                book: Book = load_workbook(opened, read_only=True, data_only=True, keep_links=False)
        except _FAULTS as error:
            raise _unreadable(name, error) from None
        try:
            yield book
        finally:
            book.close()


def _check_parts(file: BinaryIO, name: str) -> None:
    with zipfile.ZipFile(file) as packed:
        for entry in packed.infolist():
            most = MAX_SHEET if entry.filename.startswith("xl/worksheets/") else MAX_PART
            if entry.file_size > most:
                message = f"its part {entry.filename} has {entry.file_size / 1e6:.0f} MB, more than {most / 1e6:g} MB"
                raise InstrumentError(f"{name}: {message}; save the sheet as a CSV file")
    file.seek(0)


def _unreadable(name: str, error: Exception) -> InstrumentError:
    reason = (str(error).splitlines() or [""])[0][:150] or type(error).__name__
    return InstrumentError(
        f"{name} cannot be read as an Excel workbook: {reason}; save it again, or save it as a CSV file"
    )


def _sheet(book: Book, wanted: str | None, name: str) -> Sheet:
    """Returns a sheet of a workbook. Raises `InstrumentError` if there is no such sheet, or if there are several and none is named."""
    sheets = {str(sheet.title): sheet for sheet in book.worksheets}
    if wanted is not None and wanted not in sheets:
        raise InstrumentError(f"{name} has no sheet '{wanted}'; {closest(wanted, sheets)}")
    if wanted is None and len(sheets) != 1:
        named = f"the sheets {', '.join(list(sheets)[:8])}" if sheets else "no sheets with cells"
        example = f"; name one: `format: {{type: excel, sheet: {next(iter(sheets))}}}`" if sheets else ""
        raise InstrumentError(f"{name} has {named}{example}")
    return sheets[wanted] if wanted is not None else next(iter(sheets.values()))


def sheet_rows(sheet: Sheet, name: str) -> Iterator[tuple[int, Cells]]:
    """Yields the rows of a sheet, each with its number, counted from 1. `name`: name of the file, used in messages. Raises
    `InstrumentError` if the sheet cannot be read."""
    sheet.reset_dimensions()  # some programs write wrong dimensions
    rows = enumerate(sheet.iter_rows(values_only=True), start=1)
    while True:
        try:
            number, cells = next(rows, (0, ()))
        except _FAULTS as error:
            raise _unreadable(name, error) from None
        if not number:
            return
        if number > MAX_ROWS:
            message = f"the sheet has more than {MAX_ROWS} rows, which Excel cannot write"
            raise InstrumentError(f"{name}: {message}; save it again, or save it as a CSV file")
        yield number, cells

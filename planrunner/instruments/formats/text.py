"""Reads separated text. Columns are separated by commas, tabs or semicolons (with decimal commas), or are aligned with blanks. A
header line or the bench file states the names of the columns."""

from __future__ import annotations

import contextlib
import csv
import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from planrunner.base.findings import closest, count_of
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats.arrow import ArrowRows
from planrunner.instruments.formats.file import (
    MAX_COLUMNS,
    FormatFile,
    SampleRows,
    TimeStamps,
    few_columns,
)
from planrunner.instruments.formats.packed import open_text, text_size
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Choice, ListOf, Number, Record, Text, key
from planrunner.plan.span import Span

if TYPE_CHECKING:
    from pyarrow import csv as arrow_csv

MAX_HEADER = 65_536
"""Maximum length of the first line in bytes."""
BLOCK = 1 << 22
"""Number of bytes that are parsed together. No row may be longer."""
SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|", "blanks": "\t"}
"""Separators, by their names in bench files. Before the text is parsed, each sequence of blanks is replaced by one tab."""
DECIMALS = {"point": ".", "comma": ","}
MOST_COUNTED = 1_000_000
"""Largest row number for which a message states the line. For later rows, the lines are not counted."""
MOST_WRONG = 0.1
"""Number of lines with a wrong number of columns, divided by the number of correct lines. Above this ratio, the separator counts as
wrong."""
_MISSING = ("N/A", "#N/A", "#N/A N/A", "#NA", "NULL", "NA", "1.#IND", "-1.#IND", "1.#QNAN", "-1.#QNAN")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:[,.' ’]\d{3})+(?:[.,]\d*)?")
_BLANKS = re.compile(rb"[ \t]+")
_EDGES = re.compile(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)")


class TextKeys(Record):
    """Declares the bench-file keys of a file of separated text."""

    separator: str = key(
        Choice(tuple(SEPARATORS)),
        "What separates the columns; `blanks` is any number of blanks and tabs.",
        "semicolon",
        default="comma",
    )
    decimal: str = key(Choice(tuple(DECIMALS)), "The decimal sign.", "comma", default="point")
    skip: int = key(
        Number(0, 10_000, integer=True),
        "Number of lines before the header line, or before the first row of a file without one.",
        4,
        default=0,
    )
    names: tuple[str, ...] = key(
        ListOf(Text(r"[^\x00-\x1f]{1,200}", "a column's name"), maximum=MAX_COLUMNS),
        "Names of the columns, in order, of a file that has no header line.",
        ["ax", "ay", "az"],
        default=(),
    )
    encoding: str = key(
        Choice(("utf-8", "latin-1", "utf-16", "utf-16-le")), "Encoding of the text.", "latin-1", default="utf-8"
    )

    @property
    def delimiter(self) -> str:
        """Returns the character that separates the columns when the text is parsed."""
        return SEPARATORS[self.separator]

    @property
    def point(self) -> str:
        """Returns the decimal sign."""
        return DECIMALS[self.decimal]


class TextFile(FormatFile[TextKeys]):
    """Reads a text file that consists of a header line and numbers; an empty field is a missing number."""

    Parameters = TextKeys

    def __init__(self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: TextKeys):
        super().__init__(path, name, stamps, channels, parameters)
        self._wrong: list[str] = []

    @property
    def remarks(self) -> tuple[str, ...]:
        if not self._wrong:
            return ()
        lines = count_of(len(self._wrong), "line")
        return (f"{lines} with a different number of columns from the header, such as '{self._wrong[0][:40]}'",)

    def faults(self) -> tuple[type[Exception], ...]:
        import pyarrow as pa

        return (*super().faults(), pa.ArrowInvalid, pa.ArrowNotImplementedError)

    def columns(self) -> list[str]:
        if self.parameters.names:
            return list(self.parameters.names)
        with self._opened(None) as reader:
            return list(reader.schema.names)

    def words(self, column: str) -> tuple[str, ...]:
        """Returns the different texts in the first rows of a column, at most 20. Raises `InstrumentError` if the file cannot be
        read."""
        import pyarrow as pa
        import pyarrow.compute as pc

        with self._opened(None) as reader:
            first = reader.read_next_batch().column(column)
        if not pa.types.is_string(first.type):
            return ()
        found = pc.unique(first).drop_null()
        return tuple(map(str, found.to_pylist())) if len(found) <= 20 else ()

    def place(self, row: int) -> str:
        line = self._line_of(row) if row <= MOST_COUNTED else None
        return super().place(row) if line is None else f"{super().place(row)} (line {line})"

    def rows_about(self) -> int:
        with open_text(self.path, self.name) as file:
            start = file.read(MAX_HEADER)
        return text_size(self.path, self.name, MAX_HEADER) * start.count(b"\n") // max(len(start), 1)

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        self._wrong.clear()
        first = 1
        with self._opened(self.wanted) as reader:
            for batch in reader:
                self._few_wrong(first - 1 + batch.num_rows)
                for offset in range(0, batch.num_rows, format_file.BATCH):
                    part = batch.slice(offset, format_file.BATCH)
                    yield first, ArrowRows(part, first, self.name)
                    first += part.num_rows

    def _few_wrong(self, rows: int) -> None:
        """Raises `InstrumentError` if too many lines have a wrong number of columns.

        `rows`: number of lines that have the right number of columns."""
        wrong = len(self._wrong)
        if wrong > MOST_WRONG * rows:
            message = f"{wrong} of {rows + wrong} lines have a different number of columns from the header, such as '{self._wrong[0][:40]}'"
            raise InstrumentError(f"{self.name} cannot be read: {message}; check `separator` in the bench file")

    def _left_out(self, row: arrow_csv.InvalidRow) -> str:
        """Skips a line with a wrong number of columns, such as a comment or a line that the logger did not finish."""
        self._wrong.append(row.text)
        return "skip"

    def hint(self, column: str, known: list[str]) -> str:
        if known and all(name and _is_number(name, self.parameters.point) for name in known):
            return (
                "it has no header: its first line contains numbers. Name its columns in the bench file, such as "
                "`format: {type: text, names: [time, gyro_x]}`, and use the names under `time` and `channels`"
            )
        return self._other_separator(known[0] if len(known) == 1 else "") or closest(column, known)

    def unreadable(self, error: Exception) -> InstrumentError:
        with open_text(self.path, self.name) as file:
            start = file.read(MAX_HEADER).decode(self.parameters.encoding, "replace")
        header = "".join(start.splitlines()[self.parameters.skip :][:1])
        other = None if self.parameters.delimiter in header else self._other_separator(header)
        return super().unreadable(error) if other is None else InstrumentError(f"{self.name}: {other}")

    def _other_separator(self, header: str) -> str | None:
        """Returns a hint if the header line seems to have only a single column, but contains other separators; otherwise None."""
        for word, separator in SEPARATORS.items():
            if word != self.parameters.separator and separator in header.strip():
                return (
                    f"its columns are separated in another way: write `format: {{type: text, separator: {word}}}` in the bench file, and "
                    "`decimal: comma` if the numbers have decimal commas"
                )
        return None

    @contextlib.contextmanager
    def _opened(self, wanted: list[str] | None) -> Iterator[arrow_csv.CSVStreamingReader]:
        """Opens a reader of the columns `wanted`; if it is None, of all columns. Raises `InstrumentError` if the file cannot be
        read."""
        import pyarrow as pa
        from pyarrow import csv as arrow_csv

        layout = self.parameters
        types = {} if wanted is None else dict.fromkeys(wanted, pa.float64())
        types |= dict.fromkeys(types.keys() & self.unconverted, pa.string())
        convert = arrow_csv.ConvertOptions(
            column_types=types, include_columns=wanted, strings_can_be_null=True, decimal_point=layout.point
        )
        parse = arrow_csv.ParseOptions(delimiter=layout.delimiter, invalid_row_handler=self._left_out)
        try:
            with open_text(self.path, self.name) as file:
                text = self._text(file)
                options = arrow_csv.ReadOptions(
                    block_size=BLOCK,
                    skip_rows=layout.skip,
                    column_names=list(layout.names) or None,
                    encoding=layout.encoding,
                )
                with arrow_csv.open_csv(text, options, parse, convert) as reader:
                    yield reader
        except (pa.ArrowInvalid, pa.ArrowKeyError, OSError, UnicodeDecodeError) as error:
            numbers = [column for column in wanted or [] if column not in self.unconverted]
            raise self._not_numbers(numbers) or self.unreadable(error) from None

    def _text(self, file: BinaryIO) -> BinaryIO | Blanks:
        """Checks the first line; returns the text in the form in which it is parsed."""
        if self.parameters.separator == "blanks":
            return Blanks(file, self.parameters.skip)
        check_header(file, self.name, self.parameters)
        return file

    def _not_numbers(self, wanted: list[str]) -> InstrumentError | None:
        """Makes an error about the first line that is too long, or about the first cell that is not a number. Returns None if there
        is neither."""
        layout = self.parameters
        with contextlib.suppress(OSError, UnicodeDecodeError), self._lines() as lines:
            reader = csv.DictReader(lines, list(layout.names) or None, delimiter=layout.delimiter)
            try:
                for row in reader:
                    for column in wanted:
                        cell = row.get(column) or ""
                        if not _is_number(cell, layout.point):
                            place = (
                                f"{self.name}, line {reader.line_num + layout.skip}: '{cell[:40]}' in column '{column}'"
                            )
                            hint = "correct it, or leave it empty"
                            if cell.strip() == column:
                                hint = (
                                    "this line repeats the names of the columns: split the file here if the logger started anew, and use "
                                    "`continued_by`; otherwise remove the line"
                                )
                            if _THOUSANDS.fullmatch(cell.strip()):
                                hint = "write numbers without thousands separators"
                            return InstrumentError(f"{place} is not a number; {hint}")
            except csv.Error:
                message = f"a cell is wider than {csv.field_size_limit()} characters"
                line = reader.line_num + layout.skip + 1
                return InstrumentError(f"{self.name}, line {line}: {message}; a sample is one short line")
        return None

    def _line_of(self, row: int) -> int | None:
        """Returns the number of the line that contains a row; None if the lines cannot be read or if there are too few rows. Lines
        with a wrong number of columns do not count as rows."""
        layout = self.parameters
        with contextlib.suppress(OSError, UnicodeDecodeError, csv.Error), self._lines() as lines:
            reader = csv.reader(lines, delimiter=layout.delimiter)
            width = len(layout.names or next((cells for cells in reader if cells), []))
            found = 0
            for cells in reader:
                found += len(cells) == width
                if found == row:
                    return reader.line_num + layout.skip
        return None

    @contextlib.contextmanager
    def _lines(self) -> Iterator[Iterator[str]]:
        """Opens the file and yields its lines, without those before the header. Raises `OSError` or `UnicodeDecodeError` if it cannot
        be read."""
        layout = self.parameters
        encoding = "utf-8-sig" if layout.encoding == "utf-8" else layout.encoding
        with open_text(self.path, self.name) as opened:
            stream = io.BufferedReader(Blanks(opened, layout.skip)) if layout.separator == "blanks" else opened
            with io.TextIOWrapper(stream, encoding, newline="") as file:
                for _ in range(layout.skip):
                    file.readline(BLOCK)
                yield iter(lambda: file.readline(BLOCK), "")


class Blanks(io.RawIOBase):
    """Reads a text in which each sequence of blanks and tabs becomes one tab. Blanks and tabs at the ends of a line are removed.
    The first `skip` lines are not changed, because they must remain separate lines. They are read together with the lines after them,
    because the parser needs a line of the table in the first piece."""

    def __init__(self, file: BinaryIO, skip: int = 0):
        self._file = file
        self._kept = self._ready = b""
        self._skipped = b"".join(file.readline(MAX_HEADER) for _ in range(skip))

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        while not self._ready:
            more = self._file.read(1 << 20)
            if not more:
                whole, self._kept = self._kept, b""
                if not whole and not self._skipped:
                    return 0
            else:
                whole, end, rest = (self._kept + more).rpartition(b"\n")
                whole, self._kept = whole + end, rest
            self._ready = self._skipped + _BLANKS.sub(b"\t", _EDGES.sub(b"", whole))
            self._skipped = b""
        count = min(len(buffer), len(self._ready))
        buffer[:count] = self._ready[:count]
        self._ready = self._ready[count:]
        return count


def check_header(file: BinaryIO, name: str, layout: TextKeys) -> None:
    """Checks that the first line is not too long, and then moves the read position to the start of the file. Raises
    `InstrumentError` if the first line is too long."""
    for _ in range(layout.skip):
        file.readline(MAX_HEADER)
    start = file.read(MAX_HEADER + 1).removeprefix(b"\xef\xbb\xbf").lstrip(b"\r\n")
    file.seek(0)
    header = start.partition(b"\n")[0].partition(b"\r")[0]
    few_columns(header.count(layout.delimiter.encode()) + 1, name)
    if len(header) > MAX_HEADER - 100 and len(header) == len(start):  # no end of the line was found
        message = f"its header is longer than {MAX_HEADER} bytes"
        raise InstrumentError(f"{name}: {message}; the first line names the columns, and each further line is a sample")


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(decimal, ".") or "nan")
    except ValueError:
        return cell.upper() in _MISSING
    return True

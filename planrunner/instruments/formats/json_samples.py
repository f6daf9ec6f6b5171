"""Reads samples in JSON: one value per line (JSON lines), a list of samples, or an object that contains a list for each column.

A sample is an object or a list. The column name of a number in an object within the sample contains a point (`gyro.x`). The column
name of a number in a list contains the position of the number, counted from 1 (`gyro[2]`; `data[2]` if the sample itself is a
list).
"""

from __future__ import annotations

import copy
import itertools
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
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
from planrunner.instruments.formats.json_scan import JsonScanner
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Record, Text, optional
from planrunner.plan.span import Span

ROWS = 8_192
"""Number of rows in one batch."""
MAX_HELD = 60_000_000
"""Maximum number of numbers in a file with one list for each column. Such a file is read as a whole."""
_LOOKED_AT = 1_000  # samples from which the names of the columns are collected
_DEEPEST = 6  # levels of nested objects and lists
_CLEARLY = 10  # ratio to the length of the next list, from which the longest list counts as the list of samples
_PER_TEXT = 10  # number of numbers that need as much memory as one text

Step = str | int
_ABSENT = object()
"""Marks a value that a sample does not contain. None marks a missing number."""


class JsonKeys(Record):
    """Declares the keys with which a bench file describes a JSON file of samples."""

    samples: str | None = optional(
        Text(r"[^\x00-\x1f]{1,200}", "the name of a list"),
        "Keys that lead to the list of samples in the document, with points between them; by default the only list of samples.",
        "session.imu",
    )


@dataclass(frozen=True, slots=True)
class _Layout:
    """Describes where a file contains the samples.

    `samples`: the keys that lead to the list of samples; None if the values of the file follow each other, and each is a sample.
    `columns`: for each column, the keys and positions that lead to its number in a sample. `held`: the columns of a file that
    contains one list for each column, otherwise None."""

    samples: tuple[str, ...] | None
    columns: Mapping[str, tuple[Step, ...]]
    held: Mapping[str, NDArray[np.generic]] | None = None


class JsonFile(FormatFile[JsonKeys]):
    """Reads a JSON file. A value that is absent or null is a missing number. Samples that contain no channel are omitted."""

    Parameters = JsonKeys

    def __init__(self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: JsonKeys):
        super().__init__(path, name, stamps, channels, parameters)
        self._layout: _Layout | None = None
        self._truncated = False
        self._deciding: tuple[str, ...] = ()

    def deciding(self, columns: Sequence[str]) -> JsonFile:
        """Returns the same file without the samples that contain none of these columns. By default, samples that contain no channel
        are left out."""
        other = copy.copy(self)
        other._deciding = tuple(columns)
        return other

    @property
    def remarks(self) -> tuple[str, ...]:
        return ("an incomplete sample at the end",) if self._truncated else ()

    def columns(self) -> list[str]:
        layout = self._known()
        return list(layout.columns if layout.held is None else layout.held)

    def rows_about(self) -> int:
        held = self._known().held
        if held is not None:
            return self._held_rows(held)
        with open_samples(self.path, self.name) as file:
            whole = file.seek(0, 2)
            file.seek(0)
            scanner = JsonScanner(file, self.name)
            count = sum(1 for _ in itertools.islice(self._samples(scanner), _LOOKED_AT))
            return whole * count // max(file.tell() - scanner.left, 1)

    def place(self, row: int) -> str:
        if self._known().held is not None:
            return super().place(row)
        with self._scanner() as scanner:
            for number, (where, _) in enumerate(self._placed(scanner), start=1):
                if number == row:
                    return f"{super().place(row)} ({where})"
        return super().place(row)

    def hint(self, column: str, known: list[str]) -> str:
        return f"{closest(column, known)} A number in an object is named `object.key`, and a number in a list is named `list[1]`"

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        layout = self._known()
        if layout.held is not None:
            yield from self._held_batches(layout.held)
            return
        first = 1
        with self._scanner() as scanner:
            samples = self._with_channels(scanner)
            while rows := list(itertools.islice(samples, ROWS)):
                values = {}
                for name in self.wanted:
                    cells = _cells(rows, layout.columns[name])
                    kept = name in self.unconverted
                    values[name] = np.array(cells, dtype=object) if kept else self._numbers(cells, name, first)
                yield first, HeldRows(len(rows), values)
                first += len(rows)
            self._truncated = scanner.truncated

    # -- the samples, one by one ---------------------------------------------------------------------------------------

    @contextmanager
    def _scanner(self) -> Iterator[JsonScanner]:
        with open_samples(self.path, self.name) as file:
            yield JsonScanner(file, self.name)

    def _samples(self, scanner: JsonScanner) -> Iterator[object]:
        """Yields the samples of a file, each of which is an object or a list."""
        path = self._known().samples
        if path is None:
            yield from scanner.values()
        elif _descend(scanner, path):
            yield from scanner.records()

    def _with_channels(self, scanner: JsonScanner) -> Iterator[object]:
        """Yields the samples that contain at least one channel."""
        return (sample for sample in self._samples(scanner) if self._has_channel(sample))

    def _has_channel(self, sample: object) -> bool:
        columns = self._known().columns
        names = self._deciding or self.channels.values() or self.wanted
        return any(_at(sample, columns[name], _ABSENT) is not _ABSENT for name in names)

    def _placed(self, scanner: JsonScanner) -> Iterator[tuple[str, object]]:
        """Yields the samples that contain a channel, each with its place in the file."""
        for sample in self._samples(scanner):
            if self._has_channel(sample):
                yield scanner.place(), sample

    def _numbers(self, cells: Sequence[object], column: str, first: int) -> NDArray[np.float64]:
        """Converts the cells of a column to numbers, shape (n,). `first`: number of the first row."""
        try:
            return np.array([np.nan if cell is None else float(cell) for cell in cells])  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            index = next(index for index, cell in enumerate(cells) if not _is_number(cell))
            shown = str(cells[index])[:40]
            where = f"{self.name}, {self.place(first + index)}"
            hint = "correct it, or write null for a missing number"
            raise InstrumentError(f"{where}: '{shown}' in column '{column}' is not a number; {hint}") from None

    # -- the layout ----------------------------------------------------------------------------------------------------

    def _known(self) -> _Layout:
        if self._layout is None:
            self._layout = self._found()
        return self._layout

    def _found(self) -> _Layout:
        path = None if self.parameters.samples is None else tuple(self.parameters.samples.split("."))
        if path is None and self._is_sequence():
            return self._of_samples(None)
        with self._scanner() as scanner:
            if path is None and scanner.peek() == "[":
                path = ()
        if path is not None:
            return self._of_samples(path)
        lists = _Lists(self.name)
        with self._scanner() as scanner:
            lists.collect(scanner, (), 0)
        longest = max(map(len, lists.columns.values()), default=0)
        samples = sorted(lists.samples, key=lists.samples.__getitem__, reverse=True)
        if not samples or lists.samples[samples[0]] < longest:
            if not lists.columns:
                hint = "write one object for each sample, or one list for each column"
                raise InstrumentError(f"{self.name} has no list of samples, and no lists of numbers; {hint}")
            return _Layout(None, {}, lists.arrays())
        if len(samples) > 1 and lists.samples[samples[0]] < _CLEARLY * lists.samples[samples[1]]:
            named = ", ".join(f"'{'.'.join(one)}'" for one in samples[:8])
            example = f"`format: {{type: json, samples: {'.'.join(samples[0])}}}`"
            raise InstrumentError(f"{self.name} has several lists of samples: {named}; name one of them: {example}")
        return self._of_samples(samples[0])

    def _is_sequence(self) -> bool:
        """Returns True if the values of the file follow each other, and each of them is a sample."""
        with self._scanner() as scanner:
            if not scanner.peek():
                raise InstrumentError(f"{self.name} holds no samples; it is empty")
            try:
                first = scanner.value()
            except InstrumentError:
                return False
            single = not scanner.peek()
        scalars = isinstance(first, dict) and not any(isinstance(one, list | dict) for one in first.values())
        return isinstance(first, list | dict) and (not single or scalars)

    def _of_samples(self, path: tuple[str, ...] | None) -> _Layout:
        """Finds the columns in the first samples of a list. `path`: the keys that lead to this list, as in `_Layout`."""
        self._layout = _Layout(path, {})
        columns: dict[str, tuple[Step, ...]] = {}
        with self._scanner() as scanner:
            if path is not None and not _descend(scanner, path):
                message = f"{self.name} has no list '{'.'.join(path)}'"
                raise InstrumentError(f"{message}; correct the key `samples` of `format` in the bench file")
        with self._scanner() as scanner:
            for sample in itertools.islice(self._samples(scanner), _LOOKED_AT):
                _collect(sample, "" if isinstance(sample, dict) else "data", (), columns)
                few_columns(len(columns), self.name)
        if not columns:
            raise InstrumentError(f"{self.name} holds no samples; a sample is an object or a list with numbers")
        return _Layout(path, columns)

    # -- one list for each column --------------------------------------------------------------------------------------

    def _held_rows(self, held: Mapping[str, NDArray[np.generic]]) -> int:
        counts = {name: len(held[name]) for name in self.wanted}
        if not counts:
            return max(map(len, held.values()), default=0)
        least, most = min(counts, key=counts.__getitem__), max(counts, key=counts.__getitem__)
        if counts[least] != counts[most]:
            message = f"'{least}' has {counts[least]} rows and '{most}' has {counts[most]}"
            raise InstrumentError(f"{self.name}: {message}; all columns of a recording need the same number of rows")
        return counts[most]

    def _held_batches(self, held: Mapping[str, NDArray[np.generic]]) -> Iterator[tuple[int, SampleRows]]:
        count = self._held_rows(held)
        for begin in range(0, count, ROWS):
            values: dict[str, NDArray[np.generic]] = {}
            for name in self.wanted:
                part = held[name][begin : begin + ROWS]
                texts = part.dtype.kind == "O" and name not in self.unconverted
                values[name] = self._numbers(part.tolist(), name, begin + 1) if texts else part
            yield begin + 1, HeldRows(len(next(iter(values.values()))), values)


class _Lists:
    """Collects the lists of a document that is one object.

    `columns`: lists of numbers or texts, by name. `samples`: the lengths of lists of objects, by the keys that lead to the list."""

    def __init__(self, name: str):
        self.name = name
        self.columns: dict[str, array[float] | list[object]] = {}
        self.samples: dict[tuple[str, ...], int] = {}
        self._size = 0

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Returns the columns as arrays."""
        return {
            name: np.array(values, dtype=object) if isinstance(values, list) else np.frombuffer(values, np.float64)
            for name, values in self.columns.items()
        }

    def collect(self, scanner: JsonScanner, path: tuple[str, ...], depth: int) -> None:
        """Reads the next value, and collects the lists in it."""
        opening = scanner.peek()
        if opening == "[" or scanner.numbered():
            self._list(scanner, path)
        elif opening == "{" and depth < _DEEPEST:
            for key in scanner.members():
                self.collect(scanner, (*path, key), depth + 1)
        else:
            scanner.skip()

    def _list(self, scanner: JsonScanner, path: tuple[str, ...]) -> None:
        """Reads a list. The first element of a list decides whether the list is a column, several columns, or a list of samples."""
        name, width = ".".join(path), None
        for _ in scanner.elements():
            if scanner.peek() == "{":
                self.samples[path] = self.samples.get(path, 0) + 1
                scanner.skip()
                continue
            value = scanner.value()
            found = len(value) if isinstance(value, list) else 0
            width = found if width is None else width
            if width != found:
                row = f"{width} numbers, as in its first row, are" if width else "one number is"
                message = f"{scanner.place()}: {row} expected here in '{name}'"
                raise InstrumentError(f"{self.name}, {message}; correct the file there")
            for number, cell in enumerate(value if isinstance(value, list) else [value], start=1):
                self._add(f"{name}[{number}]" if width else name, cell)

    def _add(self, name: str, cell: object) -> None:
        column = self.columns.get(name)
        if column is None:
            few_columns(len(self.columns) + 1, self.name)
            column = self.columns[name] = array("d")
        number = cell if isinstance(cell, int | float) else np.nan if cell is None else None
        if number is None and not isinstance(column, list):
            column = self.columns[name] = list(column)
        self._size += 1 if number is not None and not isinstance(column, list) else _PER_TEXT
        if self._size > MAX_HELD:
            message = f"its columns contain more than {MAX_HELD} numbers"
            raise InstrumentError(f"{self.name}: {message}; write it as JSON lines, which are read piece by piece")
        try:
            column.append(cell if number is None else float(number))  # type: ignore[arg-type]
        except OverflowError:
            column.append(np.nan)


def _descend(scanner: JsonScanner, path: Sequence[str]) -> bool:
    """Reads the document up to the list to which the keys of `path` lead. Returns False if there is no such list."""
    for key in path:
        if scanner.peek() != "{":
            return False
        for found in scanner.members():
            if found == key:
                break
            scanner.skip()
        else:
            return False
    return scanner.peek() == "[" or scanner.numbered()


def _collect(value: object, name: str, path: tuple[Step, ...], columns: dict[str, tuple[Step, ...]]) -> None:
    """Adds the columns that a value of a sample contains. `name`, `path`: the name of the value, and the keys and positions that
    lead to it."""
    if isinstance(value, dict) and len(path) < _DEEPEST:
        for key, inner in value.items():
            _collect(inner, f"{name}.{key}" if name else str(key), (*path, str(key)), columns)
    elif isinstance(value, list) and len(path) < _DEEPEST and len(value) <= MAX_COLUMNS:
        for number, inner in enumerate(value):
            _collect(inner, f"{name}[{number + 1}]", (*path, number), columns)
    elif path and not isinstance(value, dict | list):
        columns.setdefault(name, path)


def _at(sample: object, path: Sequence[Step], absent: object = None) -> object:
    """Returns the value to which the keys and positions of `path` lead; `absent` if the sample does not contain it."""
    for step in path:
        if isinstance(step, str):
            if not (isinstance(sample, dict) and step in sample):
                return absent
            sample = sample[step]
        else:
            if not (isinstance(sample, list) and step < len(sample)):
                return absent
            sample = sample[step]
    return sample


def _cells(samples: Sequence[object], path: Sequence[Step]) -> list[object]:
    """Returns the value of one column in each sample."""
    return [_at(sample, path) for sample in samples]


def _is_number(cell: object) -> bool:
    try:
        float(0.0 if cell is None else cell)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return False
    return True

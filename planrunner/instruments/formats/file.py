"""Contains the functions that all formats of recordings share: reading rows in batches, checking that times increase, and limiting
sizes."""

from __future__ import annotations

import contextlib
import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path
from typing import BinaryIO, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.base.regular_files import RefusedFileError, open_regular
from planrunner.instruments.formats import clock
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Record
from planrunner.plan.span import EVERYTHING, Span

ReadRows = Iterator[tuple[Array, dict[str, Array]]]

MAX_BYTES = 100_000_000_000
"""Maximum size of the file in bytes. This size is sufficient for ten channels at 1 kHz over a month."""
MAX_COLUMNS = 1_000
BATCH = 65_536  # rows


def open_samples(path: Path, name: str) -> BinaryIO:
    """Opens the file of a recording, positioned at its start. `name`: name of the file, used in messages. Raises `InstrumentError`
    if it is not a regular file or is too large."""
    try:
        return open_regular(path, MAX_BYTES)
    except RefusedFileError as refused:
        raise InstrumentError(f"{name}: {refused}; {refused.hint}") from None


def few_columns(count: int, name: str) -> None:
    """Raises `InstrumentError` if a recording has more than `MAX_COLUMNS` columns."""
    if count > MAX_COLUMNS:
        message = f"it has more than {MAX_COLUMNS} columns"
        raise InstrumentError(f"{name}: {message}; keep time and the channels, one row for each time")


@dataclass(frozen=True, slots=True)
class TimeStamps:
    """Describes how the time of a row is determined.

    `column`: name of the column with the time or with a counter; None if the rows are counted. `scale`: seconds per unit of the column.
    `period`: time [s] between rows if the rows are counted. `wraps`: value at which the counter starts again from zero, None if it
    never does. `written`: True if the column contains dates or times of day instead of numbers; the unit is then s. `dates`: order of
    day and month in such dates, for all files of the recording and its table of segments.
    """

    column: str | None
    scale: float = 1.0
    period: float = math.nan
    wraps: float | None = None
    written: bool = False
    dates: clock.DateOrder = field(default_factory=clock.DateOrder, compare=False, repr=False)

    @property
    def columns(self) -> tuple[str, ...]:
        return () if self.column is None else (self.column,)

    @property
    def in_file(self) -> bool:
        """Returns True if each row contains its own time, so that a row can be read without the rows before it."""
        return self.column is not None and self.wraps is None


class SampleRows(Protocol):
    """Consecutive rows of a file. `count`: number of rows."""

    @property
    def count(self) -> int: ...

    def numbers(self, column: str) -> Array:
        """Returns the values of a column, shape (count,). A missing number is NaN. Raises `InstrumentError` for a value that is not
        a number."""

    def words(self, column: str) -> tuple[list[str], NDArray[np.int64]]:
        """Returns the different texts in a column, and the index of the text of each row, shape (count,); -1 if it is missing."""

    def times(self, column: str, where: clock.PlaceOfText, dates: clock.DateOrder) -> Array:
        """Returns the times [s] in a column of dates or times of day, shape (count,). A missing time is NaN. `where`: names the place
        of a row, whose index is counted from 0. `dates`: the order of day and month. Raises `InstrumentError` for a value that is
        not a time."""


@dataclass
class _Counter:
    """Unwraps a counter over consecutive rows."""

    wraps: float
    turns: float = 0.0
    last: float = math.nan

    def unwrapped(self, raw: Array) -> Array:
        known = np.isfinite(raw)
        if not known.any():
            return raw
        values = raw[known]
        steps = np.diff(values, prepend=values[0] if math.isnan(self.last) else self.last)
        turns = self.turns + np.cumsum(steps < -self.wraps / 2)
        self.turns, self.last = float(turns[-1]), float(values[-1])
        whole = raw.copy()
        whole[known] = values + turns * self.wraps
        return whole


class NoKeys(Record):
    """Declares the bench-file keys of a format that needs none, because its files describe themselves."""


Keys = TypeVar("Keys", bound=Record, covariant=True)


class FormatFile(ABC, Generic[Keys]):
    """Reads a file of samples in some format.

    `name`: name of the file, used in messages. `stamps`: how the time of a row is determined. `channels`: for each channel, the
    name of its column. `parameters`: the keys of the format in the bench file. `origin`: time of the first row, s. `interval`:
    median time between the first rows, s; NaN if there is only one row. `about`: approximate number of rows. The method `look` sets
    `origin`, `interval` and `about`. `texts`: columns of texts that are read in addition to the columns of the channels.
    """

    Parameters: type[Record] = NoKeys

    def __init__(self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: Keys):
        self.path, self.name, self.stamps, self.parameters = path, name, stamps, parameters
        self.channels = dict(channels)
        self.origin, self.interval, self.about = 0.0, math.nan, 0
        self.texts: frozenset[str] = frozenset()

    def with_channels(self, stamps: TimeStamps, channels: Mapping[str, str]) -> Self:
        """Returns the same file with other time stamps and other channels. Facts about the contents that are already known are
        kept."""
        other = copy.copy(self)
        other.stamps, other.channels = stamps, dict(channels)
        return other

    @abstractmethod
    def columns(self) -> list[str]:
        """Returns the names of the columns. Raises `InstrumentError` if the file cannot be read."""

    def examined(self) -> list[str]:
        """Returns the names of columns that can be used together in one recording; by default, all columns. Raises
        `InstrumentError` if the file cannot be read."""
        return self.columns()

    def contents(self) -> tuple[str, ...]:
        """Returns a description of the contents of a file that contains several tables, with one text for each of the tables."""
        return ()

    def units(self) -> Mapping[str, str]:
        """Returns the units of the columns whose unit the file states outside the column name."""
        return {}

    @abstractmethod
    def rows_about(self) -> int:
        """Estimates the number of rows without reading them."""

    @abstractmethod
    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        """Yields batches of rows, each with the number of its first row, counted from 1. A batch may also contain rows outside the
        span."""

    def first_rows(self) -> SampleRows | None:
        """Returns the first batch of rows; None if there is none, or if it cannot be read."""
        with contextlib.suppress(InstrumentError, *self.faults()):
            return next((rows for _, rows in self.batches(EVERYTHING)), None)
        return None

    def faults(self) -> tuple[type[Exception], ...]:
        """Returns the types of the exceptions that are raised if the file cannot be read."""
        return (OSError, UnicodeDecodeError)

    def place(self, row: int) -> str:
        """Returns a text that names a row, counted from 1, in messages."""
        return f"row {row}"

    def hint(self, column: str, known: list[str]) -> str:
        """Returns a hint about a column that the file does not have. `known`: names of the columns of the file."""
        return closest(column, known)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Returns remarks in words about rows and bytes that were skipped. The counts are complete after a pass over all rows."""
        return ()

    @property
    def wanted(self) -> list[str]:
        """Returns the names of the columns that are needed: the column of the time, the columns of the channels and the columns of
        texts, each listed once."""
        return list(dict.fromkeys((*self.stamps.columns, *self.channels.values(), *self.texts)))

    @property
    def unconverted(self) -> frozenset[str]:
        """Returns the names of the columns whose values are not converted to numbers."""
        return self.texts | frozenset(self.stamps.columns if self.stamps.written else ())

    def look(self) -> None:
        """Checks the columns and the first rows of the file. Raises `InstrumentError` if a column is absent or ambiguous, or if the
        file contains no samples."""
        known = self.columns()
        absent = [column for column in self.wanted if column not in known]
        if absent:
            more = f"; it also lacks {', '.join(map(repr, absent[1:]))}" if len(absent) > 1 else ""
            raise InstrumentError(f"{self.name} has no column '{absent[0]}'{more}; {self.hint(absent[0], known)}")
        for column in self.wanted:
            if known.count(column) > 1:
                raise InstrumentError(
                    f"{self.name} has {known.count(column)} columns called '{column}'; rename all but one"
                )
        for first, _ in self.rows():
            self.origin = float(first[0])
            self.interval = float(np.median(np.diff(first))) if first.size > 1 else math.nan
            self.about = self.rows_about()
            return
        raise InstrumentError(f"{self.name} holds no samples")

    def rows(self, span: Span = EVERYTHING) -> ReadRows:
        """Yields the samples in a span, in batches of at most `BATCH` rows: times (n,), in s, and the values (n,) of each channel.
        A missing number is NaN. Raises `InstrumentError` at the first row whose time is not later than the time of the previous
        row."""
        before: float | None = None
        following: int | None = None
        for first, rows, time in self._timed(span):
            self._check_time(time, first, before if first == following else None)
            before, following = float(time[-1]), first + rows.count
            part = span.of(time, self.interval)
            if part.start < part.stop:
                yield time[part], {channel: rows.numbers(column)[part] for channel, column in self.channels.items()}
            if part.stop < time.size:
                return

    def all_rows(self) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        """Yields all rows unchanged, in batches. Each batch contains the number of its first row, counted from 1; times [s], which
        may be missing or decrease; and the values of each channel. Raises `InstrumentError` if the file cannot be read."""
        for first, rows, time in self._timed(EVERYTHING):
            yield first, time, {name: rows.numbers(column) for name, column in self.channels.items()}

    def _timed(self, span: Span) -> Iterator[tuple[int, SampleRows, Array]]:
        """Yields the batches that contain rows: the number of the first row, the rows, and their times [s]."""
        stamps = self.stamps
        counter = None if stamps.wraps is None else _Counter(stamps.wraps)
        try:
            for first, rows in self.batches(span):
                if not rows.count:
                    continue
                if stamps.column is None:
                    time = np.arange(first - 1, first - 1 + rows.count, dtype=np.float64) * stamps.period
                else:
                    raw = self._stamped(rows, first)
                    time = (raw if counter is None else counter.unwrapped(raw)) * stamps.scale
                yield first, rows, time
        except self.faults() as error:
            raise self.unreadable(error) from None

    def _stamped(self, rows: SampleRows, first: int) -> Array:
        """Returns the values of the column of the time, shape (n,). `first`: number of the first row."""
        column = self.stamps.column or ""
        if not self.stamps.written:
            return rows.numbers(column)
        times = rows.times(column, self._places(first, column), self.stamps.dates)
        if not self.stamps.dates.undecided:
            return times
        self._decide_dates(column)
        return rows.times(column, self._places(first, column), self.stamps.dates)

    def _places(self, first: int, column: str) -> clock.PlaceOfText:
        """Returns a function that names the places of the cells of a column in messages. `first`: number of the first row."""
        return lambda index: f"{self.name}, {self.place(first + index)}, column '{column}'"

    def _decide_dates(self, column: str) -> None:
        """Decides the order of day and month from the dates of the whole file."""
        whole = self.with_channels(self.stamps, {})
        for first, rows in whole.batches(EVERYTHING):
            if rows.count:
                rows.times(column, self._places(first, column), self.stamps.dates)
        self.stamps.dates.decide()

    def _check_time(self, time: Array, first: int, before: float | None) -> None:
        """Raises `InstrumentError` if a time is missing, or is not later than the time of the previous row. `before`: time of the
        last row of the previous batch. `time`: array of shape (n,), s. `first`: number of the first row."""
        if not np.all(np.isfinite(time)):
            row = first + int(np.flatnonzero(~np.isfinite(time))[0])
            raise InstrumentError(
                f"{self.name}, {self.place(row)}: the time is missing or not a number; fill it in, or remove the row"
            )
        steps = np.diff(time, prepend=-np.inf if before is None else before)
        if np.any(steps <= 0):
            index = int(np.flatnonzero(steps <= 0)[0])
            earlier = time[index - 1] if index else before
            message = f"time does not increase: {self._shown(time[index])} after {self._shown(earlier)}"
            hint = "sort the recording, or correct or remove this row or the row before it"
            raise InstrumentError(f"{self.name}, {self.place(first + index)}: {message}; {hint}")

    def _shown(self, seconds: float | None) -> str:
        """Returns a time in the form in which messages show it."""
        moment = math.nan if seconds is None else float(seconds)
        return clock.text_of(moment) if self.stamps.written else f"{moment:.15g} s"

    def unreadable(self, error: Exception) -> InstrumentError:
        """Makes the `InstrumentError` that describes why the file cannot be read."""
        reason = (error.strerror if isinstance(error, OSError) else None) or (str(error).splitlines() or [""])[0][:200]
        if isinstance(error, UnicodeDecodeError):
            reason = "its header is not UTF-8 text; save it as UTF-8, or state its encoding in `format`"
        return InstrumentError(f"{self.name} cannot be read: {reason}")


AnyFile = FormatFile[Record]
"""A file in any supported format."""


@dataclass(frozen=True, slots=True)
class HeldRows:
    """Rows in memory. `count`: number of rows. `values`: the values (count,) of each column."""

    count: int
    values: Mapping[str, NDArray[np.generic]]

    def numbers(self, column: str) -> Array:
        values = self.values[column]
        if values.dtype.kind == "M":
            raise InstrumentError(f"the column '{column}' contains dates, not numbers")
        return np.asarray(values, dtype=np.float64)

    def words(self, column: str) -> tuple[list[str], NDArray[np.int64]]:
        known: dict[str, int] = {}
        cells = (None if cell is None or cell != cell else cell for cell in self.values[column].tolist())
        texts = (f"{cell:g}" if isinstance(cell, float) else cell for cell in cells)
        index = [-1 if cell is None else known.setdefault(str(cell), len(known)) for cell in texts]
        return list(known), np.array(index, np.int64)

    def times(self, column: str, where: clock.PlaceOfText, dates: clock.DateOrder) -> Array:
        return clock.of_objects(self.values[column], where, dates)

"""Functions common to all formats of recordings: reading rows in batches, checking that times increase, limits of size."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.base.regular_files import RefusedFileError, open_regular
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Record
from planrunner.plan.span import EVERYTHING, Span

ReadRows = Iterator[tuple[Array, dict[str, Array]]]

MAX_BYTES = 100_000_000_000
"""Maximum size of the file: ten channels at 1 kHz for a month."""
MAX_COLUMNS = 1_000
BATCH = 65_536  # rows


def open_samples(path: Path, name: str) -> BinaryIO:
    """Opens the file of a recording, positioned at its start. name: name for messages. Raises `InstrumentError`."""
    try:
        return open_regular(path, MAX_BYTES)
    except RefusedFileError as refused:
        raise InstrumentError(f"{name}: {refused}; {refused.hint}") from None


def few_columns(count: int, name: str) -> None:
    """Checks that a recording does not have too many columns. Raises `InstrumentError` otherwise."""
    if count > MAX_COLUMNS:
        message = f"it has more than {MAX_COLUMNS} columns"
        raise InstrumentError(f"{name}: {message}; keep time and the channels, one row for each time")


@dataclass(frozen=True, slots=True)
class TimeStamps:
    """Source of the time of a row.

    column: the column with the time or the counter; None if rows are counted. scale: seconds per unit of the column. period: time
    [s] between rows, if rows are counted. wraps: value at which the counter starts again from zero, None if it does not wrap.
    """

    column: str | None
    scale: float = 1.0
    period: float = math.nan
    wraps: float | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        return () if self.column is None else (self.column,)

    @property
    def in_file(self) -> bool:
        """Whether the value in a row is its time, so that rows can be read without the preceding rows."""
        return self.column is not None and self.wraps is None


class SampleRows(Protocol):
    """Consecutive rows of a file. count: number of rows."""

    @property
    def count(self) -> int: ...

    def numbers(self, column: str) -> Array:
        """A column, (count,); a missing number is NaN. Raises `InstrumentError` for a value that is not a number."""


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
    """The keys of a format that needs no keys, because the file describes itself."""


Keys = TypeVar("Keys", bound=Record, covariant=True)


class FormatFile(ABC, Generic[Keys]):
    """A file of samples. name: name for messages; stamps: source of the time of its rows; channels: channel → column; parameters:
    the keys of the format in the bench file.

    origin: time of the first row, s; interval: median time between the first rows, s, NaN for a single row; about: approximate
    number of rows. `look` sets `origin`, `interval` and `about`.
    """

    Parameters: type[Record] = NoKeys

    def __init__(self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: Keys):
        self.path, self.name, self.stamps, self.parameters = path, name, stamps, parameters
        self.channels = dict(channels)
        self.origin, self.interval, self.about = 0.0, math.nan, 0

    @abstractmethod
    def columns(self) -> list[str]:
        """Names of the columns. Raises `InstrumentError`."""

    @abstractmethod
    def rows_about(self) -> int:
        """Approximate number of rows, without reading them."""

    @abstractmethod
    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        """Batches of rows as (number of the first row, counted from 1; rows). A batch may contain rows outside the span."""

    def faults(self) -> tuple[type[Exception], ...]:
        """Exceptions that indicate that the file cannot be read."""
        return (OSError, UnicodeDecodeError)

    def hint(self, column: str, known: list[str]) -> str:
        """The remedy for a column that the file does not have. known: the columns that it has."""
        return closest(column, known)

    @property
    def remarks(self) -> tuple[str, ...]:
        """The rows and bytes that were skipped, in words. The numbers are known after a pass over all rows."""
        return ()

    @property
    def wanted(self) -> list[str]:
        """The columns of time and channels, each once."""
        return list(dict.fromkeys((*self.stamps.columns, *self.channels.values())))

    def look(self) -> None:
        """Checks the columns and the first rows. Raises `InstrumentError`."""
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
        """Times [s], shape (n,), and channels, each (n,), of the samples in a span, in batches of at most `BATCH` rows. A missing number is
        NaN. Raises `InstrumentError` where time does not increase."""
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
        """Every row unchanged, in batches: number of the first row, counted from 1; times [s], which may be missing or decrease;
        channels. Raises `InstrumentError` if the file cannot be read."""
        for first, rows, time in self._timed(EVERYTHING):
            yield first, time, {name: rows.numbers(column) for name, column in self.channels.items()}

    def _timed(self, span: Span) -> Iterator[tuple[int, SampleRows, Array]]:
        """The batches that contain rows, with their times."""
        stamps = self.stamps
        counter = None if stamps.wraps is None else _Counter(stamps.wraps)
        try:
            for first, rows in self.batches(span):
                if not rows.count:
                    continue
                if stamps.column is None:
                    time = np.arange(first - 1, first - 1 + rows.count, dtype=np.float64) * stamps.period
                elif counter is None:
                    time = rows.numbers(stamps.column) * stamps.scale
                else:
                    time = counter.unwrapped(rows.numbers(stamps.column)) * stamps.scale
                yield first, rows, time
        except self.faults() as error:
            raise self.unreadable(error) from None

    def _check_time(self, time: Array, first: int, before: float | None) -> None:
        """Checks that every time is present and later than the time of the row before, also across batches."""
        if not np.all(np.isfinite(time)):
            row = first + int(np.flatnonzero(~np.isfinite(time))[0])
            raise InstrumentError(f"{self.name}, row {row}: the time is missing or not a number")
        steps = np.diff(time, prepend=-np.inf if before is None else before)
        if np.any(steps <= 0):
            index = int(np.flatnonzero(steps <= 0)[0])
            earlier = time[index - 1] if index else before
            message = f"time does not increase: {time[index]:.9g} s after {earlier:.9g} s"
            raise InstrumentError(f"{self.name}, row {first + index}: {message}; sort the recording or remove the row")

    def unreadable(self, error: Exception) -> InstrumentError:
        """The message about a fault of the file."""
        reason = (error.strerror if isinstance(error, OSError) else None) or (str(error).splitlines() or [""])[0][:200]
        if isinstance(error, UnicodeDecodeError):
            reason = "its header is not UTF-8 text; save it as UTF-8, or state its encoding in `format`"
        return InstrumentError(f"{self.name} cannot be read: {reason}")


AnyFile = FormatFile[Record]
"""A file of any format."""


@dataclass(frozen=True, slots=True)
class HeldRows:
    """Rows that are in memory, by column, each (count,)."""

    count: int
    values: Mapping[str, NDArray[np.generic]]

    def numbers(self, column: str) -> Array:
        return np.asarray(self.values[column], dtype=np.float64)

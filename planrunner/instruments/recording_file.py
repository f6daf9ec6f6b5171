"""Recorded samples in a file: CSV or Parquet, read in batches, inside a data folder.

Before a sample is read, the resources that the file requires are checked. Samples come in batches, so a recording may have any length. The
data in memory at one time are limited: the header and the columns of a CSV file; the directory, the columns and the row groups of a Parquet
file. Only columns of numbers are read.
"""

from __future__ import annotations

import contextlib
import csv
import io
import math
import shutil
import struct
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from planrunner.base import arrow_columns
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.base.progress import Announce, Pace
from planrunner.base.regular_files import RefusedFileError, open_regular
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.span import EVERYTHING, Span

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.csv as arrow_csv
    import pyarrow.parquet as pq

MAX_BYTES = 100_000_000_000
"""Maximum size of the file: ten channels at 1 kHz for a month."""
MAX_COLUMNS = 1_000
MAX_HEADER = 65_536
"""Bytes of a CSV file's first line."""
CSV_BLOCK = 1 << 22
"""Bytes of a CSV file that are parsed at once; no row may be longer."""
MAX_DIRECTORY = 16_000_000
"""Bytes of the directory at the end of a Parquet file."""
MAX_CHUNK = 600_000_000
"""Bytes, unpacked, of a column in one row group of a Parquet file; the largest that common writers make holds 2^26 numbers."""
_PARQUET_END = struct.Struct("<I4s")


def open_samples(path: Path, name: str) -> BinaryIO:
    """The file of a recording, open from its beginning; `name` is for messages. Raises `InstrumentError`."""
    try:
        return open_regular(path, MAX_BYTES)
    except RefusedFileError as refused:
        raise InstrumentError(f"{name}: {refused}; {refused.hint}") from None


def check_header(file: BinaryIO, name: str) -> None:
    """Check the first line of a CSV file against its bounds and return to the beginning. Raises `InstrumentError`."""
    start = file.read(MAX_HEADER + 1).removeprefix(b"\xef\xbb\xbf").lstrip(b"\r\n")
    file.seek(0)
    header = start.partition(b"\n")[0].partition(b"\r")[0]
    _few_columns(header.count(b",") + 1, name)
    if len(header) > MAX_HEADER - 100 and len(header) == len(start):  # no end of the line was found
        message = f"its header is longer than {MAX_HEADER} bytes"
        raise InstrumentError(f"{name}: {message}; the first line names the columns, and each further line is a sample")


def check_directory(file: BinaryIO, name: str) -> None:
    """Check the size of a Parquet file's directory against its bound and return to the beginning. Raises `InstrumentError`."""
    size = file.seek(0, 2)
    if size >= _PARQUET_END.size:
        file.seek(size - _PARQUET_END.size)
        length, _ = _PARQUET_END.unpack(file.read(_PARQUET_END.size))
        if length > MAX_DIRECTORY and length < size:
            message = f"its directory of columns and row groups has {length / 1e6:.0f} MB, more than {MAX_DIRECTORY / 1e6:g} MB"
            raise InstrumentError(f"{name}: {message}; write it again with larger row groups, or fewer columns")
    file.seek(0)


def check_parquet(file: pq.ParquetFile, name: str, wanted: Iterable[str]) -> None:
    """Check the columns of a Parquet file: their number, the types of the `wanted` columns, and their size in a row group. Raises
    `InstrumentError`."""
    from pyarrow import types

    _few_columns(file.metadata.num_columns, name)
    schema = file.schema_arrow
    for column in wanted:
        for index in schema.get_all_field_indices(column):
            kind = schema.field(index).type
            if not any(
                fits(kind) for fits in (types.is_integer, types.is_floating, types.is_decimal, types.is_boolean)
            ):
                what = "text" if types.is_string(kind) or types.is_large_string(kind) else f"values of the type {kind}"
                message = f"column '{column}' holds {what}, not numbers"
                raise InstrumentError(f"{name}: {message}; write it again with a column of float64")
    read = frozenset(wanted)
    for number in range(file.num_row_groups):
        group = file.metadata.row_group(number)
        for index in range(group.num_columns):
            chunk = group.column(index)
            if chunk.path_in_schema in read and chunk.total_uncompressed_size > MAX_CHUNK:
                message = f"column '{chunk.path_in_schema}' has {chunk.total_uncompressed_size / 1e6:.0f} MB in row group {number + 1}"
                raise InstrumentError(f"{name}: {message}; write it again with row groups of a million rows")


def _few_columns(count: int, name: str) -> None:
    if count > MAX_COLUMNS:
        message = f"it has more than {MAX_COLUMNS} columns"
        raise InstrumentError(f"{name}: {message}; keep time and the channels, one row for each time")


Array = NDArray[np.float64]
BATCH = 65_536  # rows
HELD = 1_000_000  # largest recording, in rows, that is kept in memory to read many intervals
_MISSING = ("N/A", "#N/A", "#N/A N/A", "#NA", "NULL", "NA", "1.#IND", "-1.#IND", "1.#QNAN", "-1.#QNAN")
ReadRows = Iterator[tuple[Array, dict[str, Array]]]


def beneath(root: Path | None, name: str) -> Path:
    """The file `name` in the data folder. Raises `InstrumentError` for a file or link outside it."""
    if root is None:
        raise InstrumentError(f"'{name}' is relative to a data folder, but no data folder is given; add --data FOLDER")
    posix, windows = PurePosixPath(name), PureWindowsPath(name)
    rooted = posix.is_absolute() or windows.is_absolute() or windows.drive or windows.root
    if rooted or ".." in posix.parts or ".." in windows.parts:
        raise InstrumentError(
            f"'{name}' leads outside the data folder; give its path relative to that folder, without '..'"
        )
    try:
        top = root.resolve(strict=True)
    except OSError:
        raise InstrumentError(f"the data folder {root} does not exist; check --data") from None
    try:
        path = (top / name).resolve(strict=True)
    except (OSError, RuntimeError):
        raise InstrumentError(f"there is no file '{name}' in the data folder {root}") from None
    if not path.is_relative_to(top):
        raise InstrumentError(f"'{name}' is a link that leads outside the data folder; replace the link with the file")
    return path


class RecordingFile(Protocol):
    """A recording that can be read again and again. origin: time of its first row, s; interval: median time between its
    first rows, s, NaN for a single row; about: approximate number of rows, for progress."""

    @property
    def origin(self) -> float: ...
    @property
    def interval(self) -> float: ...
    @property
    def about(self) -> int: ...

    def rows(self, span: Span = EVERYTHING) -> ReadRows:
        """Times [s], shape (n,), and channels, each (n,), of the samples in a span, in batches of at most `BATCH`
        rows. A missing number is NaN. Raises `InstrumentError` where time does not increase."""

    def all_rows(self) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        """Every row unchanged, in batches: number of the first, counted from 1; times [s], which may be missing or decrease; channels.
        Raises `InstrumentError` where the file cannot be read."""


def open_recording(path: Path, name: str, time: str, scale: float, channels: Mapping[str, str]) -> RecordingFile:
    """The recording at `path`, after a check of its columns and first row.

    name: for messages; time: column of time, `scale` seconds a unit; channels: channel → column. Raises
    `InstrumentError`.
    """
    kinds: dict[str, type[_File]] = {".parquet": _Parquet, ".pq": _Parquet, ".csv": _Csv, ".txt": _Csv}
    kind = kinds.get(path.suffix.lower())
    if kind is None:
        open_samples(path, name).close()  # a folder, or nothing at all, is named as what it is
        raise InstrumentError(f"'{name}' is neither .csv nor .parquet")
    file: _File = kind(path, name, time, scale, dict(channels))
    known = file.columns()
    absent = [column for column in dict.fromkeys((time, *channels.values())) if column not in known]
    if absent:
        more = f"; it also lacks {', '.join(map(repr, absent[1:]))}" if len(absent) > 1 else ""
        raise InstrumentError(f"{name} has no column '{absent[0]}'{more}; {_column_hint(absent[0], known)}")
    for column in (time, *channels.values()):
        if known.count(column) > 1:
            raise InstrumentError(f"{name} has {known.count(column)} columns called '{column}'; rename all but one")
    for first, _ in file.rows():
        file.origin = float(first[0])
        file.interval = float(np.median(np.diff(first))) if first.size > 1 else math.nan
        file.about = file.rows_about()
        return file
    raise InstrumentError(f"{name} holds no samples")


@dataclass(frozen=True, slots=True)
class HeldRecording:
    """A recording in memory, so that many intervals need only one read. time: (n,), s; columns: each (n,)."""

    origin: float
    interval: float
    time: Array
    columns: Mapping[str, Array]

    @classmethod
    def of(cls, file: RecordingFile, most: float = np.inf, pace: Pace | None = None) -> HeldRecording | None:
        """All rows of a file, read once; None if there are more than `most`. Raises `InstrumentError` like the file."""
        pieces, count = [], 0
        for piece in file.rows():
            pieces.append(piece)
            count += len(piece[0])
            if pace is not None:
                pace.reached(count)
            if count > most:
                return None
        time = np.concatenate([piece for piece, _ in pieces])
        names = pieces[0][1]
        columns = {name: np.concatenate([values[name] for _, values in pieces]) for name in names}
        return cls(file.origin, file.interval, time, columns)

    @property
    def about(self) -> int:
        return len(self.time)

    def rows(self, span: Span = EVERYTHING) -> ReadRows:
        """As `rows` of a recording file, but yields one batch at most."""
        part = span.of(self.time, self.interval)
        if part.start < part.stop:
            yield self.time[part], {name: values[part] for name, values in self.columns.items()}

    def all_rows(self) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        """As `all_rows` of a recording file, but yields one batch at most."""
        if len(self.time):
            yield 1, self.time, dict(self.columns)


def at_hand(file: RecordingFile, name: str = "", notice: Announce | None = None) -> RecordingFile:
    """The same recording in a form from which many stretches can be read quickly: in memory up to `HELD` rows. A longer CSV file becomes a
    temporary Parquet file, because all preceding rows must be read to find a stretch in CSV. name: of the file, for notice, which
    receives the progress. Raises `InstrumentError` like the file."""
    held = HeldRecording.of(file, HELD, Pace(f"reading {name}", min(file.about, HELD), notice))
    if held is not None:
        return held
    return file if isinstance(file, _Parquet) else _Spooled.of(file, Pace(f"copying {name}", file.about, notice))


def _column_hint(column: str, known: list[str]) -> str:
    if known and all(name and _is_number(name) for name in known):
        return (
            "it has no header: its first line contains numbers. Add a line above it with the names of the columns, "
            "separated by commas, and use them under `time` and `channels` of the bench file"
        )
    separators = {";": "semicolons", "\t": "tabs", "|": "bars"}
    for separator, word in separators.items():
        if len(known) == 1 and separator in known[0]:
            return f"its header is separated by {word}: save the file with commas between the columns and with decimal points"
    return closest(column, known)


@dataclass(slots=True)
class _File:
    path: Path
    name: str
    time: str
    scale: float
    channels: dict[str, str]
    origin: float = 0.0
    interval: float = math.nan
    about: int = 0

    def columns(self) -> list[str]:
        raise NotImplementedError

    def rows_about(self) -> int:
        """Approximate number of rows, without reading them."""
        raise NotImplementedError

    def batches(self, span: Span) -> Iterator[tuple[int, pa.RecordBatch]]:
        """(number of the first row, counted from 1; record batch), possibly with rows outside the span."""
        raise NotImplementedError

    def rows(self, span: Span = EVERYTHING) -> ReadRows:
        import pyarrow as pa

        before: float | None = None
        following: int | None = None
        try:
            for first, batch in self.batches(span):
                if batch.num_rows == 0:
                    continue
                time = self._numbers(batch, self.time, first) * self.scale
                self._check_time(time, first, before if first == following else None)
                before, following = float(time[-1]), first + batch.num_rows
                part = span.of(time, self.interval)
                if part.start < part.stop:
                    columns = {
                        channel: self._numbers(batch, column, first)[part] for channel, column in self.channels.items()
                    }
                    yield time[part], columns
                if part.stop < time.size:
                    return
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError, UnicodeDecodeError) as error:
            raise self._unreadable(error) from None

    def all_rows(self) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        import pyarrow as pa

        try:
            for first, batch in self.batches(EVERYTHING):
                if batch.num_rows:
                    columns = {name: self._numbers(batch, column, first) for name, column in self.channels.items()}
                    yield first, self._numbers(batch, self.time, first) * self.scale, columns
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError, UnicodeDecodeError) as error:
            raise self._unreadable(error) from None

    def _numbers(self, batch: pa.RecordBatch, column: str, first: int) -> Array:
        import pyarrow as pa

        try:
            values = batch.column(column).cast(pa.float64())
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            message = f"column '{column}' contains a value that is not a number, in rows {first} to {first + batch.num_rows - 1}"
            raise InstrumentError(f"{self.name}: {message}") from None
        return arrow_columns.numbers(values)

    def _check_time(self, time: Array, first: int, before: float | None) -> None:
        """Checks that time is present and increases, from row to row and from the row before this batch."""
        if not np.all(np.isfinite(time)):
            row = first + int(np.flatnonzero(~np.isfinite(time))[0])
            raise InstrumentError(f"{self.name}, row {row}: the time is missing or not a number")
        steps = np.diff(time, prepend=-np.inf if before is None else before)
        if np.any(steps <= 0):
            index = int(np.flatnonzero(steps <= 0)[0])
            earlier = time[index - 1] if index else before
            message = f"time does not increase: {time[index]:.9g} s after {earlier:.9g} s"
            raise InstrumentError(f"{self.name}, row {first + index}: {message}; sort the recording or remove the row")

    def _unreadable(self, error: Exception) -> InstrumentError:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error).splitlines()[0][:200]
        if isinstance(error, UnicodeDecodeError):
            reason = "its header is not UTF-8 text; save it as UTF-8"
        return InstrumentError(f"{self.name} cannot be read: {reason}")


class _Parquet(_File):
    """Row groups outside the stretch, according to their statistics, are skipped."""

    def columns(self) -> list[str]:
        import pyarrow as pa

        try:
            with self._opened() as file:
                return list(file.schema_arrow.names)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise self._unreadable(error) from None

    def rows_about(self) -> int:
        with self._opened() as file:
            return int(file.metadata.num_rows)

    @contextlib.contextmanager
    def _opened(self) -> Iterator[pq.ParquetFile]:
        """The file, with its directory read and checked against its bounds; columns are read in small pieces."""
        import pyarrow.parquet as pq

        with open_samples(self.path, self.name) as opened:
            check_directory(opened, self.name)
            with pq.ParquetFile(opened, buffer_size=1 << 20, pre_buffer=False) as file:
                check_parquet(file, self.name, (self.time, *self.channels.values()))
                yield file

    def batches(self, span: Span) -> Iterator[tuple[int, pa.RecordBatch]]:
        wanted = list(dict.fromkeys((self.time, *self.channels.values())))
        with self._opened() as file:
            first = 1
            for group in range(file.num_row_groups):
                count = file.metadata.row_group(group).num_rows
                if not self._outside(file.metadata.row_group(group), span):
                    row = first
                    for batch in file.iter_batches(BATCH, row_groups=[group], columns=wanted):
                        yield row, batch
                        row += batch.num_rows
                first += count

    def _outside(self, group: pq.RowGroupMetaData, span: Span) -> bool:
        """Whether a group overlaps the stretch, by its statistics; a group that a rounded boundary may touch is read."""
        for index in range(group.num_columns):
            column = group.column(index)
            if column.path_in_schema == self.time:
                known = column.statistics
                if known is None or not known.has_min_max or not isinstance(known.min, int | float):
                    return False
                rounding = 0.0 if math.isnan(self.interval) else self.interval
                return bool(known.max * self.scale < span.start - rounding or known.min * self.scale > span.end)
        return False


@dataclass
class _Spooled:
    """Rows of a file in a temporary Parquet file, which is deleted together with this object."""

    origin: float
    interval: float
    file: _Parquet

    @classmethod
    def of(cls, file: RecordingFile, pace: Pace) -> _Spooled:
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = Path(tempfile.mkdtemp(prefix="planrunner-")) / "recording.parquet"
        spooled = cls(
            file.origin,
            file.interval,
            _Parquet(path, path.name, "time", 1.0, {}, file.origin, file.interval, file.about),
        )
        weakref.finalize(spooled, shutil.rmtree, path.parent, ignore_errors=True)
        writer, count = None, 0
        try:
            for time, columns in file.rows():
                spooled.file.channels = {name: f"column {name}" for name in columns}
                table = pa.table(
                    [arrow_columns.column(values) for values in (time, *columns.values())],
                    names=["time", *spooled.file.channels.values()],
                )
                writer = writer or pq.ParquetWriter(path, table.schema)
                writer.write_table(table)
                count += len(time)
                pace.reached(count)
        except OSError as error:
            message = f"{path} cannot be written: {error.strerror}; planrunner needs room for a copy of a long CSV file"
            raise InstrumentError(message) from None
        finally:
            if writer is not None:
                writer.close()
        return spooled

    @property
    def about(self) -> int:
        return self.file.about

    def rows(self, span: Span = EVERYTHING) -> ReadRows:
        """As for a file."""
        return self.file.rows(span)

    def all_rows(self) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        """As for a file."""
        return self.file.all_rows()


class _Csv(_File):
    """A header line, then numbers; an empty field is a missing number."""

    def columns(self) -> list[str]:
        with self._opened(None) as reader:
            return list(reader.schema.names)

    def rows_about(self) -> int:
        with open_samples(self.path, self.name) as file:
            start = file.read(MAX_HEADER)
            return file.seek(0, 2) * start.count(b"\n") // max(len(start), 1)

    def batches(self, span: Span) -> Iterator[tuple[int, pa.RecordBatch]]:
        with self._opened(list(dict.fromkeys((self.time, *self.channels.values())))) as reader:
            first = 1
            for batch in reader:
                for offset in range(0, batch.num_rows, BATCH):
                    part = batch.slice(offset, BATCH)
                    yield first, part
                    first += part.num_rows

    @contextlib.contextmanager
    def _opened(self, wanted: list[str] | None) -> Iterator[arrow_csv.CSVStreamingReader]:
        """A reader of the columns `wanted`, by default all. Faults of the file become an `InstrumentError`."""
        import pyarrow as pa
        from pyarrow import csv as arrow_csv

        types = {} if wanted is None else dict.fromkeys(wanted, pa.float64())
        convert = arrow_csv.ConvertOptions(column_types=types, include_columns=wanted, strings_can_be_null=True)
        try:
            with open_samples(self.path, self.name) as file:
                check_header(file, self.name)
                options = arrow_csv.ReadOptions(block_size=CSV_BLOCK)
                with arrow_csv.open_csv(file, options, convert_options=convert) as reader:
                    yield reader
        except (pa.ArrowInvalid, pa.ArrowKeyError, OSError, UnicodeDecodeError) as error:
            raise self._not_numbers(wanted or []) or self._unreadable(error) from None

    def _not_numbers(self, wanted: list[str]) -> InstrumentError | None:
        """The message about the first line that is too long, or the first cell that is not a number; None if there is a different fault."""
        with (
            contextlib.suppress(OSError, UnicodeDecodeError),
            open_samples(self.path, self.name) as opened,
            io.TextIOWrapper(opened, "utf-8-sig", newline="") as file,
        ):
            reader = csv.DictReader(iter(lambda: file.readline(CSV_BLOCK), ""))
            try:
                for row in reader:
                    for column in wanted:
                        cell = row.get(column) or ""
                        if not _is_number(cell):
                            place = f"{self.name}, line {reader.line_num}: '{cell[:40]}' in column '{column}'"
                            return InstrumentError(f"{place} is not a number; correct it, or leave it empty")
            except csv.Error:
                message = f"a cell is wider than {csv.field_size_limit()} characters"
                return InstrumentError(
                    f"{self.name}, line {reader.line_num + 1}: {message}; a sample is one short line"
                )
        return None


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return cell.upper() in _MISSING
    return True

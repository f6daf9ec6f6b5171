"""Reads a recording that is played back. The recording consists of one file or several, in any format, inside a data folder.

The memory that a file requires is checked before a sample is read. Samples are read in batches, so the required memory does not
grow with the length of the recording.
"""

from __future__ import annotations

import math
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Protocol

import numpy as np

from planrunner.base import arrow_columns
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.progress import Announce, Pace
from planrunner.instruments.formats.choice import Format, open_file
from planrunner.instruments.formats.file import AnyFile, NoKeys, ReadRows, TimeStamps
from planrunner.instruments.formats.parquet import ParquetFile
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.span import EVERYTHING, Span

HELD = 1_000_000
"""Maximum number of rows of a recording that is kept in memory, so that many parts of the recording can be read quickly."""


def beneath(root: Path | None, name: str) -> Path:
    """Returns the path of the file `name` inside the data folder `root`. Raises `InstrumentError` if there is no such file, or if
    it is outside the folder, for example because of a link."""
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
    """A recording that can be read repeatedly.

    `origin`: time of the first row, s. `interval`: median time between the first rows, s; NaN if there is only one row. `about`:
    approximate number of rows, used to display progress.
    """

    @property
    def origin(self) -> float: ...
    @property
    def interval(self) -> float: ...
    @property
    def about(self) -> int: ...

    def rows(self, span: Span = EVERYTHING) -> ReadRows:
        """Yields the samples in a span, in batches of at most `BATCH` rows: times (n,), in s, and the values (n,) of each channel.
        A missing number is NaN. Raises `InstrumentError` at the first row whose time is not later than the time of the previous
        row."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Returns remarks in words about rows and bytes that were skipped. The remarks are complete after a pass over all rows."""

    def all_rows(self) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        """Yields all rows unchanged, in batches. Each batch contains the number of its first row, counted from 1; times [s], which
        may be missing or decrease; and the values of each channel. Raises `InstrumentError` if the file cannot be read."""


@dataclass(frozen=True, slots=True)
class RecordedFile:
    """One file of a recording. `name`: name of the file, used in messages."""

    path: Path
    name: str


def open_recording(
    parts: Sequence[RecordedFile],
    stamps: TimeStamps,
    channels: Mapping[str, str],
    given: Format | None = None,
    pause: float | None = None,
) -> RecordingFile:
    """Opens the files `parts` as one recording, in this order, after a check of their columns and first rows.

    `channels`: for each channel, the name of its column. `given`: format from the bench file; None if the extension of each file
    name determines it. `pause`: None if the time continues from file to file. If the time starts again in each file, `pause` is the
    time [s] between the last row of a file and the first row of the next one. Raises `InstrumentError` if a file cannot be read or
    lacks a column.
    """
    files = []
    for part in parts:
        file = open_file(part.path, part.name, stamps, channels, given)
        file.look()
        files.append(file)
    return files[0] if len(files) == 1 else _Joined(tuple(files), pause, stamps.column is None)


class _Joined:
    """Several files, read one after the other as one recording. `counted`: True if the files contain no time, so that rows are
    counted through all files instead."""

    def __init__(self, files: tuple[AnyFile, ...], pause: float | None, counted: bool):
        self.files, self.pause, self.counted = files, pause, counted
        self.origin, self.interval = files[0].origin, files[0].interval
        self.about = sum(file.about for file in files)

    @property
    def remarks(self) -> tuple[str, ...]:
        return tuple(f"{file.name}: {remark}" for file in self.files for remark in file.remarks)

    def _shift(self, file: AnyFile, last: float, first: float) -> float:
        """Returns the time [s] that is added to the times of a file. `last`: time of the last row of the previous file. `first`:
        first time in this file. Raises `InstrumentError` if the file begins before the previous file ends."""
        period = 0.0 if math.isnan(self.interval) else self.interval
        if self.counted:
            return last + period - first
        if self.pause is not None:
            return last + self.pause - first
        if not first > last:
            message = f"it begins at {first:.9g} s, but the file before it ends at {last:.9g} s"
            hint = "correct the order of the files; if the time of each begins anew, state `pause_between_files`"
            raise InstrumentError(f"{file.name}: {message}; {hint}")
        return 0.0

    def rows(self, span: Span = EVERYTHING) -> ReadRows:
        """Yields the rows of all files, as described in `RecordingFile.rows`."""
        last = math.nan
        for file in self.files:
            shift = 0.0 if math.isnan(last) else self._shift(file, last, file.origin)
            for time, columns in file.rows():
                moved = time + shift
                last = float(moved[-1])
                part = span.of(moved, self.interval)
                if part.start < part.stop:
                    yield moved[part], {name: values[part] for name, values in columns.items()}
                if part.stop < moved.size:
                    return

    def all_rows(self) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        """Yields all rows of all files, as described in `RecordingFile.all_rows`. Row numbers continue from file to file."""
        last, before = math.nan, 0
        for file in self.files:
            shift = 0.0 if math.isnan(last) else self._shift(file, last, file.origin)
            count = 0
            for first, time, columns in file.all_rows():
                moved = time + shift
                known = moved[np.isfinite(moved)]
                last = float(known[-1]) if known.size else last
                count = first + len(time) - 1
                yield before + first, moved, columns
            before += count


@dataclass(frozen=True, slots=True)
class HeldRecording:
    """Holds a recording in memory, so that many intervals can be read after one pass over its files. `time`: array of shape (n,) in
    s. `columns`: the values (n,) of each channel."""

    origin: float
    interval: float
    time: Array
    columns: Mapping[str, Array]

    @classmethod
    def of(cls, file: RecordingFile, most: float = np.inf, pace: Pace | None = None) -> HeldRecording | None:
        """Reads all rows of a file once. Returns None if the file has more than `most` rows. Raises `InstrumentError` if the file
        cannot be read."""
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

    @property
    def remarks(self) -> tuple[str, ...]:
        return ()

    def rows(self, span: Span = EVERYTHING) -> ReadRows:
        """Returns the rows in a span, as described in `RecordingFile.rows`, in at most one batch."""
        part = span.of(self.time, self.interval)
        if part.start < part.stop:
            yield self.time[part], {name: values[part] for name, values in self.columns.items()}

    def all_rows(self) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        """Returns all rows, as described in `RecordingFile.all_rows`, in at most one batch."""
        if len(self.time):
            yield 1, self.time, dict(self.columns)


def at_hand(file: RecordingFile, name: str = "", notice: Announce | None = None) -> RecordingFile:
    """Returns the same recording in a form from which many intervals can be read quickly. A recording of at most `HELD` rows is
    stored in memory. A longer recording is copied to a temporary Parquet file, because in other formats, all preceding rows must be
    read to reach an interval. `name`: name of the file, used in the progress that `notice` receives. Raises `InstrumentError` if
    the recording cannot be read or the copy cannot be written."""
    held = HeldRecording.of(file, HELD, Pace(f"reading {name}", min(file.about, HELD), notice))
    if held is not None:
        return held
    return file if isinstance(file, ParquetFile) else _Spooled.of(file, Pace(f"copying {name}", file.about, notice))


@dataclass
class _Spooled:
    """A copy of a recording in a temporary Parquet file, which is deleted together with this object."""

    origin: float
    interval: float
    file: ParquetFile

    @classmethod
    def of(cls, file: RecordingFile, pace: Pace) -> _Spooled:
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = Path(tempfile.mkdtemp(prefix="planrunner-")) / "recording.parquet"
        copy = ParquetFile(path, path.name, TimeStamps("time"), {}, NoKeys())
        copy.origin, copy.interval, copy.about = file.origin, file.interval, file.about
        spooled = cls(file.origin, file.interval, copy)
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
            message = (
                f"{path} cannot be written: {error.strerror}; planrunner needs room for a copy of a long recording"
            )
            raise InstrumentError(message) from None
        finally:
            if writer is not None:
                writer.close()
        return spooled

    @property
    def about(self) -> int:
        return self.file.about

    @property
    def remarks(self) -> tuple[str, ...]:
        return ()

    def rows(self, span: Span = EVERYTHING) -> ReadRows:
        """Returns the rows in a span, as described in `RecordingFile.rows`."""
        return self.file.rows(span)

    def all_rows(self) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        """Returns all rows, as described in `RecordingFile.all_rows`."""
        return self.file.all_rows()

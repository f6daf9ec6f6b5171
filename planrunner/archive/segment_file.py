"""Stores the samples of one segment on disk, in Parquet files of limited length. A file is either complete or absent.

Columns are float64: `time` in s, then the channels, with the unit in the field's metadata. A part is written as `….partial`, synced
and renamed; its SHA-256 is computed from the bytes as they are written. A reader loads the bytes of a part into memory, checks
their digest and then decodes them. Data are therefore read only once, and unchecked data are never used. Before decoding, the rows,
columns and types in the file's footer are checked against the journal and against the limits of a part.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.formats import IntegrityError
from planrunner.archive.storage import ASIDE, Storage, digest
from planrunner.archive.summaries import METADATA, from_text
from planrunner.base import arrow_columns
from planrunner.base.documents import Json, JsonObject
from planrunner.base.guarded_folder import GuardedFolder, NotOrdinaryError
from planrunner.instruments.interfaces import Block, InstrumentError, SummaryChannels

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

FOLDER = "segments"
FORMAT = 1
SUMMARY_FORMAT = 2
"""Format of a segment's summary. This format differs from `FORMAT`, so that an older version of planrunner does not read a summary
as samples."""
PART_BYTES = 32 * 2**20
"""Maximum size of the samples of one part, in bytes."""
PART_SECONDS = 600.0
"""Maximum duration of one part, s. A crash loses at most the samples of this time."""
GROUP_ROWS = 65_536
MOST_BYTES = 2 * PART_BYTES
"""Maximum size in bytes of a file of samples. The maximum allows for samples that cannot be compressed, and for the tables of the
file."""
MOST_COLUMNS = 1000
"""Maximum number of columns of a file of samples."""


@dataclass(frozen=True, slots=True)
class Part:
    """Describes a finished file of samples: its name within the run folder, its SHA-256, its number of rows, and its size in bytes."""

    file: str
    sha256: str
    rows: int
    bytes: int

    def to_json(self) -> JsonObject:
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Json]) -> Part:
        if not re.fullmatch(rf"{FOLDER}/[A-Za-z0-9+_.-]+\.parquet", data["file"]):
            raise ValueError(f"{data['file']!r} is not a file of samples")
        return cls(str(data["file"]), str(data["sha256"]), int(data["rows"]), int(data["bytes"]))


def safe_name(label: str) -> str:
    """Returns a label in a form that every platform accepts in a file name: letters, digits, `+`, `-` and `_`, at most 60
    characters."""
    return re.sub(r"[^A-Za-z0-9+_-]+", "_", label).strip("_")[:60] or "segment"


def file_stem(index: int, label: str, attempt: int) -> str:
    """Returns the beginning of a file name, such as `0001-P1`, or `0001-P1.try2` for a repeated segment. The numbers count from
    1."""
    again = f".try{attempt}" if attempt > 1 else ""
    return f"{index + 1:04d}-{safe_name(label)}{again}"


class SegmentWriter:
    """Writes the samples of one segment as they arrive; `take_finished` returns the parts that are complete on the disk."""

    def __init__(
        self,
        folder: GuardedFolder,
        stem: str,
        channels: Mapping[str, str],
        storage: Storage,
        *,
        description: Mapping[str, str] | None = None,
        part_bytes: int = PART_BYTES,
        part_seconds: float = PART_SECONDS,
    ):
        if "time" in channels:
            raise InstrumentError(
                "the sensor has a channel named 'time', which is reserved for the recording: rename it"
            )
        if len(channels) >= MOST_COLUMNS:
            raise InstrumentError(
                f"the sensor has {len(channels)} channels; a recording takes {MOST_COLUMNS - 1} at most"
            )
        self.folder = folder
        self.stem = stem
        self.channels = dict(channels)
        self.parts = 0
        self.rows = 0
        self._storage = storage
        self._schema = _schema(self.channels, description or {})
        self._part_rows = max(1, part_bytes // (8 * (len(channels) + 1)))
        self._part_seconds = part_seconds
        self._waiting: list[Block] = []
        self._waiting_rows = 0
        self._open: _OpenPart | None = None
        self._part_start: float | None = None
        self._part_filled = 0
        self._last_time = -np.inf
        self._finished: list[Part] = []

    def append(self, block: Block) -> None:
        """Adds consecutive samples. Raises `InstrumentError` for samples that do not continue the segment, and `OSError` if they
        cannot be written."""
        self._check(block)
        start = 0
        while start < len(block.time):
            stop = self._until(block, start)
            if stop == start:
                self._finish_part()
                continue
            piece = block if stop - start == len(block.time) else _cut(block, start, stop)
            if self._part_start is None:
                self._part_start = float(piece.time[0])
            self._waiting.append(piece)
            self._waiting_rows += len(piece.time)
            self._part_filled += len(piece.time)
            self.rows += len(piece.time)
            start = stop
            if self._waiting_rows >= GROUP_ROWS:
                self._write_waiting()
        if self._waiting:  # a driver may reuse its buffers before these samples are written
            last = self._waiting[-1]
            self._waiting[-1] = Block(
                np.array(last.time), {name: np.array(values) for name, values in last.channels.items()}
            )

    def take_finished(self) -> list[Part]:
        """Returns the parts finished since the last call, in order."""
        finished, self._finished = self._finished, []
        return finished

    def close(self) -> list[Part]:
        """Finishes the last part; a segment without samples gets one empty file. Returns the finished parts that `take_finished`
        has not returned."""
        if self._part_filled or self.parts == 0:
            self._finish_part()
        return self.take_finished()

    def abandon(self) -> None:
        """Discards the part in progress and its file."""
        part, self._open, self._waiting = self._open, None, []
        if part is not None:
            part.abandon()

    def _check(self, block: Block) -> None:
        if set(block.channels) != set(self.channels):
            got, want = ", ".join(block.channels), ", ".join(self.channels)
            raise InstrumentError(f"the sensor gave the channels {got} but had announced {want}")
        count = len(block.time)
        if any(len(values) != count for values in block.channels.values()):
            raise InstrumentError("the sensor gave a block whose channels differ in length")
        if count:
            if not (block.time[0] > self._last_time and (count == 1 or bool(np.all(np.diff(block.time) > 0)))):
                raise InstrumentError(
                    f"the sensor's time does not increase after {self._last_time:.6f} s: check its clock, or the "
                    "recording"
                )
            self._last_time = float(block.time[-1])

    def _until(self, block: Block, start: int) -> int:
        """Returns the index of the first row of the block that no longer fits into the current part."""
        stop = min(len(block.time), start + self._part_rows - self._part_filled)
        begin = self._part_start if self._part_start is not None else float(block.time[start])
        limit = begin + self._part_seconds
        if stop > start and block.time[stop - 1] > limit:
            stop = int(np.searchsorted(block.time[:stop], limit, side="right"))
        return max(stop, start)

    def _write_waiting(self) -> None:
        import pyarrow as pa

        if self._open is None:
            name = f"{self.stem}.parquet" if self.parts == 0 else f"{self.stem}.part{self.parts + 1:03d}.parquet"
            self._open = _OpenPart(self.folder, name, self._schema, self._storage)
        if not self._waiting:
            return
        waiting, self._waiting, self._waiting_rows = self._waiting, [], 0
        columns = [_joined([block.time for block in waiting])]
        columns += [_joined([block.channels[name] for block in waiting]) for name in self.channels]
        self._open.write(
            pa.Table.from_arrays([arrow_columns.column(values) for values in columns], schema=self._schema)
        )

    def _finish_part(self) -> None:
        if self._waiting or self._open is None:
            self._write_waiting()
        assert self._open is not None
        part, self._open = self._open, None
        self._part_start, self._part_filled = None, 0
        self.parts += 1
        self._finished.append(part.finish())


class _HashedSink:
    """An output for pyarrow that hashes the bytes and passes them on."""

    def __init__(self, storage: Storage, folder: GuardedFolder, name: str):
        self.storage = storage
        self.file = storage.open_new(folder, name)
        self.hash = hashlib.sha256()
        self.size = 0
        self.closed = False
        self.broken = False

    def write(self, data: bytes) -> int:
        if self.broken:
            raise OSError("an earlier write of this file failed")
        self.broken = True  # until this write has succeeded: a file with a gap is never finished
        self.storage.write(self.file, memoryview(data))
        self.broken = False
        self.hash.update(data)
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None: ...

    def writable(self) -> bool:
        return True

    def readable(self) -> bool:
        return False

    def seekable(self) -> bool:
        return False

    def close(self) -> None:
        """Does nothing: pyarrow closes its output, but the file must stay open until it is synced."""


class _OpenPart:
    """A Parquet file that is being written under a temporary name."""

    def __init__(self, folder: GuardedFolder, name: str, schema: pa.Schema, storage: Storage):
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.folder = folder
        self.name = name
        self.aside = name + ASIDE
        self.rows = 0
        self._storage = storage
        self._sink = _HashedSink(storage, folder, self.aside)
        try:
            self._native = pa.PythonFile(self._sink, mode="w")
            self._writer = pq.ParquetWriter(
                self._native, schema, compression="snappy", use_dictionary=False, write_statistics=False
            )
        except BaseException:  # it writes a header
            self._sink.file.close()
            raise

    def write(self, table: pa.Table) -> None:
        self._writer.write_table(table, row_group_size=max(GROUP_ROWS, 1))
        self.rows += table.num_rows

    def finish(self) -> Part:
        try:
            self._writer.close()
            self._native.close()
            if self._sink.broken:
                raise OSError("an earlier write of this file failed")
            self._storage.sync(self._sink.file)
            self._sink.file.close()
            self._storage.replace(self.folder, self.aside, self.name)
        except BaseException:
            self.abandon()
            raise
        self._storage.sync_folder(self.folder)
        return Part(f"{FOLDER}/{self.name}", self._sink.hash.hexdigest(), self.rows, self._sink.size)

    def abandon(self) -> None:
        """Closes the file and removes it, as far as possible."""
        self._sink.broken = True
        try:
            with contextlib.suppress(Exception):
                self._writer.close()
        finally:
            self._sink.file.close()
        with contextlib.suppress(OSError):
            self._storage.remove(self.folder, self.aside)


def _schema(
    channels: Mapping[str, str],
    description: Mapping[str, str],
) -> pa.Schema:
    import pyarrow as pa

    units = {"time": "s", **channels}
    fields = [pa.field(name, pa.float64(), nullable=False, metadata={"unit": unit}) for name, unit in units.items()]
    version = SUMMARY_FORMAT if METADATA in description else FORMAT
    return pa.schema(fields, metadata={"planrunner_segment": str(version), **description})


def _joined(arrays: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    whole = arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
    return np.ascontiguousarray(whole, dtype=np.float64)


def _cut(block: Block, start: int, stop: int) -> Block:
    return Block(block.time[start:stop], {name: values[start:stop] for name, values in block.channels.items()})


# -- reading -----------------------------------------------------------------------------------------------------------


class SegmentData:
    """Contains the samples of one part: the bytes of the file, and its footer. The bytes have been checked against the digest in
    the journal.

    `folder`: the run folder. Raises `IntegrityError` if the file is missing, differs from its digest, or does not have the form
    that this version writes.
    """

    def __init__(self, folder: GuardedFolder, part: Part):
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.path = folder.path / part.file
        self.summary: SummaryChannels | None = None
        data = _checked_bytes(folder, part)
        try:
            self._file = pq.ParquetFile(pa.BufferReader(data))
            schema = self._file.schema_arrow
            self._check_version(schema)
            self._check_shape(part, schema)
            self.units = {
                field.name: (field.metadata or {}).get(b"unit", b"").decode()
                for field in schema
                if field.name != "time"
            }
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            raise self._foreign(str(error)[:200]) from None

    def blocks(self, channels: Sequence[str] | None = None) -> Iterator[Block]:
        """Yields the samples, one block for each row group. `channels`: the channels to return; None for all channels. Raises
        `IntegrityError` if a channel is missing or the samples cannot be decoded."""
        import pyarrow as pa

        names = list(self.units) if channels is None else list(channels)
        missing = [name for name in names if name not in self.units]
        if missing:
            raise self._foreign(f"it has no column '{missing[0][:60]}'")
        last = -np.inf
        try:
            for group in range(self._file.num_row_groups):
                table = self._file.read_row_group(group, columns=["time", *names], use_threads=False)
                block = Block(_column(table, "time"), {name: _column(table, name) for name in names})
                last = self._later(block.time, last)
                yield block
        except (pa.ArrowException, OSError) as error:
            raise self._foreign(str(error)[:200]) from None

    def _check_version(self, schema: pa.Schema) -> None:
        version = (schema.metadata or {}).get(b"planrunner_segment", b"").decode("ascii", "replace")
        if version not in (str(FORMAT), str(SUMMARY_FORMAT)):
            raise IntegrityError(
                f"{self.path}: segment format {version[:40]!r}; this version of planrunner reads {FORMAT} and {SUMMARY_FORMAT}: use a "
                "newer version of planrunner"
            )
        if version == str(SUMMARY_FORMAT):
            try:
                self.summary = from_text((schema.metadata or {}).get(METADATA.encode(), b"").decode())
            except ValueError as error:
                raise self._foreign(str(error)[:200]) from None

    def _check_shape(self, part: Part, schema: pa.Schema) -> None:
        """Checks the footer: the file has as many rows as the journal states, only columns of 64-bit floats, and no more rows and
        columns than a part can have."""
        import pyarrow as pa

        about: pq.FileMetaData = self._file.metadata
        groups = [about.row_group(number) for number in range(about.num_row_groups)]
        columns = len(schema.names)
        if about.num_rows != part.rows or sum(group.num_rows for group in groups) != part.rows:
            raise self._foreign(f"it holds {about.num_rows} rows, but the journal counts {part.rows}")
        if not 1 <= columns <= MOST_COLUMNS or len(set(schema.names)) != columns or "time" not in schema.names:
            raise self._foreign("its columns must be time and channels, with different names")
        if any(field.type != pa.float64() for field in schema) or about.num_columns != columns:
            raise self._foreign("not every column is of 64-bit floats")
        if part.rows > max(1, PART_BYTES // (8 * columns)):
            raise self._foreign(f"{part.rows} rows of {columns} columns are more than a part may contain")
        for group in groups:
            for number in range(columns):
                column = group.column(number)
                if column.physical_type != "DOUBLE" or column.num_values != group.num_rows:
                    raise self._foreign("its tables contradict each other")
                if column.total_uncompressed_size > MOST_BYTES:
                    raise self._foreign("its samples would need more memory than a part may use")

    def _later(self, time: NDArray[np.float64], last: float) -> float:
        """Returns the last time of a block, after checking that the block's times are finite, increase, and begin after `last`."""
        if len(time) == 0:
            return last
        if not (time[0] > last and np.isfinite(time[-1]) and bool(np.all(time[1:] > time[:-1]))):
            raise self._foreign("its time does not increase")
        return float(time[-1])

    def _foreign(self, what: str) -> IntegrityError:
        return IntegrityError(f"{self.path}: not a recording of a segment: {what}; restore the file from a backup")


def rows_of(data: bytes) -> int:
    """Returns the number of rows of a Parquet file according to its footer. Raises ValueError if it is not a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return int(pq.read_metadata(pa.BufferReader(data)).num_rows)
    except (pa.ArrowException, OSError) as error:
        raise ValueError(str(error)) from None


def check_part(folder: GuardedFolder, part: Part) -> None:
    """Checks a part against the journal without decoding its samples. Raises `IntegrityError` if the part does not agree with the
    journal."""
    SegmentData(folder, part)


def _checked_bytes(folder: GuardedFolder, part: Part) -> bytes:
    """Reads the bytes of a part and checks them against the digest in the journal. Raises `IntegrityError` if the bytes do not have
    this digest."""
    path = folder.path / part.file
    try:
        data = folder.folder(FOLDER).read(part.file.removeprefix(f"{FOLDER}/"), MOST_BYTES)
    except OSError as error:
        how = "" if isinstance(error, NotOrdinaryError) else "cannot be read: "
        raise IntegrityError(f"{path}: the samples: {how}{error.strerror}; restore the file from a backup") from None
    if digest(data) != part.sha256 or len(data) != part.bytes:
        raise IntegrityError(
            f"{path}: the samples differ from what was recorded (SHA-256); restore the file from a backup"
        )
    return data


def _column(table: pa.Table, name: str) -> NDArray[np.float64]:
    parts = [arrow_columns.numbers(chunk) for chunk in table.column(name).chunks]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)

"""Reads Parquet files. The directory, the columns and the row groups are checked against limits of size before they are read."""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Collection, Iterable, Iterator
from typing import TYPE_CHECKING, BinaryIO

from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats.arrow import ArrowRows
from planrunner.instruments.formats.file import FormatFile, NoKeys, SampleRows, few_columns, open_samples
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.span import Span

if TYPE_CHECKING:
    import pyarrow.parquet as pq

MAX_DIRECTORY = 16_000_000
"""Maximum size in bytes of the directory at the end of the file."""
MAX_CHUNK = 600_000_000
"""Maximum uncompressed size in bytes of a column in one row group. The largest row group of common writers has 2^26 numbers."""
_END = struct.Struct("<I4s")


def check_directory(file: BinaryIO, name: str) -> None:
    """Checks that the directory of the file is not too large, and then moves the read position to the start of the file. Raises
    `InstrumentError` if the directory is too large."""
    size = file.seek(0, 2)
    if size >= _END.size:
        file.seek(size - _END.size)
        length, _ = _END.unpack(file.read(_END.size))
        if length > MAX_DIRECTORY and length < size:
            message = f"its directory of columns and row groups has {length / 1e6:.0f} MB, more than {MAX_DIRECTORY / 1e6:g} MB"
            raise InstrumentError(f"{name}: {message}; write it again with larger row groups, or fewer columns")
    file.seek(0)


def check_parquet(file: pq.ParquetFile, name: str, wanted: Iterable[str], written: Collection[str] = ()) -> None:
    """Checks the columns of a file: their number, the types of the `wanted` columns, and the size of these columns in a row group.
    `written`: the columns that may contain dates or times of day. Raises `InstrumentError` if a check fails."""
    from pyarrow import types

    few_columns(file.metadata.num_columns, name)
    schema = file.schema_arrow
    for column in wanted:
        for index in () if column in written else schema.get_all_field_indices(column):
            kind = schema.field(index).type
            if not any(
                fits(kind) for fits in (types.is_integer, types.is_floating, types.is_decimal, types.is_boolean)
            ):
                what = "text" if types.is_string(kind) or types.is_large_string(kind) else f"values of the type {kind}"
                message = f"column '{column}' holds {what}, not numbers"
                hint = "write it again with a column of float64"
                if types.is_timestamp(kind) or types.is_time(kind):
                    hint = f"write `time: {{column: {column}, unit: date_time}}` if it is the time of the recording"
                raise InstrumentError(f"{name}: {message}; {hint}")
    read = frozenset(wanted)
    for number in range(file.num_row_groups):
        group = file.metadata.row_group(number)
        for index in range(group.num_columns):
            chunk = group.column(index)
            if chunk.path_in_schema in read and chunk.total_uncompressed_size > MAX_CHUNK:
                message = f"column '{chunk.path_in_schema}' has {chunk.total_uncompressed_size / 1e6:.0f} MB in row group {number + 1}"
                raise InstrumentError(f"{name}: {message}; write it again with row groups of a million rows")


class ParquetFile(FormatFile[NoKeys]):
    """A Parquet file. A row group is skipped if its statistics show that it is outside the requested span."""

    def faults(self) -> tuple[type[Exception], ...]:
        import pyarrow as pa

        return (*super().faults(), pa.ArrowInvalid, pa.ArrowNotImplementedError)

    def columns(self) -> list[str]:
        import pyarrow as pa

        try:
            with self._opened() as file:
                return list(file.schema_arrow.names)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise self.unreadable(error) from None

    def rows_about(self) -> int:
        with self._opened() as file:
            return int(file.metadata.num_rows)

    @contextlib.contextmanager
    def _opened(self) -> Iterator[pq.ParquetFile]:
        """Checks the directory at the end of the file and the columns, and yields the open file. Columns are read in small
        pieces."""
        import pyarrow.parquet as pq

        with open_samples(self.path, self.name) as opened:
            check_directory(opened, self.name)
            with pq.ParquetFile(opened, buffer_size=1 << 20, pre_buffer=False) as file:
                check_parquet(file, self.name, self.wanted, self.unconverted)
                yield file

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        with self._opened() as file:
            first = 1
            for group in range(file.num_row_groups):
                count = file.metadata.row_group(group).num_rows
                if not self._outside(file.metadata.row_group(group), span):
                    row = first
                    for batch in file.iter_batches(format_file.BATCH, row_groups=[group], columns=self.wanted):
                        yield row, ArrowRows(batch, row, self.name)
                        row += batch.num_rows
                first += count

    def _outside(self, group: pq.RowGroupMetaData, span: Span) -> bool:
        """Returns True if the statistics of a row group show that it is outside the span. A group that may touch a boundary of the
        span, because of rounding, is read."""
        if not self.stamps.in_file:
            return False
        scale = self.stamps.scale
        for index in range(group.num_columns):
            column = group.column(index)
            if column.path_in_schema == self.stamps.column:
                known = column.statistics
                if known is None or not known.has_min_max or not isinstance(known.min, int | float):
                    return False
                rounding = 0.0 if math.isnan(self.interval) else self.interval
                return bool(known.max * scale < span.start - rounding or known.min * scale > span.end)
        return False

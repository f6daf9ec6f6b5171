"""What the file of a recording may ask of this computer, looked at before a sample is read.

Samples are read in batches, so that a recording may be as long as it likes. What would be held at once is bounded here: the header and
the columns of a CSV file; the directory, the columns and the row groups of a Parquet file. Only columns of numbers are read.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from planrunner.base.regular_files import RefusedFileError, open_regular
from planrunner.instruments.interfaces import InstrumentError

if TYPE_CHECKING:
    import pyarrow.parquet as pq

MAX_BYTES = 100_000_000_000
"""Of the file: 1 kHz of ten channels for a month."""
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
    """Hold the first line of a CSV file to its bounds and go back to the beginning. Raises `InstrumentError`."""
    start = file.read(MAX_HEADER + 1).removeprefix(b"\xef\xbb\xbf").lstrip(b"\r\n")
    file.seek(0)
    header = start.partition(b"\n")[0].partition(b"\r")[0]
    _few_columns(header.count(b",") + 1, name)
    if len(header) > MAX_HEADER - 100 and len(header) == len(start):  # no end of the line was found
        message = f"its header is longer than {MAX_HEADER} bytes"
        raise InstrumentError(f"{name}: {message}; the first line names the columns, and each further line is a sample")


def check_directory(file: BinaryIO, name: str) -> None:
    """Hold the size of a Parquet file's directory to its bound and go back to the beginning. Raises `InstrumentError`."""
    size = file.seek(0, 2)
    if size >= _PARQUET_END.size:
        file.seek(size - _PARQUET_END.size)
        length, _ = _PARQUET_END.unpack(file.read(_PARQUET_END.size))
        if length > MAX_DIRECTORY and length < size:
            message = f"its directory of columns and row groups has {length / 1e6:.0f} MB, more than {MAX_DIRECTORY / 1e6:g} MB"
            raise InstrumentError(f"{name}: {message}; write it again with larger row groups, or fewer columns")
    file.seek(0)


def check_parquet(file: pq.ParquetFile, name: str, wanted: Iterable[str]) -> None:
    """Hold the columns of a Parquet file to their bounds: how many, which types those that are `wanted` have, and how large they are
    in a row group. Raises `InstrumentError`."""
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

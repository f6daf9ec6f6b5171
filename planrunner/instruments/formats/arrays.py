"""Reads files of numeric arrays: MATLAB files of version 5 and 7.3, NumPy files and HDF5.

A column is named after its array if the array has one number per row (`gyro_x`). A column of a matrix has the name of the matrix
and the number of the column, counted from 1 (`imu[4]`). An array in a structure has the name of the structure, a point and the name
of the field (`data.gyr[1]`). In HDF5, `/` separates the groups (`imu/gyro[1]`). The rows of a matrix are counted along its longer
dimension.
"""

from __future__ import annotations

import contextlib
import io
import re
import struct
import zipfile
import zlib
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats.file import (
    MAX_COLUMNS,
    FormatFile,
    HeldRows,
    NoKeys,
    SampleRows,
    TimeStamps,
    open_samples,
)
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.span import Span

if TYPE_CHECKING:
    import h5py

MAX_UNPACKED = 2_000_000_000
"""Maximum size in bytes of the arrays in a file that is read as a whole."""
_COLUMN = re.compile(r"(.*)\[(\d{1,6})\]")
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_MATLAB_HEADER = 128
_COMPRESSED = 15  # type of an element of a MATLAB file that is packed with zlib
_DEEPEST = 6  # structures in structures


class ArraysFile(FormatFile[NoKeys]):
    """A file of named arrays. Each array is a single column or a matrix of columns."""

    @abstractmethod
    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """Returns the shapes of the numeric arrays, by name. Raises `InstrumentError` if the file cannot be read."""

    @abstractmethod
    def read(self, names: list[str], begin: int, end: int) -> Mapping[str, Array]:
        """Reads the rows from `begin` (counted from 0) up to but not including `end` of the named columns."""

    def faults(self) -> tuple[type[Exception], ...]:
        return (*super().faults(), ValueError, KeyError, EOFError, zlib.error, zipfile.BadZipFile, struct.error)

    def columns(self) -> list[str]:
        try:
            found = [name for array, shape in self.shapes().items() for name in _columns_of(array, shape)]
        except self.faults() as error:
            raise self.unreadable(error) from None
        if not found:
            raise InstrumentError(f"{self.name} contains no arrays of numbers with one or two dimensions")
        return found

    def rows_about(self) -> int:
        return self._rows()

    def _rows(self) -> int:
        shapes = self.shapes()
        counts = {name: max(shapes[array_of(name)], default=1) for name in self.wanted}
        least, most = min(counts, key=counts.__getitem__), max(counts, key=counts.__getitem__)
        if counts[least] != counts[most]:
            message = f"'{least}' has {counts[least]} rows and '{most}' has {counts[most]}"
            raise InstrumentError(f"{self.name}: {message}; all columns of a recording need the same number of rows")
        return counts[least]

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        count = self._rows()
        for begin in range(0, count, format_file.BATCH):
            end = min(begin + format_file.BATCH, count)
            yield begin + 1, HeldRows(end - begin, self.read(self.wanted, begin, end))

    def hint(self, column: str, known: list[str]) -> str:
        shapes = self.shapes()
        named = ", ".join(f"{name} ({' × '.join(map(str, shape))})" for name, shape in list(shapes.items())[:12])
        return f"its arrays are {named}; column 2 of a matrix is written as 'name[2]'"


def array_of(column: str) -> str:
    """Returns the name of the array that contains a column."""
    found = _COLUMN.fullmatch(column)
    return column if found is None else found[1]


def _columns_of(array: str, shape: tuple[int, ...]) -> list[str]:
    if len(shape) == 1 or (len(shape) == 2 and min(shape) == 1):
        return [array]
    if len(shape) != 2 or min(shape) > MAX_COLUMNS:
        return []
    return [f"{array}[{number + 1}]" for number in range(min(shape))]


def _part(array: NDArray[np.generic] | h5py.Dataset, column: str, begin: int, end: int) -> Array:
    """Returns the rows from `begin` up to but not including `end` of one column of an array or dataset, shape (end − begin,). If
    the column is in a dataset, only these rows are read from the file. Dates keep their type."""
    shape = array.shape
    kind = None if array.dtype.kind == "M" else float
    if len(shape) == 1:
        return np.asarray(array[begin:end], kind)
    found = _COLUMN.fullmatch(column)
    number = 0 if found is None else int(found[2]) - 1
    rows_first = shape[0] >= shape[1]
    return np.asarray(array[begin:end, number] if rows_first else array[number, begin:end], kind)


def _is_table(array: object) -> bool:
    return isinstance(array, np.ndarray) and array.dtype.kind in "fiubM" and 1 <= array.ndim <= 2 and array.size > 0


class _HeldArrays(ArraysFile):
    """A file that is read as a whole; its arrays are kept in memory."""

    def __init__(self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: NoKeys):
        super().__init__(path, name, stamps, channels, parameters)
        self._arrays: dict[str, NDArray[np.generic]] | None = None

    @abstractmethod
    def load(self, file: BinaryIO) -> Mapping[str, object]:
        """Loads all contents of the file, by name."""

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Returns the numeric arrays by name."""
        if self._arrays is None:
            with open_samples(self.path, self.name) as file:
                found = {}
                for name, value in self.load(file).items():
                    found.update(_within(name, value))
            self._arrays = found
        return self._arrays

    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        return {name: array.shape for name, array in self.arrays().items()}

    def read(self, names: list[str], begin: int, end: int) -> Mapping[str, Array]:
        return {name: _part(self.arrays()[array_of(name)], name, begin, end) for name in names}

    def bounded(self, size: int) -> None:
        """Raises `InstrumentError` if the arrays, with `size` bytes in total, are too large for the memory."""
        if size > MAX_UNPACKED:
            message = f"its arrays have more than {MAX_UNPACKED / 1e9:g} GB"
            raise InstrumentError(
                f"{self.name}: {message}; save them as Parquet or HDF5, which are read piece by piece"
            )


def _within(name: str, value: object, depth: int = 0) -> dict[str, NDArray[np.generic]]:
    """Finds the numeric arrays in a value: the value itself, or the fields of a structure."""
    if not isinstance(value, np.ndarray) or depth > _DEEPEST:
        return {}
    if _is_table(value):
        return {name: value}
    if value.dtype.names is not None and value.size == 1:
        item = value.reshape(-1)[0]
        fields = {field: np.asarray(item[field]) for field in value.dtype.names}
    elif value.dtype.names is not None:  # a table with one record a row
        fields = {field: value[field].reshape(value.size, -1) for field in value.dtype.names}
        return {f"{name}.{field}": array for field, array in fields.items() if _is_table(array)}
    else:
        return {}
    found = {}
    for field, inner in fields.items():
        found.update(_within(f"{name}.{field}", inner, depth + 1))
    return found


class MatlabFile(_HeldArrays):
    """A MATLAB file of version 5, 6 or 7. Version 7.3 writes HDF5, which `Hdf5File` reads."""

    def load(self, file: BinaryIO) -> Mapping[str, object]:
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError

        self.bounded(_unpacked(file))
        try:
            contents = loadmat(file, squeeze_me=False, struct_as_record=True, chars_as_strings=False)
        except (MatReadError, NotImplementedError, TypeError) as error:
            raise InstrumentError(f"{self.name} cannot be read as a MATLAB file: {str(error)[:200]}") from None
        return {name: value for name, value in contents.items() if not name.startswith("__")}


def _unpacked(file: BinaryIO) -> int:
    """Returns the total size in bytes of all elements of a MATLAB file after unpacking. Counting stops as soon as the total exceeds
    `MAX_UNPACKED`. Finally, the read position is set to the start of the file."""
    file.seek(0)
    header = file.read(_MATLAB_HEADER)
    order = ">" if header[126:128] == b"MI" else "<"
    total = 0
    while total <= MAX_UNPACKED and len(tag := file.read(8)) == 8:
        kind, size = struct.unpack(f"{order}II", tag)
        if kind != _COMPRESSED:
            total += size
            file.seek(size, 1)
            continue
        unpack, left = zlib.decompressobj(), size
        while left and total <= MAX_UNPACKED:
            piece = file.read(min(left, 1 << 16))
            if not piece:
                break
            left -= len(piece)
            while piece and total <= MAX_UNPACKED:
                total += len(unpack.decompress(piece, 1 << 22))
                piece = unpack.unconsumed_tail
    file.seek(0)
    return total


class NumpyFile(_HeldArrays):
    """Reads a NumPy file. A `.npy` file contains a matrix, which is named `data`, or a table with named fields; an `.npz` file
    contains several arrays. Python objects are refused."""

    def load(self, file: BinaryIO) -> Mapping[str, object]:
        if file.read(4) == b"PK\x03\x04":
            with zipfile.ZipFile(file) as packed:
                self.bounded(sum(entry.file_size for entry in packed.infolist()))
                return {
                    entry.filename.removesuffix(".npy"): _array(packed.open(entry), entry.file_size)
                    for entry in packed.infolist()
                }
        size = file.seek(0, 2)
        self.bounded(size)
        file.seek(0)
        array = _array(file, size)
        if isinstance(array, np.ndarray) and array.dtype.names is not None:
            return {field: array[field].reshape(array.size, -1) for field in array.dtype.names}
        return {"data": array}


def _array(file: IO[bytes], size: int) -> object:
    """Reads an array in NumPy's format from the first `size` bytes of the file. Raises `ValueError` if the header states more data
    than these bytes contain."""
    whole = io.BytesIO(file.read(size))
    return np.lib.format.read_array(whole, allow_pickle=False)


class Hdf5File(ArraysFile):
    """An HDF5 file, which may have been written by MATLAB 7.3. Only datasets in the file itself are read; links to other files are
    refused."""

    @contextlib.contextmanager
    def _opened(self) -> Iterator[h5py.File]:
        try:
            import h5py
        except ImportError:
            message = "reading HDF5 needs the package h5py; install it with: pip install 'planrunner[recordings]'"
            raise InstrumentError(f"{self.name}: {message}") from None
        with open_samples(self.path, self.name) as opened, h5py.File(opened, "r") as file:
            yield file

    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        import h5py

        found: dict[str, tuple[int, ...]] = {}

        def look(group: h5py.Group, prefix: str, depth: int) -> None:
            for name in group:
                if len(found) > MAX_COLUMNS or not isinstance(group.get(name, getlink=True), h5py.HardLink):
                    continue
                item = group[name]
                if isinstance(item, h5py.Dataset):
                    plain = item.dtype.kind in "fiub" and item.external is None and not item.is_virtual
                    if plain and 1 <= item.ndim <= 2 and item.size:
                        self._bounded(name, item)
                        found[prefix + name] = tuple(item.shape)
                elif isinstance(item, h5py.Group) and depth < _DEEPEST and not name.startswith("#"):
                    look(item, f"{prefix}{name}/", depth + 1)

        with self._opened() as file:
            look(file, "", 0)
        return found

    def _bounded(self, name: str, item: h5py.Dataset) -> None:
        if item.chunks is not None and np.prod(item.chunks) * item.dtype.itemsize > MAX_UNPACKED // 4:
            message = f"'{name}' is stored in pieces of more than {MAX_UNPACKED / 4e9:g} GB"
            raise InstrumentError(f"{self.name}: {message}; write it again with chunks of a million rows")

    def read(self, names: list[str], begin: int, end: int) -> Mapping[str, Array]:
        with self._opened() as file:
            return {name: _part(file[array_of(name)], name, begin, end) for name in names}


def is_hdf5(path: Path, name: str) -> bool:
    """Returns True if a file is HDF5. In a file of MATLAB 7.3, another header precedes the HDF5 part. Raises `InstrumentError` if
    the file cannot be opened."""
    with open_samples(path, name) as file:
        start = file.read(512 + len(HDF5_MAGIC))
    return start.startswith(HDF5_MAGIC) or start[512:] == HDF5_MAGIC


class UlogFile(_HeldArrays):
    """A flight log of PX4. The name of a column consists of a topic, a field and an index counted from 1, such as
    `sensor_combined.gyro_rad[1]`. The name of a further instance of a topic also contains the number of the instance, as in
    `sensor_accel.1.x`. Each topic has its own times, so a recording takes all its columns from one topic."""

    def load(self, file: BinaryIO) -> Mapping[str, object]:
        try:
            from pyulog import ULog
            from pyulog.exceptions import ULogException
        except ImportError:
            message = "reading ULog needs the package pyulog; install it with: pip install 'planrunner[recordings]'"
            raise InstrumentError(f"{self.name}: {message}") from None
        self.bounded(file.seek(0, 2))
        file.seek(0)
        try:
            log = ULog(file)
        except (ULogException, TypeError, IndexError, AttributeError) as error:
            raise InstrumentError(f"{self.name} cannot be read as ULog: {str(error)[:200]}") from None
        found: dict[str, object] = {}
        for data in log.data_list:
            topic = f"{data.name}.{data.multi_id}" if data.multi_id else data.name
            vectors: dict[str, list[NDArray[np.generic]]] = {}
            for field, values in data.data.items():
                vectors.setdefault(field.partition("[")[0], []).append(np.asarray(values))
            for field, parts in vectors.items():
                found[f"{topic}.{field}"] = parts[0] if len(parts) == 1 else np.stack(parts, axis=1)
        return found

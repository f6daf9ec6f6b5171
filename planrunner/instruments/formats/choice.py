"""Lists the formats of recordings, and reads the bench-file key `format`, which names one of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path

from planrunner.base.documents import JsonObject
from planrunner.base.findings import Findings, InputError
from planrunner.instruments.formats.arrays import Hdf5File, MatlabFile, NumpyFile, UlogFile, is_hdf5
from planrunner.instruments.formats.bag_files import METADATA
from planrunner.instruments.formats.binary import BinaryFile, BinaryKeys, check_binary
from planrunner.instruments.formats.database import SqliteFile
from planrunner.instruments.formats.dataflash import DataflashFile
from planrunner.instruments.formats.file import AnyFile, TimeStamps, open_samples
from planrunner.instruments.formats.json_samples import JsonFile
from planrunner.instruments.formats.long import LongFile, ReadingColumns
from planrunner.instruments.formats.novatel import NovatelFile
from planrunner.instruments.formats.parquet import ParquetFile
from planrunner.instruments.formats.rosbag import RosbagFile
from planrunner.instruments.formats.tdms import TdmsFile
from planrunner.instruments.formats.text import TextFile
from planrunner.instruments.formats.workbook import WorkbookFile
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Choice, Plugged, Record, RecordOf, key, optional
from planrunner.plan.source import Node

FORMATS: dict[str, type[AnyFile]] = {
    "text": TextFile,
    "parquet": ParquetFile,
    "binary": BinaryFile,
    "matlab": MatlabFile,
    "numpy": NumpyFile,
    "hdf5": Hdf5File,
    "sqlite": SqliteFile,
    "ulog": UlogFile,
    "json": JsonFile,
    "excel": WorkbookFile,
    "tdms": TdmsFile,
    "novatel": NovatelFile,
    "dataflash": DataflashFile,
    "rosbag": RosbagFile,
}
ENDINGS = {
    ".csv": "text",
    ".txt": "text",
    ".tsv": "text",
    ".parquet": "parquet",
    ".pq": "parquet",
    ".mat": "matlab",
    ".npy": "numpy",
    ".npz": "numpy",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".sqlite": "sqlite",
    ".db": "sqlite",
    ".ulg": "ulog",
    ".json": "json",
    ".jsonl": "json",
    ".ndjson": "json",
    ".xlsx": "excel",
    ".xlsm": "excel",
    ".tdms": "tdms",
    ".bag": "rosbag",
    ".db3": "rosbag",
    ".mcap": "rosbag",
}
"""File formats, by the extension of the file name."""


def usual_format(path: Path) -> str | None:
    """Returns the format that the extension of the file name determines; None if it determines no format. A folder with metadata of
    a bag has the format `rosbag`."""
    if path.is_dir() and (path / METADATA).is_file():
        return "rosbag"
    kind = ENDINGS.get(path.suffix.lower())
    if path.suffix.lower() == ".gz" and ENDINGS.get(Path(path.stem).suffix.lower()) == "text":
        return "text"
    return kind


class Format(Record):
    """The format of a recording, and the arrangement of a table of readings. Each format has additional keys (`parameters`)."""

    type: str = key(
        Choice(tuple(FORMATS)), "The format; by default, the extension of the file name determines it.", "text"
    )
    readings: ReadingColumns | None = optional(
        RecordOf(ReadingColumns),
        "For a table in which each row is one reading of one channel or sensor: the columns of its name and of its values.",
        {"name": "channel", "values": "value"},
    )
    parameters: Record = field(default_factory=Record)


def _kind(name: str) -> type[AnyFile]:
    """Finds the format with this name. Raises `InputError` if there is no such format."""
    if name not in FORMATS:
        raise InputError(())
    return FORMATS[name]


class FormatChoice:
    """Reads the value of `format`, and the additional keys of this format."""

    _plugged = Plugged(Format, "type", lambda: tuple(FORMATS), _kind, "form-choice")

    def read(self, node: Node, log: Findings) -> Format | None:
        made: Format | None = self._plugged.read(node, log)
        if made is not None and isinstance(made.parameters, BinaryKeys):
            check_binary(made.parameters, log)
        return made

    def schema(self) -> JsonObject:
        return self._plugged.schema()


def open_file(path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], given: Format | None) -> AnyFile:
    """Opens a file of samples in its format. `given`: format from the bench file; None if the extension of the file name determines
    it. Raises `InstrumentError` if the format is unknown or the file cannot be opened."""
    kind = usual_format(path) if given is None else given.type
    if kind is None:
        open_samples(path, name).close()  # raises an error that fits, if the path is a folder or does not exist
        endings = ", ".join(ENDINGS)
        raise InstrumentError(
            f"the extension of '{name}' is not one of {endings}; state the format in the bench file, such as "
            "`format: {type: text, separator: blanks}`"
        )
    if kind == "matlab" and is_hdf5(path, name):
        kind = "hdf5"
    made = FORMATS[kind]
    parameters = given.parameters if given is not None and kind == given.type else made.Parameters()
    if given is None or given.readings is None:
        return made(path, name, stamps, channels, parameters)
    return LongFile(made(path, name, stamps, {}, parameters), given.readings, stamps, channels)

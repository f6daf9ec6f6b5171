"""Reads TDMS files of LabVIEW. A column is named after its group and its channel, with `/` between them (`IMU/Gyro X`).

LabVIEW does not store the times of the samples of a waveform, but only their start and their increment. The column `wf_time_s` of a
group contains the times that follow from these two, in s.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats.file import (
    FormatFile,
    HeldRows,
    NoKeys,
    SampleRows,
    TimeStamps,
    few_columns,
    open_samples,
)
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.span import Span

WAVEFORM_TIME = "wf_time_s"
_FAULTS = (OSError, ValueError, KeyError, EOFError, TypeError, IndexError, AttributeError, OverflowError, MemoryError)
"""Exceptions that npTDMS raises for files that are not correct."""


class TdmsChannel(Protocol):
    """A channel as npTDMS opens it."""

    name: str
    group_name: str
    dtype: np.dtype[np.generic]
    properties: Mapping[str, object]

    def __len__(self) -> int: ...
    def read_data(self, offset: int, length: int) -> NDArray[np.generic]: ...


@dataclass(frozen=True, slots=True)
class _Waveform:
    """The time of a waveform: the time of its first row and the time between its rows, s. `count`: number of rows."""

    begin: float
    increment: float
    count: int


class TdmsFile(FormatFile[NoKeys]):
    """A TDMS file. Its channels are read in batches."""

    def __init__(self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: NoKeys):
        super().__init__(path, name, stamps, channels, parameters)
        self._known: tuple[dict[str, int], dict[str, _Waveform]] | None = None
        self._units: dict[str, str] = {}

    def columns(self) -> list[str]:
        counts, waveforms = self._contents()
        return [*waveforms, *counts]

    def units(self) -> Mapping[str, str]:
        self._contents()
        return self._units

    def rows_about(self) -> int:
        counts, waveforms = self._contents()
        sizes = {name: waveforms[name].count if name in waveforms else counts[name] for name in self.wanted}
        if not sizes:
            return max(counts.values(), default=0)
        least, most = min(sizes, key=sizes.__getitem__), max(sizes, key=sizes.__getitem__)
        if sizes[least] != sizes[most]:
            message = f"'{least}' has {sizes[least]} rows and '{most}' has {sizes[most]}"
            raise InstrumentError(f"{self.name}: {message}; all columns of a recording need the same number of rows")
        return sizes[least]

    def hint(self, column: str, known: list[str]) -> str:
        shown = ", ".join(f"'{name}'" for name in known[:12])
        return f"its columns are {shown}; the name of the group comes first, then the name of the channel"

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        count, waveforms = self.rows_about(), self._contents()[1]
        with self._opened() as found:
            for begin in range(0, count, format_file.BATCH):
                size = min(format_file.BATCH, count - begin)
                values: dict[str, NDArray[np.generic]] = {}
                for name in self.wanted:
                    if name in waveforms:
                        one = waveforms[name]
                        values[name] = one.begin + one.increment * np.arange(begin, begin + size)
                    else:
                        values[name] = self._read(found[name], begin, size)
                yield begin + 1, HeldRows(size, values)

    def _read(self, channel: TdmsChannel, begin: int, size: int) -> NDArray[np.generic]:
        try:
            values = channel.read_data(begin, size)
        except _FAULTS as error:
            raise self._unreadable(error) from None
        if len(values) != size:
            raise self._unreadable(ValueError(f"the channel '{channel.name}' ends too early"))
        return values

    def _contents(self) -> tuple[dict[str, int], dict[str, _Waveform]]:
        """Returns the number of rows of each channel that contains numbers or dates, and the times of each group's waveforms."""
        if self._known is None:
            counts: dict[str, int] = {}
            waveforms: dict[str, _Waveform] = {}
            with self._opened() as found:
                for name, channel in found.items():
                    if not (channel.dtype.kind in "fiubM" and len(channel)):
                        continue
                    counts[name] = len(channel)
                    unit, waveform = channel.properties.get("unit_string"), _waveform(channel)
                    if isinstance(unit, str) and unit.strip():
                        self._units[name] = unit.strip()
                    if waveform is not None:
                        waveforms.setdefault(f"{channel.group_name}/{WAVEFORM_TIME}", waveform)
            if not counts:
                raise InstrumentError(f"{self.name} contains no channels of numbers")
            few_columns(len(counts), self.name)
            self._known = counts, waveforms
        return self._known

    @contextlib.contextmanager
    def _opened(self) -> Iterator[dict[str, TdmsChannel]]:
        """Opens the file, and yields its channels by the names of their columns."""
        try:
            import nptdms
        except ImportError:
            message = "reading TDMS needs the package npTDMS; install it with: pip install 'planrunner[recordings]'"
            raise InstrumentError(f"{self.name}: {message}") from None
        with open_samples(self.path, self.name) as opened:
            try:
                made = nptdms.TdmsFile.open(opened)
                channels: dict[str, TdmsChannel] = {
                    f"{group.name}/{channel.name}": channel for group in made.groups() for channel in group.channels()
                }
            except _FAULTS as error:
                raise self._unreadable(error) from None
            yield channels

    def _unreadable(self, error: Exception) -> InstrumentError:
        reason = (str(error).splitlines() or [""])[0][:150] or type(error).__name__
        return InstrumentError(
            f"{self.name} cannot be read as TDMS: {reason}; save it again, or export its channels as text"
        )


def _waveform(channel: TdmsChannel) -> _Waveform | None:
    """Returns the time of a waveform; None if the channel is not a waveform."""
    increment, offset = (channel.properties.get(f"wf_{name}", 0.0) for name in ("increment", "start_offset"))
    if not isinstance(increment, int | float) or not isinstance(offset, int | float):
        return None
    if not (math.isfinite(increment) and math.isfinite(offset) and increment > 0):
        return None
    return _Waveform(float(offset), float(increment), len(channel))

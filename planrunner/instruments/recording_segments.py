"""Finds the segments of a recording that is played back. Each segment is stated in a row of a table, or is a part of the recording
between two pauses.

The table is a small CSV file; each row contains a label, a start time and an end time. Without a table, pauses in the recorded time
divide the recording.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import InputError, closest
from planrunner.base.progress import Announce, Pace
from planrunner.instruments.formats.clock import DAY, DateOrder
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording_file import RecordingFile
from planrunner.instruments.recording_keys import WRITTEN, RecordingParameters, seconds_in_unit
from planrunner.plan.selection import closest_label
from planrunner.plan.source import read_text
from planrunner.plan.span import Span

LabelledRow = Mapping[str, str | None]
"""A row of the table of labels: the cell of each column, by the name of the column."""


@dataclass(frozen=True, slots=True)
class SegmentTable:
    """Contains the intervals of a recording by label, after trimming. Also contains the line of the table that states each label.

    `name`: name of the file with the table, used in messages."""

    name: str
    spans: Mapping[str, Span]
    lines: Mapping[str, int]

    def span(self, label: str) -> Span:
        """Returns the interval that belongs to a label. If there is no such interval, raises an `InstrumentError` that suggests the
        closest label."""
        if label not in self.spans:
            raise InstrumentError(f"{self.name} has no segment '{label}'; {closest_label(label, self.spans)}")
        return self.spans[label]


def read_segment_table(
    path: Path, name: str, columns: tuple[str, str, str], unit: str, trim: float, origin: float, dates: DateOrder
) -> SegmentTable:
    """Reads the table of segments at `path`.

    `columns`: names of three columns: labels, start times, and end times. `unit`: unit of the start and end times, one of
    `TIME_UNITS`. `trim`: time [s] omitted at both ends of each segment. `origin`: time of the first row of the recording, s.
    `dates`: order of day and month in the recording, which also applies to the table.

    If the unit is `time_of_day`, times after midnight are recognised: each start is within half a day of the preceding end, and the
    first start is within half a day of the first row of the recording.

    Raises `InstrumentError` with the line of the fault.
    """
    spans: dict[str, Span] = {}
    lines: dict[str, int] = {}
    rows, near = list(labelled_rows(path, name, columns)), origin
    if unit in WRITTEN:
        dates.decide_for([row[column] or "" for _, _, row in rows for column in columns[1:]])
    for label, line, row in rows:
        where = f"{name}, line {line}"
        start, end = (_time(row, column, where, unit, dates) for column in columns[1:])
        if unit == "time_of_day":
            start += DAY * round((near - start) / DAY)
            end += DAY * math.ceil((start - end) / DAY)
            near = end
        spans[label], lines[label] = _span(label, start, end, where, trim), line
    if not spans:
        raise InstrumentError(f"{name} contains no segments")
    return SegmentTable(name, spans, lines)


def stated_stretches(parameters: RecordingParameters, origin: float) -> SegmentTable:
    """Returns the segments that the bench file states as `stretches`. `origin`: time of the first row, s. Raises `InstrumentError`
    if a stretch does not end after its start."""
    stated = parameters.stretches or {}
    spans: dict[str, Span] = {}
    lines: dict[str, int] = {}
    for label, one in stated.items():
        spans[label], lines[label] = Span(origin + one.start.value, origin + one.end.value), one.origin.mark.line
        if not spans[label].seconds > 0:
            raise InstrumentError(f"the stretch '{label}' does not end after it starts: correct it in the bench file")
    return SegmentTable(parameters.origin.mark.file, spans, lines)


def labelled_rows(path: Path, name: str, columns: Sequence[str]) -> Iterator[tuple[str, int, LabelledRow]]:
    """Yields the rows of a CSV table, each as label, line number and cells. `columns`: names of the columns that the table must
    have; the first is the column of the labels. `name`: name of the file, used in messages.

    Raises `InstrumentError` with the line of the fault if a label is missing or occurs twice.
    """
    try:
        text = read_text(path, name)
    except InputError as error:
        raise InstrumentError(f"{name}: {error.findings[0].message}") from None
    reader = csv.DictReader(text.splitlines(), strict=True)
    seen: set[str] = set()
    try:
        present = reader.fieldnames or ()
        for column in columns:
            if column not in present:
                raise InstrumentError(
                    f"{name} has no column '{column}'; {closest(column, [one for one in present if one])}"
                )
        for row in reader:
            where, label = f"{name}, line {reader.line_num}", (row[columns[0]] or "").strip()
            if not label:
                raise InstrumentError(f"{where}: the label is empty")
            if label in seen:
                raise InstrumentError(f"{where}: the label '{label}' appears twice")
            seen.add(label)
            yield label, reader.line_num, row
    except csv.Error as error:
        raise InstrumentError(f"{name}, line {reader.line_num}: not readable as CSV: {error}") from None


def _time(row: LabelledRow, column: str, where: str, unit: str, dates: DateOrder) -> float:
    """Returns the time [s] that a cell states."""
    try:
        return seconds_in_unit(row[column] or "", unit, f"{where}, column '{column}'", dates)
    except ValueError:
        raise InstrumentError(f"{where}: '{(row[column] or '')[:40]}' in column '{column}' is not a number") from None


def _span(label: str, begin: float, stop: float, where: str, trim: float) -> Span:
    """Returns the interval between two times [s] after trimming. `begin`, `stop`: these times. `trim`: time that is left out at
    both ends, s."""
    start, end = begin + trim, stop - trim
    if not (math.isfinite(start) and math.isfinite(end)) or stop <= begin:
        raise InstrumentError(f"{where}: the segment '{label}' does not end after it starts")
    if end <= start:
        message = f"the segment '{label}' lasts {stop - begin:g} s, and nothing remains after {trim:g} s are trimmed from both ends"
        raise InstrumentError(f"{where}: {message}")
    return Span(start, end)


def stretches(file: RecordingFile, pause: float, name: str = "", notice: Announce | None = None) -> tuple[Span, ...]:
    """Divides a recording at its pauses, which are steps of time longer than `pause` [s]; returns the parts between pauses. Each
    part ends one sample period after its last row. `name`: name of the file, used in the progress that `notice` receives.

    Raises `InstrumentError` if the file cannot be read.
    """
    found: list[Span] = []
    start = last = math.nan
    period = 0.0 if math.isnan(file.interval) else min(file.interval, pause)
    pace, rows = Pace(f"searching {name} for pauses", file.about, notice), 0
    for time, _ in file.rows():
        steps = np.diff(time, prepend=time[0] if math.isnan(last) else last)
        breaks = np.flatnonzero(steps > pause)
        if math.isnan(start):
            start = float(time[0])
        for index in breaks:
            found.append(Span(start, (float(time[index - 1]) if index else last) + period))
            start = float(time[index])
        last = float(time[-1])
        rows += len(time)
        pace.reached(rows)
    return (*found, Span(start, last + period))

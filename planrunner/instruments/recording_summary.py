"""Plays back a table that replaces a recording. For each segment, the table contains a row with the mean, the standard deviation
and the number of the samples.

Published calibrations often contain only such tables. A row is used as an observation, like the means of recorded samples.
Estimates that need samples are refused. The samples of a segment are treated as independent: the standard error of a mean is s/√n,
unless the table states a standard error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.base.findings import Findings, Mark
from planrunner.instruments.formats.clock import DateOrder
from planrunner.instruments.interfaces import Block, Clock, InstrumentError, PlaysBack, SummaryChannels, UnservedError
from planrunner.instruments.recording_keys import SECONDS, WRITTEN, RecordingParameters, RowColumns, seconds_in_unit
from planrunner.instruments.recording_segments import LabelledRow, labelled_rows
from planrunner.plan.schedule import Segment
from planrunner.plan.selection import closest_label

_DURATION = "seconds"


@dataclass(frozen=True, slots=True)
class SummaryRow:
    """Contains the row of a segment in the table.

    `line`: line in the file. `start`: start time, s. `count`: number of samples. `means`, `deviations`: mean and standard deviation
    of each channel, in the unit of the channel. If the table states a standard error instead, it is converted to a standard
    deviation. `count` independent samples with this standard deviation have a mean with the stated standard error.
    """

    line: int
    start: float
    count: int
    means: Mapping[str, float]
    deviations: Mapping[str, float]


class SummaryPlayer(PlaysBack):
    """A sensor that plays back a table of means (a summary)."""

    def __init__(self, parameters: RecordingParameters, rows: Mapping[str, SummaryRow], clock: Clock):
        self.parameters = parameters
        self.rows = rows
        self.clock = clock
        self.summary = SummaryChannels(
            {name: f"{name} standard deviation" for name in parameters.channels},
            "samples",
            _DURATION,
        )

    @classmethod
    def open(cls, parameters: RecordingParameters, path: Path, clock: Clock) -> SummaryPlayer:
        """Opens a player for the table at `path`. Raises `InstrumentError` with the line of the fault."""
        columns = parameters.summary
        assert columns is not None
        for key in ("time", "segments", "stretches", "pauses"):
            if getattr(parameters, key) is not None:
                raise InstrumentError(
                    f"`{key}` belongs to a recording of samples, `summary` to a table of means: keep one of them"
                )
        return cls(parameters, read_rows(path, parameters, columns), clock)

    # -- capabilities --------------------------------------------------------------------------------------------------

    def channels(self) -> Mapping[str, str]:
        units = {name: channel.unit for name, channel in self.parameters.channels.items()}
        scatter = {own: units[name] for name, own in self.summary.deviations.items()}
        return {**units, **scatter, self.summary.count: "1", self.summary.seconds: "s"}

    def foresee(self, segments: Sequence[Segment]) -> None:
        """Checks that the table contains every segment. Raises `UnservedError` with all errors that were found."""
        found = Findings()
        self.look_over(segments, found)
        if found.errors:
            raise UnservedError(found.errors)

    def look_over(self, segments: Sequence[Segment], log: Findings) -> None:
        """Adds findings to `log` for segments that have no row, or whose row does not fit the planned dwell."""
        for segment in segments:
            try:
                self._row(segment)
            except InstrumentError as error:
                mark = Mark(self.parameters.file, self.rows[segment.label].line if segment.label in self.rows else 1)
                code = "recording-unfit" if segment.label in self.rows else "recording-labels"
                log.error(
                    code, mark, str(error), "check the table, its columns in the bench file, and the plan's labels"
                )

    def stream(self, segment: Segment) -> Iterator[Block]:
        """Yields a single sample, which consists of the values in the row of the segment: the mean and the standard deviation of
        each channel, the number of samples and the duration."""
        row = self._row(segment)
        seconds = row.count / self.parameters.sample_rate.value
        self.clock.sleep(seconds)
        values = {self.summary.count: float(row.count), self.summary.seconds: seconds}
        for name in self.parameters.channels:
            values[name] = row.means[name]
            values[self.summary.deviations[name]] = row.deviations[name]
        yield Block(np.array([row.start]), {name: np.array([values[name]]) for name in self.channels()})

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": "recording", "model": self.parameters.kind, "file": self.parameters.file}

    def checkpoint(self) -> Mapping[str, Json]:
        return {}

    def restore(self, state: Mapping[str, Json]) -> None:
        """Does nothing: the table has no state."""

    def _row(self, segment: Segment) -> SummaryRow:
        name = self.parameters.file
        row = self.rows.get(segment.label)
        if row is None:
            raise InstrumentError(f"{name} has no row '{segment.label}'; {closest_label(segment.label, self.rows)}")
        interval = 1 / self.parameters.sample_rate.value
        seconds = row.count * interval
        if segment.dwell is not None and abs(segment.dwell - seconds) > 0.5 * interval + 1e-9 * seconds:
            raise InstrumentError(
                f"{name}, line {row.line}: the row of '{segment.label}' describes {row.count} samples ({seconds:g} s), but the plan dwells "
                f"{segment.dwell:g} s, and a mean cannot be divided; write `dwell: recorded`"
            )
        return row


def read_rows(path: Path, parameters: RecordingParameters, columns: RowColumns) -> dict[str, SummaryRow]:
    """Reads the rows of a table; returns them by label. Raises `InstrumentError` with the line of the fault."""
    name = parameters.file
    rows: dict[str, SummaryRow] = {}
    begin, dates = 0.0, DateOrder()
    table = list(labelled_rows(path, name, _columns(parameters, columns)))
    if columns.start is not None and columns.unit in WRITTEN:
        dates.decide_for([cells[columns.start] or "" for _, _, cells in table])
    for label, line, cells in table:
        rows[label] = _row_of(cells, f"{name}, line {line}", line, begin, parameters, columns, dates)
        begin = rows[label].start + rows[label].count / parameters.sample_rate.value
    if not rows:
        raise InstrumentError(f"{name} contains no rows")
    return rows


def _columns(parameters: RecordingParameters, columns: RowColumns) -> list[str]:
    """Returns the columns that the table must have; the first is the column of the labels. Raises `InstrumentError` if a channel
    does not have exactly one column for its scatter."""
    wanted = [columns.label, columns.count, *([] if columns.start is None else [columns.start])]
    for name, channel in parameters.channels.items():
        stated = [key for key in (channel.standard_deviation, channel.standard_error) if key is not None]
        if len(stated) != 1:
            raise InstrumentError(
                f"the channel '{name}' of a table of means needs one column of its scatter: write `standard_deviation` (of the samples) or "
                "`standard_error` (of the mean) in the bench file"
            )
        wanted += [channel.column, *stated]
    return wanted


def _row_of(
    cells: LabelledRow,
    where: str,
    line: int,
    begin: float,
    parameters: RecordingParameters,
    columns: RowColumns,
    dates: DateOrder,
) -> SummaryRow:
    count = _number(cells, columns.count, where)
    if count < 1 or count != round(count):
        raise InstrumentError(f"{where}: {count:g} in column '{columns.count}' is not a number of samples")
    start = begin if columns.start is None else _start(cells, columns.start, columns.unit, where, dates)
    means, deviations = {}, {}
    for name, channel in parameters.channels.items():
        means[name] = channel.sign * (_number(cells, channel.column, where) - channel.zero) / channel.per_unit
        column = channel.standard_deviation or channel.standard_error
        assert column is not None
        scatter = _number(cells, column, where)
        if scatter < 0:
            raise InstrumentError(
                f"{where}: {scatter:g} in column '{column}' is negative, but a standard deviation cannot be negative"
            )
        independent = 1.0 if channel.standard_deviation else math.sqrt(count)
        deviations[name] = scatter / abs(channel.per_unit) * independent
    return SummaryRow(line, start, int(count), means, deviations)


def _start(cells: LabelledRow, column: str, unit: str, where: str, dates: DateOrder) -> float:
    """Returns the start time [s] that a row states. `unit`: unit of the column. `dates`: the order of day and month."""
    if unit not in WRITTEN:
        return _number(cells, column, where) * SECONDS[unit]
    return seconds_in_unit(cells[column] or "", unit, f"{where}, column '{column}'", dates)


def _number(cells: LabelledRow, column: str, where: str) -> float:
    text = (cells[column] or "").strip()
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InstrumentError(f"{where}: '{text[:40]}' in column '{column}' is not a number")
    return value

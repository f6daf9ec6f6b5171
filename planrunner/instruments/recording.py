"""The recording player: a sensor that plays back a CSV or Parquet file as if it were measured now.

Columns are mapped to channels with units. A table of segments says which stretch of the recording belongs to which
label; without one the whole recording is one stretch. Files lie beneath the data root, never outside it. Rows stream;
a long recording is never held as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planrunner.instruments.interfaces import Block, Clock, InstrumentError, Surroundings
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.instruments.recording_file import RecordingFile, beneath, open_recording
from planrunner.instruments.recording_table import SegmentTable, Span, read_segment_table
from planrunner.plan.findings import Findings
from planrunner.plan.kinds import Choice, MapOf, Number, QuantityOf, Record, RecordOf, Text, key
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Segment
from planrunner.plan.source import Node, Scalar
from planrunner.plan.units import DIMENSIONS, Unit, UnknownUnitError, unit

Array = NDArray[np.float64]
NAME = r"[A-Za-z][A-Za-z0-9_-]{0,39}"
COLUMN = r"[^\x00-\x1f]{1,200}"
TIME_UNITS = ("s", "ms", "us", "ns", "min", "h")
SECONDS = dict(zip(TIME_UNITS, (1.0, 1e-3, 1e-6, 1e-9, 60.0, 3600.0), strict=True))
RATE_TOLERANCE = math.log(1.25)
_NO_TRIM = Quantity(0.0, Unit("s", 1.0, DIMENSIONS["time"]))


class UnitText:
    """The text of a unit, such as deg/s."""

    def read(self, node: Node, log: Findings) -> str | None:
        text = node.text if isinstance(node, Scalar) else ""
        try:
            unit(text)
        except UnknownUnitError as error:
            log.error("meaning-unit", node.mark, f"{error}", "write for example deg/s, g, m/s^2 or degC")
            return None
        return text

    def schema(self) -> dict[str, Any]:
        return {"type": "string"}


class TimeColumn(Record):
    """The column that holds time."""

    column: str = key(Text(COLUMN, "a column's name"), "Name of the column.", "time_s")
    unit: str = key(Choice(TIME_UNITS), "Its unit.", "s", "s")


class ChannelColumn(Record):
    """The column that a channel is read from."""

    column: str = key(Text(COLUMN, "a column's name"), "Name of the column in the file.", "gyro_y_deg_per_s")
    unit: str = key(UnitText(), "Unit of the numbers in the file, kept in the recording.", "deg/s")
    sign: int = key(Number(-1, 1, integer=True), "-1 where the sensor's axis points the other way.", -1, 1)
    noise: Quantity | None = key(
        QuantityOf(None, "not negative"),
        "Standard deviation of one sample at rest, for predictions.",
        "0.1 deg/s",
        None,
    )
    full_scale: Quantity | None = key(QuantityOf(None, "positive"), "Full scale, either sign.", "2000 deg/s", None)


class ChannelKind:
    """A channel's column; its noise and full scale are of its own dimension."""

    _record = RecordOf(ChannelColumn)

    def read(self, node: Node, log: Findings) -> ChannelColumn | None:
        channel: ChannelColumn | None = self._record.read(node, log)
        if channel is None:
            return None
        if channel.sign == 0:
            log.error("meaning-range", channel.at("sign"), "a sign is 1 or -1", "write 1 or -1")
        for name in ("noise", "full_scale"):
            value = getattr(channel, name)
            if value is not None and value.unit.dimension != unit(channel.unit).dimension:
                message = f"'{value.unit.text}' is not of the dimension of {channel.unit}"
                log.error("meaning-dimension", channel.at(name), message, f"write it in {channel.unit}")
        return channel

    def schema(self) -> dict[str, Any]:
        return self._record.schema()


class SegmentColumns(Record):
    """The table that says which stretch of the recording belongs to which label."""

    table: str = key(Text(r"[^\x00-\x1f]{1,400}", "a file's path"), "CSV file beneath the data root.", "jig/stops.csv")
    label: str = key(Text(COLUMN, "a column's name"), "Column of the labels.", "label", "label")
    start: str = key(
        Text(COLUMN, "a column's name"), "Column of the beginnings, in the recording's time.", "start_s", "start_s"
    )
    end: str = key(Text(COLUMN, "a column's name"), "Column of the ends.", "end_s", "end_s")
    unit: str = key(Choice(TIME_UNITS), "Unit of both columns.", "s", "s")
    trim: Quantity = key(QuantityOf("time", "not negative"), "Left out at either end of a stretch.", "2 s", _NO_TRIM)


class RecordingParameters(Record):
    """A recording that is played back."""

    file: str = key(
        Text(r"[^\x00-\x1f]{1,400}", "a file's path"),
        "CSV or Parquet file beneath the data root.",
        "jig/staircase.parquet",
    )
    kind: str = key(Text(NAME, "a sensor kind"), "Kind of sensor that was recorded.", "imu")
    time: TimeColumn = key(RecordOf(TimeColumn), "The column that holds time.", {"column": "time_s", "unit": "s"})
    channels: dict[str, ChannelColumn] = key(
        MapOf(ChannelKind(), pattern=NAME),
        "Channel name → column of the file.",
        {"gyro_y": {"column": "gyro_y_deg_per_s", "unit": "deg/s"}},
    )
    segments: SegmentColumns | None = key(
        RecordOf(SegmentColumns),
        "Where the segments lie; without it the whole recording is one segment.",
        {"table": "jig/stops.csv", "trim": "2 s"},
        None,
    )
    sample_rate: Quantity = key(QuantityOf("frequency", "positive"), "Samples per second.", "100 Hz")


class RecordingPlayer:
    """A sensor that plays back a recording."""

    role = "sensor"
    replays = True
    Parameters = RecordingParameters

    def __init__(
        self,
        parameters: RecordingParameters,
        file: RecordingFile,
        spans: SegmentTable | None,
        clock: Clock,
        piece: float,
    ):
        self.parameters = parameters
        self.file = file
        self.spans = spans
        self.clock = clock
        self.piece = piece
        self._served: str | None = None

    @classmethod
    def model(cls, parameters: RecordingParameters) -> SensorModel:
        rate = parameters.sample_rate.value
        outputs = []
        for name, channel in parameters.channels.items():
            factor = unit(channel.unit).factor
            white = 0.0 if channel.noise is None else _width(channel.noise) / factor / math.sqrt(rate)
            full_scale = math.inf if channel.full_scale is None else _width(channel.full_scale) / factor
            outputs.append(OutputModel(name, channel.unit, full_scale, NoiseModel(white)))
        return SensorModel(parameters.kind, tuple(outputs), rate)

    @classmethod
    def connect(cls, parameters: RecordingParameters, surroundings: Surroundings) -> RecordingPlayer:
        columns = {name: channel.column for name, channel in parameters.channels.items()}
        path = beneath(surroundings.data_root, parameters.file)
        scale = SECONDS[parameters.time.unit]
        file = open_recording(path, parameters.file, parameters.time.column, scale, columns)
        _check_rate(file, parameters)
        spans = None
        stated = parameters.segments
        if stated is not None:
            table = beneath(surroundings.data_root, stated.table)
            spans = read_segment_table(
                table, stated.table, (stated.label, stated.start, stated.end), SECONDS[stated.unit], stated.trim.value
            )
        piece = 1.0 if surroundings.real_time else math.inf
        return cls(parameters, file, spans, surroundings.clock, piece)

    # -- what it does ----------------------------------------------------------------------------------------------

    def channels(self) -> Mapping[str, str]:
        return {name: channel.unit for name, channel in self.parameters.channels.items()}

    def foresee(self, segments: Sequence[Segment]) -> None:
        """Whether the recording holds every segment, for long enough. Raises `InstrumentError`."""
        labels = [segment.label for segment in segments]
        if self.spans is None:
            if len(labels) > 1:
                raise self._one_stretch(labels[0], labels[1])
            return
        for segment in segments:
            span = self.spans.span(segment.label)
            if (
                segment.dwell is not None
                and segment.dwell > span.end - span.start + 1.5 / self.parameters.sample_rate.value
            ):
                raise self._too_short(segment, span.end - span.start)

    def stream(self, segment: Segment) -> Iterator[Block]:
        """The stretch of one label: its first `dwell` seconds, or all of it. Time counts from the recording's first
        row.
        """
        span = self._span(segment)
        interval = 1 / self.parameters.sample_rate.value
        if segment.dwell is not None and segment.dwell > span.end - span.start + 1.5 * interval:
            raise self._too_short(segment, span.end - span.start)
        first = last = until = math.inf
        for time, columns in self.file.rows(span.start, span.end):
            if math.isinf(first):
                first = float(time[0])
                until = math.inf if segment.dwell is None else first + segment.dwell - 0.5 * interval
            count = int(np.searchsorted(time, until))
            if count:
                last = float(time[count - 1])
                yield from self._pieces(time[:count], {name: values[:count] for name, values in columns.items()})
            if count < time.size:
                break
        if math.isinf(first):
            where = f"between {span.start:g} s and {span.end:g} s"
            raise InstrumentError(f"{self.parameters.file} has no samples {where} for '{segment.label}'")
        if segment.dwell is not None and last - first + 1.5 * interval < segment.dwell:
            raise self._too_short(segment, last - first + interval)

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": "recording", "model": self.parameters.kind, "file": self.parameters.file}

    def make_safe(self) -> None:
        """A file does nothing dangerous."""

    def close(self) -> None:
        """The file is opened anew for every segment and held open by none."""

    def checkpoint(self) -> Mapping[str, Any]:
        return {"served": self._served}

    def restore(self, state: Mapping[str, Any]) -> None:
        self._served = state["served"]

    # -- how it does it --------------------------------------------------------------------------------------------

    def _pieces(self, time: Array, columns: Mapping[str, Array]) -> Iterator[Block]:
        """Blocks as long as the clock likes: about a second each in real time."""
        rate = self.parameters.sample_rate.value
        size = time.size if math.isinf(self.piece) else max(1, round(self.piece * rate))
        for first in range(0, time.size, size):
            part = slice(first, first + size)
            channels = {}
            for name, channel in self.parameters.channels.items():
                values = columns[name][part]
                channels[name] = values if channel.sign > 0 else -values
            self.clock.sleep(len(time[part]) / rate)
            yield Block(time[part] - self.file.origin, channels)

    def _span(self, segment: Segment) -> Span:
        if self.spans is not None:
            return self.spans.span(segment.label)
        if self._served not in (None, segment.label):
            raise self._one_stretch(self._served, segment.label)
        self._served = segment.label
        return Span(self.file.origin, math.inf)

    def _one_stretch(self, served: str | None, label: str) -> InstrumentError:
        return InstrumentError(
            f"{self.parameters.file} has no table of segments and so holds one, which is played back as '{served}'; "
            f"'{label}' needs `segments: {{table: …}}` in the bench file"
        )

    def _too_short(self, segment: Segment, available: float) -> InstrumentError:
        return InstrumentError(
            f"the recording is shorter than the plan: '{segment.label}' dwells {segment.dwell:g} s, and "
            f"{self.parameters.file} holds {available:.6g} s of it; shorten the dwell or write `dwell: recorded`"
        )


def _check_rate(file: RecordingFile, parameters: RecordingParameters) -> None:
    """A declared rate that the time column contradicts: most often a wrong unit of time."""
    declared = parameters.sample_rate.value
    if not math.isnan(file.interval) and abs(math.log(file.interval * declared)) > RATE_TOLERANCE:
        message = (
            f"{parameters.file} is declared at {declared:g} Hz, but its rows are {file.interval:.4g} s apart "
            f"({1 / file.interval:.4g} Hz): correct `sample_rate`, or the unit of the column '{parameters.time.column}'"
        )
        raise InstrumentError(message)


def _width(quantity: Quantity) -> float:
    """An amount in SI units, such as a standard deviation, without the offset of a temperature scale."""
    return quantity.value - quantity.unit.offset

"""Declares the bench-file keys of a recording that is played back: its file, time and segments, and its channels with their noise."""

from __future__ import annotations

import math
from typing import Final, Literal

from planrunner.base.documents import JsonObject
from planrunner.base.findings import Findings
from planrunner.instruments.formats.choice import Format, FormatChoice
from planrunner.instruments.formats.clock import DAY, DateOrder, seconds_of
from planrunner.instruments.formats.file import TimeStamps
from planrunner.instruments.parameters import nominal_supply
from planrunner.plan.kinds import (
    Choice,
    ListOf,
    MapOf,
    Number,
    QuantityOf,
    Record,
    RecordOf,
    Text,
    WordOr,
    key,
    optional,
)
from planrunner.plan.quantity import Quantity
from planrunner.plan.source import Node, Scalar
from planrunner.plan.units import DIMENSIONS, Unit, UnknownUnitError, unit

NAME = r"[A-Za-z][A-Za-z0-9_-]{0,39}"
COLUMN = r"[^\x00-\x1f]{1,200}"
WRITTEN = ("date_time", "time_of_day")
"""Kinds of times that are texts: a date with a time, and a time of day."""
TIME_UNITS = ("s", "ms", "us", "ns", "min", "h", "days", *WRITTEN)
SECONDS = dict(zip(TIME_UNITS, (1.0, 1e-3, 1e-6, 1e-9, 60.0, 3600.0, DAY, 1.0, 1.0), strict=True))
"""Seconds per unit of time. A time that is a text is converted to seconds."""
SAMPLE_COUNT: Final = "sample_count"
_NO_TRIM = Quantity(0.0, Unit("s", 1.0, DIMENSIONS["time"]))


class UnitText:
    """Reads the name of a unit, such as deg/s."""

    def read(self, node: Node, log: Findings) -> str | None:
        text = node.text if isinstance(node, Scalar) else ""
        try:
            unit(text)
        except UnknownUnitError as error:
            log.error("meaning-unit", node.mark, f"{error}", "write for example deg/s, g, m/s^2 or degC")
            return None
        return text

    def schema(self) -> JsonObject:
        return {"type": "string"}


class TimeColumn(Record):
    """Declares the bench-file keys of the column that contains the time."""

    column: str = key(Text(COLUMN, "a column's name"), "Name of the column.", "time_s")
    unit: str = key(
        Choice(TIME_UNITS),
        "Its unit. `date_time`: dates with times, such as 2026-03-04T12:00:00.005Z. `time_of_day`: times of day, such as 12:00:00.005.",
        "s",
        default="s",
    )
    per_second: float | None = optional(Number(), "For a counter instead of a time: its counts per second.", 168000000)
    wraps: float | None = optional(
        Number(),
        "For a counter: the value at which it starts again from zero, in its own counts or unit. It may not wrap twice between two rows.",
        4294967296,
    )
    power_on: Quantity | None = optional(
        QuantityOf("time"),
        "Time at which the sensor was switched on, as a value of the column; the time of the recording then starts at "
        "this value. By default it starts at the first row.",
        "0 s",
    )


class ChannelColumn(Record):
    """Declares the bench-file keys of a channel: the column from which it is read, its unit, and its noise."""

    column: str = key(Text(COLUMN, "a column's name"), "Name of the column in the file.", "gyro_y_deg_per_s")
    unit: str = key(
        UnitText(), "Unit of the channel; also the unit of the numbers in the file, unless they are counts.", "deg/s"
    )
    sign: int = key(
        Number(-1, 1, integer=True), "-1 if the sensor's axis points in the opposite direction.", -1, default=1
    )
    zero: float = key(
        Number(),
        "Value of the column at which the channel is zero, for a file of raw counts.",
        59136,
        default=0.0,
    )
    per_unit: float = key(
        Number(), "Change of the column per unit of the channel, for a file of raw counts.", 256, default=1.0
    )
    noise: Quantity | None = optional(
        QuantityOf(None, "not negative"), "White noise as the standard deviation of one sample at rest.", "0.1 deg/s"
    )
    noise_density: Quantity | None = optional(
        QuantityOf(None, "not negative"),
        "White noise as a one-sided density D, as data sheets give it: one sample at f Hz scatters by D·√(f/2).",
        "0.002 deg/s/sqrt(Hz)",
    )
    random_walk: Quantity | None = optional(
        QuantityOf(None, "not negative"),
        "White noise as the coefficient N of an Allan deviation: a mean over T scatters by N/√T.",
        "0.085 deg/sqrt(h)",
    )
    bias_instability: Quantity | None = optional(
        QuantityOf(None, "not negative"),
        "Coefficient B of IEEE Std 952; the flat part of the Allan deviation is 0.664·B.",
        "2 deg/h",
    )
    resolution: Quantity | None = optional(QuantityOf(None, "not negative"), "One count.", "0.0005 deg/s")
    full_scale: Quantity | None = optional(QuantityOf(None, "positive"), "Full scale, for both signs.", "2000 deg/s")

    standard_deviation: str | None = optional(
        Text(COLUMN, "a column's name"),
        "With `summary`: column of the standard deviation of the samples, in the unit of the column.",
        "gyro_y_sd",
    )
    standard_error: str | None = optional(
        Text(COLUMN, "a column's name"),
        "With `summary`, instead: column of the standard error of the mean.",
        "gyro_y_u",
    )

    def white(self, sample_rate: float) -> float:
        """Returns the random-walk coefficient N of the white noise, in the unit of the channel times √s; 0 if no noise is declared.
        `sample_rate`: sample rate of the channel, Hz."""
        factor = unit(self.unit).factor
        if self.noise is not None:
            return width(self.noise) / factor / math.sqrt(sample_rate)
        if self.noise_density is not None:
            return self.noise_density.value / factor / math.sqrt(2)
        return 0.0 if self.random_walk is None else self.random_walk.value / factor

    def amount(self, name: str, otherwise: float = 0.0) -> float:
        """Returns the bias instability, the resolution or the full scale, in the unit of the channel. `name`: the name of one of
        these keys. `otherwise`: the result if the key is absent."""
        value: Quantity | None = getattr(self, name)
        return otherwise if value is None else width(value) / unit(self.unit).factor


def seconds_in_unit(cell: str, unit: str, where: str, dates: DateOrder) -> float:
    """Returns the time [s] that a cell of a table states. `unit`: one of `TIME_UNITS`. `where`: a text that names the file and the
    cell; it is used in messages. `dates`: the order of day and month. Raises `ValueError` if the cell should be a number but is
    not, and `InstrumentError` if it should be a date or a time of day but is not."""
    return seconds_of(cell, where, dates) if unit in WRITTEN else float(cell) * SECONDS[unit]


def check_time(time: TimeColumn, log: Findings) -> None:
    """Adds an error for each contradiction in the description of a time column."""
    for name in ("per_second", "wraps"):
        value = time.per_second if name == "per_second" else time.wraps
        if value is not None and not value > 0:
            log.error("meaning-range", time.at(name), "a positive number is needed here", "write for example 1000")
    if time.wraps is not None and time.unit in WRITTEN:
        message = f"a time in the unit {time.unit} is no counter that returns to zero"
        hint = "leave `wraps` out: a time of day returns to zero at midnight without it"
        log.error("meaning-range", time.at("wraps"), message, hint)
    if time.per_second is not None and "unit" in time.origin.keys:
        message = "the unit of the time is given twice, by `unit` and by `per_second`"
        log.error("meaning-range", time.at("unit"), message, "leave `unit` out for a counter")


WHITE = ("noise", "noise_density", "random_walk")


class ChannelKind:
    """Reads the description of a channel. The dimensions of the declared noise and full scale must fit the unit of the channel."""

    _record = RecordOf(ChannelColumn)

    def read(self, node: Node, log: Findings) -> ChannelColumn | None:
        channel: ChannelColumn | None = self._record.read(node, log)
        if channel is None:
            return None
        if channel.sign == 0:
            log.error("meaning-range", channel.at("sign"), "a sign is 1 or -1", "write 1 or -1")
        if channel.per_unit == 0:
            log.error(
                "meaning-range",
                channel.at("per_unit"),
                "with 0 counts per unit, the column would not change with the measured quantity",
                "write the counts per unit, which are not zero",
            )
        for name in ("noise", "bias_instability", "resolution", "full_scale"):
            _check_dimension(channel, name, "", log)
        for name in ("noise_density", "random_walk"):
            _check_dimension(channel, name, "*sqrt(s)", log)
        stated = [name for name in WHITE if getattr(channel, name) is not None]
        if len(stated) > 1:
            message = f"white noise is given twice, as {' and as '.join(stated)}"
            log.error("meaning-noise-twice", channel.at(stated[1]), message, "keep one of them")
        return channel

    def schema(self) -> JsonObject:
        return self._record.schema()


class SegmentColumns(Record):
    """Declares the bench-file keys of a table that assigns an interval of the recording to each label."""

    table: str = key(Text(r"[^\x00-\x1f]{1,400}", "a file's path"), "CSV file in the data folder.", "jig/stops.csv")
    label: str = key(Text(COLUMN, "a column's name"), "Column of the labels.", "label", default="label")
    start: str = key(
        Text(COLUMN, "a column's name"),
        "Column of the start times, in the time of the recording.",
        "start_s",
        default="start_s",
    )
    end: str = key(Text(COLUMN, "a column's name"), "Column of the end times.", "end_s", default="end_s")
    unit: str = key(Choice(TIME_UNITS), "Unit of both columns.", "s", default="s")
    trim: Quantity = key(
        QuantityOf("time", "not negative"), "Time to leave out at both ends of a segment.", "2 s", default=_NO_TRIM
    )

    @classmethod
    def of(cls, table: str) -> SegmentColumns:
        """Returns the keys of a table whose columns have the default names."""
        return cls(table=table)


class StatedStretch(Record):
    """Declares the bench-file keys of a stretch of the recording, which is the interval of one label."""

    start: Quantity = key(QuantityOf("time", "not negative"), "Start of the stretch, after the first row.", "12 s")
    end: Quantity = key(QuantityOf("time", "positive"), "End of the stretch, after the first row.", "22 s")


class RowColumns(Record):
    """States the names of the columns in a table that has one row for each segment."""

    label: str = key(Text(COLUMN, "a column's name"), "Column of the labels.", "state", default="label")
    count: str = key(Text(COLUMN, "a column's name"), "Column of the number of samples.", "n", default="count")
    start: str | None = optional(
        Text(COLUMN, "a column's name"),
        "Column of the start times; by default the rows follow each other without pauses.",
        "start_s",
    )
    unit: str = key(Choice(TIME_UNITS), "Unit of the start times.", "s", default="s")


class RecordingParameters(Record):
    """Declares the bench-file keys of a recording that is played back."""

    file: str = key(
        Text(r"[^\x00-\x1f]{1,400}", "a file's path"),
        "File in the data folder: text, Parquet, MATLAB, NumPy, HDF5, SQLite, ULog, JSON, Excel, TDMS, NovAtel, ArduPilot or binary.",
        "jig/staircase.parquet",
    )
    kind: str = key(Text(NAME, "a sensor kind"), "Kind of sensor that was recorded.", "imu")
    continued_by: tuple[str, ...] = key(
        ListOf(Text(r"[^\x00-\x1f]{1,400}", "a file's path"), single=True, maximum=1000),
        "Further files with the same columns that continue the recording, in order.",
        ["jig/staircase_2.parquet"],
        default=(),
    )
    pause_between_files: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "If the time of each file begins anew: time from the last row of a file to the first row of the next. Without it, the times of the "
        "files must follow each other.",
        "60 s",
    )
    format: Format | None = optional(
        FormatChoice(),
        "Format of the files, and properties that the files themselves do not state.",
        {"type": "text", "separator": "semicolon", "decimal": "comma"},
    )
    time: TimeColumn | Literal["sample_count"] | None = optional(
        WordOr((SAMPLE_COUNT,), RecordOf(TimeColumn, check_time)),
        "The time column, unless there is `summary`. `sample_count`: the file has no time, and its rows follow each other at "
        "`sample_rate`.",
        {"column": "time_s", "unit": "s"},
    )
    summary: RowColumns | None = optional(
        RecordOf(RowColumns),
        "The file is a table with one row per segment instead of samples: the mean of every channel, its standard deviation, and the "
        "number of samples.",
        {"label": "state", "count": "n"},
    )
    channels: dict[str, ChannelColumn] = key(
        MapOf(ChannelKind(), pattern=NAME),
        "Channel name → column of the file.",
        {"gyro_y": {"column": "gyro_y_deg_per_s", "unit": "deg/s"}},
    )
    segments: SegmentColumns | None = optional(
        RecordOf(SegmentColumns),
        "Table of the segments; without it the whole recording is one segment.",
        {"table": "jig/stops.csv", "trim": "2 s"},
    )
    stretches: dict[str, StatedStretch] | None = optional(
        MapOf(RecordOf(StatedStretch)),
        "Instead of a table: label of each segment → its start and its end, counted from the first row of the recording.",
        {"rate_1": {"start": "12 s", "end": "22 s"}},
    )
    pauses: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "Instead of a table: divide the recording into segments wherever the time steps by more than this, in the order "
        "of the plan.",
        "10 s",
    )
    sample_rate: Quantity = key(QuantityOf("frequency", "positive"), "Samples per second.", "100 Hz")
    nominal_supply: Quantity = nominal_supply()

    @property
    def files(self) -> tuple[str, ...]:
        """Returns all files of the recording, in order."""
        return (self.file, *self.continued_by)

    @property
    def power_on(self) -> Quantity | None:
        """Returns the value that the time column had when the sensor was switched on; None if it is not declared."""
        return self.time.power_on if isinstance(self.time, TimeColumn) else None

    @property
    def stamps(self) -> TimeStamps | None:
        """Returns a description of how the time of a row is determined; None if the bench file does not state this."""
        if isinstance(self.time, TimeColumn):
            scale = SECONDS[self.time.unit] if self.time.per_second is None else 1 / self.time.per_second
            wraps = DAY if self.time.unit == "time_of_day" else self.time.wraps
            return TimeStamps(self.time.column, scale, wraps=wraps, written=self.time.unit in WRITTEN)
        return None if self.time is None else TimeStamps(None, period=1 / self.sample_rate.value)


def width(quantity: Quantity) -> float:
    """Converts a difference, such as a standard deviation, to SI units. The offset of a temperature scale is not added."""
    return quantity.value - quantity.unit.offset


def _check_dimension(channel: ChannelColumn, name: str, times: str, log: Findings) -> None:
    """Checks that a declared quantity has the dimension of the channel. `times`: a factor by which the unit of the channel is
    multiplied, such as `*sqrt(s)`; an empty text if there is no factor."""
    value: Quantity | None = getattr(channel, name)
    if value is None:
        return
    own = unit(channel.unit).dimension
    if times:
        powers = dict(own)
        powers["time"] = powers.get("time", 0.0) + 0.5
        own = tuple(sorted((base, power) for base, power in powers.items() if power))
    if value.unit.dimension != own:
        message = f"'{value.unit.text}' does not have the dimension of {channel.unit}{times}"
        log.error("meaning-dimension", channel.at(name), message, f"write it in {channel.unit}{times}")

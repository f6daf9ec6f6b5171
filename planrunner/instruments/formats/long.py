"""Reads long tables, in which each row is one reading: a time, the name of a channel or sensor, and its value or values.

Readings with the same time form one row. Each channel then has a column with its name (`gyro_x`). If a reading has several values,
a point and the name of the value's column are appended (`gyroscope.x`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats.file import (
    MAX_COLUMNS,
    AnyFile,
    FormatFile,
    HeldRows,
    SampleRows,
    TimeStamps,
    few_columns,
)
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import ListOf, QuantityOf, Record, Text, key
from planrunner.plan.quantity import Quantity
from planrunner.plan.span import EVERYTHING, Span
from planrunner.plan.units import DIMENSIONS, Unit

MAX_HELD = 50_000_000
"""Maximum number of numbers in a table that is not sorted by time. Such a table is read as a whole."""
_COLUMN = r"[^\x00-\x1f]{1,200}"
_SAME_TIME = Quantity(0.0, Unit("s", 1.0, DIMENSIONS["time"]))


class ReadingColumns(Record):
    """Declares the bench-file keys of a table in which each row is one reading."""

    name: str = key(Text(_COLUMN, "a column's name"), "Column of the name of the channel or sensor.", "channel")
    values: tuple[str, ...] = key(
        ListOf(Text(_COLUMN, "a column's name"), single=True, maximum=MAX_COLUMNS),
        "Column of the value, or columns of the values.",
        ["x", "y", "z"],
        default=("value",),
    )
    within: Quantity = key(
        QuantityOf("time", "not negative"),
        "Longest time between two successive readings of a sample. By default, the readings of a sample have the same time.",
        "1 ms",
        default=_SAME_TIME,
    )

    def column(self, name: str, value: str) -> str:
        """Returns the name of the column of a channel. `name`: the name in the reading. `value`: the column of the value."""
        return name if len(self.values) == 1 else f"{name}.{value}"


@dataclass(frozen=True, slots=True)
class _Batch:
    """Contains readings in the order of the file. `first`: number of the first row. `time`: shape (n,), s. `code`: shape (n,),
    index of the name in the table; -1 if it is missing. `values`: shape (n, k)."""

    first: int
    time: Array
    code: NDArray[np.int64]
    values: Array


@dataclass
class _Survey:
    """Contains facts about a whole table of readings.

    `names`: the names, each with its index. `count`: number of readings. `ordered`: True if no reading is earlier than the previous
    reading. `fault`: the first reading that is not later than the previous reading with the same name: its row, its name, and the
    two times, s; None if there is no such reading."""

    names: dict[str, int] = field(default_factory=dict)
    count: int = 0
    ordered: bool = True
    fault: tuple[int, str, float, float] | None = None


class LongFile(FormatFile[Record]):
    """A table of readings in a file of any format. A table that is sorted by time is read in batches. A table that is not sorted is
    read as a whole, and then sorted."""

    def __init__(self, table: AnyFile, readings: ReadingColumns, stamps: TimeStamps, channels: Mapping[str, str]):
        super().__init__(table.path, table.name, stamps, channels, table.parameters)
        self.table, self.readings = table, readings
        self._survey: _Survey | None = None
        self._known: dict[str, int] = {}

    @property
    def remarks(self) -> tuple[str, ...]:
        return self.table.remarks

    def faults(self) -> tuple[type[Exception], ...]:
        return self.table.faults()

    def columns(self) -> list[str]:
        own = [self.readings.column(name, value) for name in self._surveyed().names for value in self.readings.values]
        few_columns(len(own), self.name)
        return [*self.stamps.columns, *own]

    def rows_about(self) -> int:
        survey = self._surveyed()
        return survey.count // max(len(survey.names), 1)

    def place(self, row: int) -> str:
        return f"sample {row}"

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        for first, rows, _ in self._timed(span):
            yield first, rows

    def hint(self, column: str, known: list[str]) -> str:
        return f"{closest(column, known)} The column '{self.readings.name}' contains the names"

    def look(self) -> None:
        """Checks the table and its first samples, as described in `FormatFile.look`. Also raises `InstrumentError` if no sample
        contains all channels."""
        super().look()
        for _, channels in self.rows():
            known = {name: np.isfinite(values) for name, values in channels.items()}
            if known and not np.logical_and.reduce(list(known.values())).any():
                self._no_whole_sample(known)
            return

    def _no_whole_sample(self, known: Mapping[str, NDArray[np.bool_]]) -> None:
        names = list(known)
        for other in names[1:]:
            if not (known[names[0]] & known[other]).any() and known[names[0]].any() and known[other].any():
                first, second = self.channels[names[0]], self.channels[other]
                message = f"'{first}' and '{second}' have no readings at the same time, so that no sample contains both"
                hint = "use the channels of one sensor, or state under `readings` how far apart in time they may be, such as `within: 2 ms`"
                raise InstrumentError(f"{self.name}: {message}; {hint}")

    # -- readings ------------------------------------------------------------------------------------------------------

    def _surveyed(self) -> _Survey:
        if self._survey is None:
            self._survey = self._found()
        return self._survey

    def _found(self) -> _Survey:
        """Reads the whole table once, and returns facts about it. Raises `InstrumentError` if the table has no column of the time,
        or if a column is absent."""
        if self.stamps.column is None:
            message = "a table of readings needs a column of the time, because it shows which readings form a sample"
            raise InstrumentError(f"{self.name}: {message}; write `time: {{column: …}}`")
        known = self.table.columns()
        for column in (self.stamps.column, self.readings.name, *self.readings.values):
            if column not in known:
                raise InstrumentError(f"{self.name} has no column '{column}'; {closest(column, known)}")
        survey = _Survey()
        last = np.full(MAX_COLUMNS + 1, -np.inf)
        latest = -np.inf
        for batch in self._read():
            if len(self._known) > MAX_COLUMNS:
                message = f"the column '{self.readings.name}' contains more than {MAX_COLUMNS} different names"
                raise InstrumentError(f"{self.name}: {message}; check the key `name` of `readings`")
            survey.count += len(batch.time)
            survey.ordered &= bool(np.all(np.diff(batch.time, prepend=latest) >= 0))
            latest = float(batch.time[-1])
            if survey.fault is None:
                survey.fault = self._first_fault(batch, last)
        survey.names = dict(self._known)
        return survey

    def _first_fault(self, batch: _Batch, last: Array) -> tuple[int, str, float, float] | None:
        """Finds a reading that is not later than the previous reading with the same name. `last`: shape (names,), the last time [s]
        of each name, which is updated."""
        order = np.argsort(batch.code, kind="stable")
        code, time = batch.code[order], batch.time[order]
        begins = np.diff(code, prepend=-2) != 0
        before = np.where(begins, last[code], np.roll(time, 1))
        ends = np.append(begins[1:], True)
        last[code[ends]] = time[ends]
        wrong = np.flatnonzero((time <= before) & (code >= 0))
        if not len(wrong):
            return None
        index = int(wrong[np.argmin(order[wrong])])
        return batch.first + int(order[index]), list(self._known)[code[index]], float(time[index]), float(before[index])

    def _read(self) -> Iterator[_Batch]:
        """Yields all readings of the table."""
        names, values = self.readings.name, self.readings.values
        table = self.table.with_channels(self.stamps, {value: value for value in values})
        table.texts = frozenset({names})
        for first, rows, time in table._timed(EVERYTHING):
            if not np.all(np.isfinite(time)):
                row = first + int(np.flatnonzero(~np.isfinite(time))[0])
                message = "the time is missing or not a number; fill it in, or remove the row"
                raise InstrumentError(f"{self.name}, {table.place(row)}: {message}")
            words, index = rows.words(names)
            codes = np.array([self._known.setdefault(word.strip(), len(self._known)) for word in words], np.int64)
            code = np.where(index < 0, -1, codes[index] if len(codes) else -1)
            yield _Batch(first, time, code, np.column_stack([rows.numbers(value) for value in values]))

    def _chosen(self) -> Iterator[_Batch]:
        """Yields the readings of the channels, sorted by time. The code of a reading is the position of its name in `_names`."""
        survey, wanted = self._surveyed(), self._names()
        position = np.full(MAX_COLUMNS + 2, -1)
        for number, name in enumerate(wanted):
            position[survey.names[name]] = number
        if survey.fault is not None and survey.fault[1] in wanted:
            row, name, late, before = survey.fault
            times = f"{self._shown(late)} after {self._shown(before)}"
            message = f"the time of '{name}' does not increase: {times}"
            hint = "correct or remove this reading or the one before it"
            raise InstrumentError(f"{self.name}, {self.table.place(row)}: {message}; {hint}")
        held, size = [], 0
        for batch in self._read():
            code = position[batch.code]  # -1, a missing name, is the last element
            kept = code >= 0
            chosen = _Batch(batch.first, batch.time[kept], code[kept], batch.values[kept])
            if survey.ordered:
                yield chosen
                continue
            held.append(chosen)
            size += chosen.values.size + 2 * chosen.time.size
            if size > MAX_HELD:
                message = f"it is not sorted by time, and contains more than {MAX_HELD / 1e6:g} million numbers"
                raise InstrumentError(f"{self.name}: {message}; sort its rows by time, or write one file for each hour")
        if held:
            time = np.concatenate([one.time for one in held])
            order = np.argsort(time, kind="stable")
            code, values = np.concatenate([one.code for one in held]), np.concatenate([one.values for one in held])
            for begin in range(0, len(order), format_file.BATCH):
                part = order[begin : begin + format_file.BATCH]
                yield _Batch(1, time[part], code[part], values[part])

    def _names(self) -> list[str]:
        """Returns the names of the readings that the channels need; all names if there are no channels."""
        names = self._surveyed().names
        own = {self.readings.column(name, value): name for name in names for value in self.readings.values}
        wanted = [own[column] for column in self.channels.values() if column in own]
        return list(dict.fromkeys(wanted)) or list(names)

    # -- samples -------------------------------------------------------------------------------------------------------

    def _timed(self, span: Span) -> Iterator[tuple[int, SampleRows, Array]]:
        names, first = self._names(), 1
        rest: _Batch | None = None
        try:
            for batch in self._chosen():
                joined = batch if rest is None else _joined(rest, batch)
                begins = np.diff(joined.time, prepend=-np.inf) > self.readings.within.value
                last = int(np.flatnonzero(begins)[-1]) if len(joined.time) else 0
                rest = _part(joined, slice(last, None))  # the next batch may continue the last sample
                if last:
                    yield self._samples(_part(joined, slice(0, last)), begins[:last], names, first)
                    first += int(begins[:last].sum())
            if rest is not None and len(rest.time):
                begins = np.diff(rest.time, prepend=-np.inf) > self.readings.within.value
                yield self._samples(rest, begins, names, first)
        except self.faults() as error:
            raise self.unreadable(error) from None

    def _samples(
        self, batch: _Batch, begins: NDArray[np.bool_], names: list[str], first: int
    ) -> tuple[int, SampleRows, Array]:
        """Combines readings into samples. `begins`: shape (n,), True for the first reading of each sample."""
        row = np.cumsum(begins) - 1
        time = batch.time[begins]
        cell = row * len(names) + batch.code
        twice = np.flatnonzero(np.bincount(cell) > 1)
        if len(twice):
            at, name = time[twice[0] // len(names)], names[twice[0] % len(names)]
            message = f"'{name}' has two readings in the sample at {self._shown(at)}"
            hint = "remove one of them, or state a shorter time `within` under `readings`"
            raise InstrumentError(f"{self.name}: {message}; {hint}")
        cells = np.full((len(time) * len(names), len(self.readings.values)), np.nan)
        cells[cell] = batch.values
        table = cells.reshape(len(time), len(names), -1)
        values = {
            self.readings.column(name, value): table[:, j, k]
            for j, name in enumerate(names)
            for k, value in enumerate(self.readings.values)
        }
        return (
            first,
            HeldRows(len(time), {**values, **dict.fromkeys(self.stamps.columns, time / self.stamps.scale)}),
            time,
        )


def _part(batch: _Batch, part: slice) -> _Batch:
    return _Batch(batch.first, batch.time[part], batch.code[part], batch.values[part])


def _joined(one: _Batch, other: _Batch) -> _Batch:
    return _Batch(
        one.first,
        np.concatenate([one.time, other.time]),
        np.concatenate([one.code, other.code]),
        np.concatenate([one.values, other.values]),
    )

"""Finds properties of a recording that has no description yet: channels, time, noise, and intervals at rest."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import InputError, Mark
from planrunner.base.progress import Announce, Pace
from planrunner.instruments.formats.choice import Format
from planrunner.instruments.formats.file import AnyFile
from planrunner.instruments.formats.guessing import (
    GRAVITY_ALIKE,
    LONGEST_STEP,
    Guess,
    LikelyTime,
    columns_of_numbers,
    columns_of_times,
    guessed_channel,
    guessed_channels,
    guessed_format,
    guessed_readings,
    guessed_time,
    not_numbers,
    of_minutes,
    of_sensors_alone,
    opened,
    reading,
    sensors_in_rows,
    stated_rates,
    table_of_readings,
    usual_unit,
    with_readings,
    wrap_of,
)
from planrunner.instruments.formats.long import LongFile
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording_motion import TurnComparison, turns_compared
from planrunner.physics.earth import EARTH_RATE
from planrunner.plan.span import Span
from planrunner.plan.units import STANDARD_GRAVITY, unit

FileRows = Iterator[tuple[int, Array, dict[str, Array]]]
WINDOW = 0.5
"""Length of the window [s] in which the scatter is computed to distinguish rest from motion."""
MOST_WINDOWS = 100_000
AT_LEAST = 2.0
"""Shortest span that counts as rest, s."""
MOST_G = 1200.0
"""The mean vector at rest can be gravity only if its length is at most this value, in mg."""
MOST_DEGREES = 400.0
"""Highest plausible temperature, degC."""
_LEAST_ROWS = 5  # in a window
MOVING = 4.0  # times the scatter of the quietest tenth of the windows
_QUIETEST = 0.1  # share of the windows that count as the quietest
COURSE = 1.0
"""A window shows a motion if the change of the mean to the next window, divided by the scatter in the window, is above this value.
The ratio is 2.4 for a constant slope, and 0.2 for white noise in windows of 50 samples."""
PAUSE = 2.0
"""A step of the time counts as a pause between two parts of a recording if it is longer than this time [s] and longer than
`_PERIODS` sample intervals."""
_PERIODS = 5.0
"""A step of the time of at most this number of sample intervals is not a pause."""
_SAME_RATE = 0.02
_RANGE = 50.0  # scatter in motion over the largest at rest: noise may grow with the orientation
_LARGE = 0.99  # quantile of a gyro's means that shows its unit: single wrong values do not count
_SPARSE = 0.5  # share of the samples below which a channel comes from a slower instrument
_OTHER_RATE = 0.2  # relative difference from the usual rate
_OTHER_RATES = 0.05  # share of the windows from which another rate is reported
_RATES_DIFFER = 10.0  # times the noise of a sample: step of the mean of a gyro that shows two rates
_ABOVE_DRIFT = 3.0  # times the range of the mean within intervals
_LEAST_DWELL = 3  # windows that must remain of an interval without its ends
_ALIKE_SPREAD, _MOST_SPREAD = 0.01, 3.0
"""Median deviation of the length of three columns from gravity. Up to the first value, or up to the second value times the smallest
deviation of all columns, the columns may be accelerometers."""
_ALIKE_NOISE = math.log(2.5)  # logarithm of the ratio between the noises of the axes of one sensor
_DIRECTIONS = 15.0  # deg between two poses that count as different
_OF_MEANS = re.compile(r"(?:^|[^a-z])(?:mean|average|mittel\w*)(?:[^a-z]|$)", re.IGNORECASE)
_NAME = re.compile(r"[^A-Za-z0-9_]+")


@dataclass(frozen=True, slots=True)
class LikelyChannel:
    """A column that is probably a channel.

    `unit`: the probable unit. `counts`: True if the numbers are raw counts, of which `per_unit` are one unit. `noise`: standard
    deviation of a sample at rest, in `unit`. `noise` is 0 if the channel is constant at rest, and NaN if the noise is unknown.
    `source`: the evidence for the unit. `source` is `name` if the name of the column states the unit, `size` if the size of the
    values suggests the unit, and `motion` if a comparison with the accelerometers during turns confirms the unit. `stands`: True if
    the values of the channel never change. `increments`: True if the column contains the integral over one sample period; in this
    case, `per_unit` is this period."""

    name: str
    column: str
    sensed: str
    unit: str
    counts: bool
    per_unit: float
    noise: float
    source: str
    stands: bool = False
    increments: bool = False

    @property
    def sure(self) -> bool:
        """Returns True if the name of the column contains the unit."""
        return self.source == "name"


@dataclass(frozen=True, slots=True)
class WindowLevels:
    """Contains the mean and the standard deviation (scatter) of each column in successive windows.

    `begin`, `end`: arrays of shape (n,), start and end times of the windows, s. `size`: number of rows in a window. `mean`,
    `scatter`: for each column, the mean and the standard deviation (n,) in the windows; NaN if a window contains fewer than two
    numbers."""

    begin: Array
    end: Array
    size: int
    mean: Mapping[str, Array]
    scatter: Mapping[str, Array]

    @property
    def length(self) -> float:
        """Returns the median length of the windows, s."""
        return float(np.median(self.end - self.begin)) if len(self.begin) else 0.0

    @property
    def rates(self) -> Array:
        """Returns the sample rate in each window, Hz, shape (n,)."""
        return self.size / (self.end - self.begin)


@dataclass(frozen=True, slots=True)
class Look:
    """Properties that were found in a recording.

    `time`: the column of the time; None if the file has none and rows are counted. `rate`: sample rate, Hz. `other`: columns that
    are not channels. `sparse`: columns that contain less than half as many numbers as the fullest column of a gyro or
    accelerometer. `still`: spans without motion. `backwards`: number of rows whose time does not increase; if there are such rows,
    the time is not used, and rows are counted instead. `pauses`: number of pauses, and the length of the shortest one, s. `motion`:
    comparison of gyros and accelerometers during turns; None if it gives no clear result. `contents`: a text for each table of a file
    with several tables, such as the topics of a ROS bag. `unread`: for each column that cannot be read although its name suggests a time
    or a channel, the reason."""

    file: str
    format: Format | None
    time: LikelyTime | None
    rate: float
    rows: int
    channels: tuple[LikelyChannel, ...]
    other: tuple[str, ...]
    sparse: tuple[str, ...]
    windows: WindowLevels
    still: tuple[Span, ...]
    backwards: int = 0
    pauses: tuple[int, float] = (0, 0.0)
    motion: TurnComparison | None = None
    contents: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()

    @property
    def other_rate(self) -> tuple[float, float] | None:
        """Returns a second sample rate [Hz] of the recording, and the time [s] at which it first occurs; None if there is no second
        rate."""
        if self.time is None:
            return None
        rates = self.windows.rates
        other = np.abs(rates / np.median(rates) - 1) > _OTHER_RATE if len(rates) else np.zeros(0, bool)
        own = float(np.median(rates[other])) if np.count_nonzero(other) > _OTHER_RATES * len(rates) else math.nan
        steady = other & (np.abs(rates / own - 1) < _OTHER_RATE)
        # a window that contains a pause has no neighbour with the same rate
        steady &= np.append(steady[1:], False) | np.append(False, steady[:-1])
        if np.count_nonzero(steady) <= _OTHER_RATES * len(rates):
            return None
        return own, float(self.windows.begin[int(np.argmax(steady))])

    @property
    def bursts(self) -> bool:
        """Returns True if the recording consists of short pieces with long pauses between them."""
        count, shortest = self.pauses
        if not count or self.backwards or self.time is None or not len(self.windows.end):
            return False
        whole, recorded = float(self.windows.end[-1]), self.rows / self.rate
        return whole - recorded > recorded and shortest > recorded / (count + 1)

    @property
    def dwells(self) -> tuple[Span, ...]:
        """Returns the intervals without acceleration, if the gyros show different rates in them; otherwise empty. One window is
        left out at each end of an interval, because the table may still settle there."""
        if self.bursts or not any(self._turns_at_rates(one) for one in self.channels if one.sensed == "gyro"):
            return ()
        window = max(WINDOW, self.windows.length)
        inner = (Span(span.start + window, span.end - window) for span in self.still)
        return tuple(span for span in inner if span.seconds >= _LEAST_DWELL * window)

    def _turns_at_rates(self, gyro: LikelyChannel) -> bool:
        """Returns True if the mean of a gyro changes between the intervals without acceleration, but not within them. (A drift
        would also change the mean within the intervals.)"""
        if len(self.still) < 2 or not gyro.noise > 0:
            return False
        means = [_at_rest(self.windows, (span,), self.windows.mean[gyro.column]) / gyro.per_unit for span in self.still]
        within = max(float(np.nanmax(one) - np.nanmin(one)) for one in means)
        step = float(np.max(np.abs(np.diff([np.nanmean(one) for one in means]))))
        of_earth = 0.0 if gyro.counts else 2 * EARTH_RATE / unit(gyro.unit).factor
        return step > max(_RATES_DIFFER * gyro.noise, _ABOVE_DRIFT * within, of_earth)

    def mean_in(self, span: Span, channel: LikelyChannel) -> float:
        """Returns the mean of a channel in an interval, in the unit of the channel."""
        return float(np.nanmean(_at_rest(self.windows, (span,), self.windows.mean[channel.column]))) / channel.per_unit

    @property
    def reversed_axes(self) -> bool:
        """Returns True if the axes of the gyros seem to differ from the axes of the accelerometers."""
        return self.motion is not None and not self.motion.same_axes

    @property
    def named_accel(self) -> str:
        """Returns a sentence about accelerometers whose vector at rest has the length of gravity in a unit other than the one that
        their names state; empty if the units agree or are not known."""
        accels = [one for one in self.channels if one.sensed == "accel" and one.source == "name" and not one.increments]
        if len(accels) != 3 or not self.still or len({one.unit for one in accels}) != 1:
            return ""
        rested = (_at_rest(self.windows, self.still, self.windows.mean[one.column]) for one in accels)
        level, named = _median(np.sqrt(sum(means**2 for means in rested))), accels[0].unit
        fitting = usual_unit("accel", level)
        if not fitting or fitting == named:
            return ""
        return f"the columns of the accelerometers name the unit {named}, but their vector at rest has the length of gravity in {fitting}"

    @property
    def still_share(self) -> float:
        """Returns the fraction of the recorded time that is without motion. Windows that contain a pause do not count."""
        lengths = self.windows.end - self.windows.begin
        whole = float(np.sum(lengths[lengths <= self.windows.length + max(PAUSE, _PERIODS / self.rate)]))
        return sum(span.seconds for span in self.still) / whole if whole else 0.0


def look_at(path: Path, rate: float | None = None, notice: Announce | None = None) -> Look:
    """Examines a recording. `rate`: sample rate [Hz] of a file without a time. Raises `InputError` if the file cannot be read, or
    contains no time or no inertial channel."""
    try:
        given = guessed_format(path, path.name)
        whole = opened(path, path.name, given)
        columns = columns_of_numbers(whole)
        likely = guessed_readings(whole, columns)
        if likely is not None:
            whole = table_of_readings(whole, likely)
            columns = whole.columns()
            given = with_readings(path, given, likely.readings)
            _whole_samples(whole, columns)
        _one_sensor_a_row(whole, columns)
        whole = of_sensors_alone(whole, columns)
        file = reading(whole, columns)
        first = next((values for _, _, values in file.all_rows()), None)
        if first is None:
            raise InstrumentError(f"{path.name} holds no samples")
        plain = [column for column in columns if not of_minutes(first[column])]
        written = {} if rate is not None or likely is not None else columns_of_times(whole, plain)
        time = (
            guessed_time(first, written, stated_rates(path, path.name, given), whole.units())
            if likely is None
            else likely.time
        )
        unread = not_numbers(whole, columns) if likely is None else {}
        rate = rate if likely is None else None  # the rows of a table of readings cannot be counted
        if rate is None and time is None:
            message = "no column of this recording looks like a time that increases"
            hint = "state the sample rate, such as --sample-rate '100 Hz'"
            if any(_OF_MEANS.search(column) for column in columns):
                hint = f"{hint}. For a table of means, see docs/real-recordings.md (key `summary`)"
            if unread:
                message = f"{message}; {next(iter(unread.values()))}"
                hint = f"correct the file, or {hint}"
            raise InputError.at(Mark(str(path)), "recording-unfit", message, hint)
        if rate is None and time is not None and time.written:
            file = reading(whole, columns, time.column)
        found = rate if rate is not None else 0.0 if time is None else time.rate
        stamp = time if rate is None else None
        guesses = guessed_channels(
            [column for column in columns if stamp is None or column != stamp.column], whole.units()
        )
        guesses = _named_or_alike(guesses, first, 1 / found)
        clock = _Clock(stamp, max(PAUSE, _PERIODS / found))
        wanted = [one.column for one in guesses]
        windows, rows, counts = _windows(clock.watched(file.all_rows()), wanted, found, file.about, clock, notice)
        stamp = clock.stamp
        if time is not None and rate is None and stamp is None:
            found = found if time.shared else clock.rate(rows, found)
            windows = _counted(windows, found)
    except InstrumentError as error:
        hint = "docs/recording-formats.md shows how a bench describes a recording"
        raise InputError.at(Mark(str(path)), "recording-unfit", str(error), hint) from None
    if not any(one.sensed in ("gyro", "accel") for one in guesses):
        message = f"no column looks like a gyro or an accelerometer: {', '.join(columns[:12])}"
        hint = "describe the recording in a bench file, as docs/recording-formats.md shows"
        if unread:
            message, hint = f"no gyro or accelerometer can be read: {next(iter(unread.values()))}", "correct the file"
        raise InputError.at(Mark(str(path)), "recording-unfit", message, hint)
    samples = max(counts[one.column] for one in guesses if one.sensed in ("gyro", "accel"))
    _complete_rows(path, guesses, first)
    sparse = tuple(one.column for one in guesses if one.sensed and counts[one.column] < _SPARSE * samples)
    sensed = [one for one in guesses if one.sensed and one.column not in sparse]
    still = _still(
        windows, max(PAUSE, _PERIODS / found), [one.column for one in sensed if one.sensed in ("gyro", "accel")]
    )
    period = 1 / found
    motion = _motion(sensed, windows, still, period)
    channels = _channels(sensed, windows, still, motion, period)
    other = tuple(one.column for one in guesses if not one.sensed)
    pauses = (len(clock.steps), min(clock.steps, default=0.0))
    return Look(
        path.name,
        given,
        stamp,
        found,
        rows,
        channels,
        other,
        sparse,
        windows,
        still,
        clock.backwards,
        pauses,
        motion,
        whole.contents(),
        tuple(unread.values()),
    )


def _whole_samples(table: LongFile, columns: Sequence[str]) -> None:
    """Raises `InstrumentError` if no sample of a table of readings contains all gyros and accelerometers."""
    sensed = [column for column in columns if guessed_channel(column).sensed in ("gyro", "accel")]
    table.with_channels(table.stamps, {column: column for column in sensed}).look()


def _one_sensor_a_row(file: AnyFile, columns: Sequence[str]) -> None:
    """Raises `InstrumentError` if the rows of a file belong to different sensors."""
    column, words = sensors_in_rows(file, columns)
    if column:
        message = (
            f"each row of {file.name} belongs to one sensor, which the column '{column}' states: {', '.join(words)}"
        )
        hint = "write one file for each sensor, or a table in which each row contains all sensors"
        raise InstrumentError(f"{message}; {hint}")


def _complete_rows(path: Path, guesses: Sequence[Guess], first: Mapping[str, Array]) -> None:
    """Raises `InputError` if no row contains both a number of a gyro and a number of an accelerometer, because each row belongs to one
    of the two sensors. `first`: the first rows of each column."""
    gyro, accel = (
        [np.isfinite(first[one.column]) for one in guesses if one.sensed == sensed] for sensed in ("gyro", "accel")
    )
    if not gyro or not accel:
        return
    of_gyro, of_accel = np.any(gyro, axis=0), np.any(accel, axis=0)
    if of_gyro.any() and of_accel.any() and not np.any(of_gyro & of_accel):
        message = "no row contains both gyros and accelerometers: each row belongs to one of the two sensors"
        hint = "write one file for each sensor, or a table in which each row contains all sensors"
        raise InputError.at(Mark(str(path)), "recording-unfit", message, hint)


class _Clock:
    """Observes the time column: rows in which time does not increase, steps longer than `pause` [s], and the total time.

    `times`: times of the rows that were yielded last, s after the first row. `stamp`: the column of the time, which is final only
    after the last row has been read; None if the column is not a time."""

    def __init__(self, stamp: LikelyTime | None, pause: float):
        self._stamp = stamp
        self._pause = pause
        self._first = self._last = self._raw = math.nan
        self._most, self._turns = 0.0, 0
        self._falls: list[float] = []
        self.steps: list[float] = []
        self.times: Array = np.zeros(0)

    @property
    def backwards(self) -> int:
        """Returns the number of rows whose time does not increase."""
        late = self._stamp is not None and self._stamp.wraps is None and self._wraps is not None
        return 0 if late else len(self._falls)

    @property
    def _wraps(self) -> float | None:
        stamp = self._stamp
        if stamp is None or stamp.wraps is not None:
            return None if stamp is None else stamp.wraps
        return wrap_of(np.array(self._falls), 1 / (stamp.rate * stamp.scale), 0.0, self._most)

    @property
    def counts_rows(self) -> bool:
        """Returns True if the time of a row is its number divided by the sample rate."""
        return self._stamp is None

    @property
    def stamp(self) -> LikelyTime | None:
        """Returns the column of the time, with the value at which its counter returns to zero; None if the time of some rows does
        not increase."""
        return None if self._stamp is None or self.backwards else replace(self._stamp, wraps=self._wraps)

    def unwrapped(self, times: Array) -> Array:
        """Corrects times [s] that come from a counter, if it became clear only after the last row that the counter returns to zero.
        Adds one period of the counter for each return to zero."""
        if self._stamp is None or self._stamp.wraps is not None or self._wraps is None:
            return times
        return times + np.cumsum(np.diff(times, prepend=times[:1]) < 0) * (self._wraps * self._stamp.scale)

    def watched(self, rows: FileRows) -> FileRows:
        """Yields the rows unchanged, and observes their times."""
        for number, time, values in rows:
            if self._stamp is not None and len(time):
                self._take(time if self._stamp.written else values[self._stamp.column], self._stamp)
            yield number, time, values

    def _take(self, raw: Array, stamp: LikelyTime) -> None:
        steps = np.diff(raw, prepend=raw[0] if math.isnan(self._raw) else self._raw)
        falls, returns = steps <= 0, np.zeros(len(raw), bool)
        falls[0] &= not math.isnan(self._raw)  # the first row follows no other
        if stamp.wraps is not None:
            longest = LONGEST_STEP / (stamp.rate * stamp.scale)
            returns = (steps + stamp.wraps > 0) & (steps + stamp.wraps <= longest)
            falls |= steps >= stamp.wraps - longest  # back across the return to zero
        self._falls += steps[falls & ~returns].tolist()
        turns = self._turns + np.cumsum(returns)
        own = (raw + turns * (stamp.wraps or 0.0)) * stamp.scale
        advance = np.diff(own, prepend=self._last)
        self.steps += advance[advance > self._pause].tolist()
        self._first = float(own[0]) if math.isnan(self._first) else self._first
        self._raw, self._turns, self._last = float(raw[-1]), int(turns[-1]), float(own[-1])
        self._most = max(self._most, float(np.nanmax(raw, initial=0.0)))
        self.times = own - self._first

    def rate(self, rows: int, median: float) -> float:
        """Returns the number of rows per second [Hz], averaged over the whole recording. If pauses make this average differ from
        `median`, which is the rate of the median step, returns `median`."""
        whole = (rows - 1) / (self._last - self._first) if self._last > self._first else median
        return whole if abs(whole / median - 1) < _SAME_RATE else median


def _named_or_alike(guesses: list[Guess], first: Mapping[str, Array], period: float) -> list[Guess]:
    """Returns the guesses about the columns. If the names of the columns show nothing, the guesses are completed from the values.

    If no name suggests a gyro or an accelerometer, the function searches for three neighbouring columns whose vector is as long as
    gravity, or as its integral over one sample period. These columns are assumed to be the accelerometers. Three columns next to them
    are assumed to be the gyros. If the names of three columns state the axes x, y and z, the columns get these axes; otherwise they
    are x, y and z in their order. `first`: the first rows of each column. `period`: sample period, s."""
    if any(one.sensed in ("accel", "gyro") for one in guesses):
        return guesses
    begin = _like_gravity(guesses, first, (STANDARD_GRAVITY, 1.0), counts=True)
    increments = begin is None
    if begin is None:
        begin = _like_gravity(guesses, first, (STANDARD_GRAVITY * period,), counts=False)
    if begin is None:
        return guesses
    after = [guesses[k : k + 3] for k in range(begin + 3, len(guesses) - 2, 3)][:2]
    triads = [*after, guesses[max(begin - 3, 0) : begin]]
    matrix = guesses[begin].column.partition("[")[0]
    triads.sort(key=lambda three: any(one.column.partition("[")[0] != matrix for one in three if "[" in one.column))
    sensed = _axes("accel", guesses[begin : begin + 3])
    gyros = next((one for one in triads if len(one) == 3 and not _turns_with_the_sensor(first, one)), None)
    if gyros is not None:
        sensed |= _axes("gyro", gyros)
    return [
        Guess(one.column, *sensed.get(one.column, ("", "")), one.unit, increments and one.column in sensed)
        for one in guesses
    ]


def _like_gravity(
    guesses: Sequence[Guess], first: Mapping[str, Array], lengths: Sequence[float], *, counts: bool
) -> int | None:
    """Returns the index of the first of three neighbouring columns whose vector is as long as gravity; None if there are none.

    If several sets of three columns fit, the scatter of the length decides, then the similarity of the noise of the three columns.
    `first`: the first rows of each column. `lengths`: the possible lengths of gravity. `counts`: True if the columns may also contain
    raw counts."""
    fitting: list[tuple[float, float, int]] = []
    for begin in range(0, len(guesses) - 2):
        three = guesses[begin : begin + 3]
        norm = np.sqrt(sum(first[one.column] ** 2 for one in three))
        level = _median(norm)
        alike = any(abs(math.log(max(level, 1e-12) / one_g)) < GRAVITY_ALIKE for one_g in lengths)
        if alike or (counts and _of_counts(level) and _turns_with_the_sensor(first, three)):
            noise = [_median(np.abs(np.diff(first[one.column]))) for one in three]
            unlike = math.log(max(noise) / min(noise)) if min(noise) > 0 else math.inf
            fitting.append((_median(np.abs(norm / level - 1)), unlike, begin))
    least = min((spread for spread, _, _ in fitting), default=0.0)
    near = [one for one in fitting if one[0] <= max(_ALIKE_SPREAD, _MOST_SPREAD * least)]
    return min(near, key=lambda one: (one[1] > _ALIKE_NOISE, one[2]), default=(0.0, 0.0, None))[2]


def _of_counts(level: float) -> bool:
    """Returns True if 1 g may correspond to `level` counts: a power of two of at least 256, as in the registers of most
    accelerometers, or 1000 for values in mg."""
    return any(
        abs(math.log(max(level, 1e-9) / one_g)) < GRAVITY_ALIKE for one_g in (1000.0, *(2.0**k for k in range(8, 17)))
    )


def _turns_with_the_sensor(first: Mapping[str, Array], three: Sequence[Guess]) -> bool:
    """Returns True if the three columns `three` form a vector of constant length whose direction changes, as a magnetometer
    measures it. `first`: the first rows of each column."""
    table = np.column_stack([first[one.column] for one in three])
    table = table[np.isfinite(table).all(axis=1)]
    if not len(table):
        return False
    length = np.linalg.norm(table, axis=1)
    return bool(length.std() < 0.3 * length.mean() and table.std(axis=0).max() > 0.3 * length.mean())


def _axes(sensed: str, three: Sequence[Guess]) -> dict[str, tuple[str, str]]:
    """Returns the sensed quantity and the axis of three columns, by name of the column.

    If the names do not state the axes x, y and z, the columns are x, y and z in their order."""
    named = {one.axis for one in three} == set("xyz")
    return {one.column: (sensed, one.axis if named else "xyz"[k]) for k, one in enumerate(three)}


def _median(values: Array) -> float:
    """Returns the median of the finite values; 0 if there are none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0


def _windows(
    rows: FileRows,
    columns: Sequence[str],
    rate: float,
    about: int,
    clock: _Clock,
    notice: Announce | None,
) -> tuple[WindowLevels, int, dict[str, int]]:
    """Computes the means and standard deviations of all windows.

    Also returns the number of rows, and the number of finite values in each column. `about`: approximate number of rows. `rate`:
    sample rate, Hz."""
    size = max(_LEAST_ROWS, round(WINDOW * rate), math.ceil(about / MOST_WINDOWS))
    pace = Pace("looking at the recording", about, notice)
    kept: dict[str, Array] = {column: np.zeros(0) for column in columns}
    means: dict[str, list[Array]] = {column: [] for column in columns}
    scatters: dict[str, list[Array]] = {column: [] for column in columns}
    counts = dict.fromkeys(columns, 0)
    times: list[Array] = []
    total = left = 0
    for _, time, values in rows:
        at = np.arange(total, total + len(time)) / rate if clock.counts_rows else clock.times
        times.append(at[-left % size :: size])
        total += len(time)
        whole = (left + len(time)) // size * size
        for column in columns:
            counts[column] += int(np.count_nonzero(np.isfinite(values[column])))
            joined = np.concatenate([kept[column], values[column]])
            level, spread = _levels(joined[:whole].reshape(-1, size))
            means[column].append(level)
            scatters[column].append(spread)
            kept[column] = joined[whole:]
        left = left + len(time) - whole
        pace.reached(total)
    mean = {column: np.concatenate(parts) for column, parts in means.items()}
    scatter = {column: np.concatenate(parts) for column, parts in scatters.items()}
    edges = clock.unwrapped(np.concatenate([*times, np.zeros(0)]))
    count = total // size
    last = edges[count] if len(edges) > count else edges[count - 1] + size / rate if count else 0.0
    return WindowLevels(edges[:count], np.append(edges[1:count], last)[:count], size, mean, scatter), total, counts


def _levels(table: Array) -> tuple[Array, Array]:
    """Returns the mean and the standard deviation (n,) of each row of a table (n, k), without missing numbers.

    Both are NaN if a row contains fewer than two numbers."""
    if np.isfinite(table).all():
        return table.mean(axis=1), table.std(axis=1, ddof=1)
    known = np.isfinite(table)
    count = np.count_nonzero(known, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(known, table, 0.0).sum(axis=1) / np.where(count < 2, np.nan, count)
        squares = np.where(known, (table - mean[:, np.newaxis]) ** 2, 0.0).sum(axis=1)
        return mean, np.sqrt(squares / np.where(count < 2, np.nan, count - 1))


def _counted(windows: WindowLevels, rate: float) -> WindowLevels:
    """Returns the same windows, with times that are computed from row numbers.

    `rate`: sample rate, Hz."""
    begin = np.arange(float(len(windows.begin))) * (windows.size / rate)
    return replace(windows, begin=begin, end=begin + windows.size / rate)


def _still(windows: WindowLevels, pause: float, columns: Sequence[str]) -> tuple[Span, ...]:
    """Returns the spans in which every sensor is at rest. A sensor is at rest if two conditions hold. First, its mean does not
    change much between windows. Second, its scatter is similar to the scatter in its quietest windows, or small compared with the
    scatter in motion. A span ends at each pause that is longer than `pause` [s]."""
    from scipy.stats import chi2

    if not columns or not len(windows.begin):
        return ()
    quiet = windows.end - windows.begin <= windows.length + pause
    low = math.sqrt(
        chi2.ppf(_QUIETEST, windows.size - 1) / (windows.size - 1)
    )  # quantile of the scatter of white noise
    for column in columns:
        scatter = windows.scatter[column]
        known = scatter[np.isfinite(scatter)]
        if not len(known):
            continue
        usual, most = np.quantile(known, (_QUIETEST, 0.95)).tolist()
        least = max(most / _RANGE, np.finfo(float).tiny)
        quiet &= scatter <= max(MOVING * usual, least)
        quiet &= _course(windows.mean[column]) <= np.maximum(COURSE * np.fmax(scatter, usual / low), least)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], quiet.view(np.int8), [0]]))).reshape(-1, 2)
    spans = (Span(float(windows.begin[begin]), float(windows.end[end - 1])) for begin, end in edges.tolist())
    return tuple(span for span in spans if span.seconds >= AT_LEAST)


def _course(mean: Array) -> Array:
    """Returns the absolute change of the mean from window to window, shape (n,). The change at a window is half of the difference
    between the next and the previous window. `mean`: array of shape (n,), mean of each window."""
    if len(mean) < 3:
        return np.zeros(len(mean))
    change = np.abs(mean[2:] - mean[:-2]) / 2
    return np.concatenate([change[:1], change, change[-1:]])


def _at_rest(windows: WindowLevels, still: Sequence[Span], values: Array) -> Array:
    """Returns the values of the windows in the still spans; of all windows if there are no still spans. `values`: array of shape
    (n,), one value for each window."""
    chosen = np.zeros(len(windows.begin), bool)
    for span in still:
        chosen |= (windows.begin >= span.start - 1e-9) & (windows.begin < span.end - 1e-9)
    return values[chosen] if chosen.any() else values


def _motion(
    guesses: Sequence[Guess], windows: WindowLevels, still: Sequence[Span], period: float
) -> TurnComparison | None:
    """Compares gyros and accelerometers during turns; None if there is not exactly one triad of each, or if the comparison gives no
    clear result. `period`: sample period, s."""
    triads: list[Array] = []
    for sensed in ("gyro", "accel"):
        triad = [[one for one in guesses if (one.sensed, one.axis) == (sensed, axis)] for axis in "xyz"]
        if any(len(columns) != 1 for columns in triad):
            return None
        triads.append(np.column_stack([windows.mean[one.column] / _integrated(one, period) for (one,) in triad]))
    gyro, accel = triads
    return turns_compared(gyro, accel, windows.begin, windows.end, still)


def _channels(
    guesses: Sequence[Guess],
    windows: WindowLevels,
    still: Sequence[Span],
    motion: TurnComparison | None,
    period: float,
) -> tuple[LikelyChannel, ...]:
    """Makes the channels from the guesses, which are completed from the size of the values. `period`: sample period, s."""
    accels = [one for one in guesses if one.sensed == "accel"]
    rested = [_at_rest(windows, still, windows.mean[one.column]) / _integrated(one, period) for one in accels]
    norm = largest = math.nan
    if len(accels) < 3:
        largest = max(
            (abs(_median(means)) for means in rested), default=math.nan
        )  # one axis may be close to the vertical
    else:
        norm = largest = _median(np.sqrt(sum(means**2 for means in rested[:3])))
    quietest = min(
        (
            _median(_at_rest(windows, still, windows.scatter[one.column])) / _integrated(one, period)
            if still
            else math.nan
            for one in guesses
            if one.sensed == "gyro"
        ),
        default=math.nan,
    )
    fastest = max(
        (_large(windows.mean[one.column]) / _integrated(one, period) for one in guesses if one.sensed == "gyro"),
        default=0.0,
    )
    accel_unit = next((one.unit for one in guesses if one.sensed == "accel" and one.unit), "") or usual_unit(
        "accel", largest
    )
    in_counts = len(accels) >= 3 and not accel_unit
    simple = [f"{one.sensed}_{one.axis}".rstrip("_") for one in guesses]
    made = []
    for one, short in zip(guesses, simple, strict=True):
        name = short if simple.count(short) == 1 else _NAME.sub("_", one.column).strip("_")[:40]
        mean = windows.mean[one.column]
        known = np.abs(mean[np.isfinite(mean)])
        level = {"gyro": fastest, "accel": largest}.get(one.sensed, _median(known))
        turned = "" if motion is None or one.sensed != "gyro" or in_counts else motion.unit
        unit = one.unit or turned or usual_unit(one.sensed, level, accel_unit, quietest)
        usual = level if one.sensed == "temperature" else norm
        counts = not one.unit and (in_counts or usual > (MOST_DEGREES if one.sensed == "temperature" else MOST_G))
        per_unit = _integrated(one, period)
        counts = counts or not unit
        if counts:
            unit = {"gyro": "deg/s", "accel": "g", "temperature": "degC"}[one.sensed]
            per_unit = float(f"{norm:.4g}") if one.sensed == "accel" and norm > 0 else 1.0
        scatter = _median(_at_rest(windows, still, windows.scatter[one.column])) / per_unit
        rounding = 8 * np.finfo(float).eps * (float(known.max()) if len(known) else 0.0) / per_unit
        made.append(
            LikelyChannel(
                name if name[:1].isalpha() else f"c_{name}"[:40],
                one.column,
                one.sensed,
                unit,
                counts,
                per_unit,
                scatter if scatter > rounding else 0.0,
                "name" if one.unit else "motion" if turned and not counts else "size",
                stands=bool(len(known) and np.ptp(mean[np.isfinite(mean)]) <= rounding and scatter <= rounding),
                increments=one.increments and not counts,
            )
        )
    return tuple(made)


def _integrated(one: Guess, period: float) -> float:
    """Returns the time [s] over which a column integrates the output of its sensor; 1 if the column contains the output itself.
    `period`: sample period, s."""
    return period if one.increments else 1.0


def _large(mean: Array) -> float:
    """Returns a high quantile of the absolute means of a gyro. Unlike the maximum, it is insensitive to single outliers."""
    known = np.abs(mean[np.isfinite(mean)])
    return float(np.quantile(known, _LARGE)) if len(known) else 0.0


def poses(windows: WindowLevels, still: Sequence[Span], triad: Sequence[LikelyChannel]) -> int:
    """Returns the number of different directions in which gravity points in the still spans."""
    found: list[Array] = []
    for span in still:
        mean = np.array(
            [np.nanmean(_at_rest(windows, (span,), windows.mean[one.column]) / one.per_unit) for one in triad]
        )
        direction = mean / max(float(np.linalg.norm(mean)), np.finfo(float).tiny)
        if all(float(direction @ other) < math.cos(math.radians(_DIRECTIONS)) for other in found):
            found.append(direction)
    return len(found)

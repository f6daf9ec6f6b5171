"""Finds properties of a recording that has no description yet: channels, time, noise, and intervals at rest."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import InputError, Mark
from planrunner.base.progress import Announce, Pace
from planrunner.instruments.formats.choice import Format
from planrunner.instruments.formats.guessing import (
    Guess,
    columns_of_numbers,
    guessed_channel,
    guessed_format,
    guessed_time,
    opened,
    usual_unit,
)
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording_keys import SECONDS
from planrunner.plan.span import Span
from planrunner.plan.units import STANDARD_GRAVITY

FileRows = Iterator[tuple[int, Array, dict[str, Array]]]
WINDOW = 0.5
"""Seconds over which scatter is taken to tell rest from motion."""
MOST_WINDOWS = 100_000
AT_LEAST = 2.0
"""Shortest still span, s."""
MOST_G = 1200.0
"""Longest mean vector at rest that can be 1 g, in mg."""
MOST_DEGREES = 400.0
"""Highest temperature, degC."""
MOVING = 4.0  # times the scatter of the quietest tenth of the windows
COURSE = 1.0
"""Change of the mean from one window to the next, over the scatter in the window, above which the window shows a motion: 2.4 for a constant
slope, 0.2 for white noise in windows of 50 samples."""
PAUSE = 2.0
"""Step of the time, s, that is a pause between two pieces of a recording, if it is also longer than some intervals between samples."""
_PERIODS = 5.0
"""Intervals between samples that are no pause yet."""
_SAME_RATE = 0.02
_RANGE = 50.0  # scatter in motion over the largest at rest: noise may grow with the orientation
_DIRECTIONS = 15.0  # deg between two poses that count as different
_NAME = re.compile(r"[^A-Za-z0-9_]+")


@dataclass(frozen=True, slots=True)
class LikelyChannel:
    """A column that is probably a channel. unit: the probable unit; counts: True if the numbers are raw counts, with `per_unit`
    counts per unit; noise: standard deviation of a sample at rest, in this unit; sure: True if the name of the column contains the
    unit."""

    name: str
    column: str
    sensed: str
    unit: str
    counts: bool
    per_unit: float
    noise: float
    sure: bool


@dataclass(frozen=True, slots=True)
class WindowLevels:
    """Mean and standard deviation (scatter) of each column in successive windows. begin: (n,), start times of the windows, s;
    length: length of a window, s; mean, scatter: for each column, the values (n,)."""

    begin: Array
    length: float
    mean: Mapping[str, Array]
    scatter: Mapping[str, Array]


@dataclass(frozen=True, slots=True)
class Look:
    """Properties that were found in a recording. time: column and unit of the time, None if rows are counted; rate: sample rate,
    Hz; other: columns that are not channels; still: spans without motion; backwards: number of rows whose time does not increase
    (if there are any, rows are counted instead); pauses: number of pauses, and the length of the shortest one, s."""

    file: str
    format: Format | None
    time: tuple[str, str] | None
    rate: float
    rows: int
    channels: tuple[LikelyChannel, ...]
    other: tuple[str, ...]
    windows: WindowLevels
    still: tuple[Span, ...]
    backwards: int = 0
    pauses: tuple[int, float] = (0, 0.0)

    @property
    def still_share(self) -> float:
        """The fraction of the recorded time that is without motion."""
        whole = len(self.windows.begin) * self.windows.length
        return sum(span.seconds for span in self.still) / whole if whole else 0.0


def look_at(path: Path, rate: float | None = None, notice: Announce | None = None) -> Look:
    """Examines a recording. rate: sample rate [Hz] of a file without a time. Raises `InputError` if the file cannot be read, or
    contains no time or no inertial channel."""
    try:
        given = guessed_format(path, path.name)
        columns = columns_of_numbers(path, path.name, given)
        file = opened(path, path.name, columns, given)
        first = next(values for _, values in file.rows())
        time = guessed_time(first)
        if rate is None and time is None:
            message = "no column of this recording looks like a time that increases"
            hint = "state the sample rate, such as --sample-rate '100 Hz'"
            raise InputError.at(Mark(str(path)), "recording-unfit", message, hint)
        found = rate if rate is not None else 0.0 if time is None else time[2]
        stamp = None if rate is not None or time is None else (time[0], time[1])
        guesses = [guessed_channel(column) for column in columns if stamp is None or column != stamp[0]]
        guesses = _named_or_alike(guesses, first)
        clock = _Clock(stamp, max(PAUSE, _PERIODS / found))
        wanted = [one.column for one in guesses]
        windows, rows = _windows(clock.watched(file.all_rows()), wanted, found, file.about, notice)
        if stamp is not None and clock.backwards:
            stamp, found = None, clock.rate(rows, found)
    except InstrumentError as error:
        hint = "docs/recording-formats.md shows how a bench describes a recording"
        raise InputError.at(Mark(str(path)), "recording-unfit", str(error), hint) from None
    if not any(one.sensed in ("gyro", "accel") for one in guesses):
        message = f"no column looks like a gyro or an accelerometer: {', '.join(columns[:12])}"
        hint = "describe the recording in a bench file, as docs/recording-formats.md shows"
        raise InputError.at(Mark(str(path)), "recording-unfit", message, hint)
    still = _still(windows, [one.column for one in guesses if one.sensed in ("gyro", "accel")])
    channels = _channels([one for one in guesses if one.sensed], windows, still)
    other = tuple(one.column for one in guesses if not one.sensed)
    pauses = (len(clock.steps), min(clock.steps, default=0.0))
    return Look(path.name, given, stamp, found, rows, channels, other, windows, still, clock.backwards, pauses)


class _Clock:
    """Observes the time column: rows in which time does not increase, steps longer than `pause` [s], and the total time."""

    def __init__(self, stamp: tuple[str, str] | None, pause: float):
        self._column = None if stamp is None else stamp[0]
        self._scale = 1.0 if stamp is None else SECONDS[stamp[1]]
        self._pause = pause
        self._first = self._last = math.nan
        self.backwards = 0
        self.steps: list[float] = []

    def watched(self, rows: FileRows) -> FileRows:
        """Yields the rows unchanged, and observes their times."""
        for number, time, values in rows:
            if self._column is not None and len(values[self._column]):
                own = values[self._column] * self._scale
                steps = np.diff(own, prepend=self._last)
                self.backwards += int(np.count_nonzero(steps <= 0))
                self.steps += steps[steps > self._pause].tolist()
                self._first = own[0] if math.isnan(self._first) else self._first
                self._last = float(own[-1])
            yield number, time, values

    def rate(self, rows: int, median: float) -> float:
        """Rows per second [Hz], averaged over the whole recording. If pauses make this differ from `median`, the rate of the median
        step, returns `median`."""
        whole = (rows - 1) / (self._last - self._first) if self._last > self._first else median
        return whole if abs(whole / median - 1) < _SAME_RATE else median


def _named_or_alike(guesses: list[Guess], first: Mapping[str, Array]) -> list[Guess]:
    """Guesses for the columns, completed if the names do not help. If no name suggests a gyro or an accelerometer, three
    neighbouring columns whose vector is as long as gravity are taken as accelerometers, and three columns next to them as gyros."""
    if any(one.sensed in ("accel", "gyro") for one in guesses):
        return guesses
    for begin in range(0, len(guesses) - 2):
        three = guesses[begin : begin + 3]
        norm = np.sqrt(sum(first[one.column] ** 2 for one in three))
        level = float(np.median(norm))
        if not (abs(math.log(max(level, 1e-9) / STANDARD_GRAVITY)) < 0.1 or abs(math.log(max(level, 1e-9))) < 0.1):
            continue
        others = guesses[begin + 3 : begin + 6] if len(guesses) >= begin + 6 else guesses[max(begin - 3, 0) : begin]
        sensed = {one.column: ("accel", "xyz"[k]) for k, one in enumerate(three)}
        if len(others) == 3:
            sensed |= {one.column: ("gyro", "xyz"[k]) for k, one in enumerate(others)}
        return [Guess(one.column, *sensed.get(one.column, ("", "")), one.unit) for one in guesses]
    return guesses


def _windows(
    rows: FileRows,
    columns: Sequence[str],
    rate: float,
    about: int,
    notice: Announce | None,
) -> tuple[WindowLevels, int]:
    """Computes the means and standard deviations of all windows; also returns the number of rows."""
    size = max(2, round(WINDOW * rate), math.ceil(about / MOST_WINDOWS))
    pace = Pace("looking at the recording", about, notice)
    kept: dict[str, list[Array]] = {column: [] for column in columns}
    means: dict[str, list[Array]] = {column: [] for column in columns}
    scatters: dict[str, list[Array]] = {column: [] for column in columns}
    total = left = 0
    for _, time, values in rows:
        total += len(time)
        whole = (left + len(time)) // size * size
        for column in columns:
            joined = np.concatenate([*kept[column], values[column]])
            table = joined[:whole].reshape(-1, size)
            means[column].append(table.mean(axis=1))
            scatters[column].append(table.std(axis=1, ddof=1))
            kept[column] = [joined[whole:]]
        left = left + len(time) - whole
        pace.reached(total)
    mean = {column: np.concatenate(parts) for column, parts in means.items()}
    scatter = {column: np.concatenate(parts) for column, parts in scatters.items()}
    count = len(next(iter(mean.values()))) if mean else 0
    return WindowLevels(np.arange(count) * size / rate, size / rate, mean, scatter), total


def _still(windows: WindowLevels, columns: Sequence[str]) -> tuple[Span, ...]:
    """Spans in which every sensor is at rest: its scatter is similar to that in its quietest windows, or small compared with its
    scatter in motion, and its mean does not change much between windows."""
    if not columns or not len(windows.begin):
        return ()
    quiet = np.ones(len(windows.begin), bool)
    for column in columns:
        scatter = windows.scatter[column]
        usual, most = np.nanquantile(scatter, (0.1, 0.95)).tolist()
        least = max(most / _RANGE, np.finfo(float).tiny)
        quiet &= scatter <= max(MOVING * usual, least)
        quiet &= _course(windows.mean[column]) <= np.maximum(COURSE * scatter, least)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], quiet.view(np.int8), [0]]))).reshape(-1, 2)
    spans = (Span(begin * windows.length, end * windows.length) for begin, end in edges.tolist())
    return tuple(span for span in spans if span.seconds >= AT_LEAST)


def _course(mean: Array) -> Array:
    """Absolute change (n,) of the mean per window, computed from the windows before and after each window."""
    if len(mean) < 3:
        return np.zeros(len(mean))
    change = np.abs(mean[2:] - mean[:-2]) / 2
    return np.concatenate([change[:1], change, change[-1:]])


def _at_rest(windows: WindowLevels, still: Sequence[Span], values: Array) -> Array:
    """The values of the windows in the still spans; of all windows if there are no still spans."""
    chosen = np.zeros(len(windows.begin), bool)
    for span in still:
        chosen |= (windows.begin >= span.start - 1e-9) & (windows.begin < span.end - 1e-9)
    return values[chosen] if chosen.any() else values


def _channels(guesses: Sequence[Guess], windows: WindowLevels, still: Sequence[Span]) -> tuple[LikelyChannel, ...]:
    accels = [one.column for one in guesses if one.sensed == "accel"]
    norm = math.nan
    if len(accels) >= 3:
        squares = sum(_at_rest(windows, still, windows.mean[column]) ** 2 for column in accels[:3])
        norm = float(np.nanmedian(np.sqrt(squares)))
    accel_unit = next((one.unit for one in guesses if one.sensed == "accel" and one.unit), "") or usual_unit(
        "accel", norm
    )
    simple = [f"{one.sensed}_{one.axis}".rstrip("_") for one in guesses]
    made = []
    for one, short in zip(guesses, simple, strict=True):
        name = short if simple.count(short) == 1 else _NAME.sub("_", one.column).strip("_")[:40]
        level = float(np.nanmax(np.abs(windows.mean[one.column]), initial=0.0)) if one.sensed == "gyro" else norm
        unit = one.unit or usual_unit(one.sensed, level, accel_unit)
        usual = float(np.nanmedian(np.abs(windows.mean[one.column]))) if one.sensed == "temperature" else norm
        counts = not one.unit and usual > (MOST_DEGREES if one.sensed == "temperature" else MOST_G)
        per_unit = 1.0
        counts = counts or not unit
        if counts:
            unit = {"gyro": "deg/s", "accel": "g", "temperature": "degC"}[one.sensed]
            per_unit = float(f"{norm:.4g}") if one.sensed == "accel" and math.isfinite(norm) else 1.0
        scatter = float(np.nanmedian(_at_rest(windows, still, windows.scatter[one.column]))) / per_unit
        made.append(
            LikelyChannel(
                name if name[:1].isalpha() else f"c_{name}"[:40],
                one.column,
                one.sensed,
                unit,
                counts,
                per_unit,
                scatter,
                bool(one.unit),
            )
        )
    return tuple(made)


def poses(windows: WindowLevels, still: Sequence[Span], triad: Sequence[LikelyChannel]) -> int:
    """The number of different directions in which gravity points in the still spans."""
    found: list[Array] = []
    for span in still:
        mean = np.array(
            [np.nanmean(_at_rest(windows, (span,), windows.mean[one.column]) / one.per_unit) for one in triad]
        )
        direction = mean / max(float(np.linalg.norm(mean)), np.finfo(float).tiny)
        if all(float(direction @ other) < math.cos(math.radians(_DIRECTIONS)) for other in found):
            found.append(direction)
    return len(found)

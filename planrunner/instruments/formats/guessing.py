"""Guesses how a file is arranged: its format, its numeric columns, its column of time, and the channel of each column.

The guesses use only names, numbers, and the sample rate that a text file may state before its header. A person who knows the
recording should check and correct them.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.instruments.formats.choice import ENDINGS, Format, open_file
from planrunner.instruments.formats.file import AnyFile, TimeStamps, open_samples
from planrunner.instruments.formats.text import MAX_HEADER, SEPARATORS, TextKeys
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.units import STANDARD_GRAVITY

MOST_COLUMNS = 200
"""Columns that are looked at."""
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?|nan|inf|", re.IGNORECASE)
_TIME = re.compile(
    r"(?:^|[^a-z])(t|time|timestamp|stamp|clock|epoch|seconds|ticks?|zeit)(?:[^a-z]|$)|timestamp|time", re.IGNORECASE
)
_COUNT = re.compile(r"(?:^|[^a-z])(n|count|counter|index|samples?|row)(?:[^a-z]|$)", re.IGNORECASE)
_UNITS = (
    (re.compile(r"rad[_ /]*(?:p|per)?[_ /]*s", re.IGNORECASE), "rad/s"),
    (re.compile(r"deg[_ /]*(?:p|per)?[_ /]*s|dps|°/s", re.IGNORECASE), "deg/s"),
    (re.compile(r"deg[_ /]*(?:p|per)?[_ /]*h|dph|°/h", re.IGNORECASE), "deg/h"),
    (re.compile(r"m[_ /]*(?:p|per)?[_ /]*s[\^]?2|mps2|m/s²|ms2", re.IGNORECASE), "m/s^2"),
    (re.compile(r"(?:^|[^a-z])mg(?:[^a-z]|$)", re.IGNORECASE), "mg"),
    (re.compile(r"(?:^|[^a-z])gs?(?:[^a-z]|$)", re.IGNORECASE), "g"),
    (re.compile(r"celsius|deg_?c(?:[^a-z]|$)|°c", re.IGNORECASE), "degC"),
)
_TIME_UNITS = (
    (re.compile(r"nano|[_( \[]ns", re.IGNORECASE), "ns"),
    (re.compile(r"micro|[_( \[][uµ]s", re.IGNORECASE), "us"),
    (re.compile(r"milli|[_( \[]ms", re.IGNORECASE), "ms"),
    (re.compile(r"second|[_( \[]s(?:[^a-z]|$)", re.IGNORECASE), "s"),
)
_COUNTERS = ((re.compile(r"SampleTimeFine"), 10_000.0),)  # Xsens MT Low-Level Communication Protocol: counts per second
_WRAPS = (2.0**16, 2.0**24, 2.0**32)
LONGEST_STEP = 5.0
"""Median steps in one step across the return of a counter to zero."""
_STATED_RATE = re.compile(r"(?:rate|frequency)\D{0,12}?(\d+(?:[.,]\d+)?)\s*(k?)Hz", re.IGNORECASE)
_OTHER_RATE = re.compile(
    r"cut-?off|filter|low-?pass|band-?width|gnss|gps|magn|(?:^|[^a-z])mag(?:[^a-z]|$)", re.IGNORECASE
)
_OF_SAMPLES = re.compile(r"sampl|output data rate|(?:^|[^a-z])odr(?:[^a-z]|$)", re.IGNORECASE)
_SAME_RATE = 0.05
_NEAR_RATE = 5.0
"""Factor between a stated rate and the rate in a unit of time. Within it, the unit is assumed, although it contradicts the statement;
beyond it, the column is taken for a counter of unknown frequency."""
_LONGEST_LINE = 60
GRAVITY_ALIKE = 0.12
"""Log of the length of a vector over the length of gravity, below which both count as the same: the scale of a sensor without calibration
is off by a few per cent."""
_GRAVITY_NAMED = 0.29  # the same for accelerometers known by name, in m/s^2 and g: no raw counts have such small values
_SENSED = (
    ("accel", re.compile(r"acc|specific_?force", re.IGNORECASE)),
    ("gyro", re.compile(r"gyr|omega|ang(?:ular)?_?(?:vel|rate)", re.IGNORECASE)),
    ("temperature", re.compile(r"temp|celsius", re.IGNORECASE)),
    ("gyro", re.compile(r"(?:^|[^a-z])[gw]_?[xyz](?:[^a-z]|$)", re.IGNORECASE)),
    ("accel", re.compile(r"(?:^|[^a-z])[af]_?[xyz](?:[^a-z]|$)", re.IGNORECASE)),
)
_AXIS = re.compile(r"(?:^|[^a-z])(?:[agfw]|acc\w*?|gyr\w*?)?_?([xyz])(?:[^a-z]|$)", re.IGNORECASE)
_MATRIX = re.compile(r"\[([123])\]$")


@dataclass(frozen=True, slots=True)
class LikelyTime:
    """The column that probably contains the time.

    `column`: name of the column. `unit`: unit of the values of the column; s if `per_second` is given. `rate`: sample rate, Hz.
    `per_second`: counts per second if the column is a counter, otherwise None. `wraps`: value at which the counter returns to zero;
    None if it never does. `sure`: True if the name of the column states the unit, or if this unit leads to a sample rate that the
    file states. `line`: the line of the file from which `per_second` was guessed, otherwise empty."""

    column: str
    unit: str
    rate: float
    per_second: float | None = None
    wraps: float | None = None
    sure: bool = True
    line: str = ""

    @property
    def doubt(self) -> str:
        """The reason why the unit may be wrong; empty if `sure` is True."""
        if self.sure:
            return ""
        return (
            f"guessed from the header line '{self.line}'"
            if self.line
            else "the unit is a guess from the size of the steps"
        )

    @property
    def scale(self) -> float:
        """Seconds per unit of the column."""
        return _SCALES[self.unit] if self.per_second is None else 1 / self.per_second


@dataclass(frozen=True, slots=True)
class StatedRate:
    """A rate that a file states before its header.

    `rate`: Hz. `line`: the line of the file that states the rate, shortened. `of_samples`: True if the line says that this is the
    rate of the samples.
    """

    rate: float
    line: str
    of_samples: bool


@dataclass(frozen=True, slots=True)
class Guess:
    """A guess about a column that may be a channel.

    `sensed`: gyro, accel, temperature, or empty if unknown. `axis`: x, y, z, or empty. `unit`: the unit that the name of the column
    contains, or empty.
    """

    column: str
    sensed: str
    axis: str
    unit: str


def guessed_format(path: Path, name: str) -> Format | None:
    """Guesses the format of a file; None if the extension of the file name determines it. Raises `InstrumentError` if no guess can
    be made."""
    kind = ENDINGS.get(path.suffix.lower())
    if kind not in (None, "text"):
        return None
    with open_samples(path, name) as file:
        start = file.read(MAX_HEADER)
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        keys = _text_keys(start.decode("utf-16", "ignore").lstrip("\ufeff"), "utf-16")
    elif b"\0" in start:
        raise InstrumentError(
            f"{name} is not a text file, and its extension is none of {', '.join(ENDINGS)}: describe its records in a bench file, "
            "as docs/recording-formats.md shows, or rename it with the extension of its format"
        )
    else:
        try:
            keys = _text_keys(start.decode("utf-8-sig", "strict" if len(start) < MAX_HEADER else "ignore"), "utf-8")
        except UnicodeDecodeError:
            keys = _text_keys(start.decode("latin-1"), "latin-1")
    if keys is None:
        raise InstrumentError(f"{name} has no lines of numbers in its first {MAX_HEADER} bytes")
    return None if keys == TextKeys() and kind == "text" else Format(type="text", parameters=keys)


def _text_keys(start: str, encoding: str) -> TextKeys | None:
    """Guesses the layout of a text file from its first lines. The chosen separator is the one for which most lines have the same
    number of columns; if several separators are equally good, it is the one that gives the most columns. Returns None if the lines
    contain no columns of numbers."""
    lines = start.splitlines()[:-1] or start.splitlines()
    best: tuple[int, int, TextKeys] | None = None
    for word, separator in SEPARATORS.items():
        cells = [line.split() if word == "blanks" else line.strip().split(separator) for line in lines]
        widths = Counter(len(row) for row in cells[-50:])
        if not widths:
            continue
        width = widths.most_common(1)[0][0]
        first = _first_row(cells, width)
        if width < 2 or first is None:
            continue
        rows = cells[first:]
        comma = separator != "," and any("," in cell for row in rows for cell in row)
        header = first > 0 and len(cells[first - 1]) == width
        names = () if header else tuple(f"column_{k + 1}" for k in range(width))
        keys = TextKeys(
            separator=word,
            decimal="comma" if comma else "point",
            skip=first - 1 if header else first,
            names=names,
            encoding=encoding,
        )
        rank = (sum(len(row) == width for row in rows), width)
        if best is None or rank > best[:2]:
            best = (*rank, keys)
    return None if best is None else best[2]


def _first_row(cells: Sequence[Sequence[str]], width: int) -> int | None:
    """The index of the first line whose cells are mostly numbers."""
    for index, row in enumerate(cells):
        if (
            len(row) == width
            and sum(_NUMBER.fullmatch(cell.strip().strip('"')) is not None for cell in row) > width / 2
        ):
            return index
    return None


def columns_of_numbers(path: Path, name: str, given: Format | None) -> list[str]:
    """The numeric columns of a file. Columns whose number of rows differs from the most common number of rows are left out. Raises
    `InstrumentError` if there is no numeric column."""
    counts: dict[str, int] = {}
    known = open_file(path, name, TimeStamps(None, period=1.0), {}, given).columns()
    for column in dict.fromkeys(known[:MOST_COLUMNS]):
        if known.count(column) > 1:
            continue
        file = open_file(path, name, TimeStamps(None, period=1.0), {column: column}, given)
        try:
            for _ in file.rows():
                counts[column] = file.rows_about()
                break
        except InstrumentError:
            continue
    if not counts:
        raise InstrumentError(f"{name} has no column of numbers")
    usual = max(set(counts.values()), key=list(counts.values()).count)
    return [column for column, count in counts.items() if count == usual]


def opened(path: Path, name: str, columns: Sequence[str], given: Format | None) -> AnyFile:
    """Opens a file with these columns as channels. Because the time of its rows is not known yet, they count as one second apart.
    Raises `InstrumentError` if the file cannot be read."""
    file = open_file(path, name, TimeStamps(None, period=1.0), {column: column for column in columns}, given)
    file.look()
    return file


def stated_rates(path: Path, name: str, given: Format | None) -> tuple[StatedRate, ...]:
    """The rates that a text file states before its header, such as `// Sample rate: 100.0Hz`.

    Lines that are about filters or about other instruments are left out. Raises `InstrumentError` if the file cannot be opened."""
    if given is None or not isinstance(given.parameters, TextKeys):
        return ()
    with open_samples(path, name) as file:
        lines = file.read(MAX_HEADER).decode(given.parameters.encoding, "replace").splitlines()[: given.parameters.skip]
    found: list[StatedRate] = []
    for line in lines:
        if _OTHER_RATE.search(line):
            continue
        shown = "".join(letter for letter in line if letter.isprintable()).strip()[:_LONGEST_LINE]
        for match in _STATED_RATE.finditer(line):
            rate = float(match[1].replace(",", ".")) * (1000.0 if match[2] else 1.0)
            if rate > 0:
                found.append(StatedRate(rate, shown, _OF_SAMPLES.search(line) is not None))
    return tuple(found)


def guessed_time(first: Mapping[str, Array], stated: Sequence[StatedRate] = ()) -> LikelyTime | None:
    """Guesses the column of the time from the first rows of all columns; None if no column looks like a time.

    `stated`: the rates that the file states."""
    for pattern in (_TIME, re.compile("")):
        for column, values in first.items():
            if pattern.pattern and not pattern.search(column):
                continue
            if not pattern.pattern and (_COUNT.search(column) or guessed_channel(column).sensed):
                continue
            if len(values) < 3 or not np.all(np.isfinite(values)):
                continue
            steps = np.diff(values)
            wraps = wrap_of(steps[steps <= 0], float(np.median(steps)), float(values.min()), float(values.max()))
            if wraps is not None:
                steps = np.where(steps <= 0, steps + wraps, steps)
            if not np.mean(steps > 0) > 0.99:
                continue
            step = float(np.median(_between_samples(first, steps)))
            if step <= 0 or (not pattern.pattern and np.max(np.abs(steps / step - 1)) > 0.5):
                continue
            time = _time_of(column, step, wraps, stated, bool(np.all(values == np.round(values))))
            if time is not None and (time.sure or pattern.pattern or wraps is None):
                return time
    return None


def wrap_of(backwards: Array, step: float, least: float, most: float) -> float | None:
    """The value at which a counter returns to zero; None if its values decrease for another reason.

    `backwards`: the steps of the counter that are not positive. `step`: median step of the counter. `least`, `most`: smallest and
    largest value of the counter."""
    if not len(backwards) or step <= 0 or least < 0:
        return None
    fits = (w for w in _WRAPS if most < w and np.all((backwards + w > 0) & (backwards + w <= LONGEST_STEP * step)))
    return next(fits, None)


def _between_samples(first: Mapping[str, Array], steps: Array) -> Array:
    """The steps of the time between those rows that contain a sample of a gyro or an accelerometer.

    In a log of several instruments, other rows contain no such sample. `steps`: array of shape (n - 1,), steps of the time between
    all rows."""
    held = [
        np.isfinite(values) for column, values in first.items() if guessed_channel(column).sensed in ("gyro", "accel")
    ]
    if not held or not (chosen := np.any(held, axis=0)).any() or chosen.all():
        return steps
    return np.diff(np.concatenate([[0.0], np.cumsum(steps)])[chosen])


_SCALES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def _time_of(
    column: str, step: float, wraps: float | None, stated: Sequence[StatedRate], whole: bool
) -> LikelyTime | None:
    """Describes the time in a column; None if no unit of time leads to a usual sample rate.

    `step`: median step of the column. `whole`: True if the values of the column are whole numbers. If a unit leads to a stated
    rate, the unit counts as sure. Only a column of whole numbers can be a counter of unknown frequency. Such a column counts as one
    if the file states the rate of its samples, and if each unit of time leads to a very different rate."""
    for pattern, per_second in _COUNTERS:
        if pattern.search(column):
            return LikelyTime(column, "s", per_second / step, per_second, wraps)
    for pattern, unit in _TIME_UNITS:
        if pattern.search(column):
            return LikelyTime(column, unit, 1 / (step * _SCALES[unit]), None, wraps)
    rates = {unit: 1 / (step * scale) for unit, scale in _SCALES.items()}
    for one in stated:
        for unit, rate in rates.items():
            if abs(rate / one.rate - 1) < _SAME_RATE:
                return LikelyTime(column, unit, rate, None, wraps)
    usual = {unit: rate for unit, rate in rates.items() if 1.9 < rate < 50_000}
    samples = next((one for one in stated if one.of_samples), None)
    if samples is not None and whole:
        own = samples.rate
        near = min(usual, key=lambda unit: abs(math.log(usual[unit] / own)), default=None)
        if near is None or abs(math.log(usual[near] / own)) > math.log(_NEAR_RATE):
            return LikelyTime(column, "s", own, float(f"{own * step:.6g}"), wraps, sure=False, line=samples.line)
        usual = {near: usual[near]}
    for unit, rate in usual.items():
        return LikelyTime(column, unit, rate, None, wraps, sure=False)
    return None


def guessed_channel(column: str) -> Guess:
    """Guesses the meaning of a column from its name."""
    unit = next((unit for pattern, unit in _UNITS if pattern.search(column)), "")
    sensed = next((sensed for sensed, pattern in _SENSED if pattern.search(_MATRIX.sub("", column))), "")
    by_unit = {
        "rad/s": "gyro",
        "deg/s": "gyro",
        "deg/h": "gyro",
        "m/s^2": "accel",
        "mg": "accel",
        "degC": "temperature",
    }
    sensed = by_unit.get(unit, sensed)
    if unit == "g" and (sensed != "accel" or column.lower() in ("g", "gs")):
        unit = ""  # the letter of a gyro, not a unit
    matrix, axis = _MATRIX.search(column), _AXIS.search(column)
    letter = "xyz"[int(matrix[1]) - 1] if matrix else axis[1].lower() if axis else ""
    return Guess(column, sensed, letter, unit)


def usual_unit(sensed: str, level: float, accel_unit: str = "") -> str:
    """Guesses the unit of a column whose name does not contain it; empty if no unit is plausible. `level`: for a gyro, a large
    absolute value of the column; for an accelerometer, the length of the mean vector at rest. `accel_unit`: for a gyro, the unit of
    the accelerometers."""
    if sensed == "accel":
        lengths = (
            ("m/s^2", STANDARD_GRAVITY, _GRAVITY_NAMED),
            ("g", 1.0, _GRAVITY_NAMED),
            ("mg", 1000.0, GRAVITY_ALIKE),
        )
        for unit, one_g, most in lengths:
            if abs(math.log(max(level, 1e-9) / one_g)) < most:
                return unit
        return ""
    if sensed == "gyro":
        return "rad/s" if accel_unit == "m/s^2" and level < 40 else "deg/s"
    return {"temperature": "degC"}.get(sensed, "")

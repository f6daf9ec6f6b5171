"""Guesses how a file is arranged: its format, its numeric columns, its column of time, and the channel of each column.

Guesses use only names and numbers. A person who knows the recording should check and correct them.
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
    r"(?:^|[^a-z])(t|time|timestamp|stamp|clock|epoch|seconds|zeit)(?:[^a-z]|$)|timestamp|time", re.IGNORECASE
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
class Guess:
    """A guess about a column that may be a channel. sensed: gyro, accel, temperature, or empty if unknown; axis: x, y, z, or empty;
    unit: the unit that the name of the column contains, or empty."""

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
    number of columns; among equals, the one with the most columns. Returns None if the lines contain no columns of numbers."""
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
    """The index of the first line in which most cells are numbers."""
    for index, row in enumerate(cells):
        if len(row) == width and sum(_NUMBER.fullmatch(cell.strip()) is not None for cell in row) > width / 2:
            return index
    return None


def columns_of_numbers(path: Path, name: str, given: Format | None) -> list[str]:
    """The numeric columns of a file. Columns whose number of rows differs from the most common one are left out. Raises
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
    """Opens a file with these columns as channels. As its time is not known yet, its rows count as one second apart. Raises
    `InstrumentError` if the file cannot be read."""
    file = open_file(path, name, TimeStamps(None, period=1.0), {column: column for column in columns}, given)
    file.look()
    return file


def guessed_time(first: Mapping[str, Array]) -> tuple[str, str, float] | None:
    """Guesses the column of the time, its unit and the sample rate [Hz] from the first rows of all columns; None if no column looks
    like a time."""
    for pattern in (_TIME, re.compile("")):
        for column, values in first.items():
            if pattern.pattern and not pattern.search(column):
                continue
            if not pattern.pattern and (_COUNT.search(column) or guessed_channel(column).sensed):
                continue
            steps = np.diff(values)
            if len(steps) < 2 or not np.all(np.isfinite(values)) or not np.mean(steps > 0) > 0.99:
                continue
            step = float(np.median(steps))
            if step <= 0 or (not pattern.pattern and np.max(np.abs(steps / step - 1)) > 0.5):
                continue
            unit = _unit_of_time(column, step)
            if unit is not None:
                return column, unit, 1 / (step * {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit])
    return None


def _unit_of_time(column: str, step: float) -> str | None:
    for pattern, unit in _TIME_UNITS:
        if pattern.search(column):
            return unit
    for unit, scale in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if 1.9 < 1 / (step * scale) < 50_000:
            return unit
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
    """Guesses the unit of a column whose name does not contain it; empty if no unit is plausible. level: for a gyro, the largest
    absolute value of the column; for an accelerometer, the length of the mean vector at rest; accel_unit: for a gyro, the unit of
    the accelerometers."""
    if sensed == "accel":
        for unit, one_g in (("m/s^2", STANDARD_GRAVITY), ("g", 1.0), ("mg", 1000.0)):
            if abs(math.log(max(level, 1e-9) / one_g)) < 0.25:
                return unit
        return ""
    if sensed == "gyro":
        return "rad/s" if accel_unit == "m/s^2" and level < 40 else "deg/s"
    return {"temperature": "degC"}.get(sensed, "")

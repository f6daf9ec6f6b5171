"""Guesses the layout of a file: its format, its numeric columns, its column of time, and the channel of each column.

The guesses use only names, numbers, and the sample rate that a text file may state before its header. A person who knows the
recording should check and correct the guesses.
"""

from __future__ import annotations

import contextlib
import csv
import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.instruments.formats import dataflash
from planrunner.instruments.formats.bag_files import MCAP_MAGIC, ROS1_MAGIC
from planrunner.instruments.formats.choice import ENDINGS, FORMATS, Format, open_file, usual_format
from planrunner.instruments.formats.clock import DAY, NoTimesError
from planrunner.instruments.formats.file import AnyFile, NoKeys, TimeStamps, open_samples
from planrunner.instruments.formats.json_samples import JsonFile, JsonKeys
from planrunner.instruments.formats.long import LongFile, ReadingColumns
from planrunner.instruments.formats.novatel import is_raw_imu
from planrunner.instruments.formats.packed import GZIP, open_text
from planrunner.instruments.formats.text import MAX_HEADER, SEPARATORS, TextFile, TextKeys
from planrunner.instruments.formats.workbook import WorkbookKeys, open_workbook, sheet_rows
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.units import STANDARD_GRAVITY

MOST_COLUMNS = 200
"""Maximum number of columns that are examined."""
_NUMBER = re.compile(r"[+-]?(\d{1,3}(?:,\d{3})+\.\d*|\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?|nan|inf|", re.IGNORECASE)
_TIME = re.compile(
    r"(?:^|[^a-z])(t|time|timestamp|stamp|clock|epoch?|seconds|ticks?|zeit|sekunden|utc|sow|tow)(?:[^a-z]|$)|timestamp|time",
    re.IGNORECASE,
)
_STAMP = re.compile(r"(?:\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}[T ]\s*)?\d{1,2}:\d{2}(?!\w)")
"""Start of a date with a time, or of a time of day."""
_SIGNS = frozenset({",", ";", "|"})
_ROW = "row"
"""Name that a column of row numbers gets if the file gives it none."""
_SHEET_ROWS = 200  # rows at the start of a sheet, among which the first sample is searched for
_VALUE = re.compile(
    r"(?:^|[^a-z])(values?|readings?|wert|val|measure\w*|data|signal|result)(?:[^a-z]|$)", re.IGNORECASE
)
_COUNT = re.compile(r"(?:^|[^a-z])(n|count|counter|index|samples?|row)(?:[^a-z]|$)", re.IGNORECASE)
_UNITS = (
    (re.compile(r"mrad[_ /]*(?:p|per)?[_ /]*s", re.IGNORECASE), "mrad/s"),
    (re.compile(r"m(?:illi)?-?deg[_ /]*(?:p|per)?[_ /]*s|mdps|m°/s", re.IGNORECASE), "mdeg/s"),
    (re.compile(r"rad[_ /]*(?:p|per)?[_ /]*s", re.IGNORECASE), "rad/s"),
    (re.compile(r"deg[_ /]*(?:p|per)?[_ /]*s|dps|°/s", re.IGNORECASE), "deg/s"),
    (re.compile(r"deg[_ /]*(?:p|per)?[_ /]*h|dph|°/h", re.IGNORECASE), "deg/h"),
    (re.compile(r"m[_ /]*(?:p|per)?[_ /]*\(?s(?:\^?-?2|²|/s)|mps2|ms\^?-?2", re.IGNORECASE), "m/s^2"),
    (re.compile(r"(?:^|[^a-z])[uµ]g(?:[^a-z]|$)", re.IGNORECASE), "ug"),
    (re.compile(r"(?:^|[^a-z])mg(?:[^a-z]|$)", re.IGNORECASE), "mg"),
    (re.compile(r"(?:^|[^a-z])gs?(?:[^a-z]|$)", re.IGNORECASE), "g"),
    (re.compile(r"celsius|deg_?c(?:[^a-z]|$)|°c", re.IGNORECASE), "degC"),
    (re.compile(r"fahrenheit|deg_?f(?:[^a-z]|$)|°f", re.IGNORECASE), "degF"),
    (re.compile(r"kelvin", re.IGNORECASE), "K"),
)
_OF_TEMPERATURE = (
    (re.compile(r"[^a-z]c[^a-z]*$", re.IGNORECASE), "degC"),
    (re.compile(r"[^a-z]f[^a-z]*$", re.IGNORECASE), "degF"),
    (re.compile(r"[^a-z]k[^a-z]*$", re.IGNORECASE), "K"),
)
"""Temperature units that a single letter at the end of a name states. These units are used only if the name denotes a
temperature."""
_SENSED_IN = {
    **dict.fromkeys(("rad/s", "mrad/s", "deg/s", "mdeg/s", "deg/h"), "gyro"),
    **dict.fromkeys(("m/s^2", "mg", "ug"), "accel"),
    **dict.fromkeys(("degC", "degF", "K"), "temperature"),
}
_TIME_UNITS = (
    (re.compile(r"nano|[_( \[]ns", re.IGNORECASE), "ns"),
    (re.compile(r"micro|[_( \[][uµ]s|^usecs?$", re.IGNORECASE), "us"),
    (re.compile(r"milli|[_( \[]ms|^msecs?$", re.IGNORECASE), "ms"),
    (re.compile(r"second|sekunde|[_( \[]s(?:[^a-z]|$)|(?:^|[^a-z])sow(?:[^a-z]|$)", re.IGNORECASE), "s"),
)
_COUNTERS = ((re.compile(r"SampleTimeFine"), 10_000.0),)  # Xsens MT Low-Level Communication Protocol: counts per second
_WRAPS = (2.0**16, 2.0**24, 2.0**32, DAY, 1e3 * DAY, 7 * DAY, 7e3 * DAY)
"""Values at which counters return to zero, including the seconds and milliseconds of a day and of a GPS week."""
_EPOCH = (0.94e9, 4.1e9)
"""Range of the seconds since 1970 in the years 2000 to 2099."""
_DAYS = ((36_000.0, 73_000.0), (730_000.0, 767_000.0))
"""Ranges of the days since 1900 (Excel) and since the year 0 (MATLAB) in the years 2000 to 2099."""
LONGEST_STEP = 5.0
"""Longest step across the return of a counter to zero, in units of the median step."""
_STATED_RATE = re.compile(r"(?:rate|frequency)\D{0,12}?(\d+(?:[.,]\d+)?)\s*(k?)Hz", re.IGNORECASE)
_OTHER_RATE = re.compile(
    r"cut-?off|filter|low-?pass|band-?width|gnss|gps|magn|(?:^|[^a-z])mag(?:[^a-z]|$)", re.IGNORECASE
)
_OF_SAMPLES = re.compile(r"sampl|output data rate|(?:^|[^a-z])odr(?:[^a-z]|$)", re.IGNORECASE)
_SAME_RATE = 0.05
_NEAR_RATE = 5.0
"""Largest ratio between the stated sample rate and the rate that follows from a unit of time. Up to this ratio, the unit is assumed
although it contradicts the stated rate. Beyond it, the column counts as a counter of unknown frequency."""
_LONGEST_LINE = 60
GRAVITY_ALIKE = 0.12
"""The length of a vector counts as equal to gravity if the natural logarithm of their ratio is smaller than this value. The scale
of an uncalibrated sensor is wrong by a few per cent."""
_GRAVITY_NAMED = 0.29  # the same for accelerometers known by name, in m/s^2 and g: no raw counts have such small values
_SENSED = (
    ("temperature", re.compile(r"temp(?!l)|celsius|fahrenheit|kelvin", re.IGNORECASE)),
    ("accel", re.compile(r"acc(?!ur)|beschl|specific_?force", re.IGNORECASE)),
    ("gyro", re.compile(r"gyr|omega|ang(?:ular)?_?(?:vel|rate)|(?:rotation|turn|dreh)_?rate", re.IGNORECASE)),
    ("gyro", re.compile(r"(?:^|[^a-z])[gw]_?[xyz](?:[^a-z]|$)", re.IGNORECASE)),
    ("accel", re.compile(r"(?:^|[^a-z])[af]_?[xyz](?:[^a-z]|$)", re.IGNORECASE)),
)
_VECTORS = (
    ("gyro", re.compile(r"(?:^|[^a-z])[gw]$", re.IGNORECASE)),
    ("accel", re.compile(r"(?:^|[^a-z])[af]$", re.IGNORECASE)),
)
_INCREMENTS = (
    ("gyro", re.compile(r"(?:^|[^a-z])d(?:elta|el)?[_ -]?(?:theta|ang)", re.IGNORECASE)),
    ("accel", re.compile(r"(?:^|[^a-z])d(?:elta|el)?[_ -]?v(?:el\w*|[xyz])?(?:[^a-z]|$)", re.IGNORECASE)),
)
"""Names of increments: angles and velocities that are integrated over one sample period."""
_INTEGRATED = {
    "gyro": ((re.compile(r"(?:^|[^a-z])rad", re.IGNORECASE), "rad/s"), (re.compile(r"deg|°", re.IGNORECASE), "deg/s")),
    "accel": ((re.compile(r"m/s|mps", re.IGNORECASE), "m/s^2"),),
}
"""For increments: the unit of the sensor that corresponds to a unit in the column's name."""
_NO_SAMPLE = re.compile(
    r"(?<!real)(?<!real[_ -])(?<!run)time|covar|varian|std|sigma|clip|(?:^|[^a-z])dt(?:[^a-z]|$)|(?<![a-z])abs|(?-i:Abs)|norm|magnitude"
    r"|resultant|status|valid(?!ation)",
    re.IGNORECASE,
)
"""Names of columns that belong to a sensor but do not contain an output."""
_AXIS = re.compile(r"(?:^|[^a-z])(?:[agfw]|acc\w*?|gyr\w*?)?_?([xyz])(?:[^a-z]|$)", re.IGNORECASE)
_CAPITAL = re.compile(r"[a-z]([XYZ])(?![a-z])")
_MATRIX = re.compile(r"\[([0123])\]$")
_UNIT_ALONE = re.compile(
    r"[\[(]?\s*(?:[mµun]?s|min|h|#|-|[mu]?g|m?deg(?:/s|/h)?|m?dps|°/s|°/h|m?rad(?:/s)?|mm?/s(?:\^2|²|/s)|m/\(s\^2\)|m/s2"
    r"|(?:°|deg_?)?[CFK]|m?V|[mµun]?T|u?Gauss|G|h?Pa|k?Hz|%|LSB|counts?|no_?units?|n/a)\s*[\])]?",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class LikelyTime:
    """The column that probably contains the time.

    `column`: name of the column. `unit`: unit of the values of the column. The unit is s if `per_second` is given, and `date_time`
    or `time_of_day` for texts. `rate`: sample rate, Hz. `per_second`: counts per second if the column is a counter, otherwise None.
    `wraps`: value at which the counter returns to zero; None if it never does. `sure`: True if the name of the column states the
    unit, or if this unit leads to a sample rate that the file states. `line`: the line of the file from which `per_second` was
    guessed, otherwise empty. `shared`: True if several rows share a time, so that rows must be counted."""

    column: str
    unit: str
    rate: float
    per_second: float | None = None
    wraps: float | None = None
    sure: bool = True
    line: str = ""
    shared: bool = False

    @property
    def doubt(self) -> str:
        """Returns the reason why the unit may be wrong; empty if `sure` is True."""
        if self.sure:
            unusual = "the unit leads to an unusual sample rate: check it"
            return unusual if self.rate > _USUAL_RATES[1] else ""
        return (
            f"guessed from the header line '{self.line}'"
            if self.line
            else "the unit is a guess from the size of the steps"
        )

    @property
    def written(self) -> bool:
        """Returns True if the column contains dates or times of day as text."""
        return self.unit in ("date_time", "time_of_day")

    @property
    def scale(self) -> float:
        """Returns the number of seconds per unit of the column."""
        return _ALL_SCALES[self.unit] if self.per_second is None else 1 / self.per_second


@dataclass(frozen=True, slots=True)
class StatedRate:
    """A rate that a file states before its header.

    `rate`: the stated rate, Hz. `line`: the line of the file that states the rate, shortened. `of_samples`: True if the line states
    that this is the rate of the samples.
    """

    rate: float
    line: str
    of_samples: bool


@dataclass(frozen=True, slots=True)
class Guess:
    """A guess about a column that may be a channel.

    `sensed`: gyro, accel, temperature, or empty if unknown. `axis`: x, y, z, or empty. `unit`: the unit that the name of the column
    contains, or empty. `increments`: True if the column contains the integral over one sample period.
    """

    column: str
    sensed: str
    axis: str
    unit: str
    increments: bool = False


_COUNTED = TimeStamps(None, period=1.0)
"""Time stamps of a file whose time column is not known yet: the rows are counted."""
_REFUSED = (
    ("a compressed file", b"BZh", "unpack it first (bzip2)"),
    ("a compressed file", b"\xfd7zXZ", "unpack it first (xz)"),
    (
        "an archive or an Excel workbook",
        b"PK\x03\x04",
        "unpack it first, or rename the workbook with the extension .xlsx",
    ),
    ("an old Excel workbook", b"\xd0\xcf\x11\xe0", "save it as an Excel workbook (.xlsx)"),
    ("a TDMS file of LabVIEW", b"TDSm", "rename it with the extension .tdms"),
    ("a PDF file", b"%PDF", "ask for the numbers as a text file"),
)
"""Files that are recognised but not read. Each entry states the kind of file, how the file begins, and what the user can do."""
_FASTEST, _NOISIEST = 40.0, 0.007
"""Largest rate and largest noise of a sample at rest that a gyro in rad/s usually shows."""
_FASTEST_UNKNOWN = 12.0  # the same rate if the noise is unknown
NO_UNITS: Mapping[str, str] = MappingProxyType({})
_TOPIC = re.compile(r"^/[^.\s]*\.")
"""The topic at the start of a column name in a ROS bag."""
_JSON = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:\[\s*[{\[]|\{\s*\"|\[[-+.\d\s,eE]*\]\s*\[)")
"""Start of a text in JSON: a list of objects or lists, an object, or lists that follow each other."""


def guessed_format(path: Path, name: str) -> Format | None:
    """Guesses the format of a file. The result is None if the extension of the file name determines the format. Raises
    `InstrumentError` if no guess can be made."""
    kind = usual_format(path)
    if kind == "excel":
        return _sheet_of_samples(path, name)
    if kind not in (None, "text"):
        return None
    with open_samples(path, name) as file:
        start = file.read(MAX_HEADER)
    packed = start.startswith(GZIP)
    if packed:
        with open_text(path, name) as file:
            start = file.read(MAX_HEADER)
    refused = next(((what, advice) for what, magic, advice in _REFUSED if start.startswith(magic)), None)
    recognised = _recognised(start)
    marked = start.startswith((b"\xff\xfe", b"\xfe\xff"))
    utf_16 = marked or _is_utf_16(start)
    if packed and (refused or recognised or (b"\0" in start and not utf_16)):
        raise InstrumentError(f"{name} is a compressed file, but contains no table of text: unpack it first (gzip)")
    if refused:
        raise InstrumentError(f"{name} is {refused[0]}: {refused[1]}")
    if recognised:
        return recognised
    if utf_16:
        encoding = "utf-16" if marked else "utf-16-le"
        keys = _text_keys(start.decode(encoding, "ignore").lstrip("\ufeff"), encoding)
    elif b"\0" in start:
        raise InstrumentError(
            f"{name} is not a text file, and its extension is none of {', '.join(ENDINGS)}: describe its records in a bench file, "
            "as docs/recording-formats.md shows, or rename it with the extension of its format"
        )
    else:
        try:
            whole = start if len(start) < MAX_HEADER else start[: start.rfind(b"\n") + 1] or start
            keys = _text_keys(whole.decode("utf-8-sig"), "utf-8")
        except UnicodeDecodeError:
            keys = _text_keys(start.decode("latin-1"), "latin-1")
    if keys is None:
        line = next((line for line in start.decode("latin-1").splitlines() if line.strip()), "").strip()[:_LONGEST_LINE]
        message = f"{name} has no lines of numbers in its first {MAX_HEADER} bytes; its first line is '{line}'"
        raise InstrumentError(
            f"{message}. Write it as a table with one line for each sample, and only numbers after the header"
        )
    return None if keys == TextKeys() and kind == "text" else Format(type="text", parameters=keys)


def _recognised(start: bytes) -> Format | None:
    """Returns the format that the first bytes of a file show; None if the file may be a table of text."""
    if start.startswith(dataflash.BINARY) or re.match(dataflash.TEXT, start):
        return Format(type="dataflash", parameters=dataflash.DataflashKeys())
    if start.startswith((ROS1_MAGIC, MCAP_MAGIC)):
        return Format(type="rosbag", parameters=NoKeys())
    if is_raw_imu(start):
        return Format(type="novatel", parameters=NoKeys())
    return Format(type="json", parameters=JsonKeys()) if _JSON.match(start) else None


def _sheet_of_samples(path: Path, name: str) -> Format:
    """Guesses which sheet of a workbook contains samples, and in which row they begin. Raises `InstrumentError` if no sheet contains
    columns of numbers."""
    with open_workbook(path, name) as book:
        for sheet in book.worksheets:
            rows = itertools.islice(sheet_rows(sheet, name), _SHEET_ROWS)
            cells = [["" if cell is None else str(cell) for cell in row] for _, row in rows]
            width = max((_width(row) for row in cells[-50:]), default=0)
            cells = [[*row[:width], *[""] * (width - len(row))] for row in cells]
            first = _first_row(cells, width, _filled) if width > 1 else None
            if first is None:
                continue
            names = _names_above([row[: _width(row)] for row in cells[:first]], width, cells[first:])
            title = str(sheet.title) if len(book.worksheets) > 1 else None
            keys = WorkbookKeys(sheet=title, skip=first if names else first - 1, names=names)
            return Format(type="excel", parameters=keys)
    message = f"{name} has no sheet with rows of numbers in its first {_SHEET_ROWS} rows"
    raise InstrumentError(f"{message}. Write one row for each sample, and only numbers after the names of the columns")


def _width(row: Sequence[str]) -> int:
    """Returns the number of cells up to the last one that is not empty."""
    return max((k + 1 for k, cell in enumerate(row) if cell), default=0)


def _in_two_lines(groups: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Returns the names of columns that two lines state: a name in the line above belongs to all columns up to the next name, such as
    `Gyroscope,,,Accelerometer,,` above `X,Y,Z,X,Y,Z`. The result is empty if these names are not unique either. It is also empty if
    the name above a repeated name belongs to this column alone and denotes no sensor: the line above then states other facts, such as
    `Operator,Anna,Table,T1`."""
    if len(groups) > len(names) or not groups[0] or sum(map(bool, groups)) < 2:
        return ()
    found, starts, last = [], [], 0
    for column, (group, name) in enumerate(itertools.zip_longest(groups, names, fillvalue="")):
        last = column if group and group != groups[last] else last
        starts.append(last)
        found.append(f"{groups[last]} {name}".strip())
    for start, name, joined in zip(starts, names, found, strict=True):
        if names.count(name) > 1 and starts.count(start) == 1 and not guessed_channel(joined).sensed:
            return ()
    return tuple(found) if len(set(found)) == len(found) else ()


def _row_names(names: Sequence[str], rows: Sequence[Sequence[str]]) -> bool:
    """Returns True if the first column of a table has no name, because it contains the numbers or the times of the rows.

    Some programs write such a column, but no name for it. Its numbers must increase by 1 from row to row. If the first name denotes
    a gyro or an accelerometer, the first column may also contain times, which increase by any step. If the first name denotes a time
    or a counter, the second column must increase, too. If the last column is empty, each row ends with a separator, and the first
    name belongs to the first column. `names`: the names of all other columns. `rows`: the cells of the first rows."""
    if not any(row[-1].strip().strip('"') for row in rows):
        return False
    columns = [[_plain_number(row[k]) for row in rows] for k in (0, 1)]
    rising = [len(column) > 3 and all(a < b for a, b in itertools.pairwise(column)) for column in columns]
    if guessed_channel(names[0]).sensed in ("gyro", "accel"):
        return rising[0]
    if not all(rising) and (_TIME.search(names[0]) or _COUNT.search(names[0])):
        return False
    return rising[0] and all(b - a == 1 for a, b in itertools.pairwise(columns[0]))


def _plain_number(cell: str) -> float:
    """Returns the number in a cell; NaN if there is none."""
    try:
        return float(cell.strip().strip('"').replace(",", "."))
    except ValueError:
        return math.nan


def _filled(row: Sequence[str]) -> bool:
    """Returns True if a row contains numbers, and most of its cells that are not empty are numbers or times."""
    cells = [cell for cell in row if cell.strip()]
    return len(cells) > len(row) / 2 and (_numeric(cells) or _of_reading(cells))


def _is_utf_16(start: bytes) -> bool:
    """Returns True if these bytes are text in UTF-16, little-endian, without a byte order mark: the second byte of nearly every
    character is zero, and the first byte is not."""
    low, high = start[0::2], start[1::2]
    return len(high) >= _UTF_16_LEAST and high.count(0) > 0.9 * len(high) and low.count(0) == 0


_UTF_16_LEAST = 16
"""Fewest characters in which `_is_utf_16` recognises text."""


def _text_keys(start: str, encoding: str) -> TextKeys | None:
    """Guesses the layout of a text file from its first lines. The function chooses the separator with which most lines have the
    same number of columns. If several separators are equally good, the separator that gives the most columns is chosen. Returns
    None if the lines contain no columns of numbers."""
    lines = start.splitlines()[:-1] or start.splitlines()
    filled = [(number, line) for number, line in enumerate(lines) if line.strip()]
    return _best_layout(filled, encoding, _numeric) or _best_layout(filled, encoding, _of_reading)


def _best_layout(
    lines: Sequence[tuple[int, str]], encoding: str, is_row: Callable[[Sequence[str]], bool]
) -> TextKeys | None:
    """Guesses the layout of lines, as described in `_text_keys`. `lines`: the lines that are not empty, each with the number of
    lines before it. `is_row`: returns True for the cells of a row."""
    best: tuple[int, int, TextKeys] | None = None
    for word, separator in SEPARATORS.items():
        cells = [_cells(line, word, separator) for _, line in lines]
        widths = Counter(len(row) for row in cells[-50:])
        if not widths:
            continue
        width = widths.most_common(1)[0][0]
        first = _first_row(cells, width, is_row)
        if width < 2 or first is None:
            continue
        rows = cells[first:]
        if sum(is_row(row) for row in rows if len(row) == width) < len(rows) / 2:
            continue
        if word == "blanks" and not _SIGNS.isdisjoint(rows[0]):
            continue  # blanks on both sides of another separator
        comma = separator != "," and any("," in cell for row in rows for cell in row)
        names = _names_above(cells[:first], width, rows)
        keys = TextKeys(
            separator=word,
            decimal="comma" if comma else "point",
            skip=lines[first if names else first - 1][0],
            names=names,
            encoding=encoding,
        )
        rank = (sum(len(row) == width for row in rows), width)
        if best is None or rank > best[:2]:
            best = (*rank, keys)
    return None if best is None else best[2]


def _first_row(cells: Sequence[Sequence[str]], width: int, is_row: Callable[[Sequence[str]], bool]) -> int | None:
    """Returns the index of the first line that is a row and is followed by three further rows. `is_row`: returns True for the cells
    of a row. `width`: number of cells of a row."""
    fits = [len(row) == width and is_row(row) for row in cells]
    return next((index for index in range(len(fits)) if all(fits[index : index + 4])), None)


def _cells(line: str, word: str, separator: str) -> list[str]:
    """Splits a line into its cells. `word`: the name of the separator in a bench file. `separator`: the character of the separator."""
    if word == "blanks":
        return line.split()
    whole = line.strip(" \r\n") if word == "tab" else line.strip()
    return next(csv.reader([whole], delimiter=separator), []) if '"' in line else whole.split(separator)


def _numeric(row: Sequence[str]) -> bool:
    """Returns True if most cells of a line are numbers."""
    return sum(_NUMBER.fullmatch(cell.strip().strip('"')) is not None for cell in row) > len(row) / 2


def _of_reading(row: Sequence[str]) -> bool:
    """Returns True if a line may be a reading: a time, a name, and a number, perhaps with a unit."""
    cells = [cell.strip().strip('"') for cell in row]
    numbers = sum(bool(cell) and _NUMBER.fullmatch(cell) is not None for cell in cells)
    return (
        len(row) > 2 and numbers > 0 and numbers + sum(_STAMP.match(cell) is not None for cell in cells) >= len(row) / 2
    )


def _names_above(lines: Sequence[Sequence[str]], width: int, rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Returns the names of the columns, shape (width,). The result is empty if the line before the first row already states all
    names.

    In some files, a line of units follows the names. In this case, each unit is added to the name of its column. The line of names
    may have more or fewer cells than the rows, or begin with a comment sign. If it has one cell fewer than the rows, and the first
    column contains the number of the row, the first name belongs to the second column. `lines`: the cells of the lines before the
    first row. `rows`: the cells of the first rows."""
    numbered = tuple(f"column_{k + 1}" for k in range(width))
    if not lines:
        return numbered
    held = [[cell.strip().strip('"').strip() for cell in line] for line in lines]
    direct = len(held[-1]) == width
    while held and not any(held[-1]):
        held.pop()
    if not held:
        return numbered
    units = [cell for cell in held[-1] if cell]
    of_units = len(held) > 1 and all(_UNIT_ALONE.fullmatch(cell) for cell in units) and len(held[-2]) >= len(units)
    repeated = len(held) > 1 and len(held[-1]) == width and len(set(held[-1])) < width and not of_units
    if repeated and (joined := _in_two_lines(held[-2], held[-1])):
        return joined
    names = held[-2] if of_units else held[-1]
    if len(names) > 1 and re.fullmatch(r"[#%;]+|//+", names[0]):
        names, direct = names[1:], False
    if direct and not of_units:
        return ()
    if len(names) == width - 1 and _row_names(names, [row for row in rows if len(row) == width]):
        names = [_ROW, *names]
    if len(names) < width - 1 or len(names) < 2 or sum(bool(name) for name in names) < width / 2 or _numeric(names):
        return numbered
    found = [names[k] if k < len(names) and names[k] else numbered[k] for k in range(width)]
    if of_units:
        stated = [*[""] * (names[0] == _ROW and len(held[-1]) == width - 1), *held[-1], *[""] * width]
        found = [f"{name} [{unit.strip('[]()')}]" if unit else name for name, unit in zip(found, stated, strict=False)]
    return tuple(found) if len(set(found)) == width else numbered


def columns_of_numbers(file: AnyFile) -> list[str]:
    """Returns the numeric columns of a file. Columns whose number of rows differs from the most common number of rows are left out.
    Raises `InstrumentError` if there is no numeric column."""
    counts: dict[str, int] = {}
    reason = ""
    known = file.examined()
    for column in dict.fromkeys(known[:MOST_COLUMNS]):
        if known.count(column) > 1 or not column:
            continue
        one = file.with_channels(_COUNTED, {column: column})
        try:
            for _ in one.rows():
                counts[column] = one.rows_about()
                break
        except InstrumentError as error:
            reason = str(error)
    if not counts:
        raise InstrumentError(reason or f"{file.name} has no column of numbers")
    usual = max(set(counts.values()), key=list(counts.values()).count)
    return [column for column, count in counts.items() if count == usual]


def not_numbers(file: AnyFile, numbers: Sequence[str]) -> dict[str, str]:
    """Finds columns that cannot be read, although their names suggest a time or a channel. Returns the reason for each of these
    columns. For a column of dates or times of day, the reason names the first wrong time. `numbers`: the columns of numbers, which
    are left out. Raises `InstrumentError` if the file cannot be read."""
    known = file.examined()[:MOST_COLUMNS]
    found: dict[str, str] = {}
    for column in dict.fromkeys(known):
        if column in numbers or known.count(column) > 1:
            continue
        if not (guessed_channel(column).sensed or _TIME.search(column)):
            continue
        one = file.with_channels(_COUNTED, {column: column})
        of_times = file.with_channels(TimeStamps(column, written=True), {})
        try:
            with contextlib.suppress(NoTimesError):
                next(of_times.rows(), None)
                continue
            next(one.all_rows(), None)
        except InstrumentError as error:
            found[column] = str(error)
    return found


def columns_of_times(file: AnyFile, numbers: Sequence[str]) -> dict[str, Array]:
    """Finds the columns that contain dates or times of day as text. Returns the first times [s] of each of these columns.
    `numbers`: the columns of numbers, which are left out. Raises `InstrumentError` if the file cannot be read."""
    known = file.examined()[:MOST_COLUMNS]
    found: dict[str, Array] = {}
    for column in dict.fromkeys(known):
        if not column or column in numbers or known.count(column) > 1:
            continue
        one = file.with_channels(TimeStamps(column, written=True), {})
        try:
            _, found[column], _ = next(one.all_rows())
        except (InstrumentError, StopIteration):
            continue  # other texts, or no rows
    return found


def of_sensors_alone(file: AnyFile, columns: Sequence[str]) -> AnyFile:
    """Returns the same file without the rows of other instruments, if the file contains messages of several instruments. `columns`:
    the columns of numbers."""
    sensed = [column for column in columns if guessed_channel(column).sensed in ("gyro", "accel")]
    return file.deciding(sensed) if isinstance(file, JsonFile) and sensed else file


@dataclass(frozen=True, slots=True)
class LikelyReadings:
    """The probable arrangement of a table in which each row is one reading, and the column of the time."""

    readings: ReadingColumns
    time: LikelyTime


def guessed_readings(file: AnyFile, numbers: Sequence[str]) -> LikelyReadings | None:
    """Guesses the arrangement of a table in which each row is one reading of one channel or sensor. Returns None if the file has no
    such arrangement, or if no column looks like the time. `numbers`: the columns of numbers. Raises `InstrumentError` if the file
    cannot be read."""
    if any(guessed_channel(column).sensed in ("gyro", "accel") for column in numbers):
        return None
    known = file.examined()[:MOST_COLUMNS]
    for column in dict.fromkeys(known):
        if not column or column in numbers or known.count(column) > 1:
            continue
        one = file.with_channels(_COUNTED, {number: number for number in numbers})
        one.texts = frozenset({column})
        rows = one.first_rows()
        words, index = ([], np.zeros(0, int)) if rows is None else rows.words(column)
        sensed = [k for k, word in enumerate(words) if guessed_channel(word).sensed in ("gyro", "accel")]
        if rows is None or len(sensed) < 2 or len(words) > MOST_COLUMNS:
            continue
        own = index == max(sensed, key=np.bincount(index[index >= 0]).__getitem__)
        first = {number: rows.numbers(number)[own] for number in numbers}
        plain = [number for number in numbers if not of_minutes(first[number])]
        written = {name: times[: len(own)][own[: len(times)]] for name, times in columns_of_times(file, plain).items()}
        time = guessed_time(first, written)
        if time is None:
            continue
        values = [one for one in numbers if one != time.column and not _TIME.search(one) and not _COUNT.search(one)]
        named = [one for one in values if _VALUE.search(one)] or [one for one in values if _AXIS.search(one)] or values
        if named:
            return LikelyReadings(ReadingColumns(name=column, values=tuple(named)), replace(time, shared=False))
    return None


def with_readings(path: Path, given: Format | None, readings: ReadingColumns) -> Format:
    """Returns the format of a file that is a table of readings. `given`: the format; None if the extension determines it."""
    kind = usual_format(path) or "" if given is None else given.type
    parameters = FORMATS[kind].Parameters() if given is None else given.parameters
    return Format(type=kind, readings=readings, parameters=parameters)


def table_of_readings(file: AnyFile, likely: LikelyReadings) -> LongFile:
    """Returns a table of readings as a file with one column for each channel."""
    time = likely.time
    return LongFile(
        file, likely.readings, TimeStamps(time.column, time.scale, wraps=time.wraps, written=time.written), {}
    )


def sensors_in_rows(file: AnyFile, numbers: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """Finds the column of a text file that states which sensor measured the row. Returns this column and the names of the sensors;
    empty if there is no such column. Raises `InstrumentError` if the file cannot be read."""
    if not isinstance(file, TextFile):
        return "", ()
    known = file.examined()[:MOST_COLUMNS]
    for column in known:
        if column and column not in numbers and known.count(column) == 1:
            words = file.words(column)
            if {"accel", "gyro"} <= {guessed_channel(word).sensed for word in words}:
                return column, words
    return "", ()


def opened(path: Path, name: str, given: Format | None) -> AnyFile:
    """Opens a file whose time and channels are not known yet. Raises `InstrumentError` if the file cannot be opened."""
    return open_file(path, name, _COUNTED, {}, given)


def reading(file: AnyFile, columns: Sequence[str], time: str | None = None) -> AnyFile:
    """Returns the file with these columns as channels. `time`: a column of dates or times of day. If it is not given, the rows are
    assumed to be one second apart. Raises `InstrumentError` if the file cannot be read."""
    stamps = _COUNTED if time is None else TimeStamps(time, written=True)
    stamps = file.stamps if isinstance(file, LongFile) else stamps  # the readings of a sample have the same time
    made = file.with_channels(stamps, {column: column for column in columns})
    made.about = made.rows_about()
    return made


def stated_rates(path: Path, name: str, given: Format | None) -> tuple[StatedRate, ...]:
    """Returns the rates that a text file states before its header, such as `// Sample rate: 100.0Hz`.

    Lines that are about filters or about other instruments are left out. Raises `InstrumentError` if the file cannot be opened."""
    if given is None or not isinstance(given.parameters, TextKeys):
        return ()
    with open_text(path, name) as file:
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


def guessed_time(
    first: Mapping[str, Array],
    written: Mapping[str, Array],
    stated: Sequence[StatedRate] = (),
    units: Mapping[str, str] = NO_UNITS,
) -> LikelyTime | None:
    """Guesses from the first rows which column contains the time; None if no column looks like a time.

    The following are tried in turn: columns of numbers that have the name of a time; dates and times of day; columns of numbers
    that increase regularly. If there is no such column, a time that several rows share shows at least the sample rate. `first`: the
    first rows of the columns that contain numbers. `written`: the times [s] of the columns of texts. `stated`: the rates that the
    file states. `units`: the units that the file states outside the column names."""
    named = {column: values for column, values in first.items() if _TIME.search(column)}
    for column, values in named.items():
        time = _number_time(column, values, first, stated, units.get(column, ""))
        if time is not None:
            return time
    for column, values in written.items():
        step = _step(values, first, DAY)
        if step is not None:
            return _written_time(column, values, 1 / step)
    for column, values in first.items():
        if column in named or _COUNT.search(column) or guessed_channel(column).sensed:
            continue
        time = _number_time(column, values, first, stated, units.get(column, ""), regular=True)
        if time is not None and (time.sure or time.wraps is None):
            return time
    for column, values in written.items():
        if (step := _mean_step(values)) is not None:
            return replace(_written_time(column, values, 1 / step), shared=True)
    for column, values in named.items():
        if (step := _mean_step(values)) is not None and not of_minutes(values):
            time = _time_of(column, step, None, stated, values, units.get(column, ""))
            return None if time is None else replace(time, shared=True)
    return None


def _written_time(column: str, values: Array, rate: float) -> LikelyTime:
    """Describes a column of dates or times of day. `values`: the first times in the column, s. `rate`: sample rate, Hz."""
    of_day = float(np.nanmax(values)) < 2 * DAY
    return LikelyTime(column, "time_of_day" if of_day else "date_time", rate, wraps=DAY if of_day else None)


def _number_time(
    column: str,
    values: Array,
    first: Mapping[str, Array],
    stated: Sequence[StatedRate],
    unit: str,
    *,
    regular: bool = False,
) -> LikelyTime | None:
    """Describes the time in a column of numbers; None if the column does not look like a time. `unit`: the unit that the file
    states outside the column name. `regular`: True if only a column with equal steps counts as a time. `values`: first values of the
    column. `first`: the first rows of all columns of numbers."""
    if len(values) < 3 or not np.all(np.isfinite(values)):
        return None
    steps = np.diff(values)
    wraps = wrap_of(steps[steps <= 0], float(np.median(steps)), float(values.min()), float(values.max()))
    step = _step(values, first, wraps)
    if step is None or of_minutes(values):
        return None
    if regular:
        steps = np.where(steps <= 0, steps + (wraps or 0.0), steps)
        if np.max(np.abs(steps / step - 1)) > 0.5:
            return None
    return _time_of(column, step, wraps, stated, values, unit)


def of_minutes(values: Array) -> bool:
    """Returns True if the numbers state hours, minutes and seconds, for example 120059.99 for 12:00:59.99. At each full minute,
    such numbers increase by an additional step of about 40. `values`: first values of the column."""
    steps = np.diff(values)
    jumps = steps[steps > 1]
    after_a_minute = ((jumps > 40) & (jumps < 41)) | ((jumps > 4040) & (jumps < 4041))
    return bool(len(jumps) and values.max() < 240_000 and np.all(values % 100 < 60) and after_a_minute.all())


def _step(values: Array, first: Mapping[str, Array], wraps: float | None) -> float | None:
    """Returns the median step of the time from sample to sample; None if the time does not increase. `wraps`: value at which the
    time returns to zero. `values`: first values of the column. `first`: the first rows of all columns of numbers."""
    if len(values) < 3 or not np.all(np.isfinite(values)):
        return None
    steps = np.diff(values)
    if wraps is not None:
        steps = np.where(steps <= 0, steps + wraps, steps)
    if not np.mean((steps > 0) & (steps < (wraps or np.inf))) > 0.99:
        return None
    step = float(np.median(_between_samples(first, steps)))
    return step if step > 0 else None


def _mean_step(values: Array) -> float | None:
    """Returns the mean step of the time per row. The function is used if several rows have the same time. Returns None if the time
    decreases, or changes less than four times. `values`: first values of the column."""
    if not np.all(np.isfinite(values)) or np.any(np.diff(values) < 0):
        return None
    changes = np.flatnonzero(np.diff(values) > 0) + 1
    if len(changes) < 4:
        return None
    return float(values[changes[-1]] - values[changes[0]]) / float(changes[-1] - changes[0])


def wrap_of(backwards: Array, step: float, least: float, most: float) -> float | None:
    """Returns the value at which a counter returns to zero; None if its values decrease for other reasons.

    `backwards`: the steps of the counter that are not positive. `step`: median step of the counter. `least`, `most`: smallest and
    largest value of the counter."""
    if not len(backwards) or step <= 0 or least < 0:
        return None
    fits = (w for w in _WRAPS if most < w and np.all((backwards + w > 0) & (backwards + w <= LONGEST_STEP * step)))
    return next(fits, None)


def _between_samples(first: Mapping[str, Array], steps: Array) -> Array:
    """Returns the steps of the time between the rows that contain a sample of a gyro or an accelerometer.

    In a log of several instruments, other rows contain no such sample. `steps`: array of shape (n - 1,), steps of the time between
    all rows. `first`: the first rows of all columns of numbers."""
    held = [
        np.isfinite(values) for column, values in first.items() if guessed_channel(column).sensed in ("gyro", "accel")
    ]
    if not held or not (chosen := np.any(held, axis=0)).any() or chosen.all():
        return steps
    return np.diff(np.concatenate([[0.0], np.cumsum(steps)])[chosen])


_SCALES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_ALL_SCALES = {**_SCALES, "days": DAY, "date_time": 1.0, "time_of_day": 1.0}
_USUAL_RATES = (1.9, 50_000.0)
"""Usual sample rates, Hz."""


def _time_of(
    column: str, step: float, wraps: float | None, stated: Sequence[StatedRate], values: Array, unit: str
) -> LikelyTime | None:
    """Describes the time in a column; None if no unit of time leads to a usual sample rate.

    `step`: median step of the column. `values`: first values of the column. `unit`: the unit that the file states outside the column
    name. If a unit leads to a stated rate, or to a date in this century, the unit is sure. A column of whole numbers may also be a
    counter of unknown frequency. The function assumes such a counter if the file states the rate of its samples, and if each unit
    of time leads to a very different rate."""
    if unit in _SCALES:
        return LikelyTime(column, unit, 1 / (step * _SCALES[unit]), None, wraps)
    whole, level = bool(np.all(values == np.round(values))), float(np.median(values))
    rates = {unit: 1 / (step * scale) for unit, scale in _SCALES.items()}
    usual = {unit: rate for unit, rate in rates.items() if _USUAL_RATES[0] < rate < _USUAL_RATES[1]}
    for one in stated:
        for pattern, per_second in _COUNTERS:
            if pattern.search(column) and abs(per_second / step / one.rate - 1) < _SAME_RATE:
                return LikelyTime(column, "s", per_second / step, per_second, wraps)
        for unit, rate in rates.items():
            if abs(rate / one.rate - 1) < _SAME_RATE:
                return LikelyTime(column, unit, rate, None, wraps)
    for pattern, per_second in _COUNTERS:
        if pattern.search(column) and _USUAL_RATES[0] < per_second / step < _USUAL_RATES[1]:
            return LikelyTime(column, "s", per_second / step, per_second, wraps)
    for pattern, unit in _TIME_UNITS:
        if pattern.search(column):
            return LikelyTime(column, unit, 1 / (step * _SCALES[unit]), None, wraps)
    in_days = 1 / (step * DAY)
    if any(low < level < high for low, high in _DAYS) and _USUAL_RATES[0] < in_days < _USUAL_RATES[1]:
        return LikelyTime(column, "days", in_days)
    for unit, rate in usual.items():
        if _EPOCH[0] < level * _SCALES[unit] < _EPOCH[1]:
            return LikelyTime(column, unit, rate)
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


def guessed_channels(columns: Sequence[str], units: Mapping[str, str]) -> list[Guess]:
    """Guesses the meaning of columns from their names. If a vector has an element 0, its elements are counted from 0. `units`: the
    units that the file states outside the column names."""
    from_zero = {column[:-3] for column in columns if column.endswith("[0]")}
    found = []
    for column in columns:
        named = f"{_TOPIC.sub('', column, count=1)} [{units[column]}]" if column in units else column
        guess = guessed_channel(named, 0 if _MATRIX.sub("", column) in from_zero else 1)
        found.append(replace(guess, column=column))
    return found


def guessed_channel(column: str, first: int = 1) -> Guess:
    """Guesses the meaning of a column from its name. `first`: number of the first element of a vector."""
    matrix, axis = _MATRIX.search(column), _AXIS.search(column) or _CAPITAL.search(column)
    index = int(matrix[1]) - first if matrix else -1
    letter = "xyz"[index] if 0 <= index < 3 else axis[1].lower() if axis else ""
    stem = _MATRIX.sub("", column)
    increments = next((sensed for sensed, pattern in _INCREMENTS if pattern.search(stem)), "")
    if increments:
        unit = next((unit for pattern, unit in _INTEGRATED[increments] if pattern.search(column)), "")
        return Guess(column, increments, letter, unit, increments=True)
    if _NO_SAMPLE.search(stem):
        return Guess(column, "", letter, "")
    unit = next((unit for pattern, unit in _UNITS if pattern.search(column)), "")
    sensed = next((sensed for sensed, pattern in _SENSED if pattern.search(stem)), "")
    if matrix and not sensed:
        sensed = next((sensed for sensed, pattern in _VECTORS if pattern.search(stem)), "")
    if sensed == "temperature" and _SENSED_IN.get(unit) != "temperature":
        unit = next((unit for pattern, unit in _OF_TEMPERATURE if pattern.search(column)), "")
    sensed = _SENSED_IN.get(unit, sensed)
    if unit == "g" and (sensed != "accel" or column.lower() in ("g", "gs")):
        unit = ""  # the letter of a gyro, not a unit
    return Guess(column, sensed, letter, unit)


def usual_unit(sensed: str, level: float, accel_unit: str = "", noise: float = math.nan) -> str:
    """Guesses the unit of a column whose name does not contain a unit; empty if no unit is plausible. `level`: for a gyro, the
    largest magnitude in the column; for an accelerometer, the length of the mean vector at rest; for a thermometer, the usual
    value. `accel_unit`: for a gyro, the unit of the accelerometers. `noise`: for a gyro, the standard deviation of a sample at rest;
    NaN if it is unknown."""
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
        in_radians = level < _FASTEST_UNKNOWN if math.isnan(noise) else level < _FASTEST and noise < _NOISIEST
        return "rad/s" if accel_unit == "m/s^2" and in_radians else "deg/s"
    if sensed == "temperature":
        return "K" if 220 < level < 400 else "degC"  # of an instrument that works at less than 127 degC
    return ""

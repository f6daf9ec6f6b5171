"""Reads dates and times of day that a recording contains as text, such as `2026-03-04T12:00:00.005Z` or `12:00:00,005`.

A date with a time is converted to seconds since 1970-01-01 00:00 UTC. A time without an offset from UTC is taken as UTC, because
only differences of time matter in a recording. A time of day is converted to seconds since midnight.
"""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.instruments.interfaces import InstrumentError

if TYPE_CHECKING:
    import pyarrow as pa

DAY = 86_400.0
"""Length of a day, s."""
PlaceOfText = Callable[[int], str]
"""Function that describes the place of a text for messages: the file, the row and the column. Its argument is the index of the
text."""
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_END = r"\s*(?P<p>[AaPp])?(?:\.?[Mm]\.?)?\s*(?:Z|z|UTC|GMT)?(?P<z>[+-]\d{2}:?(?:\d{2})?)?(?:\[[^\]]*\])?\s*$"  # half of the day, zone
_COLONS = r"(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{1,2})(?:[.,:](?P<f>\d{1,9})\d*)?)?"
_POINTS = r"(?P<h>\d{1,2})\.(?P<m>\d{2})\.(?P<s>\d{2})(?:[.,](?P<f>\d{1,9})\d*)?"
_DATE = r"(?P<a>\d{1,4})(?P<sep>[-/. ])(?P<b>\d{1,2}|[A-Za-z]{3})[-/. ](?P<c>\d{1,4})(?:[T_,;-]\s*|\s+)"
_NO_DATE = r"(?P<a>)(?P<sep>)(?P<b>)(?P<c>)"
_FORMS = (
    rf"^\s*(?:{_DATE})?{_COLONS}{_END}",
    rf"^\s*{_DATE}{_POINTS}{_END}",
    r"^\s*(?P<a>\d{4})(?P<b>\d{2})(?P<c>\d{2})[T_ -]?(?P<h>\d{2})(?P<m>\d{2})(?P<s>\d{2})(?:[.,](?P<f>\d{1,9})\d*)?"
    r"(?P<sep>)(?P<p>)(?:Z|z)?(?P<z>[+-]\d{2}:?(?:\d{2})?)?\s*$",
    rf"^\s*{_NO_DATE}(?P<h>)(?P<m>\d{{1,3}}):(?P<s>\d{{2}})[.,](?P<f>\d{{1,9}})\d*(?P<p>)(?P<z>)\s*$",
    rf"^\s*{_NO_DATE}(?P<h>\d{{2}})(?P<m>\d{{2}})(?P<s>\d{{2}})(?:\.(?P<f>\d{{1,9}})\d*)?(?P<p>)(?P<z>)\s*$",
)
"""Accepted forms of a time, in this order: a time of day with colons, with or without a date before it; a date and a time of day
with points; a date and a time of day without separators; minutes and seconds; a time of day without separators, as in NMEA
sentences. The year is the first or the last part of a date."""


class NoTimesError(InstrumentError):
    """Reports that none of the texts in a column is a time."""


class DateOrder:
    """Decides for all times of a recording whether dates such as 05/04/2026 state the day first or the month first.

    `day_first`: the decision; None if there is none yet. Before the decision, dates with slashes are read with the month first, and
    other dates with the day first. Dates that begin with the year, or that contain the name of the month, need no decision.
    """

    def __init__(self) -> None:
        self.day_first: bool | None = None
        self._dates: dict[tuple[int, int, int], bool] = {}

    @property
    def undecided(self) -> bool:
        """Returns True if dates were read for which the order of day and month is not decided yet."""
        return self.day_first is None and bool(self._dates)

    def read(self, one: int, other: int, year: int, slashes: bool) -> float:
        """Returns the number of days from 1970-01-01 to a date; NaN if there is no such date. The first two numbers of the date,
        `one` and `other`, are a day and a month, in either order. `slashes`: True if slashes separate the numbers."""
        if self.day_first is None:
            self._dates.setdefault((one, other, year), slashes)
        day_first = not slashes if self.day_first is None else self.day_first
        return _days_until(year, other, one) if day_first else _days_until(year, one, other)

    def decide(self) -> None:
        """Chooses the order of day and month in which all dates exist. If both orders are possible, three criteria apply in turn:
        fewer dates that are earlier than the previous date; fewer days between the earliest and the latest date; the usual
        order."""

        def cost(day_first: bool) -> tuple[int, int, float, bool]:
            days = np.array([_days_until(y, *((b, a) if day_first else (a, b))) for a, b, y in self._dates])
            known = days[np.isfinite(days)]
            span = float(np.ptp(known)) if len(known) else 0.0
            usual = not any(self._dates.values())
            return int(np.isnan(days).sum()), int((np.diff(known) < 0).sum()), span, day_first != usual

        self.day_first = min((True, False), key=cost)
        self._dates.clear()

    def decide_for(self, texts: Sequence[str]) -> None:
        """Decides the order from the times in a table, unless it is decided already. Texts that are not times are ignored here; the
        reader of the table reports them."""
        for text in texts if self.day_first is None else ():
            with suppress(InstrumentError):
                seconds_of(text, "", self)
        if self.undecided:
            self.decide()


def seconds_in(texts: pa.Array, where: PlaceOfText, dates: DateOrder) -> Array:
    """Converts texts to times [s], shape (n,). An empty or missing text gives NaN.

    `where`: names the place of a text. `dates`: the order of day and month. Raises `InstrumentError` if a text is not a time, or if
    only some of the texts contain a date. The error is a `NoTimesError` if none of the texts is a time. While `dates` is undecided,
    dates with slashes are read with the month first, and other dates with the day first. A date that does not exist in this order
    then gives NaN and no error."""
    import pyarrow as pa
    import pyarrow.compute as pc

    texts = texts.cast(pa.string())
    absent = pc.or_kleene(pc.is_null(texts), pc.equal(pc.utf8_trim_whitespace(texts), "")).fill_null(True)
    unread = ~np.asarray(absent, bool)
    seconds, dated = np.full(len(texts), np.nan), np.zeros(len(texts), bool)
    for form in _FORMS:
        if not unread.any():
            break
        rows = np.flatnonzero(unread)
        parts = pc.extract_regex(texts.take(pa.array(rows)), form)
        matched = np.asarray(parts.is_valid(), bool)
        if matched.any():
            kept = parts.filter(pa.array(matched))
            seconds[rows[matched]], dated[rows[matched]] = _seconds(
                {name: kept.field(name) for name in _names(form)}, dates
            )
            unread[rows[matched]] = False
    wrong = unread | (~np.asarray(absent, bool) & np.isnan(seconds) & (not dates.undecided))
    present = ~np.asarray(absent, bool)
    if wrong.any():
        index = int(np.flatnonzero(wrong)[0])
        message = f"{where(index)}: {_quoted(texts, index)} is not a date with a time, or a time of day"
        if not (present & ~wrong).any():
            raise NoTimesError(f"{message}; write times such as 2026-03-04 12:00:00.5 or 12:00:00.5")
        other = _quoted(texts, int(np.flatnonzero(present & ~wrong)[0]))
        raise InstrumentError(f"{message}; write it like the other times, such as {other}, or remove the row")
    if dated[present].any() and not dated[present].all():
        seldom = bool(dated[present].mean() < 0.5)
        index = int(np.flatnonzero(present & (dated == seldom))[0])
        has = "has a date, but most other times have none" if seldom else "has no date, but other times have one"
        raise InstrumentError(f"{where(index)}: {_quoted(texts, index)} {has}; write all times in one form")
    return seconds


def _quoted(texts: pa.Array, index: int) -> str:
    return f"'{str(texts[index])[:40]}'"


def text_of(seconds: float) -> str:
    """Returns a time as text for a message: a date with hours, minutes and seconds. If the time is from 0 to less than two days, it
    counts as a time of day, and the text contains no date."""
    whole = round(seconds * 1e6)
    moment = datetime.datetime(1970, 1, 1) + datetime.timedelta(microseconds=whole)
    shown = f"{moment:%H:%M:%S.%f}".rstrip("0").rstrip(".")
    return shown if 0 <= seconds < 2 * DAY else f"{moment:%Y-%m-%d} {shown}"


def seconds_of(text: str, where: str, dates: DateOrder) -> float:
    """Returns the time [s] that a text states. `dates`: the order of day and month. Raises `InstrumentError` if the text is not a
    time."""
    import pyarrow as pa

    found = float(seconds_in(pa.array([text], pa.string()), lambda _: where, dates)[0])
    if np.isnan(found):
        raise InstrumentError(f"{where}: the time is missing")
    return found


def of_objects(values: Sequence[object] | NDArray[np.generic], where: PlaceOfText, dates: DateOrder) -> Array:
    """Converts values to times [s], shape (n,). The values have NumPy's type `datetime64`, or are texts or Python objects for dates
    and times. A missing value gives NaN."""
    import pyarrow as pa

    array = np.asarray(values)
    if array.dtype.kind == "M":
        whole = array.astype("M8[ns]").astype(np.int64)
        return np.where(np.isnat(array), np.nan, whole / 1e9)
    return seconds_in(pa.array([None if one is None else str(one) for one in values], pa.string()), where, dates)


def of_arrow(values: pa.Array, where: PlaceOfText, dates: DateOrder) -> Array:
    """Converts an Arrow array of time stamps, of times of day or of texts to times [s], shape (n,). A missing value gives NaN.
    `where`: names the place of a value. `dates`: the order of day and month. Raises `InstrumentError` for other types of values,
    and for texts under the conditions of `seconds_in`."""
    import pyarrow as pa
    from pyarrow import types

    kind = values.type
    if types.is_dictionary(kind):
        values, kind = values.dictionary_decode(), kind.value_type
    if types.is_timestamp(kind):
        counts = values.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64())
    elif types.is_time(kind):
        counts = values.cast(pa.time64("ns")).cast(pa.int64())
    elif types.is_string(kind) or types.is_large_string(kind) or types.is_null(kind):
        return seconds_in(values, where, dates)
    else:
        raise InstrumentError(f"{where(0)}: the values have the type {kind}; they are not dates or times of day")
    whole = np.asarray(counts.fill_null(0), np.int64)
    return np.where(np.asarray(counts.is_null(), bool), np.nan, whole / 1e9)


def _names(form: str) -> tuple[str, ...]:
    return tuple(re.compile(form).groupindex)


def _seconds(parts: dict[str, pa.Array], dates: DateOrder) -> tuple[Array, NDArray[np.bool_]]:
    """Returns two arrays of shape (n,): the times [s] that consist of the given parts, NaN if a part is out of range; and True for
    each time that contains a date."""
    import pyarrow.compute as pc

    digits = np.asarray(pc.utf8_length(parts["f"]), float)
    hours, minutes, whole = (_number(parts[name]) for name in ("h", "m", "s"))
    half = np.asarray(pc.utf8_lower(parts["p"]).to_numpy(zero_copy_only=False), str)
    hours = np.where(half != "", hours % 12 + 12 * (half == "p"), hours)
    seconds = 3600 * hours + 60 * minutes + whole + _number(parts["f"]) / 10.0**digits
    zone = pc.replace_substring(parts["z"], ":", "")
    sign = np.where(np.asarray(pc.starts_with(zone, "-"), bool), -1.0, 1.0)
    ahead = _number(pc.utf8_slice_codeunits(zone, 1, 3)) * 3600 + _number(pc.utf8_slice_codeunits(zone, 3, 5)) * 60
    alone = np.asarray(pc.equal(parts["h"], ""), bool)  # minutes without hours continue after 59
    seconds = np.where((hours < 25) & (alone | (minutes < 60)) & (whole < 61), seconds - sign * ahead, np.nan)
    dated = ~np.asarray(pc.equal(parts["a"], ""), bool)
    return np.where(dated, seconds + DAY * _days(parts, dated, dates), seconds), dated


def _number(text: pa.Array) -> Array:
    """Returns the numbers that texts state, shape (n,); 0 for an empty text."""
    import pyarrow as pa
    import pyarrow.compute as pc

    return np.asarray(pc.if_else(pc.equal(text, ""), "0", text).cast(pa.float64()))


def _days(parts: dict[str, pa.Array], dated: NDArray[np.bool_], dates: DateOrder) -> Array:
    """Returns the number of days since 1970-01-01, shape (n,); NaN for a date that does not exist. Each of the few different dates
    is converted only once. `parts`: the parts of the dates as texts, by name. `dated`: array of shape (n,), True for each time that
    contains a date."""
    import pyarrow.compute as pc

    texts = pc.binary_join_element_wise(*(parts[name] for name in ("a", "sep", "b", "c")), "|").dictionary_encode()
    known = [_day(text.split("|"), dates) if text.strip("|") else 0.0 for text in texts.dictionary.to_pylist()]
    return np.where(dated, np.array(known)[np.asarray(texts.indices)], 0.0)


def _day(parts: Sequence[str], dates: DateOrder) -> float:
    """Returns the days from 1970-01-01 to a date; NaN if it does not exist. `parts`: the first number of the date, the separator
    after it, and the other two numbers."""
    a, separator, b, c = parts
    if len(a) == 4:
        return _days_until(int(a), _month(b), int(c))
    year = int(c) + (2000 if int(c) < 100 else 0)
    return dates.read(int(a), int(b), year, separator == "/") if b.isdigit() else _days_until(year, _month(b), int(a))


def _month(text: str) -> int:
    return int(text) if text.isdigit() else _MONTHS.index(text.lower()) + 1 if text.lower() in _MONTHS else 0


def _days_until(year: int, month: int, day: int) -> float:
    try:
        return float((datetime.date(year, month, day) - datetime.date(1970, 1, 1)).days)
    except ValueError:
        return math.nan

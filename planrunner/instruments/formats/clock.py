"""Reads dates and times of day that a recording contains as text, such as `2026-03-04T12:00:00.005Z` or `12:00:00,005`.

A date with a time becomes seconds since 1970-01-01 00:00 UTC. If no offset from UTC is written, the time counts as UTC: only
differences of time matter in a recording. A time of day becomes seconds since midnight.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.instruments.interfaces import InstrumentError

if TYPE_CHECKING:
    import pyarrow as pa

DAY = 86_400.0
"""Seconds."""
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
"""A date in the order year, month, day, or month/day/year, or day.month.year, before a time of day; both without separators; minutes
and seconds; and a time of day without separators, as in NMEA sentences."""


def seconds_in(texts: pa.Array, where: str) -> Array:
    """Converts texts to times [s], shape (n,). An empty or missing text gives NaN.

    `where`: a text that names the file and the column; it is used in messages. Raises `InstrumentError` for a text that is not a
    time, and if some texts contain a date and others do not."""
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
            seconds[rows[matched]], dated[rows[matched]] = _seconds({name: kept.field(name) for name in _names(form)})
            unread[rows[matched]] = False
    wrong = unread | (~np.asarray(absent, bool) & np.isnan(seconds))
    if wrong.any():
        text = str(texts[int(np.flatnonzero(wrong)[0])])[:40]
        raise InstrumentError(f"{where}: '{text}' is not a date with a time, or a time of day")
    present = ~np.asarray(absent, bool)
    if dated[present].any() and not dated[present].all():
        raise InstrumentError(f"{where}: only some of the times contain a date")
    return seconds


def seconds_of(text: str, where: str) -> float:
    """Returns the time [s] that a text states. Raises `InstrumentError` if it is not a time."""
    import pyarrow as pa

    found = float(seconds_in(pa.array([text], pa.string()), where)[0])
    if np.isnan(found):
        raise InstrumentError(f"{where}: the time is missing")
    return found


def of_objects(values: Sequence[object] | NDArray[np.generic], where: str) -> Array:
    """Converts values to times [s], shape (n,). The values have NumPy's type `datetime64`, or are texts or times of Python. A
    missing value gives NaN."""
    import pyarrow as pa

    array = np.asarray(values)
    if array.dtype.kind == "M":
        whole = array.astype("M8[ns]").astype(np.int64)
        return np.where(np.isnat(array), np.nan, whole / 1e9)
    return seconds_in(pa.array([None if one is None else str(one) for one in values], pa.string()), where)


def of_arrow(values: pa.Array, where: str) -> Array:
    """Converts an Arrow array of time stamps, of times of day or of texts to times [s], shape (n,). A missing value gives NaN."""
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
        return seconds_in(values, where)
    else:
        raise InstrumentError(f"{where} holds values of the type {kind}, not dates or times of day")
    whole = np.asarray(counts.fill_null(0), np.int64)
    return np.where(np.asarray(counts.is_null(), bool), np.nan, whole / 1e9)


def _names(form: str) -> tuple[str, ...]:
    return tuple(re.compile(form).groupindex)


def _seconds(parts: dict[str, pa.Array]) -> tuple[Array, NDArray[np.bool_]]:
    """Returns the times (n,) [s] from their parts, NaN where a part is out of range, and whether they contain a date (n,)."""
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
    return np.where(dated, seconds + DAY * _days(parts, dated), seconds), dated


def _number(text: pa.Array) -> Array:
    """Returns the numbers that texts state, shape (n,); 0 for an empty text."""
    import pyarrow as pa
    import pyarrow.compute as pc

    return np.asarray(pc.if_else(pc.equal(text, ""), "0", text).cast(pa.float64()))


def _days(parts: dict[str, pa.Array], dated: NDArray[np.bool_]) -> Array:
    """Days since 1970-01-01 (n,); NaN for a date that does not exist. Each of the few different dates is converted once."""
    import pyarrow.compute as pc

    dates = pc.binary_join_element_wise(*(parts[name] for name in ("a", "sep", "b", "c")), "|").dictionary_encode()
    known = [_day(*date.split("|")) if date.strip("|") else 0.0 for date in dates.dictionary.to_pylist()]
    return np.where(dated, np.array(known)[np.asarray(dates.indices)], 0.0)


def _day(a: str, separator: str, b: str, c: str) -> float:
    month = _MONTHS.index(b.lower()) + 1 if b.lower() in _MONTHS else int(b) if b.isdigit() else 0
    if len(a) == 4:
        year, day = int(a), int(c)
    else:
        year, day = int(c), int(a)
        american = separator == "/" or month > 12
        if b.isdigit() and american and day <= 12:
            month, day = day, month
        year += 2000 if year < 100 else 0
    try:
        return float((datetime.date(year, month, day) - datetime.date(1970, 1, 1)).days)
    except ValueError:
        return float("nan")

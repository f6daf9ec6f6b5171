"""Checks a recording before it is played back: reports all faults in one pass with limited memory.

The check finds times that are missing or decrease; segments that extend beyond the data, contain no or too few samples, or overlap;
gaps in time; and missing numbers. Faults that prevent playback are errors. Faults that only reduce the data for an estimate are
warnings.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, Mark
from planrunner.base.progress import Announce, Pace
from planrunner.instruments.recording_file import RecordingFile
from planrunner.instruments.sample_rates import RowsAtOneRate, SampleRates
from planrunner.plan.span import ROUNDING, Span

GAP = 1.5
"""If two consecutive samples are further apart than this number of sample periods, a sample is missing. A segment may also end this
long after its last sample."""
_MISSING = 0.05
"""Fraction of a segment. If no samples exist for a longer part at the beginning or at the end of the segment, a warning is given. A
shorter part may be due to rounded times in the table of segments."""
LEAST_ROWS = 100
"""A channel with a constant value counts as dead if it has at least this number of rows."""
SHOWN = 3
"""Maximum number of places that a finding names. For the other places, the finding states only their number."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """An interval of the recording that a plan requires.

    `span`: the interval, in the time of the recording; an interval from the table of segments is trimmed. `dwell`: length [s] of
    the part to be played, None for the whole interval. `mark`: position for findings: the line of the interval in the table of
    segments, or the recording.
    """

    label: str
    span: Span
    dwell: float | None
    mark: Mark

    @property
    def played(self) -> Span:
        """Returns the part of the interval that is played; it starts at the start of the interval."""
        end = self.span.end if self.dwell is None else min(self.span.end, self.span.start + self.dwell)
        return Span(self.span.start, end)


@dataclass(slots=True)
class _Seen:
    """Contains what a pass over the recording has found in one interval. `gap`: length [s] of the longest gap between samples.
    `at`: time at which this longest gap starts."""

    rows: int = 0
    complete: int = 0
    first: float = math.nan
    last: float = math.nan
    gaps: int = 0
    gap: float = 0.0
    at: float = math.nan

    def take(self, time: Array, complete: NDArray[np.bool_], period: float) -> None:
        steps = np.diff(time, prepend=self.last if self.rows else time[0])
        if not self.rows:
            self.first = float(time[0])
        wide = steps > GAP * period
        self.gaps += int(np.count_nonzero(wide))
        k = int(np.argmax(steps))
        if wide[k] and steps[k] > self.gap:
            self.gap, self.at = float(steps[k]), float(time[k] - steps[k])
        self.rows += len(time)
        self.complete += int(np.count_nonzero(complete))
        self.last = float(time[-1])


@dataclass(slots=True)
class _Pass:
    """Contains what one pass over a recording has found so far.

    `period`: usual sample period, s. `divider`: the object that divides the rows at changes of the sample rate. `faults`:
    descriptions of the first rows whose time is wrong. `wrong`: total number of rows whose time is wrong. `missing`: number of
    missing values of each channel. `lowest`, `highest`: smallest and largest value of each channel. `rates`: each time [s] at which
    the sample rate changes, with the new rate [Hz].
    """

    period: float
    seen: list[_Seen]
    divider: SampleRates[np.bool_] = field(default_factory=SampleRates)
    rows: int = 0
    first: float = math.nan
    last: float = math.nan
    wrong: int = 0
    faults: list[str] = field(default_factory=list)
    missing: dict[str, int] = field(default_factory=dict)
    lowest: dict[str, float] = field(default_factory=dict)
    highest: dict[str, float] = field(default_factory=dict)
    rates: list[tuple[float, float]] = field(default_factory=list)

    def take(self, first: int, time: Array, columns: Mapping[str, Array], wanted: Sequence[Wanted]) -> None:
        """Processes the next rows. `first`: number of the first of these rows. `time`: array of shape (n,), s. `columns`: the
        values (n,) of each channel."""
        self.rows += len(time)
        for name, values in columns.items():
            self.missing[name] = self.missing.get(name, 0) + int(np.count_nonzero(~np.isfinite(values)))
            self.lowest[name] = min(self.lowest.get(name, math.inf), float(np.nanmin(values, initial=math.inf)))
            self.highest[name] = max(self.highest.get(name, -math.inf), float(np.nanmax(values, initial=-math.inf)))
        known = np.isfinite(time)
        steps = np.diff(time, prepend=time[0] - 1 if math.isnan(self.last) else self.last)
        for k in np.flatnonzero(~known | (steps <= 0)).tolist():
            if known[k] and not math.isfinite(steps[k]):
                continue  # it follows a missing time
            self.wrong += 1
            if len(self.faults) < SHOWN:
                earlier = time[k] - steps[k]
                what = f"{time[k]:.9g} s after {earlier:.9g} s" if known[k] else "missing or not a number"
                self.faults.append(f"row {first + k} ({what})")
        if known.any():
            self.last = float(time[known][-1])
            self.first = float(time[known][0]) if math.isnan(self.first) else self.first
        if self.wrong:
            return  # where segments lie cannot be said
        complete = np.all([np.isfinite(values) for values in columns.values()], axis=0)
        for part in self.divider.take(time, complete):
            self._take_part(part, wanted)

    def finish(self, wanted: Sequence[Wanted]) -> None:
        """Processes the last rows of the recording."""
        for part in self.divider.rest():
            self._take_part(part, wanted)

    def _take_part(self, part: RowsAtOneRate[np.bool_], wanted: Sequence[Wanted]) -> None:
        """Adds rows with one sample rate to the intervals to which they belong."""
        time, period = part.time, self.period if math.isnan(part.period) else part.period
        if part.changed:
            self.rates.append((float(time[0]), 1 / period))
        for one, seen in zip(wanted, self.seen, strict=True):
            if one.span.start <= time[-1] + period and one.span.end > time[0]:
                rows = one.played.of(time, period)
                if rows.start < rows.stop:
                    seen.take(time[rows], part.data[rows], period)


def scan(
    file: RecordingFile,
    name: str,
    sample_rate: float,
    wanted: Sequence[Wanted],
    log: Findings,
    notice: Announce | None = None,
    live: Collection[str] = (),
) -> Span | None:
    """Adds all faults of a recording to `log`.

    `name`: name of the file, used in messages. `sample_rate`: declared sample rate, Hz. `notice`: receives the progress. `live`:
    channels whose values must change because of their noise. Returns the span of the recording; None if some of its times are
    wrong. Raises `InstrumentError` if the file cannot be read to its end.
    """
    period = 1 / sample_rate if math.isnan(file.interval) else file.interval
    found = _Pass(period, [_Seen() for _ in wanted])
    pace = Pace(f"checking {name}", file.about, notice)
    try:
        for first, time, columns in file.all_rows():
            found.take(first, time, columns, wanted)
            pace.reached(found.rows)
    finally:
        _on_time(found, name, log)
    for remark in file.remarks:
        hint = "check `format` in the bench file, and the logger"
        log.warning("recording-corrupt", Mark(name), f"left out: {remark}", hint)
    if found.wrong:
        return None
    found.finish(wanted)
    for one, seen in zip(wanted, found.seen, strict=True):
        _on_segment(one, seen, found, name, log)
    _on_gaps(wanted, found, name, log)
    _on_ends(wanted, found, name, log)
    _on_rates(found, name, log)
    _on_dead(found, name, live, log)
    _on_missing(wanted, found, name, log)
    _on_overlaps(wanted, period, log)
    return Span(found.first, found.last + period)


def _on_time(found: _Pass, name: str, log: Findings) -> None:
    if not found.wrong:
        return
    more = f" and {found.wrong - len(found.faults)} more" if found.wrong > len(found.faults) else ""
    message = f"{name}: time is missing or does not increase at {', '.join(found.faults)}{more}"
    log.error("recording-time", Mark(name), message, "sort the recording by time, or remove these rows, then run again")


def _on_segment(one: Wanted, seen: _Seen, found: _Pass, name: str, log: Findings) -> None:
    """Checks that an interval lies within the data and contains the part to be played. Adds a finding to `log` if it does not."""
    slack = GAP * found.period
    end = found.last + found.period
    begins, ends = (
        one.span.start < found.first - slack,
        math.isfinite(one.span.end) and one.span.end > end + slack / GAP,
    )
    if begins or ends:
        where = f"from {one.span.start:.9g} s to {one.span.end:.9g} s"
        message = f"'{one.label}' is listed {where}, but {name} holds {found.first:.9g} s to {end:.9g} s"
        log.error("recording-beyond", one.mark, message, "correct the table of segments, or its `unit` and `trim`")
        return
    if not seen.rows:
        message = f"{name} has no samples between {one.played.start:.9g} s and {one.played.end:.9g} s for '{one.label}'"
        log.error("recording-empty", one.mark, message, "correct the table of segments, or leave the segment out")
        return
    if not seen.complete:
        message = f"'{one.label}' has no complete row"
        log.warning("recording-missing", one.mark, message, "leave the segment or the channel out, or record it again")
    lasts = seen.last - seen.first + found.period
    if one.dwell is not None and one.dwell > lasts + found.period / 2:
        message = f"the recording is shorter than the plan: '{one.label}' dwells {one.dwell:g} s, but {name} holds only {lasts:.6g} s of it"
        log.error("recording-short", one.mark, message, "shorten the dwell or write `dwell: recorded`")


def _on_gaps(wanted: Sequence[Wanted], found: _Pass, name: str, log: Findings) -> None:
    holed = [(one, seen) for one, seen in zip(wanted, found.seen, strict=True) if seen.gaps]
    if not holed:
        return
    one, seen = max(holed, key=lambda pair: pair[1].gap)
    total = sum(each.gaps for _, each in holed)
    where = f"{len(holed)} segments; the longest" if len(holed) > 1 else f"'{one.label}'; the longest"
    place = f"gap lasts {seen.gap:.4g} s, from {seen.at:.9g} s in '{one.label}'"
    message = f"{name}: samples are missing at {total} places in {where} {place}"
    hint = "check the logger; estimates use the existing samples"
    missing = sum((each.last - each.first) / found.period + 1 - each.rows for _, each in holed)
    if missing < total / 2:
        message = (
            f"{name}: the times are irregular, although hardly any samples are missing: {total} gaps in {where} {place}"
        )
        hint = "check the logger; if its samples are regular, but their times are not, write `time: sample_count`"
    log.warning("recording-gap", one.mark, message, hint)


def _on_ends(wanted: Sequence[Wanted], found: _Pass, name: str, log: Findings) -> None:
    """Warns if a segment has no samples for some time at its beginning or at its end. The warning names the segment for which this
    time is longest. After a jump of the recorded time, the table of segments no longer agrees with the samples."""
    worst, longest, place = None, 0.0, (0.0, 0.0)
    for one, seen in zip(wanted, found.seen, strict=True):
        start, end = max(one.played.start, found.first), min(one.played.end, found.last + found.period)
        last = seen.last + found.period
        for low, high in ((start, seen.first), (last, end)) if seen.rows else ():
            if high - low > max(GAP * found.period, _MISSING * (end - start), longest):
                worst, longest, place = one, high - low, (low, high)
    if worst is not None:
        message = (
            f"{name}: '{worst.label}' has no samples from {place[0]:.9g} s to {place[1]:.9g} s, at one of its ends: samples are missing, "
            "or the recorded time jumps"
        )
        hint = "compare the table of segments with the recording; estimates use the existing samples"
        log.warning("recording-gap", worst.mark, message, hint)


def _on_rates(found: _Pass, name: str, log: Findings) -> None:
    """Warns if the sample rate changes."""
    if found.rates:
        shown = ", ".join(f"about {rate:.4g} Hz from {time:.6g} s" for time, rate in found.rates[:SHOWN])
        more = f" and {len(found.rates) - SHOWN} more changes" if len(found.rates) > SHOWN else ""
        hint = "an estimate that needs one rate, such as allan_deviation, needs segments that do not contain the change"
        log.warning("recording-rate", Mark(name), f"{name}: the sample rate changes: {shown}{more}", hint)


def _on_dead(found: _Pass, name: str, live: Collection[str], log: Findings) -> None:
    """Warns of each channel that has only one value or no value, although noise must change the values of the channel."""
    hint = "check the sensor, and the column that the bench file gives for the channel"
    for channel in live:
        low, high = found.lowest.get(channel, math.inf), found.highest.get(channel, -math.inf)
        if found.rows >= LEAST_ROWS and low >= high:
            what = "has no value in any row" if low > high else f"is {low:g} in every row"
            log.warning("recording-dead", Mark(name), f"{name}: '{channel}' {what}", hint)


def _on_missing(wanted: Sequence[Wanted], found: _Pass, name: str, log: Findings) -> None:
    lacking = {channel: count for channel, count in found.missing.items() if count}
    if not lacking:
        return
    counts = ", ".join(f"'{channel}' {count} of {found.rows}" for channel, count in lacking.items())
    used = sum(seen.rows - seen.complete for seen in found.seen)
    message = f"{name}: numbers are missing in {counts} rows; {used} of them are in segments and are left out"
    log.warning("recording-missing", Mark(name), message, "check the logger; a few missing rows do no harm")


def _on_overlaps(wanted: Sequence[Wanted], period: float, log: Findings) -> None:
    ordered = sorted(wanted, key=lambda one: one.span.start)
    for one, other in pairwise(ordered):
        shared = min(one.played.end, other.played.end) - other.played.start
        if shared > ROUNDING * period:
            message = f"'{one.label}' and '{other.label}' share {shared:.4g} s of the recording"
            hint = "end one segment where the other begins: samples that are used twice make uncertainties too small"
            log.warning("recording-overlap", other.mark, message, hint)

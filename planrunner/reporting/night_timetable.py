"""Shows the timetable of a night, as lines of text for the terminal and as a page with a Gantt chart."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import tzinfo
from html import escape

from planrunner.base.findings import count_of
from planrunner.night.civil_time import civil, shown_time
from planrunner.night.expansion import PlannedTest
from planrunner.night.suite import Suite
from planrunner.night.timetable import NightForecast, Slot
from planrunner.night.words import spell_out

WARM_UP = "warm-up"
MOST_BARS = 400
_LONGEST_NAME = 36  # characters, beside a bar
_STEPS = (60, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400, 172800, 604800)
"""Possible distances between the ticks of a time axis, s."""


@dataclass(frozen=True, slots=True)
class Timetable:
    """A suite and the forecast of its night. `durations`: planned duration of each test, s; None if a recording determines it."""

    suite: Suite
    file: str
    tests: Sequence[PlannedTest]
    durations: Sequence[float | None]
    forecast: NightForecast
    zone: tzinfo | None
    virtual: bool

    @property
    def begins(self) -> float:
        return self.forecast.hours.begins

    def slots(self, bench: str) -> list[Slot]:
        return sorted((slot for slot in self.forecast.slots if slot.bench == bench), key=lambda slot: slot.begins)

    def name(self, slot: Slot) -> str:
        return WARM_UP if slot.test is None else self.tests[slot.test].name

    def time(self, instant: float) -> str:
        """Returns the time of day of an instant, preceded by the date if the night began on another date."""
        local, first = civil(instant, self.zone), civil(self.begins, self.zone)
        return f"{local:%H:%M}" if local.date() == first.date() else f"{local:%m-%d %H:%M}"

    def length(self, slot: Slot) -> str:
        unknown = slot.test is not None and self.durations[slot.test] is None
        return "length of the recording" if unknown else spell_out(slot.ends - slot.begins)


def headline(table: Timetable) -> str:
    """States the number of tests and benches, and the times at which the night begins, is expected to end, and must end."""
    night = table.forecast
    benches = len({slot.bench for slot in night.slots})
    runs = sum(slot.test is not None for slot in night.slots)
    words = (
        f"{runs} of {count_of(len(table.tests), 'test')} on {count_of(benches, 'bench', 'benches')}, from "
        f"{shown_time(table.begins, table.zone)}, predicted end {shown_time(night.ends, table.zone)}"
    )
    if math.isfinite(night.hours.closes):
        spare = night.hours.closes - night.ends
        words += f", {spell_out(spare)} before the limit"
    return words + (" (simulated time)" if table.virtual else "")


def timetable_lines(table: Timetable, width: int = 100) -> list[str]:
    """Returns one line with a bar for each test and warm-up, grouped by bench, followed by the tests that will not run."""
    night = table.forecast
    lines = [f"  {headline(table)}"]
    names = [table.name(slot) for slot in night.slots]
    wide = max(map(len, names), default=0)
    times = max((len(table.time(slot.ends)) for slot in night.slots), default=5)
    room = max(8, min(40, width - wide - 2 * times - 32))
    for bench in table.suite.benches:
        slots = table.slots(bench)
        if not slots:
            continue
        lines.append(f"  bench {bench} ({table.suite.benches[bench].bench})")
        for slot in slots:
            bar = _bar(slot, table.begins, night.ends, room)
            span = f"{table.time(slot.begins):>{times}} – {table.time(slot.ends):>{times}}"
            lines.append(f"    {span}  {bar}  {table.name(slot):<{wide}}  {table.length(slot)}".rstrip())
    for index, reason in night.left_out:
        lines.append(f"  will not run: {table.tests[index].name}: {reason}")
    return lines


def _bar(slot: Slot, begins: float, ends: float, room: int) -> str:
    span = (ends - begins) or 1.0
    first = min(room - 1, int((slot.begins - begins) / span * room))
    last = max(first + 1, round((slot.ends - begins) / span * room))
    return "·" * first + ("▒" if slot.test is None else "█") * (last - first) + "·" * (room - last)


def timetable_page(table: Timetable, warnings: Sequence[str]) -> str:
    """Renders one self-contained HTML page. The same data give the same text. Raises `ReportError` if the page cannot be rendered."""
    from markupsafe import Markup

    from planrunner.reporting.templates import render

    night, suite = table.forecast, table.suite
    facts = [
        ["Suite", table.file],
        ["Begin", shown_time(table.begins, table.zone)],
        ["Predicted end", shown_time(night.ends, table.zone)],
        ["Limit", shown_time(night.hours.closes, table.zone) if math.isfinite(night.hours.closes) else "none"],
        ["Time", "simulated" if table.virtual else "real"],
    ]
    benches = [
        {
            "name": bench,
            "file": suite.benches[bench].bench,
            "busy": spell_out(sum(slot.ends - slot.begins for slot in slots)),
            "rows": [
                [table.time(slot.begins), table.time(slot.ends), table.name(slot), table.length(slot)] for slot in slots
            ],
        }
        for bench in suite.benches
        if (slots := table.slots(bench))
    ]
    drawn = 0 < len(night.slots) <= MOST_BARS
    given = {
        "title": suite.title,
        "description": suite.description,
        "headline": headline(table),
        "facts": facts,
        "chart": Markup(gantt_svg(table)) if drawn else "",
        "benches": benches,
        "left_out": [[table.tests[index].name, reason] for index, reason in night.left_out],
        "warnings": list(warnings),
    }
    return render("timetable.html", given)


def gantt_svg(table: Timetable) -> str:
    """Returns the night as a chart over local time: below the name of each bench, one row for each of its tests."""
    left, right, row, top = 260, 900, 24, 34
    begins, ends = table.begins, max(table.forecast.ends, table.begins + 60)

    def x(instant: float) -> float:
        return left + (instant - begins) / (ends - begins) * (right - left)

    parts, y = [], float(top)
    for bench in table.suite.benches:
        slots = table.slots(bench)
        if not slots:
            continue
        parts.append(f'<text x="0" y="{y + 16:g}" class="bench">bench {escape(bench)}</text>')
        y += row
        for slot in slots:
            name, kind = table.name(slot), "warm" if slot.test is None else "test"
            said = f"{name}: {table.time(slot.begins)} to {table.time(slot.ends)}, {table.length(slot)}"
            width = max(2.0, x(slot.ends) - x(slot.begins))
            parts.append(f'<text x="12" y="{y + 16:g}" class="name">{escape(_short(name))}</text>')
            parts.append(
                f'<rect x="{x(slot.begins):.1f}" y="{y + 4:g}" width="{width:.1f}" height="{row - 8}" rx="2" '
                f'class="{kind}"><title>{escape(said)}</title></rect>'
            )
            y += row
    grid = []
    for instant in _ticks(begins, ends, table):
        grid.append(f'<line x1="{x(instant):.1f}" x2="{x(instant):.1f}" y1="{top - 8}" y2="{y:g}" class="grid"/>')
        grid.append(f'<text x="{x(instant):.1f}" y="{top - 14}" class="tick">{civil(instant, table.zone):%H:%M}</text>')
    described = f"Timetable: {headline(table)}"
    return (
        f'<svg viewBox="0 0 {right + 30} {y + 8:g}" role="img" aria-label="{escape(described)}" '
        f'xmlns="http://www.w3.org/2000/svg" class="gantt">{"".join(grid)}{"".join(parts)}</svg>'
    )


def _ticks(begins: float, ends: float, table: Timetable) -> Iterator[float]:
    step = next((step for step in _STEPS if (ends - begins) / step <= 9), _STEPS[-1])
    offset = civil(begins, table.zone).utcoffset()
    shift = 0.0 if offset is None else offset.total_seconds()
    instant = math.ceil((begins + shift) / step) * step - shift
    while instant <= ends:
        yield instant
        instant += step


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 1] + "…"

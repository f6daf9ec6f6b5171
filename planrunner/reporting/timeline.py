"""Draws the panels of a schedule's timeline: bars for the segments, and the temperature and the rate over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from planrunner.plan.schedule import Cycle, Rock, Schedule, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Panel = Literal["segments", "temperature", "rate"]
PHASES = (("reaching", "#c9d1d9"), ("soaking, settling", "#f0c48a"), ("recording", "#0b5394"))


@dataclass(frozen=True, slots=True)
class SegmentTimes:
    """The times [s] at which a segment begins, reaches its state, begins to record, and ends. The times are measured from the
    beginning of the run."""

    segment: Segment
    leave: float
    arrive: float
    start: float
    end: float


def spans(schedule: Schedule) -> list[SegmentTimes]:
    """Returns the planned times of every segment. A dwell of unknown length counts as zero."""
    result = []
    for segment in schedule.segments:
        arrive = segment.start - segment.waiting
        end = segment.start + (segment.dwell or 0.0)
        result.append(SegmentTimes(segment, arrive - segment.transition, arrive, segment.start, end))
    return result


def panels_of(schedule: Schedule) -> list[Panel]:
    """Returns the panels for which this schedule has data."""
    panels: list[Panel] = ["segments"]
    if any(item.temperature is not None or item.ramp_to is not None for item in schedule.segments):
        panels.append("temperature")
    if any(isinstance(item.motion, Spin | Rock | Cycle) for item in schedule.segments):
        panels.append("rate")
    return panels


def draw_panels(rows: Sequence[Axes], panels: Sequence[Panel], schedule: Schedule) -> None:
    """Draws the panels one below the other in their matplotlib axes, with a common time axis."""
    times = spans(schedule)
    longest = max([schedule.total, *(span.end for span in times)], default=0.0) or 1.0
    unit, divisor = ("h", 3600.0) if longest >= 7200 else ("min", 60.0) if longest >= 120 else ("s", 1.0)
    draw = {"segments": _bars, "temperature": _temperature, "rate": _rate}
    for axes, panel in zip(rows, panels, strict=True):
        draw[panel](axes, times, divisor, longest)
        axes.set_xlim(0, longest / divisor)
    rows[-1].set_xlabel(f"time since the first move [{unit}]")


def _bars(axes: Axes, times: list[SegmentTimes], divisor: float, longest: float) -> None:
    from matplotlib.patches import Patch

    for place, (_, colour) in enumerate(PHASES):
        edges = [((s.leave, s.arrive), (s.arrive, s.start), (s.start, s.end))[place] for s in times]
        bars = [(a / divisor, (b - a) / divisor) for a, b in edges if b > a]
        axes.broken_barh(
            bars, (0.1, 0.8), facecolors=colour, edgecolor="white", linewidth=0.4 if len(times) < 60 else 0
        )
    for span in times:
        share = (span.end - span.start) / longest
        if share * 95 > len(span.segment.label):
            middle = (span.start + span.end) / 2 / divisor
            axes.text(middle, 0.5, span.segment.label, ha="center", va="center", fontsize=7.5, color="white")
        elif share > 0.014 and len(span.segment.label) <= 14:
            middle = (span.start + span.end) / 2 / divisor
            axes.text(middle, 0.5, span.segment.label, ha="center", va="center", fontsize=7, color="white", rotation=90)
    axes.set_ylim(0, 1)
    axes.set_yticks([])
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)
    handles = [Patch(facecolor=colour, label=name) for name, colour in PHASES]
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=3, borderaxespad=0.2, handlelength=1)


def _temperature(axes: Axes, times: list[SegmentTimes], divisor: float, longest: float) -> None:
    xs: list[float] = []
    ys: list[float] = []
    last = math.nan
    for span in times:
        held = last if span.segment.temperature is None else span.segment.temperature - ZERO_CELSIUS
        after = held if span.segment.ramp_to is None else span.segment.ramp_to - ZERO_CELSIUS
        first = last if math.isfinite(last) else held
        xs += [span.leave / divisor, span.arrive / divisor, span.start / divisor, span.end / divisor]
        ys += [first, held, held, after]
        last = after
    axes.plot(xs, ys, color="#b45309", linewidth=1.4)
    known = [y for y in ys if math.isfinite(y)]
    if known:
        margin = max(0.08 * (max(known) - min(known)), 2.0)
        axes.set_ylim(min(known) - margin, max(known) + margin)
    axes.set_ylabel("temperature\n[°C]", fontsize=8.5)


def _rate(axes: Axes, times: list[SegmentTimes], divisor: float, longest: float) -> None:
    xs, ys = [0.0], [0.0]
    for span in times:
        motion = span.segment.motion
        if isinstance(motion, Rock | Cycle):
            peak = motion.amplitude * 2 * math.pi * motion.frequency if isinstance(motion, Rock) else motion.rate
            begin, until = span.start, span.end
            if isinstance(motion, Rock):
                begin, until = span.start + motion.steady, span.start + motion.steady + motion.duration
            size = math.degrees(peak)
            axes.fill_between(
                [begin / divisor, until / divisor],
                [-size] * 2,
                [size] * 2,
                color="#0b5394",
                alpha=0.25,
                linewidth=0,
            )
        value = math.degrees(span.segment.rate)
        xs += [span.leave / divisor, span.arrive / divisor, span.end / divisor]
        ys += [ys[-1], value, value]
    axes.plot([*xs, longest / divisor], [*ys, 0.0], color="#0b5394", linewidth=1.2)
    axes.set_ylabel("rate\n[°/s]", fontsize=8.5)

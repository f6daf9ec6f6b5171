"""Shows runs in progress on a terminal: a table with the statistics of the channels, or one line for each run for a log."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from planrunner.archive.live import LiveChannel
from planrunner.live.monitor import Activity, RunningRun
from planrunner.reporting import words

if TYPE_CHECKING:
    from rich.console import RenderableType

NONE = "No run is in progress."
BAR = 60
"""Width of a bar in columns."""


def activity_view(activity: Activity) -> RenderableType:
    """Makes the view of all runs in progress for a terminal."""
    from rich.console import Group
    from rich.text import Text

    if not activity.running:
        return Text(NONE)
    return Group(*(part for run in activity.running for part in _run_view(run)))


def _run_view(run: RunningRun) -> list[RenderableType]:
    from rich.table import Table
    from rich.text import Text

    state = run.state
    parts: list[RenderableType] = [
        Text(_title(run), style="bold"),
        Text(_place(run)),
        Text(_bar(state.fraction), style="cyan"),
    ]
    if state.question is not None:
        parts.append(Text(f"waits for the operator: {state.question.text}", style="bold yellow"))
    if state.channels:
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
        table.add_column("channel")
        for title in ("samples", "mean", "s", "least", "greatest"):
            table.add_column(title, justify="right")
        table.add_column("unit")
        for channel in state.channels:
            table.add_row(*map(Text, _cells(channel)))
        parts.append(table)
    parts += [Text(f"noticed {notice.at[11:19]} UTC: {notice.text}", style="yellow") for notice in state.notices[-3:]]
    parts.append(Text(""))
    return parts


def _bar(fraction: float) -> str:
    done = round(BAR * fraction)
    return "━" * done + "─" * (BAR - done)


def _cells(channel: LiveChannel) -> tuple[str, ...]:
    numbers = (
        _number(channel.mean, 8),
        _number(channel.standard_deviation, 4),
        _number(channel.least, 8),
        _number(channel.greatest, 8),
    )
    return channel.name, str(channel.count), *numbers, channel.unit


def _number(value: float, digits: int) -> str:
    return "–" if math.isnan(value) else words.number(value, digits)


def log_line(run: RunningRun) -> str:
    """Describes a run in progress in one line, for a log."""
    return f"{_title(run)}: {_place(run)}"


def _title(run: RunningRun) -> str:
    header = run.header
    device = f", device {header.device}" if header.device else ""
    return f"{header.plan or header.run}{device} ({header.run})"


def _place(run: RunningRun) -> str:
    state = run.state
    parts = [f"{state.fraction:.0%}"]
    if state.label:
        parts.append(f"segment {state.index + 1} of {state.segments} ({state.label})")
    if state.question is not None:
        parts.append(f"waits for the operator: {state.question.text}")
    elif state.activity:
        parts.append(state.activity)
    if run.asked_to_pause and not state.paused:
        parts.append("pauses after this segment")
    if state.time_left is not None and state.question is None and not state.paused:
        parts.append(f"about {words.duration(float(_rounded(state.time_left)))} left")
    return ", ".join(parts)


def _rounded(seconds: float) -> int:
    return round(seconds) if seconds < 60 else 60 * round(seconds / 60)

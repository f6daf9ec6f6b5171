"""A progress bar with time left for runs; silent on request and if standard error is not a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planrunner.execution.progress import ProgressCallback, ProgressEvent

LINES_EVERY = 10.0
"""Seconds between lines of progress if the output is not a terminal."""


@contextmanager
def run_progress(quiet: bool) -> Iterator[tuple[ProgressCallback | None, Callable[[str], None]]]:
    """A callback for the executor's progress events, and one for notices to the operator."""
    if quiet:
        yield None, lambda text: print(text, file=sys.stderr)
    elif not sys.stderr.isatty():
        yield _Lines().take, lambda text: print(text, file=sys.stderr)
    else:
        yield from _bar()


def _bar() -> Iterator[tuple[ProgressCallback, Callable[[str], None]]]:
    from rich.progress import BarColumn, Progress, TextColumn

    from planrunner.execution.progress import Advanced
    from planrunner.reporting import terminal

    columns = (
        TextColumn("{task.fields[count]}"),
        BarColumn(bar_width=30),
        TextColumn("{task.percentage:3.0f} %"),
        TextColumn("{task.fields[left]}", style="cyan"),
        TextColumn("{task.description}", style="dim"),
    )
    console = terminal.console(file=sys.stderr)
    with Progress(*columns, console=console, transient=False) as progress:
        task = progress.add_task("", total=1.0, count="", left="")

        def take(event: ProgressEvent) -> None:
            what = event.activity if isinstance(event, Advanced) else ""
            progress.update(
                task,
                completed=event.fraction,
                count=f"{event.index + 1}/{event.segments}",
                left=left_text(event.time_left),
                description=f"{event.label}  {what}",
            )

        yield take, lambda text: progress.console.print(text)


class _Lines:
    """Progress for logs: an occasional line."""

    def __init__(self) -> None:
        import time

        self._now = time.monotonic
        self._shown = self._now()

    def take(self, event: ProgressEvent) -> None:
        if self._now() - self._shown >= LINES_EVERY:
            self._shown = self._now()
            text = f"{event.fraction:.0%}, segment {event.index + 1} of {event.segments} ({event.label})"
            print(f"{text}, {left_text(event.time_left)}", file=sys.stderr, flush=True)


class RowsLookedAt:
    """Progress in examining a long recording: an occasional line, none for a short recording."""

    def __init__(self) -> None:
        import time

        self._now = time.monotonic
        self._shown = self._now()

    def take(self, rows: int) -> None:
        if self._now() - self._shown >= LINES_EVERY:
            self._shown = self._now()
            print(f"{rows:,} rows checked".replace(",", " "), file=sys.stderr, flush=True)


def left_text(seconds: float | None) -> str:
    """`about 3 min left`."""
    if seconds is None:
        return ""
    from planrunner.reporting.words import duration

    rounded = round(seconds) if seconds < 60 else 60 * round(seconds / 60)
    return f"about {duration(float(rounded))} left"

"""Shows the progress and the remaining time of runs, and of reading long recordings. A terminal shows a bar. Otherwise, a line is
printed from time to time. With the option for quiet output, nothing is shown.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress

    from planrunner.base.progress import Announce, Underway
    from planrunner.execution.progress import Advanced, ProgressCallback, ProgressEvent, SegmentBegun, SegmentFinished

LINES_EVERY = 10.0
"""Time between lines of progress if the output is not a terminal, s."""


@contextmanager
def run_progress(quiet: bool) -> Iterator[tuple[ProgressCallback | None, Callable[[str], None]]]:
    """Yields two callbacks: one for the progress events of the executor, and one for notices to the operator."""
    if quiet:
        yield None, lambda text: print(text, file=sys.stderr)
    elif not sys.stderr.isatty():
        yield _Lines().take, lambda text: print(text, file=sys.stderr)
    else:
        yield from _bar()


def _bar() -> Iterator[tuple[ProgressCallback, Callable[[str], None]]]:
    with _drawn(transient=False) as (take, progress):
        yield take, lambda text: progress.console.print(text)


@contextmanager
def _drawn(*, transient: bool) -> Iterator[tuple[ProgressCallback, Progress]]:
    """Shows a progress bar on the terminal. `transient`: True if the bar disappears at the end."""
    from rich.progress import BarColumn, Progress, TextColumn

    from planrunner.base.progress import Underway
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
    with Progress(*columns, console=console, transient=transient) as progress:
        task = progress.add_task("", total=1.0, count="", left="")

        def take(event: ProgressEvent) -> None:
            if isinstance(event, Underway):
                count, what = "", event.what
            else:
                count = f"{event.index + 1}/{event.segments}"
                what = f"{event.label}  {event.activity if isinstance(event, Advanced) else ''}"
            left = left_text(event.time_left)
            progress.update(task, completed=event.fraction, count=count, left=left, description=what)

        yield take, progress


@contextmanager
def reading_progress(quiet: bool = False) -> Iterator[Announce | None]:
    """Yields a callback for the progress of reading recorded samples. Nothing is shown before its first call, and a bar disappears
    at the end. `quiet`: True to show nothing; the callback is then None."""
    if quiet:
        yield None
        return
    if not sys.stderr.isatty():
        yield _Lines().take
        return
    with ExitStack() as stack:
        drawn: list[Announce] = []

        def take(event: Underway) -> None:
            if not drawn:
                drawn.append(stack.enter_context(_drawn(transient=True))[0])
            drawn[0](event)

        yield take


class _Lines:
    """Shows progress in a log: prints a line from time to time."""

    def __init__(self) -> None:
        from planrunner.base.progress import now

        self._now = now
        self._shown = self._now()

    def take(self, event: ProgressEvent) -> None:
        from planrunner.base.progress import Underway

        if self._now() - self._shown < LINES_EVERY:
            return
        self._shown = self._now()
        what = event.what if isinstance(event, Underway) else _place(event)
        print(f"{event.fraction:.0%}, {what}, {left_text(event.time_left)}", file=sys.stderr, flush=True)


def _place(event: SegmentBegun | Advanced | SegmentFinished) -> str:
    return f"segment {event.index + 1} of {event.segments} ({event.label})"


def left_text(seconds: float | None) -> str:
    """Returns the time left in words, such as `about 3 min left`."""
    if seconds is None:
        return ""
    from planrunner.reporting.words import duration

    rounded = round(seconds) if seconds < 60 else 60 * round(seconds / 60)
    return f"about {duration(float(rounded))} left"

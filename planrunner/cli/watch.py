"""`planrunner watch`: shows the active runs of an archive, as a table on the terminal or as lines for a log."""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING

from planrunner.cli import exit_codes
from planrunner.cli.arguments import add_archive
from planrunner.cli.printing import print_json
from planrunner.cli.progress import LINES_EVERY

if TYPE_CHECKING:
    from rich.console import Console

    from planrunner.live.monitor import Activity, Monitor, RunningRun

EVERY = 1.0
"""Time between two readings of the state, s."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_archive(parser)
    parser.add_argument("--once", action="store_true", help="print the state once and end")
    parser.add_argument(
        "--until-idle", action="store_true", help="end when no run is in progress (default: until Ctrl-C)"
    )
    parser.add_argument("--json", action="store_true", help="print the state once as JSON and end")


def run(args: argparse.Namespace) -> int:
    from planrunner.live.monitor import Monitor
    from planrunner.live.terminal import activity_view
    from planrunner.reporting.terminal import console

    monitor = Monitor(args.archive)
    if args.json:
        print_json(monitor.look().to_json())
        return exit_codes.DONE
    output = console()
    if args.once:
        output.print(activity_view(monitor.look()))
    elif output.is_terminal:
        _draw(monitor, output, until_idle=args.until_idle)
    else:
        _log(monitor, until_idle=args.until_idle)
    return exit_codes.DONE


def _draw(monitor: Monitor, output: Console, *, until_idle: bool) -> None:
    from rich.live import Live

    from planrunner.live.terminal import activity_view

    activity = monitor.look()
    with Live(activity_view(activity), console=output, auto_refresh=False, vertical_overflow="ellipsis") as drawn:
        while activity.running or not until_idle:
            time.sleep(EVERY)
            activity = monitor.look()
            drawn.update(activity_view(activity), refresh=True)


def _log(monitor: Monitor, *, until_idle: bool) -> None:
    """Prints lines about the active runs: one whenever a run begins, waits or ends, and at least one for each run every ten
    seconds."""
    from planrunner.live.terminal import NONE, log_line

    shown: dict[str, tuple[float, object]] = {}
    activity = monitor.look()
    if not activity.running:
        print(NONE, flush=True)
    while True:
        now = time.monotonic()
        for one in activity.running:
            last, kind = shown.get(one.header.run, (-LINES_EVERY, None))
            if now - last >= LINES_EVERY or kind != _kind(one):
                print(log_line(one), flush=True)
                shown[one.header.run] = now, _kind(one)
        for name in shown.keys() - {one.header.run for one in activity.running}:
            del shown[name]
            print(f"{name}: {_ending(activity, name)}", flush=True)
        if until_idle and not activity.running:
            return
        time.sleep(EVERY)
        activity = monitor.look()


def _kind(run: RunningRun) -> object:
    """Returns the part of a run's state that causes a new line to be printed when it changes."""
    return run.state.paused, run.state.question, run.asked_to_pause, len(run.state.notices)


def _ending(activity: Activity, name: str) -> str:
    for one in activity.recent:
        if one.header.run == name:
            return f"{one.outcome}{f': {one.reason}' if one.reason else ''}"
    return "ended"

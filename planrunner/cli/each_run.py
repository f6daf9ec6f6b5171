"""A command on several run folders: each is processed separately, the exit code is the highest, and JSON is a list with one entry per
run."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from planrunner.base.documents import JsonObject
from planrunner.cli.failures import failure_of
from planrunner.cli.printing import print_json
from planrunner.night.record import holds_nights
from planrunner.reporting.printable import printable


@dataclass(frozen=True, slots=True)
class Done:
    """Result of a command on one run: its exit code and, for `--json`, its output."""

    code: int
    found: JsonObject = field(default_factory=dict)


def add_runs(parser: argparse.ArgumentParser) -> None:
    """Adds RUN [RUN …] for commands without other positional arguments."""
    parser.add_argument("runs", metavar="RUN", nargs="+", type=Path, help="one or more run folders")


def run_folders(given: Sequence[Path]) -> list[Path]:
    """The given folders without those that hold the nights of an archive, which a pattern such as `runs/*` contains; a note names them."""
    nights = [] if len(given) < 2 else [folder for folder in given if holds_nights(folder)]
    for folder in nights:
        print(
            printable(f"note: {folder} is skipped: it holds the records of nights, not a run", keep=""), file=sys.stderr
        )
    return [folder for folder in given if folder not in nights]


def each_run(
    runs: Sequence[Path], work: Callable[[Path], Done], *, as_json: bool, last: Callable[[], Done | None] | None = None
) -> int:
    """Does the work on every run, even if others fail. A failure is printed; with `--json` it is in `findings` of its entry.

    With several runs, the output of each begins with its name. The exit code is the highest of all. last: gives what concerns
    all runs together, which is the last entry.
    """
    runs = run_folders(runs)
    entries, worst = [], 0
    for run in runs:
        if len(runs) > 1 and not as_json:
            print(f"{run}:", flush=True)
        try:
            done = work(run)
        except BrokenPipeError:
            raise  # the reader closed the pipe
        except Exception as error:
            if len(runs) == 1 and not as_json:
                raise
            failure = failure_of(error, str(run))
            failure.show()
            done = Done(failure.code, {"findings": [finding.to_json() for finding in failure.findings]})
        entries.append({"run": str(run), "exit_code": done.code, **done.found})
        worst = max(worst, done.code)
    together = None if last is None else last()
    if together is not None:
        entries.append({"exit_code": together.code, **together.found})
        worst = max(worst, together.code)
    if as_json:
        print_json(entries)
    return worst

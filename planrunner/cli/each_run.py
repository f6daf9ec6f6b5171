"""Applies a command to several run folders: each is processed separately, the exit code is the highest, and JSON is a list with one
entry for each run."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

from planrunner.base.documents import JsonObject
from planrunner.base.findings import InputError
from planrunner.base.progress import Pace
from planrunner.base.workers import Workers, results_in_order
from planrunner.cli.failures import CommandFailure, unsaved_failure_of
from planrunner.cli.printing import print_json, print_line
from planrunner.cli.progress import reading_progress
from planrunner.night.record import holds_nights

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Done:
    """Result of a command on one run: its exit code and, for `--json`, its output."""

    code: int
    found: JsonObject = field(default_factory=dict)


def add_runs(parser: argparse.ArgumentParser, kind: Callable[[str], Path] = Path) -> None:
    """Adds RUN [RUN …] for commands without other positional arguments. kind: converts an argument to a path."""
    parser.add_argument("runs", metavar="RUN", nargs="+", type=kind, help="one or more run folders")


def run_folders(given: Sequence[Path]) -> list[Path]:
    """The given folders without those that contain the nights of an archive. A pattern such as `runs/*` includes these; a note
    names them."""
    nights = [] if len(given) < 2 else [folder for folder in given if holds_nights(folder)]
    for folder in nights:
        print_line(f"note: {folder} is skipped: it holds the records of nights, not a run", sys.stderr)
    return [folder for folder in given if folder not in nights]


def runs_of(args: argparse.Namespace) -> list[Path]:
    """The run folders: those that were given or, with --all, those in the archive. Raises `InputError`."""
    runs: list[Path] = args.runs
    if not args.all:
        return run_folders(runs)
    from planrunner.tasks.verify import runs_beneath

    return runs_beneath(archive_of(runs))


def archive_of(runs: Sequence[Path]) -> Path:
    """The folder that was given with --all. Raises `InputError` if there are several."""
    if len(runs) > 1:
        raise InputError.of_usage("--all takes one folder", "give the folder that contains the runs")
    return runs[0]


def each_run(runs: Sequence[Path], work: Callable[[Path], Done], *, as_json: bool) -> int:
    """Does the work on every run, even if others fail. A failure is printed; with `--json` it is in `findings` of its entry.

    With several runs, the output of each begins with its name. The exit code is the highest of all.
    """
    runs = run_folders(runs)

    def attempt(run: Path) -> Done | CommandFailure:
        _name(run, len(runs), as_json)
        return _attempt(work, run, run)

    alone = len(runs) == 1 and not as_json
    return _concluded(runs, map(work if alone else attempt, runs), lambda done: done, as_json=as_json)


def each_result(
    runs: Sequence[Path],
    work: Callable[[Path], R],
    show: Callable[[R], Done],
    workers: Workers,
    *,
    what: str,
    as_json: bool,
    last: Callable[[], Done | None] | None = None,
) -> int:
    """The same as `each_run`, for work that prints nothing and that workers can share. `work` must be a function defined at
    module level, or a `partial` of one, so that it can be sent to workers. show: prints a result, in the order of the runs. what: text
    for the progress. last: computes the result for all runs together, which is the last entry."""
    alone = len(runs) == 1 and not as_json
    with reading_progress(as_json) as notice:
        pace = Pace(what, 1.0, notice)
        results: Iterable[R | CommandFailure] = results_in_order(
            work if alone else partial(_attempted, work), runs, workers, pace.reached
        )
        return _concluded(runs, results, show, last, headed=True, as_json=as_json)


def _attempted(work: Callable[[Path], R], run: Path) -> R | CommandFailure:
    return _attempt(work, run, run)


def _attempt(work: Callable[[T], R], given: T, run: Path) -> R | CommandFailure:
    try:
        return work(given)
    except BrokenPipeError:
        raise  # the reader closed the pipe
    except Exception as error:
        return unsaved_failure_of(error, str(run))


def _name(run: Path, number: int, as_json: bool) -> None:
    if number > 1 and not as_json:
        print(f"{run}:", flush=True)


def _concluded(
    runs: Sequence[Path],
    results: Iterable[R | CommandFailure],
    show: Callable[[R], Done],
    last: Callable[[], Done | None] | None = None,
    *,
    as_json: bool,
    headed: bool = False,
) -> int:
    """Prints the results and returns the exit code. headed: whether to print the names of the runs here."""
    alone = len(runs) == 1 and not as_json
    entries, worst = [], 0
    for run, result in zip(runs, results, strict=True):
        if headed:
            _name(run, len(runs), as_json)
        shown = result if isinstance(result, CommandFailure) else show(result) if alone else _attempt(show, result, run)
        done = _failed(shown) if isinstance(shown, CommandFailure) else shown
        if as_json:
            entries.append({"run": str(run), "exit_code": done.code, **done.found})
        worst = max(worst, done.code)
    together = None if last is None else last()
    if together is not None:
        entries.append({"exit_code": together.code, **together.found})
        worst = max(worst, together.code)
    if as_json:
        print_json(entries)
    return worst


def _failed(failure: CommandFailure) -> Done:
    failure = failure.saved()
    failure.show()
    return Done(failure.code, {"findings": [finding.to_json() for finding in failure.findings]})

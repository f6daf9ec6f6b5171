"""Applies a command to several run folders. Each folder is processed separately. The exit code is the highest exit code of all
runs, and JSON output is a list with one entry for each run."""

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
    """Contains the result of a command for one run: the exit code and, for `--json`, the data to print."""

    code: int
    found: JsonObject = field(default_factory=dict)


def add_runs(parser: argparse.ArgumentParser, kind: Callable[[str], Path] = Path) -> None:
    """Adds the argument RUN [RUN …], for commands without other positional arguments. `kind`: function that converts the text of an
    argument to a path."""
    parser.add_argument("runs", metavar="RUN", nargs="+", type=kind, help="one or more run folders")


def run_folders(given: Sequence[Path]) -> list[Path]:
    """Returns the given folders, except those that contain the records of suite nights. A pattern such as `runs/*` also matches
    such folders; a note names each one that is skipped."""
    nights = [] if len(given) < 2 else [folder for folder in given if holds_nights(folder)]
    for folder in nights:
        print_line(f"note: {folder} is skipped: it holds the records of nights, not a run", sys.stderr)
    return [folder for folder in given if folder not in nights]


def runs_of(args: argparse.Namespace) -> list[Path]:
    """Returns the run folders that the command processes: those given as arguments or, with --all, those in the archive. Raises
    `InputError` if --all is used with several folders."""
    runs: list[Path] = args.runs
    if not args.all:
        return run_folders(runs)
    from planrunner.tasks.verify import runs_beneath

    return runs_beneath(archive_of(runs))


def archive_of(runs: Sequence[Path]) -> Path:
    """Returns the single folder given together with --all. Raises `InputError` if several folders were given."""
    if len(runs) > 1:
        raise InputError.of_usage("--all takes one folder", "give the folder that contains the runs")
    return runs[0]


def each_run(runs: Sequence[Path], work: Callable[[Path], Done], *, as_json: bool) -> int:
    """Performs the work for every run. If the work fails for one run, the function continues with the next run. The failure is
    printed; with `--json`, it is also in `findings` of the run's entry.

    With several runs, the name of each run precedes its output. The exit code is the highest exit code of all runs.
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
    """Does the same as `each_run`, but several workers can share the runs, because the work itself prints nothing. `work` must be a
    function defined at module level, or a `partial` of such a function, because it is sent to workers.

    `show`: prints one result; it is called in the order of the runs. `what`: text that describes the work in the progress. `last`:
    a function that computes a further result from all runs together; this result becomes the last entry.
    """
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
    """Prints the results of all runs and returns the exit code. `headed`: True if this function prints the name of each run before
    the result of the run."""
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

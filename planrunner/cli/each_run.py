"""A command over several run folders: each is done by itself, the exit code is the worst of them, and JSON is a list of one entry a run."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planrunner.cli.failures import failure_of
from planrunner.cli.printing import print_json


@dataclass(frozen=True, slots=True)
class Done:
    """What a command made of one run: its exit code and, for `--json`, what it found."""

    code: int
    found: dict[str, Any] = field(default_factory=dict)


def add_runs(parser: argparse.ArgumentParser) -> None:
    """RUN [RUN …], for commands that take nothing else by position."""
    parser.add_argument("runs", metavar="RUN", nargs="+", type=Path, help="one or more run folders")


def each_run(runs: Sequence[Path], work: Callable[[Path], Done], *, as_json: bool) -> int:
    """Does the work on every run, whatever becomes of the others. A failure is shown and stands, with `--json`, as `findings` in its entry.

    With several runs, the name of each stands above what it prints. Exit codes: the highest is the worst.
    """
    entries, worst = [], 0
    for run in runs:
        if len(runs) > 1 and not as_json:
            print(f"{run}:", flush=True)
        try:
            done = work(run)
        except BrokenPipeError:
            raise  # the reader went away
        except Exception as error:
            if len(runs) == 1 and not as_json:
                raise
            failure = failure_of(error, str(run))
            failure.show()
            done = Done(failure.code, {"findings": [finding.to_json() for finding in failure.findings]})
        entries.append({"run": str(run), "exit_code": done.code, **done.found})
        worst = max(worst, done.code)
    if as_json:
        print_json(entries)
    return worst

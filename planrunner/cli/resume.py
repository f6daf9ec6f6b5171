"""`planrunner resume`: go on where a run was cut short."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.cli.outcome import conclude, tell
from planrunner.cli.progress import run_progress
from planrunner.cli.run import add_run_arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="run folder")
    parser.add_argument("--data", metavar="DIR", type=Path, help="folder that recordings to play back lie beneath")
    add_run_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from planrunner import running
    from planrunner.execution.stopping import StopRequest

    with run_progress(args.quiet) as (progress, notify), StopRequest(notify) as stop:
        outcome = running.resume(args.run_folder, stop=stop, data_root=args.data, progress=progress)
    if not outcome.ok:
        return tell(args.run_folder, outcome)
    return conclude(running.analyse_run(args.run_folder), as_json=args.json)

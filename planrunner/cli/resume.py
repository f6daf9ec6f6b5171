"""`planrunner resume`: continues an interrupted or paused run, or repeats segments."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.archive import pausing
from planrunner.archive.verifying import open_run
from planrunner.base.findings import COMMAND_LINE, InputError
from planrunner.cli import exit_codes
from planrunner.cli.arguments import add_data
from planrunner.cli.operator import operator_of
from planrunner.cli.outcome import evaluate, tell
from planrunner.cli.printing import print_json
from planrunner.cli.progress import run_progress
from planrunner.cli.run import add_override, add_run_arguments, override_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="run folder")
    add_data(parser)
    parser.add_argument(
        "--retake",
        metavar="LABEL",
        action="append",
        default=[],
        help="record this segment again and keep its earlier data (with --reason)",
    )
    parser.add_argument("--reason", metavar="TEXT", help="reason for --retake; stored in the run folder")
    parser.add_argument(
        "--bench",
        metavar="BENCH",
        help="use this bench file instead of the bench file in the folder; it may differ only in the addresses of the instruments",
    )
    parser.add_argument(
        "--trust-bench",
        action="store_true",
        help="use the bench file of a folder that was not made on this computer, and connect to the addresses in it",
    )
    parser.add_argument(
        "--approvals",
        metavar="PLAN",
        type=Path,
        help="also accept approvals that were given after the run began and are stored next to this plan file",
    )
    add_override(parser)
    add_run_arguments(parser)


def run(args: argparse.Namespace) -> int:
    folder: Path = args.run_folder
    if bool(args.retake) != bool(args.reason):
        raise InputError.at(COMMAND_LINE, "run-retake", "give both --retake and --reason", "give both")
    override = override_of(args)
    if pausing.take_back(open_run(folder)):
        if args.json:
            print_json({"run": str(folder), "asked": "go on"})
        else:
            print("The run continues.")
        return exit_codes.DONE
    from planrunner.execution.stopping import StopRequest
    from planrunner.tasks import run as running

    retake = running.Retake(tuple(args.retake), args.reason) if args.retake else None
    with run_progress(args.quiet) as (progress, notify), StopRequest(notify) as stop:
        outcome = running.resume(
            folder,
            stop=stop,
            data_root=args.data,
            progress=progress,
            operator=operator_of(args, notify),
            retake=retake,
            bench=args.bench,
            trust_bench=args.trust_bench,
            approvals=args.approvals,
            override=override,
        )
    if not outcome.ok:
        return tell(folder, outcome, as_json=args.json)
    return evaluate(folder, outcome, args)

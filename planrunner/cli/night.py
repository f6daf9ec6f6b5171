"""`planrunner night`: runs a suite unattended, or continues it where it stopped."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from planrunner.cli.arguments import add_data, add_workers, workers_of
from planrunner.cli.printing import print_findings, print_json
from planrunner.cli.suites import add_at
from planrunner.tasks.check_suite import check_suite


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("suite", metavar="SUITE", help="suite file")
    add_data(parser)
    parser.add_argument(
        "--runs",
        metavar="DIR",
        type=Path,
        default=Path("runs"),
        help="archive that receives the run folders; the record of the night is stored in its folder `nights` (default: runs)",
    )
    parser.add_argument(
        "--new", action="store_true", help="begin a new night, even if an unfinished one can be continued"
    )
    parser.add_argument("--flushed", action="store_true", help="do not wait for the disk after every event")
    parser.add_argument(
        "--github",
        action="store_true",
        default=os.environ.get("GITHUB_ACTIONS") == "true",
        help="print annotations for GitHub Actions (default: if the environment variable GITHUB_ACTIONS is true)",
    )
    parser.add_argument("--quiet", action="store_true", help="do not print a line for each test")
    parser.add_argument("--json", action="store_true", help="print the record of the night as JSON")
    add_workers(parser, "number of processes that check the plans (default: as many as speed up the checks)")
    add_at(parser)


def run(args: argparse.Namespace) -> int:
    sound = check_suite(Path(args.suite), at=args.at, archive=args.runs, workers=workers_of(args, None)).sound()
    print_findings(sound.findings)
    from planrunner.execution.stopping import StopRequest
    from planrunner.night.summary import github_annotations
    from planrunner.tasks import night

    def tell(text: str) -> None:
        if not args.quiet:
            print(text, file=sys.stderr, flush=True)

    options = night.NightOptions(args.runs, args.data, args.flushed, args.new, tell)
    with StopRequest(tell) as stop:
        result = night.run_night(sound, options, stop)
    if args.github and not args.json:
        for line in github_annotations(result.record):
            print(line)
    if args.json:
        print_json(result.record)
    else:
        for line in night.lines_of(result):
            print(line)
    return result.exit_code

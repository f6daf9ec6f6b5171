"""`planrunner stamp`: requests the missing time stamps of seals, for example if the authority did not answer when the run was
sealed."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.cli import exit_codes
from planrunner.cli.each_run import Done, add_runs, each_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_runs(parser)
    parser.add_argument(
        "--url", metavar="URL", help="address of the authority (default: that in the bench file, if you made the run)"
    )
    parser.add_argument("--json", action="store_true", help="print a list as JSON, one entry per run")


def run(args: argparse.Namespace) -> int:
    from planrunner.tasks.stamp import stamp_run

    def one(folder: Path) -> Done:
        at = stamp_run(folder, args.url)
        if not args.json:
            print(f"    seal stamped {at}" if at else "    the seal has a time stamp already")
        return Done(exit_codes.DONE, {"stamped": at or None})

    return each_run(args.runs, one, as_json=args.json)

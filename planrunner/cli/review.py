"""`planrunner review`: makes the page on which a run is reviewed for sign-off."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.cli import exit_codes
from planrunner.cli.log import ring_of
from planrunner.cli.printing import print_json, print_line, write_file
from planrunner.cli.progress import reading_progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="RUN", type=Path, help="run folder")
    parser.add_argument("--html", metavar="FILE", type=Path, help="write the review page to this file")
    parser.add_argument("--analysis", type=int, metavar="N", help="number of the analysis (default: the newest)")
    parser.add_argument(
        "--keys", metavar="RING", type=Path, help="key ring, with which signatures and approvals are verified"
    )
    parser.add_argument("--json", action="store_true", help="print the deviations as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner.reporting.review_page import render_review
    from planrunner.tasks.review_run import review_of

    with reading_progress() as notice:
        context = review_of(args.folder, args.analysis, notice, ring_of(args))
    if args.html is not None:
        write_file(args.html, render_review(context))
    if args.json:
        print_json(
            {
                "run": str(args.folder),
                "deviations": [
                    {
                        "kind": one.kind,
                        "segment": one.segment,
                        "estimate": one.estimate,
                        "text": str(one.text),
                        "grave": one.grave,
                    }
                    for one in context.deviations
                ],
            }
        )
        return exit_codes.DONE
    for one in context.deviations:
        where = one.segment or one.estimate
        print_line(f"{one.kind}{f' ({where})' if where else ''}: {one.text}")
    if not context.deviations:
        print("no deviations")
    if args.html is not None:
        print(args.html)
    return exit_codes.DONE

"""`planrunner site`: writes the static site of an archive."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.cli.arguments import add_index, folder_argument, opened_index, report_left_out
from planrunner.cli.printing import print_json
from planrunner.cli.progress import reading_progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "archive", metavar="ARCHIVE", type=folder_argument, help="folder that contains the run folders, or its URL"
    )
    parser.add_argument("out", metavar="OUT", type=Path, help="folder of the site: a new one, or a site to replace")
    add_index(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner.night.site import build_site

    with opened_index(args, args.archive) as index, reading_progress(args.quiet) as notice:
        built = build_site(index, args.out, notice)
        faults = index.faults()
    if args.json:
        print_json({"page": str(built.page), "runs": built.runs, "devices": built.devices})
    else:
        print(built.page)
    return report_left_out(faults)

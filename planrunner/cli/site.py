"""`planrunner site`: writes the static site of an archive."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.cli.arguments import add_workers, folder_argument, report_left_out, workers_of
from planrunner.cli.printing import print_json
from planrunner.cli.progress import reading_progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "archive", metavar="ARCHIVE", type=folder_argument, help="folder that contains the run folders, or its URL"
    )
    parser.add_argument("out", metavar="OUT", type=Path, help="folder of the site: a new one, or a site to replace")
    parser.add_argument("--index", metavar="INDEX", help="file or URL of the index (default: a file of this user)")
    parser.add_argument("--no-refresh", action="store_true", help="use the index as it is, without reading new runs")
    add_workers(parser, "number of processes that read the runs (default: one for each processor)")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    from planrunner.night.history.index import Index
    from planrunner.night.site import build_site

    workers = workers_of(args, None)
    with reading_progress(args.quiet) as notice, Index.open(args.archive, args.index) as index:
        if not args.no_refresh:
            index.refresh(notice=notice, workers=workers)
        built = build_site(index, args.out, notice)
        faults = index.faults()
    if args.json:
        print_json({"page": str(built.page), "runs": built.runs, "devices": built.devices})
    else:
        print(built.page)
    return report_left_out(faults)

"""`planrunner runs`: lists the runs of an archive that pass a filter; also updates, rebuilds or exports the index."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.base.findings import count_of
from planrunner.cli.arguments import add_archive, add_index, add_period, opened_index, report_left_out
from planrunner.cli.printing import print_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_archive(parser)
    parser.add_argument(
        "--device", default="", metavar="SERIAL", help="serial number; * and ? stand for any characters"
    )
    parser.add_argument("--plan", default="", metavar="NAME", help="name of the plan, also as a pattern")
    parser.add_argument("--bench", default="", metavar="NAME", help="name of the bench, also as a pattern")
    parser.add_argument("--operator", default="", metavar="NAME", help="name of the operator, also as a pattern")
    parser.add_argument(
        "--verdict",
        default="",
        choices=("pass", "warned", "fail", "none", "not analysed"),
        help="verdict on the limits",
    )
    add_period(parser)
    parser.add_argument("--limit", type=int, metavar="N", help="list only the newest N runs")
    parser.add_argument(
        "--export",
        metavar="FILE",
        type=Path,
        help="write the whole index to FILE.duckdb, or to a folder of Parquet files",
    )
    add_index(parser)
    parser.add_argument("--json", action="store_true", help="print the list as JSON")
    parser.epilog = "Exit codes: 0 done, 2 wrong input, 4 some folders are damaged and are not listed."


def run(args: argparse.Namespace) -> int:
    from planrunner.night.history.rows import RunFilter
    from planrunner.tasks.history import list_runs

    wanted = RunFilter(
        args.device, args.plan, args.bench, args.operator, args.verdict, args.since, args.until, args.limit
    )
    with opened_index(args, args.archive) as index:
        found = list_runs(index, wanted)
        if args.export is not None:
            from planrunner.night.history.export import export_index

            export_index(index, args.export)
    if args.json:
        print_json(found.to_json())
    else:
        from planrunner.reporting import terminal
        from planrunner.reporting.history_tables import runs_table

        if found.runs:
            terminal.print_tables(runs_table(found.runs))
        more = f", {len(found.runs)} shown" if len(found.runs) < found.total else ""
        print(f"{count_of(found.total, 'run')}{more}")
        if args.export is not None:
            print(args.export)
    return report_left_out(found.faults)

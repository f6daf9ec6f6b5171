"""`planrunner gauge`: repeatability and reproducibility of a coefficient over devices, operators and benches."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.cli.archive_arguments import add_index, folder_argument, opened_index, report_left_out
from planrunner.cli.printing import print_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("coefficient", metavar="COEFFICIENT", help="estimate.coefficient")
    parser.add_argument(
        "--runs",
        metavar="ARCHIVE",
        type=folder_argument,
        default=Path("runs"),
        help="folder or URL of the runs (default: runs)",
    )
    parser.add_argument(
        "--device", default="", metavar="SERIAL", help="devices of the study; * and ? stand for any characters"
    )
    parser.add_argument("--plan", default="", metavar="NAME", help="name of the plan, also as a pattern")
    parser.add_argument("--since", default="", metavar="DATE", help="runs from this day or moment on (UTC)")
    parser.add_argument("--until", default="", metavar="DATE", help="runs up to this day or moment (UTC)")
    add_index(parser)
    parser.add_argument("--json", action="store_true", help="print the study as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner.night.history.rows import RunFilter
    from planrunner.tasks.history import gauge_of

    wanted = RunFilter(device=args.device, plan=args.plan, since=args.since, until=args.until)
    with opened_index(args, args.runs) as index:
        code = report_left_out(index.faults())
        found, unit = gauge_of(index, args.coefficient, wanted)
    if args.json:
        print_json(found.to_json(args.coefficient, unit))
    else:
        from planrunner.reporting import terminal
        from planrunner.reporting.history_tables import gauge_table
        from planrunner.reporting.printable import printable

        counts = ", ".join(f"{count} {name}{'es' if name == 'bench' else 's'}" for name, count in found.levels.items())
        print(printable(f"{args.coefficient}: {counts}, {found.repetitions} runs of each", keep=""))
        terminal.console().print(terminal.data_table(gauge_table(found, unit)))
        if found.unused:
            print(f"{found.unused} runs are not used, because the other combinations have fewer runs")
    return code

"""`planrunner gauge`: shows the repeatability and reproducibility of a coefficient over devices, operators and benches."""

from __future__ import annotations

import argparse

from planrunner.base.findings import count_of
from planrunner.cli.arguments import add_index, add_period, add_runs_folder, opened_index, report_left_out
from planrunner.cli.printing import print_json, print_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("coefficient", metavar="COEFFICIENT", help="estimate.coefficient")
    add_runs_folder(parser)
    parser.add_argument(
        "--device", default="", metavar="SERIAL", help="devices of the study; * and ? stand for any characters"
    )
    parser.add_argument("--plan", default="", metavar="NAME", help="name of the plan, also as a pattern")
    add_period(parser)
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

        counts = ", ".join(
            count_of(count, name, "benches" if name == "bench" else "") for name, count in found.levels.items()
        )
        print_line(f"{args.coefficient}: {counts}, {count_of(found.repetitions, 'run')} of each")
        terminal.print_tables(gauge_table(found, unit))
        if found.unused:
            print(f"not used: {count_of(found.unused, 'run')}, because the other combinations have fewer runs")
    return code

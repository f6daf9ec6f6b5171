"""`planrunner history`: shows a coefficient of a device over time, with control charts, changes, drift and the next calibration."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.cli import exit_codes
from planrunner.cli.arguments import add_index, add_runs_folder, opened_index, report_left_out
from planrunner.cli.printing import print_json, print_line, write_named


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("device", metavar="DEVICE", help="serial number of the device")
    parser.add_argument(
        "coefficient", metavar="COEFFICIENT", nargs="?", help="estimate.coefficient; without it, the names are listed"
    )
    add_runs_folder(parser)
    parser.add_argument(
        "--tolerance", metavar="QUANTITY", help="permissible deviation for the next calibration, such as '0.5 deg/h'"
    )
    parser.add_argument(
        "--since", default="", metavar="DATE", help="use runs from this day on (UTC), such as after an accepted change"
    )
    parser.add_argument("--html", metavar="FILE", type=Path, help="write a page with the control charts")
    add_index(parser)
    parser.add_argument("--json", action="store_true", help="print the history as JSON")
    parser.epilog = (
        "Exit codes: 0 in control, 1 the newest value is outside a control limit, 2 wrong input, 4 some folders are damaged "
        "and are not used."
    )


def run(args: argparse.Namespace) -> int:
    from planrunner.reporting.printable import printable
    from planrunner.tasks.history import coefficients_of, trend_of

    with opened_index(args, args.runs) as index:
        code = report_left_out(index.faults())
        if args.coefficient is None:
            names = coefficients_of(index, args.device)
            if args.json:
                print_json(names)
            else:
                print(printable("\n".join(names)))
            return code
        found = trend_of(index, args.device, args.coefficient, args.tolerance, args.since)
    if args.html is not None:
        from planrunner.reporting.history_page import render_history

        write_named(args.html, render_history(found), args.json)
    if args.json:
        print_json(found.to_json())
    else:
        from planrunner.reporting import terminal
        from planrunner.reporting.history_tables import agreement_table, plot_lines, points_table, sentences

        terminal.print_tables(points_table(found))
        for line in (*plot_lines(found), *sentences(found)):
            print_line(line)
        for title, participants in (("benches", found.benches), ("laboratories", found.laboratories)):
            if participants:
                terminal.print_tables(agreement_table(title, participants, found.unit))
    charts = found.charts
    out = charts is not None and charts.out_of_control
    return code or (exit_codes.LIMIT_FAILED if out else exit_codes.DONE)

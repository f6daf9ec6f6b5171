"""`planrunner compare`: shows the coefficients of several runs side by side."""

from __future__ import annotations

import argparse

from planrunner.base.findings import InputError
from planrunner.cli import exit_codes
from planrunner.cli.arguments import folder_argument
from planrunner.cli.each_run import add_runs, run_folders
from planrunner.cli.printing import print_json, print_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_runs(parser, folder_argument)
    parser.add_argument("--json", action="store_true", help="print the comparison as JSON")
    parser.epilog = "Exit codes: 0 all coefficients agree with the first run (|E_n| ≤ 1), 1 some do not, 2 wrong input."


def run(args: argparse.Namespace) -> int:
    from planrunner.night.history.comparison import compare_runs

    runs = run_folders(args.runs)
    if len(runs) < 2:
        raise InputError.of_usage("at least two runs are needed", "write `planrunner compare RUN RUN`")
    found = compare_runs(runs)
    if args.json:
        print_json(found.to_json())
    else:
        from planrunner.reporting import terminal
        from planrunner.reporting.history_tables import comparison_table, scatter_sentence

        for number, (name, row) in enumerate(zip(found.names, found.runs, strict=True), start=1):
            about = (
                f"run {number}: {name} ({row.device or 'no device'}, {row.bench}, {row.created[:10]}, {row.verdict})"
            )
            print_line(about)
        terminal.print_tables(comparison_table(found))
        if sentence := scatter_sentence(found):
            print_line(sentence)
    return exit_codes.LIMIT_FAILED if found.differs else exit_codes.DONE

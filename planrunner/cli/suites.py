"""Functions for suites that the commands `check` and `night` share: their arguments, and printing the timetable."""

from __future__ import annotations

import argparse
import re
import sys
from datetime import datetime
from pathlib import Path

from planrunner.archive.schema_check import FIRST_YEAR, LAST_YEAR
from planrunner.base.findings import InputError, count_of
from planrunner.cli.arguments import workers_of
from planrunner.cli.printing import columns, write_file
from planrunner.reporting.night_timetable import Timetable, timetable_lines, timetable_page
from planrunner.tasks.check_suite import CheckedSuite, check_suite, is_suite


def add_suite_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of `check` that apply to suites only."""
    parser.add_argument("--html", metavar="FILE", type=Path, help="for a suite: write its timetable as a page")
    add_at(parser)


def add_at(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--at",
        metavar="TIME",
        type=local_time,
        help="for a suite: local time at which the night begins, such as 2026-03-28T22:00 (default: now)",
    )


def local_time(text: str) -> str:
    """Checks that a text is a local time of the form YYYY-MM-DDTHH:MM; returns the text unchanged. The time is in the time zone of
    the suite. Raises `argparse.ArgumentTypeError` for any other text."""
    try:
        form = re.fullmatch(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?", text)
        if form and FIRST_YEAR <= datetime.fromisoformat(text).year <= LAST_YEAR:
            return text
    except ValueError:
        pass
    years = f"of a year from {FIRST_YEAR} to {LAST_YEAR}"
    raise argparse.ArgumentTypeError(f"write a time such as 2026-03-28T22:00, {years}, not {text!r}")


def require_usable(args: argparse.Namespace) -> None:
    """Raises `InputError` if an argument for suites is given without a suite, or an argument for plans is given with a suite."""
    suites = [plan for plan in args.plans if is_suite(Path(plan))]
    if args.html is not None and (len(args.plans) != 1 or not suites):
        raise InputError.of_usage("--html needs exactly one suite", "use `planrunner show` for a plan")
    if args.at is not None and not suites:
        raise InputError.of_usage("--at applies to a suite", "leave it out")
    if suites and args.parameter:
        message = "a suite gives the parameters of its plans itself"
        raise InputError.of_usage(message, "leave --parameter out, or change the suite")
    if suites and args.bench is not None:
        raise InputError.of_usage("a suite names its benches itself", "leave --bench out, or change the suite")


def checked_suite(args: argparse.Namespace, file: Path) -> CheckedSuite:
    """Checks a suite; on request, also writes the page of its timetable."""
    checked = check_suite(file, at=args.at, archive=args.runs, workers=workers_of(args, None))
    table = timetable_of(checked)
    if args.html is not None and table is not None:
        left = {finding.mark for finding in checked.findings if finding.code == "suite-does-not-fit"}
        warnings = [
            finding.message
            for finding in checked.findings
            if finding.severity == "warning" and finding.mark not in left
        ]
        write_file(args.html, timetable_page(table, warnings))
    return checked


def timetable_of(checked: CheckedSuite) -> Timetable | None:
    """Returns the timetable of a suite; None if errors in the suite prevent one."""
    if checked.suite is None or checked.forecast is None:
        return None
    return Timetable(
        checked.suite,
        checked.file,
        checked.tests,
        checked.durations,
        checked.forecast,
        checked.zone,
        checked.virtual,
    )


def suite_summary(checked: CheckedSuite) -> str:
    """Returns a summary for the terminal: the numbers of findings and the timetable."""
    counts = {kind: sum(item.severity == kind for item in checked.findings) for kind in ("error", "warning")}
    head = ", ".join(count_of(number, kind) for kind, number in counts.items())
    table = timetable_of(checked) if checked.ok else None
    lines = [] if table is None else timetable_lines(table, columns(sys.stdout))
    return "\n".join([f"{checked.file}: {head}", *lines])

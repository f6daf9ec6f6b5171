"""`planrunner check`: shows all findings on one or more plans or suites, then the expected results of each sound plan."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import date
from functools import partial
from pathlib import Path

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Finding, count_of
from planrunner.base.workers import ALONE, results_of
from planrunner.bench.attendance import check_unattended
from planrunner.bench.model import runs_on_virtual_clock, safe_order
from planrunner.cli import exit_codes
from planrunner.cli.arguments import add_workers, workers_of
from planrunner.cli.operator import add_attendance
from planrunner.cli.printing import columns, print_findings, print_json
from planrunner.cli.progress import reading_progress
from planrunner.cli.suites import add_suite_arguments, checked_suite, require_usable, suite_summary
from planrunner.plan.parameters import parameters_of
from planrunner.reporting.budgets import shown_unit
from planrunner.reporting.printable import printable
from planrunner.reporting.words import duration
from planrunner.tasks.check import Checked, Sound, check_plan
from planrunner.tasks.check_suite import is_suite


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plans", nargs="+", metavar="PLAN", help="plan files, or suite files for `planrunner night`")
    parser.add_argument("--bench", metavar="BENCH", help="check the plans with this bench: a shipped name or a file")
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=Path,
        help="folder that contains the recordings to play back: check the recording and try the estimates on it",
    )
    add_parameter(parser)
    add_workers(
        parser,
        "number of processes for several plans (default: as many as speed up the check, at most one per "
        "processor; 1 with --data)",
    )
    add_suite_arguments(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.add_argument("--json", action="store_true", help="print a list of findings as JSON")
    add_attendance(parser)
    parser.add_argument(
        "--runs",
        metavar="ARCHIVE",
        type=Path,
        default=Path("runs"),
        help="folder of the runs, for benches with a check standard (default: runs)",
    )


def run(args: argparse.Namespace) -> int:
    # Recordings are read one after the other, with progress, and none has to share the memory.
    workers = ALONE if args.data is not None else workers_of(args, None)
    require_usable(args)
    parameters_of(args.parameter)
    if workers.scheduler is None:
        answers = results_of(partial(_answer, args), args.plans, workers)
    else:
        bench = None if args.bench is None else Path(args.bench)
        found = results_of(
            partial(_answer_elsewhere, args, date.today()), [(Path(plan), bench) for plan in args.plans], workers
        )
        answers = [one or _answer(args, plan) for plan, one in zip(args.plans, found, strict=True)]
    if args.json:
        print_json([finding.to_json() for answer in answers for finding in answer.findings])
    else:
        for answer in answers:
            print_findings(answer.findings)
            print(answer.summary)
    return exit_codes.DONE if all(answer.ok for answer in answers) else exit_codes.WRONG_INPUT


@dataclass(frozen=True, slots=True)
class _Answer:
    """The result of checking a plan, ready for output. `summary`: text for the terminal; empty with the option `--json`."""

    findings: tuple[Finding, ...]
    ok: bool
    summary: str


def _answer_elsewhere(args: argparse.Namespace, today: date, files: tuple[Path, Path | None]) -> _Answer | None:
    """Checks a plan on a worker of a cluster. Returns None if the result depends on this computer, so that the plan must be checked
    here. `files`: the plan file, and the bench file if one was given."""
    plan, _ = files
    if is_suite(plan):
        return None  # its plans are shared
    checked = check_plan(plan, bench=args.bench, today=today, parameters=parameters_of(args.parameter))
    return _finished(args, checked) if checked.portable else None


def _answer(args: argparse.Namespace, plan: str) -> _Answer:
    if is_suite(Path(plan)):
        suite = checked_suite(args, Path(plan))
        return _Answer(tuple(suite.findings), suite.ok, "" if args.json else suite_summary(suite))
    return _finished(args, check_plan(Path(plan), bench=args.bench, parameters=parameters_of(args.parameter)))


def _finished(args: argparse.Namespace, checked: Checked) -> _Answer:
    if args.unattended and checked.bench is not None and checked.schedule is not None:
        check_unattended(checked.bench, checked.schedule, checked.findings)
    if checked.bench is not None and checked.bench.check_standard is not None:
        from planrunner.tasks.check_standard import check_before_run

        check_before_run(checked.bench, checked.name, args.runs, checked.findings)
    if args.data is not None and checked.models is not None and checked.models.replays:
        from planrunner.tasks.check_recording import check_recording

        with reading_progress(args.quiet) as notice:
            check_recording(checked, args.data, notice)
    said = "" if args.json else summary(checked, looked_over=args.data is not None)
    return _Answer(tuple(checked.findings), checked.ok, said)


def add_parameter(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--parameter",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="replace the value that has this name as its anchor (&NAME) in the plan",
    )


def sound_plan(plan: str, bench: str | None, parameters: Sequence[str] = ()) -> Sound:
    """Returns a plan that passes its checks. Prints its warnings. Raises `InputError` with all findings if there are errors."""
    sound = check_plan(Path(plan), bench=bench, parameters=parameters_of(parameters)).sound()
    print_findings(sound.findings)
    return sound


def summary(checked: Checked, looked_over: bool = True) -> str:
    """Returns a summary for the terminal: whether the plan is sound, the time that it takes, and the expected uncertainties.
    `looked_over`: True if the check also examined a recording that the bench plays back."""
    errors, warnings = (
        sum(finding.severity == severity for finding in checked.findings) for severity in ("error", "warning")
    )
    head = f"{checked.file}: {count_of(errors, 'error')}, {count_of(warnings, 'warning')}"
    if not checked.ok or checked.schedule is None or checked.bench is None:
        return head
    count = len(checked.schedule.segments)
    open_ended = any(segment.dwell is None for segment in checked.schedule.segments)
    total = "length of the recording" if open_ended else duration(checked.schedule.total)
    lines = [f"{head}; {count_of(count, 'segment')} on bench '{checked.bench.name}', {total}"]
    for name, design in checked.designs.items():
        for judged in checked.judged[name]:
            lines.append(
                f"  {name}, output {judged.output}: rank {judged.rank} of {judged.columns}, condition "
                f"{judged.condition:.3g}"
            )
        if design.predicted:
            lines.append(f"  {name}: expected standard uncertainties")
            lines.append(
                _columns(
                    [
                        (item.name, f"{item.standard_uncertainty:.2g} {shown_unit(item.unit)}")
                        for item in design.predicted
                    ]
                )
            )
    if not looked_over and checked.models is not None and checked.models.replays:
        lines.append("  the recording was not checked: add --data DIR")
    prompts = sum(len(segment.prompts) for segment in checked.schedule.segments)
    if prompts and not runs_on_virtual_clock(checked.bench):
        lines.append(f"  asks the operator {count_of(prompts, 'time')}")
    if checked.approvals is not None:
        names = ", ".join(one.name for one in checked.approvals.approvals)
        lines.append(f"  approved by {printable(names, keep='')}")
    lines.append("  safe state in this order: " + ", ".join(safe_order(checked.bench)))
    return "\n".join(lines)


def _columns(pairs: list[tuple[str, str]]) -> str:
    """Writes pairs of texts in columns, with three pairs on a line, or fewer if the terminal is too narrow."""
    wide = [max(len(name) for name, _ in pairs), max(len(text) for _, text in pairs)]
    cells = [f"{name:<{wide[0]}} {text:<{wide[1]}}" for name, text in pairs]
    across = max(1, min(3, (columns(sys.stdout) - 1) // (sum(wide) + 4)))
    return "\n".join("    " + "   ".join(cells[row : row + across]).rstrip() for row in range(0, len(cells), across))

"""`planrunner design` of a plan whose segment goes through a cycle of turns and stops."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner import cli
from planrunner.cli.printing import print_findings, print_json, printable, write_file
from planrunner.estimators.interface import EstimationError

if TYPE_CHECKING:
    from planrunner.designing_cycles import CycleStudy
    from planrunner.reporting.cycle_page import CycleContext


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--segment",
        metavar="LABEL",
        help="design this segment's cycle of turns and stops (default: where no estimate's positions can be designed)",
    )
    parser.add_argument(
        "--order",
        choices=("free", "same"),
        default="free",
        help="which cycle goes into the plan: with a free or with the same order of stops (default: free)",
    )


def wanted(args: argparse.Namespace) -> bool:
    """Whether a cycle is to be designed: where a segment is named, or the plan holds nothing else to design."""
    from planrunner.checking import check_plan
    from planrunner.designing_cycles import has_cycle_alone

    if args.segment is not None:
        return True
    return args.estimate is None and has_cycle_alone(check_plan(Path(args.plan), bench=args.bench))


def run(args: argparse.Namespace) -> int:
    from planrunner.designed_plan import write_plan
    from planrunner.designing_cycles import CycleOptions, design_cycle

    study = design_cycle(Path(args.plan), CycleOptions(args.segment, args.order), args.bench)
    print_findings(study.checked.findings)
    context = _context(study)
    if args.json:
        from planrunner.reporting.cycle_page import to_json

        print_json(to_json(context))
    else:
        _print(context)
    if args.html is not None:
        from planrunner.reporting.cycle_page import render_cycles

        write_file(args.html, render_cycles(context))
        print(args.html, file=sys.stderr if args.json else sys.stdout)
    if args.write is not None:
        if not study.text:
            reason = study.reasons.get(study.chosen, "none was found")
            raise EstimationError(f"there is no cycle with the {study.chosen} of stops to write: {reason}")
        print_findings(write_plan(study, args.write, args.bench).findings)
        print(args.write, file=sys.stderr if args.json else sys.stdout)
    return cli.DONE


def _context(study: CycleStudy) -> CycleContext:
    from planrunner.reporting.context import site_facts
    from planrunner.reporting.cycle_page import CycleContext

    checked = study.checked
    assert checked.plan is not None and checked.bench is not None and checked.models is not None
    return CycleContext(
        checked.plan.title,
        study.segment.label,
        study.axis.name,
        study.cycles,
        study.searches,
        study.reasons,
        study.chosen,
        {"Plan": checked.file, "Bench": checked.bench.name, **site_facts(checked.models.site)},
    )


def _print(context: CycleContext) -> None:
    from planrunner.reporting import cycle_page, terminal

    console = terminal.console()
    said = cycle_page.facts(context)
    console.print(printable(f"cycle of '{context.label}': stops of {said['Stops']}, turns at {said['Turns']}"))
    for table in cycle_page.tables(context):
        console.print(terminal.data_table(table))
    for note in cycle_page.notes(context):
        console.print(printable(f"note: {note}"), style="dim")

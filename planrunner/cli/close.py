"""`planrunner close`: repeats four steps until no remaining difference can be attributed to a named effect. The steps are to
diagnose, to enter the effects found into the simulation, to simulate, and to compare."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.documents import JsonObject
from planrunner.cli import exit_codes
from planrunner.cli.arguments import whole_number
from planrunner.cli.diagnose import add_nominal, add_recording, context_of, options_of, recorded_of
from planrunner.cli.printing import print_findings, print_json, write_file, write_named
from planrunner.cli.progress import reading_progress

if TYPE_CHECKING:
    from planrunner.tasks.closing import Closed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_recording(parser)
    add_nominal(parser)
    parser.add_argument(
        "--simulation",
        metavar="BENCH",
        help="the virtual bench that simulates the plan (default: that of the recording; for a file, the recorded motion is simulated)",
    )
    parser.add_argument(
        "--rounds",
        metavar="N",
        type=whole_number("the number", 1, 50),
        help="the largest number of rounds (default: 6)",
    )
    parser.add_argument("--write-bench", metavar="FILE", type=Path, help="write the bench with all effects found")
    parser.add_argument(
        "--html", metavar="FILE", type=Path, help="write a page with the first diagnosis and the last comparison"
    )
    parser.add_argument("--json", action="store_true", help="print the rounds as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner.execution.stopping import StopRequest
    from planrunner.tasks.closing import ROUNDS, close

    with reading_progress() as notice, StopRequest() as stop:
        recorded = recorded_of(args, notice)
        print_findings(recorded.remarks)
        rounds = ROUNDS if args.rounds is None else args.rounds
        closed = close(recorded, stop, args.simulation, options_of(args.nominal), rounds, notice)
    print_findings(closed.first.findings)
    found = closed.first.to_json()
    if closed.rounds:
        found["comparison"] = closed.rounds[-1].comparison.to_json()
    if args.json:
        print_json(_plain(closed))
    else:
        _show(closed, found)
    if args.html is not None:
        from planrunner.reporting.diagnosis_page import render_page

        write_named(args.html, render_page(context_of(closed.first, found, "")), args.json)
    if args.write_bench is not None:
        out = sys.stderr if args.json else sys.stdout
        if closed.bench:
            write_file(args.write_bench, closed.bench)
            print(args.write_bench, file=out)
        else:
            why = "No bench simulated the recording" if closed.stated else "No effect was added"
            print(f"{why}: {args.write_bench} is not written.", file=out)
    return exit_codes.DONE


def _plain(closed: Closed) -> JsonObject:
    return {
        "planrunner_close": 1,
        "rounds": [
            {
                "effects": list(one.made.diagnosis.verdict.named),
                "named": [item.to_json() for item in one.made.advice()],
                "before_sigma": one.comparison.before_sigma,
                "after_sigma": one.comparison.after_sigma,
            }
            for one in closed.rounds
        ],
        "entered": dict(closed.stated),
        "comparison": closed.rounds[-1].comparison.to_json() if closed.rounds else None,
        "left": closed.last.diagnosis.verdict.kind,
        "ending": closed.ending.name.lower(),
    }


def _show(closed: Closed, found: JsonObject) -> None:
    from planrunner.reporting import diagnosis_page, terminal

    console = terminal.console()
    for number, one in enumerate(closed.rounds, start=1):
        for item in one.made.advice():
            console.print(
                f"Round {number}: {item.name} ({item.effect}). Where to correct: {item.actor.value}.", style="bold"
            )
            console.print(f"  {item.remedy}")
        before, after = one.comparison.before_sigma, one.comparison.after_sigma
        console.print(
            f"  Without the added effects, the gap was {before:.3g} standard deviations of the noise; it is now {after:.3g}."
        )
    if closed.rounds:
        console.print(terminal.data_table(diagnosis_page.comparison(found)))
    console.print(f"Ended: {closed.ending.value}.", style="bold")

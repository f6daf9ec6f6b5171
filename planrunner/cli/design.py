"""`planrunner design`: finds better positions or rates for a plan on its bench, and a bound that no design can exceed. The command
can also find a better rotation cycle.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.cli import exit_codes
from planrunner.cli.arguments import add_workers, workers_of
from planrunner.cli.check import add_parameter
from planrunner.cli.printing import print_findings, print_json, write_named
from planrunner.estimators.interface import EstimationError
from planrunner.plan.parameters import parameters_of
from planrunner.plan.quantity import QuantityError, without_uncertainty
from planrunner.reporting.printable import beneath

if TYPE_CHECKING:
    from planrunner.design.study import Study

PATIENCE = 2.0
"""Time before progress is shown, s."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PLAN", help="plan file")
    parser.add_argument("--bench", metavar="BENCH", help="design for this bench: a shipped name or a file")
    add_parameter(parser)
    parser.add_argument(
        "--estimate", metavar="NAME", help="design for this estimate (default: the first that can be designed)"
    )
    parser.add_argument(
        "--criterion",
        choices=("D", "A", "G", "I"),
        default="D",
        help="optimality criterion (default: D; rates: D or A)",
    )
    parser.add_argument(
        "--time",
        metavar="DURATION",
        help="total time of the plan, such as '45 min'; the dwell times are distributed so that the plan takes this time",
    )
    parser.add_argument("--output", metavar="NAME", help="design for this output, if the outputs have different terms")
    parser.add_argument(
        "--orientations",
        choices=("free", "cardinal", "planned"),
        default="free",
        help="set of orientations to write into the plan (default: free)",
    )
    parser.add_argument(
        "--restarts", type=int, default=8, help="number of starting points of the free search (default: 8)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (default: 0)")
    parser.add_argument(
        "--rates",
        action="store_true",
        help="design the rates of a sweep (done by default if an estimate fits a line over rates)",
    )
    parser.add_argument(
        "--line-only",
        action="store_true",
        help="rates: design only for the straight line, without asymmetry and nonlinearity",
    )
    parser.add_argument("--drop-lowest", action="store_true", help="rates: the design may omit the lowest planned rate")
    parser.add_argument(
        "--segment",
        metavar="LABEL",
        help="design this segment's cycle of turns and stops (by default, a cycle is designed if no estimate has positions that can be "
        "designed)",
    )
    parser.add_argument(
        "--order",
        choices=("free", "same"),
        default="free",
        help="cycle to write into the plan: with any order of the stops (free), or with the planned order (same; default: free)",
    )
    parser.add_argument("--write", metavar="FILE", type=Path, help="write the plan with the chosen design")
    parser.add_argument("--html", metavar="FILE", type=Path, help="write a page with pictures before and after")
    add_workers(parser, "number of processes for the search (default: 1)")
    parser.add_argument("--json", action="store_true", help="print the study as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    # The searches solve many tiny systems, where threads of the linear algebra only wait for each other. The setting is read when scipy is
    # loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from planrunner.design.study import Asked
    from planrunner.tasks.design import design

    asked = Asked(
        args.estimate, args.criterion, _seconds(args.time), args.output, args.orientations, args.restarts, args.seed,
        args.rates, args.line_only, not args.drop_lowest, args.segment, args.order,
    )  # fmt: skip
    with _progress(args.quiet) as progress:
        study = design(Path(args.plan), asked, args.bench, progress, workers_of(args), parameters_of(args.parameter))
    print_findings(study.subject.findings)
    if not args.json:
        _show(study)
    _write(args, study)
    if args.json:
        print_json(study.data)
    return exit_codes.DONE


def _show(study: Study) -> None:
    from planrunner.reporting import terminal

    console = terminal.console()
    console.print(study.heading)
    for table in study.tables:
        console.print(terminal.data_table(table))
    for note in study.notes:
        console.print(f"note: {note}", style="dim")


def _write(args: argparse.Namespace, study: Study) -> None:
    """Writes the page of the study and the improved plan, if the user requests them."""
    out = sys.stderr if args.json else sys.stdout
    if args.html is not None:
        from planrunner.reporting.study_page import render_page

        write_named(args.html, render_page(study), args.json)
    if args.write is not None:
        from planrunner.tasks.design import write_plan

        if not study.text:
            raise EstimationError(study.missing)
        print_findings(write_plan(study.text, study.subject.file, args.write, args.bench).findings)
        print(args.write, file=out)


def _seconds(text: str | None) -> float | None:
    if text is None:
        return None
    try:
        return without_uncertainty(text, "time").value
    except QuantityError as error:
        raise EstimationError(f"--time: {error}") from None


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str, float], None] | None]:
    """Prints one line for each stage on stderr if the search takes longer than a moment."""
    if quiet:
        yield None
        return
    begun = time.monotonic()
    out = beneath(sys.stderr)
    terminal = out.isatty()
    last = [begun]

    def take(stage: str, fraction: float) -> None:
        now = time.monotonic()
        if now - begun < PATIENCE or now - last[0] < (0.2 if terminal else 5.0):
            return
        last[0] = now
        print(f"\r\033[K{stage}: {fraction:.0%}" if terminal else f"{stage}: {fraction:.0%}",
              end="" if terminal else "\n", file=out, flush=True)  # fmt: skip

    yield take
    if terminal:
        print("\r\033[K", end="", file=out, flush=True)

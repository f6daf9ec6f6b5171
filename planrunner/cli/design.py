"""`planrunner design`: better positions for a plan, on its bench, and what no positions can pass; or a better rotation cycle."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner import cli
from planrunner.cli import design_cycle
from planrunner.cli.printing import print_findings, print_json, write_file
from planrunner.estimators.interface import EstimationError
from planrunner.plan.quantity import QuantityError, parse_quantity

if TYPE_CHECKING:
    from planrunner.designing import Study
    from planrunner.reporting.design_page import DesignContext

PATIENCE = 2.0
"""Seconds before progress is shown."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PLAN", help="plan file")
    parser.add_argument("--bench", metavar="BENCH", help="design for this bench: a shipped name or a file")
    parser.add_argument("--estimate", metavar="NAME", help="design for this estimate (default: the first that can be)")
    parser.add_argument("--output", metavar="NAME", help="of this output, where the outputs see different things")
    parser.add_argument(
        "--criterion", choices=("D", "A", "G", "I"), default="D", help="what to search for (default: D)"
    )
    parser.add_argument(
        "--orientations",
        choices=("free", "cardinal", "planned"),
        default="free",
        help="which set goes into the plan (default: free)",
    )
    parser.add_argument(
        "--time", metavar="DURATION", help="the whole plan's time, such as '45 min': allot dwells within it"
    )
    parser.add_argument("--restarts", type=int, default=8, help="seeded starts of the free search (default: 8)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (default: 0)")
    design_cycle.add_arguments(parser)
    parser.add_argument("--write", metavar="FILE", type=Path, help="write the plan with the new positions or cycle")
    parser.add_argument("--html", metavar="FILE", type=Path, help="write a page with pictures before and after")
    parser.add_argument("--json", action="store_true", help="print the study as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    if design_cycle.wanted(args):
        return design_cycle.run(args)
    # The searches solve many tiny systems: threads of the linear algebra only wait for each other. It reads this as scipy is loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from planrunner.designed_plan import write_plan
    from planrunner.designing import Options, design_plan

    if args.restarts < 1 or args.seed < 0:
        raise EstimationError("--restarts is at least 1 and --seed at least 0")
    options = Options(
        args.estimate, args.output, args.criterion, args.orientations, _seconds(args.time), args.restarts, args.seed
    )
    with _progress(args.quiet) as progress:
        study = design_plan(Path(args.plan), options, args.bench, progress)
    print_findings(study.checked.findings)
    context = _context(study)
    if args.json:
        from planrunner.reporting.design_page import to_json

        print_json(to_json(context))
    else:
        _print(context)
    if args.html is not None:
        from planrunner.reporting.design_page import render_design

        write_file(args.html, render_design(context))
        print(args.html, file=sys.stderr if args.json else sys.stdout)
    if args.write is not None:
        print_findings(write_plan(study, args.write, args.bench).findings)
        print(args.write, file=sys.stderr if args.json else sys.stdout)
    return cli.DONE


def _seconds(text: str | None) -> float | None:
    if text is None:
        return None
    try:
        return parse_quantity(text, "time").value
    except QuantityError as error:
        raise EstimationError(f"--time: {error}") from None


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str, float], None] | None]:
    """A line a stage on standard error once the search takes longer than a moment."""
    if quiet:
        yield None
        return
    begun = time.monotonic()
    terminal = sys.stderr.isatty()
    last = [begun]

    def take(stage: str, fraction: float) -> None:
        now = time.monotonic()
        if now - begun < PATIENCE or now - last[0] < (0.2 if terminal else 5.0):
            return
        last[0] = now
        print(f"\r\033[K{stage}: {fraction:.0%}" if terminal else f"{stage}: {fraction:.0%}",
              end="" if terminal else "\n", file=sys.stderr, flush=True)  # fmt: skip

    yield take
    if terminal:
        print("\r\033[K", end="", file=sys.stderr, flush=True)


def _context(study: Study) -> DesignContext:
    from planrunner.designing import residual_ratios
    from planrunner.reporting.context import site_facts
    from planrunner.reporting.design_page import DesignContext, DesignedSet

    checked = study.checked
    assert checked.plan is not None and checked.bench is not None and checked.models is not None
    sets = {}
    for name, one in study.sets.items():
        design = one.designs.get(study.sight.name)
        sets[name] = DesignedSet(
            tuple(place.label for place in study.places),
            one.texts,
            one.attitudes,
            one.merit,
            one.of_found,
            one.of_bound,
            one.of_cardinal,
            one.schedule.total,
            residual_ratios(study, name),
            design.predicted if design is not None else (),
        )
    claims = [
        note
        for name, design in study.sets["planned"].designs.items()
        if name != study.sight.name and not design.blocks
        for note in design.notes
    ]
    return DesignContext(
        checked.plan.title,
        study.sight.name,
        study.sight.others,
        study.sight.terms,
        study.options.criterion,
        study.options.orientations,
        sets,
        study.best,
        {name: one.merit for name, one in study.bounds.items()},
        {name: one.certificate for name, one in study.bounds.items()},
        study.search,
        study.dwells,
        study.dwell_gain,
        {"Plan": checked.file, "Bench": checked.bench.name, **site_facts(checked.models.site)},
        tuple(claims),
    )


def _print(context: DesignContext) -> None:
    from planrunner.cli.printing import printable
    from planrunner.reporting import design_page, terminal

    console = terminal.console()
    console.print(printable(f"{context.estimate}: {design_page.facts(context)['Searched for']}; {context.search}"))
    for table in design_page.tables(context):
        console.print(terminal.data_table(table))
    for note in (*context.notes, *design_page.notes(context)):
        console.print(printable(f"note: {note}"), style="dim")

"""`planrunner design`: better positions or rates for a plan on its bench, with the bound that no design can exceed; or a better rotation
cycle.

One module a kind of study (`design_positions`, `design_rates`, `design_cycle`) makes it and says what its page is given; here it is chosen
and shown.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from planrunner.cli import design_cycle, design_positions, design_rates, exit_codes
from planrunner.cli.printing import print_findings, print_json, write_file
from planrunner.estimators.interface import EstimationError
from planrunner.plan.quantity import QuantityError, without_uncertainty
from planrunner.reporting.printable import beneath

PATIENCE = 2.0
"""Seconds before progress is shown."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PLAN", help="plan file")
    parser.add_argument("--bench", metavar="BENCH", help="design for this bench: a shipped name or a file")
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
        help="total time of the plan, such as '45 min': distribute the dwell times within it",
    )
    design_positions.add_arguments(parser)
    design_rates.add_arguments(parser)
    design_cycle.add_arguments(parser)
    parser.add_argument("--write", metavar="FILE", type=Path, help="write the plan with the chosen design")
    parser.add_argument("--html", metavar="FILE", type=Path, help="write a page with pictures before and after")
    parser.add_argument("--json", action="store_true", help="print the study as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    # The searches solve many tiny systems, where threads of the linear algebra only wait for each other. The setting is read when scipy is
    # loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    kind = _kind(args)
    with _progress(args.quiet) as progress:
        study: Any = kind.study(args, _seconds(args.time), progress)
    print_findings(study.checked.findings)
    context, page = kind.context(study), _page(kind)
    if not args.json:
        _show(context, page)
    _write(args, kind, study, context, page)
    if args.json:
        print_json(page.to_json(context))
    return exit_codes.DONE


def _kind(args: argparse.Namespace) -> ModuleType:
    """The kind of study for a plan and the options: positions if any estimate uses segments at rest."""
    if args.segment is not None:
        return design_cycle
    if args.rates:
        return design_rates
    from planrunner.tasks.check import check_plan
    from planrunner.tasks.design_cycles import has_cycle_alone
    from planrunner.tasks.design_rates import has_rates_alone

    checked = check_plan(Path(args.plan), bench=args.bench)
    if has_rates_alone(checked, args.estimate):
        return design_rates
    return design_cycle if args.estimate is None and has_cycle_alone(checked) else design_positions


def _page(kind: ModuleType) -> ModuleType:
    from planrunner.reporting import cycle_page, design_page, rates_page

    return {design_positions: design_page, design_rates: rates_page, design_cycle: cycle_page}[kind]


def _show(context: Any, page: ModuleType) -> None:
    from planrunner.reporting import terminal

    console = terminal.console()
    console.print(page.heading(context))
    for table in page.tables(context):
        console.print(terminal.data_table(table))
    for note in page.notes(context):
        console.print(f"note: {note}", style="dim")


def _write(args: argparse.Namespace, kind: ModuleType, study: Any, context: Any, page: ModuleType) -> None:
    """Write the page and the plan, if requested."""
    out = sys.stderr if args.json else sys.stdout
    if args.html is not None:
        write_file(args.html, page.render_page(context))
        print(args.html, file=out)
    if args.write is not None:
        from planrunner.tasks.designed_plan import write_plan

        if not study.text:
            raise EstimationError(kind.missing(study))
        print_findings(write_plan(study, args.write, args.bench).findings)
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
    """One line per stage on standard error if the search takes longer than a moment."""
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

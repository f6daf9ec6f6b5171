"""`planrunner show`: what a plan would do: timeline, positions, rates, temperatures, total time, predicted uncertainties."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner import cli
from planrunner.checking import check_plan
from planrunner.cli.check import require_sound


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PLAN", help="plan file")
    parser.add_argument("--bench", metavar="BENCH", help="show it on this bench: a shipped name or a file")
    parser.add_argument("--html", metavar="FILE", type=Path, help="write a page with a picture of every orientation")


def run(args: argparse.Namespace) -> int:
    checked = check_plan(Path(args.plan), bench=args.bench)
    require_sound(checked)
    assert (
        checked.plan is not None
        and checked.schedule is not None
        and checked.models is not None
        and checked.bench is not None
    )
    if args.html is not None:
        from planrunner.reporting.context import site_facts
        from planrunner.reporting.show_page import ShowContext, render_show

        context = ShowContext(
            title=checked.plan.title,
            description=checked.plan.description,
            schedule=checked.schedule,
            designs=checked.designs,
            facts={"Plan": checked.file, "Bench": checked.bench.name, **site_facts(checked.models.site)},
            warnings=tuple(finding.message for finding in checked.findings if finding.severity == "warning"),
        )
        args.html.write_text(render_show(context), encoding="utf-8")
        print(args.html)
        return cli.DONE
    from planrunner.reporting import terminal

    console = terminal.console()
    console.print(terminal.schedule_table(checked.schedule, checked.plan.title))
    for name, design in checked.designs.items():
        if design.predicted:
            console.print(terminal.predicted_table(name, design))
    return cli.DONE

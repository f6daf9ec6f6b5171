"""`planrunner show`: shows what a plan does: its timeline, positions, rates, temperatures and total time, and the predicted
uncertainties."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.bench.model import safe_order
from planrunner.cli import exit_codes
from planrunner.cli.check import sound_plan
from planrunner.cli.printing import print_json, write_named


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PLAN", help="plan file")
    parser.add_argument("--bench", metavar="BENCH", help="show the plan on this bench: a shipped name or a file")
    parser.add_argument("--html", metavar="FILE", type=Path, help="write a page with a picture of every orientation")
    parser.add_argument("--json", action="store_true", help="print timeline and predicted uncertainties as JSON")


def run(args: argparse.Namespace) -> int:
    sound = sound_plan(args.plan, args.bench)
    order = ", ".join(safe_order(sound.bench))
    if args.html is not None:
        from planrunner.reporting.context import site_facts
        from planrunner.reporting.show_page import ShowContext, render_show

        context = ShowContext(
            title=sound.plan.title,
            description=sound.plan.description,
            schedule=sound.schedule,
            designs=sound.designs,
            facts={
                "Plan": sound.file,
                "Bench": sound.bench.name,
                **site_facts(sound.models.site),
                "Safe state, in this order": order,
            },
            warnings=tuple(finding.message for finding in sound.findings if finding.severity == "warning"),
        )
        write_named(args.html, render_show(context), args.json)
    if args.json:
        from planrunner.reporting.show_page import show_json

        print_json(
            {
                "plan": sound.file,
                "title": sound.plan.title,
                "bench": sound.bench.name,
                **show_json(sound.schedule, sound.designs),
                "safe_order": list(safe_order(sound.bench)),
                "findings": [finding.to_json() for finding in sound.findings],
            }
        )
    if args.html is not None or args.json:
        return exit_codes.DONE
    from planrunner.reporting import terminal

    console = terminal.console()
    console.print(terminal.schedule_table(sound.schedule, sound.plan.title))
    for name, design in sound.designs.items():
        if design.predicted:
            console.print(terminal.predicted_table(name, design))
    print(f"Safe state in this order: {order}")
    return exit_codes.DONE

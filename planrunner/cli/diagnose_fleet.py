"""`planrunner diagnose RUN RUN …`: determines whether the effects in the runs come from the device, the bench or the occasion."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.documents import JsonObject
from planrunner.base.findings import COMMAND_LINE, InputError
from planrunner.base.processes import processors
from planrunner.cli import exit_codes
from planrunner.cli.arguments import workers_of
from planrunner.cli.printing import name_file, print_findings, print_json, write_file
from planrunner.cli.progress import reading_progress

if TYPE_CHECKING:
    from planrunner.instruments.models import DataOrigin

_ONE_RUN = ("bench", "recording", "segments", "also", "next", "write_plan", "write_bench", "simulation", "compare")
"""Options that are allowed for a single run only."""


def run_fleet(args: argparse.Namespace, runs: list[Path], nominal: tuple[str, ...] | None) -> int:
    """Diagnoses several runs together and prints the attribution. `nominal`: the terms that the simulations fit; None to use the
    terms that the plans state. Raises `InputError` for options that apply only to a single run."""
    from planrunner.tasks.diagnose_fleet import diagnose_fleet

    given = [f"--{name.replace('_', '-')}" for name in _ONE_RUN if vars(args).get(name)]
    if given:
        message = f"{', '.join(given)} cannot be given with several runs"
        raise InputError.at(COMMAND_LINE, "gap-arguments", message, "diagnose one run at a time with these options")
    with reading_progress() as notice:
        made = diagnose_fleet(runs, nominal, args.origins, workers_of(args, processors()), notice)
    print_findings(made.findings)
    found = made.to_json()
    if args.html is not None:
        from planrunner.reporting.fleet_page import render_page

        remarks = [f"{finding.message}: {finding.hint}" for finding in made.findings]
        write_file(args.html, render_page(found, remarks, made.origin))
    if args.json:
        print_json(found)
    else:
        _show(found, made.origin)
    if args.html is not None:
        name_file(args.html, args.json)
    return exit_codes.DONE


def _show(found: JsonObject, origin: DataOrigin | None) -> None:
    from planrunner.reporting import fleet_page, terminal
    from planrunner.reporting.verdict import stamp

    console = terminal.console()
    mark = stamp(origin)
    if mark is not None and mark.alarming:
        console.print(f"{mark.word}: {mark.about}", style="bold red")
    for sentence in fleet_page.sentences(found) or ["No amplitude is attributed to a source."]:
        console.print(sentence, style="bold")
    for sentence in fleet_page.limits(found):
        console.print(sentence)
    for table in fleet_page.tables(found).values():
        console.print(terminal.data_table(table))
    console.print(fleet_page.PRIORS, style="dim")

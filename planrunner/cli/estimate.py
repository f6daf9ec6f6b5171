"""`planrunner estimate`: estimates from recordings only, as a new analysis of each run."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from planrunner.cli.each_run import Done, add_runs, each_run
from planrunner.cli.outcome import conclude
from planrunner.cli.progress import reading_progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_runs(parser)
    parser.add_argument("--json", action="store_true", help="print a list of results as JSON, one entry per run")


def run(args: argparse.Namespace) -> int:
    return each_run(args.runs, lambda folder: _estimate(folder, as_json=args.json), as_json=args.json)


def _estimate(folder: Path, *, as_json: bool) -> Done:
    from planrunner.tasks import run as running

    with reading_progress() as notice:
        analysis = running.analyse_run(folder, notice=notice)
    if analysis.before is not None:
        verdict = "the same numbers as" if analysis.same else "OTHER NUMBERS than"
        print(f"analysis {analysis.folder.name} has {verdict} analysis {analysis.before}", file=sys.stderr)
    return conclude(analysis, as_json=as_json)

"""`planrunner amend`: evaluates a run again and stores a new analysis with the person, the time and the reason. The earlier
analyses are kept."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from planrunner.cli.each_run import Done, each_run
from planrunner.cli.outcome import conclude
from planrunner.cli.progress import reading_progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="run folder")
    parser.add_argument("--why", required=True, metavar="TEXT", help="the reason")
    parser.add_argument("--by", required=True, metavar="NAME", help="the person who amends")
    parser.add_argument(
        "--plan", metavar="FILE", type=Path, help="copy of the run's plan with other estimates or limits"
    )
    parser.add_argument("--analysis", type=int, metavar="N", help="the analysis to amend (default: the newest)")
    parser.add_argument("--json", action="store_true", help="print a list of results as JSON, with one entry")


def run(args: argparse.Namespace) -> int:
    return each_run([args.run_folder], lambda folder: _amend(folder, args), as_json=args.json)


def _amend(folder: Path, args: argparse.Namespace) -> Done:
    from planrunner.plan import source
    from planrunner.tasks.amendment import Amendment
    from planrunner.tasks.check import Document
    from planrunner.tasks.estimate import analyse_run

    plan = None if args.plan is None else Document(source.read_bytes(args.plan), str(args.plan))
    amendment = Amendment(args.by, args.why, plan, args.analysis)
    with reading_progress() as notice:
        analysis = analyse_run(folder, notice=notice, amendment=amendment)
    verdict = "the same numbers as" if analysis.same else "other numbers than"
    print(f"analysis {analysis.folder.name} has {verdict} analysis {analysis.before}", file=sys.stderr)
    return conclude(analysis, as_json=args.json)

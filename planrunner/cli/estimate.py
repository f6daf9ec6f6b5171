"""`planrunner estimate`: estimates from recordings only, as a new analysis of each run, or as a proof of a stored one."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from planrunner.base.findings import COMMAND_LINE, InputError
from planrunner.cli import exit_codes
from planrunner.cli.each_run import Done, add_runs, each_run
from planrunner.cli.outcome import conclude
from planrunner.cli.progress import reading_progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_runs(parser)
    parser.add_argument(
        "--prove",
        action="store_true",
        help="recompute the newest analysis with its own settings, and say whether every number is the stored one; nothing is written",
    )
    parser.add_argument("--analysis", type=int, metavar="N", help="with --prove: number of the analysis")
    parser.add_argument("--json", action="store_true", help="print a list of results as JSON, one entry per run")


def run(args: argparse.Namespace) -> int:
    if args.prove:
        return each_run(args.runs, lambda folder: _prove(folder, args.analysis, as_json=args.json), as_json=args.json)
    if args.analysis is not None:
        raise InputError.at(COMMAND_LINE, "command-usage", "--analysis belongs to --prove", "add --prove")
    return each_run(args.runs, lambda folder: _estimate(folder, as_json=args.json), as_json=args.json)


def _estimate(folder: Path, *, as_json: bool) -> Done:
    from planrunner.tasks import run as running

    with reading_progress() as notice:
        analysis = running.analyse_run(folder, notice=notice)
    if analysis.before is not None:
        verdict = "the same numbers as" if analysis.same else "OTHER NUMBERS than"
        print(f"analysis {analysis.folder.name} has {verdict} analysis {analysis.before}", file=sys.stderr)
    return conclude(analysis, as_json=as_json)


def _prove(folder: Path, number: int | None, *, as_json: bool) -> Done:
    from planrunner.tasks.prove import TOLERANCE, prove

    with reading_progress() as notice:
        proof = prove(folder, number, notice)
    if not as_json:
        print(f"analysis {proof.analysis}: {_PROVED[proof.verdict].format(tolerance=TOLERANCE)}")
        if proof.verdict != "identical" and proof.largest_of:
            print(f"    largest change: {proof.largest:.2g} of the standard uncertainty of {proof.largest_of}")
        for name, (then, now) in proof.changed.items():
            print(f"    {name}: {then or 'not recorded'} then, {now or 'not installed'} now")
    return Done(exit_codes.INTEGRITY if proof.verdict == "different" else exit_codes.DONE, proof.to_json())


_PROVED = {
    "identical": "recomputed from the samples; every number is bit for bit the stored one",
    "within tolerance": "recomputed from the samples with other versions; no number changes by more than {tolerance:g} of its standard "
    "uncertainty",
    "different": "NOT REPRODUCED: the samples do not give the stored results",
}

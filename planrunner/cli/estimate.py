"""`planrunner estimate`: makes estimates from stored recordings. The result is a new analysis of each run, or a proof that a stored
analysis can be reproduced."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.findings import InputError
from planrunner.base.workers import ALONE, Workers
from planrunner.cli import exit_codes
from planrunner.cli.arguments import add_workers, folder_argument, workers_of
from planrunner.cli.each_run import Done, add_runs, each_result, each_run, runs_of
from planrunner.cli.outcome import conclude
from planrunner.cli.progress import reading_progress

if TYPE_CHECKING:
    from planrunner.tasks.estimate import Evaluated
    from planrunner.tasks.prove import Proof


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_runs(parser, folder_argument)
    parser.add_argument("--all", action="store_true", help="RUN is an archive: estimate every run folder in it")
    parser.add_argument(
        "--prove",
        action="store_true",
        help="recompute the newest analysis with its own settings, and report whether every number is identical "
        "to the stored number; nothing is written",
    )
    parser.add_argument("--analysis", type=int, metavar="N", help="with --prove: number of the analysis")
    add_workers(
        parser, "number of processes for several runs, or for the Monte Carlo draws of a single run (default: 1)"
    )
    parser.add_argument("--json", action="store_true", help="print a list of results as JSON, one entry per run")


def run(args: argparse.Namespace) -> int:
    if args.analysis is not None and not args.prove:
        raise InputError.of_usage("--analysis belongs to --prove", "add --prove")
    workers = workers_of(args)
    runs = runs_of(args)
    if args.prove:
        show = partial(_show_proof, as_json=args.json)
        if len(runs) == 1:
            return each_run(runs, lambda folder: show(_proved(args.analysis, folder, workers)), as_json=args.json)
        work = partial(_proved, args.analysis)
        return each_result(runs, work, show, workers, what="recomputing the runs", as_json=args.json)
    if len(runs) == 1:
        return each_run(runs, lambda folder: _estimate(folder, workers, as_json=args.json), as_json=args.json)
    from planrunner.tasks.estimate import evaluate_run

    keep = partial(_keep, as_json=args.json, elsewhere=workers.scheduler is not None)
    return each_result(runs, evaluate_run, keep, workers, what="estimating the runs", as_json=args.json)


def _estimate(folder: Path, workers: Workers, *, as_json: bool) -> Done:
    """Makes the estimates of one run and shows the progress of reading the samples. The workers share the Monte Carlo draws."""
    from planrunner.tasks.estimate import evaluate_run

    with reading_progress() as notice:
        made = evaluate_run(folder, notice=notice, workers=workers)
    return _keep(made, as_json=as_json, elsewhere=workers.scheduler is not None)


def _keep(made: Evaluated, *, as_json: bool, elsewhere: bool = False) -> Done:
    from planrunner.archive.remote import push_back
    from planrunner.tasks.estimate import keep

    analysis = keep(made, elsewhere=elsewhere)
    push_back(made.run, analysis.folder)
    if analysis.before is not None:
        verdict = "the same numbers as" if analysis.same else "OTHER NUMBERS than"
        print(f"analysis {analysis.folder.name} has {verdict} analysis {analysis.before}", file=sys.stderr)
    return conclude(analysis, as_json=as_json)


def _proved(number: int | None, folder: Path, workers: Workers = ALONE) -> Proof:
    from planrunner.tasks.prove import prove

    return prove(folder, number, workers=workers)


def _show_proof(proof: Proof, *, as_json: bool) -> Done:
    from planrunner.tasks.prove import TOLERANCE

    if not as_json:
        only_texts = proof.only_texts and proof.verdict == "different"
        text = _ONLY_TEXTS if only_texts else _PROVED[proof.verdict].format(tolerance=TOLERANCE)
        print(f"analysis {proof.analysis}: {text}")
        if proof.verdict != "identical" and proof.largest == 0:
            more = f" and {len(proof.places) - _MOST_PLACES} more" if len(proof.places) > _MOST_PLACES else ""
            print(f"    no coefficient changes; these differ: {', '.join(proof.places[:_MOST_PLACES])}{more}")
        elif proof.verdict != "identical" and proof.largest_of:
            print(f"    largest change: {proof.largest:.2g} of the standard uncertainty of {proof.largest_of}")
        for name, (then, now) in proof.changed.items():
            print(f"    {name}: {then or 'not recorded'} then, {now or 'not installed'} now")
    return Done(exit_codes.INTEGRITY if proof.verdict == "different" else exit_codes.DONE, proof.to_json())


_MOST_PLACES = 5
_ONLY_TEXTS = (
    "NOT REPRODUCED: every number is identical to the stored number, but texts differ, as they do if another state of the "
    "software wrote them"
)
_PROVED = {
    "identical": "recomputed from the samples; every number is identical to the stored number, bit for bit",
    "within tolerance": "recomputed from the samples with other versions; no number changes by more than {tolerance:g} of its standard "
    "uncertainty",
    "different": "NOT REPRODUCED: the samples do not give the stored results",
}

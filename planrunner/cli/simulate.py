"""`planrunner simulate`: runs a plan on a virtual bench to which effects from the catalogue are added."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from planrunner.cli.arguments import SEED
from planrunner.cli.check import add_parameter
from planrunner.cli.outcome import evaluate, tell
from planrunner.cli.printing import print_findings
from planrunner.cli.progress import run_progress
from planrunner.cli.run import add_new_runs, add_run_arguments
from planrunner.plan.parameters import parameters_of
from planrunner.plan.run_information import gather


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PLAN", type=Path, help="plan file")
    parser.add_argument("--bench", metavar="BENCH", help="virtual bench: a shipped name or a file")
    parser.add_argument(
        "--with",
        dest="effects",
        metavar="EFFECT[=VALUE]",
        action="append",
        default=[],
        help="effect to add; may be repeated. EFFECT alone uses the default size; EFFECT=VALUE sets its only "
        "parameter, or all its amplitudes; EFFECT=NAME:VALUE,NAME:VALUE sets these parameters and leaves the others "
        "at zero",
    )
    parser.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[], help="run information that the plan asks for"
    )
    add_parameter(parser)
    parser.add_argument("--seed", type=SEED, help="seed of the simulation (default: the bench's own)")
    parser.add_argument(
        "--write-bench", metavar="FILE", type=Path, help="write the bench with its effects, for later runs"
    )
    add_run_arguments(parser)
    add_new_runs(parser)


def run(args: argparse.Namespace) -> int:
    from planrunner.execution.stopping import StopRequest
    from planrunner.tasks import run as running
    from planrunner.tasks.simulate import simulation

    made = simulation(args.plan, args.bench, args.effects, parameters_of(args.parameter))
    print_findings(made.sound.findings)
    given = {setting.partition("=")[0].strip() for setting in args.set}
    wanted = [
        f"{name}=simulated" for name, item in made.sound.plan.record.items() if item.required and name not in given
    ]
    info = gather(made.sound.plan, [*args.set, *wanted], None)
    if args.write_bench is not None:
        args.write_bench.write_bytes(made.sound.bench_bytes)
    with run_progress(args.quiet) as (progress, notify), StopRequest(notify) as stop:
        folder, outcome = running.start(
            made.sound, info=info, runs=args.runs, stop=stop, seed=args.seed, durability="flushed", progress=progress
        )
    if not outcome.ok:
        return tell(folder, outcome, as_json=args.json)
    out = sys.stderr if args.json else sys.stdout
    for line in made.words() or ["Nothing was added."]:
        print(f"added {line}" if made.additions else line, file=out)
    code = evaluate(folder, outcome, args, made.sound, standard=False)
    print(folder, file=out)
    return code

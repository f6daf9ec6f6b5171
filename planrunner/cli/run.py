"""`planrunner run`: checks a plan, runs it, makes its estimates and writes its reports."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.documents import Json
from planrunner.base.findings import InputError
from planrunner.cli.arguments import SEED, add_data
from planrunner.cli.check import add_parameter, sound_plan
from planrunner.cli.operator import add_live_page, operator_of
from planrunner.cli.outcome import evaluate, tell
from planrunner.cli.printing import print_findings
from planrunner.cli.progress import reading_progress, run_progress
from planrunner.plan.run_information import gather

if TYPE_CHECKING:
    from planrunner.tasks.check import Sound
    from planrunner.tasks.check_standard import Admission, Override


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PLAN", help="plan file")
    parser.add_argument("--bench", metavar="BENCH", help="run on this bench: a shipped name or a file")
    parser.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[], help="run information that the plan asks for"
    )
    add_parameter(parser)
    parser.add_argument("--info", metavar="FILE", type=Path, help="run information as a YAML file of `name: value`")
    add_data(parser)
    parser.add_argument("--seed", type=SEED, help="seed of a simulated bench (default: the bench's own)")
    parser.add_argument(
        "--flushed",
        action="store_true",
        help="do not wait for the disk after every event: faster, but a power failure can lose data",
    )
    add_run_arguments(parser)
    add_override(parser)
    parser.add_argument(
        "--id",
        metavar="DIGITS",
        type=identity,
        help="end of the run folder's name, 6 to 32 hexadecimal digits (default: random)",
    )
    add_new_runs(parser)


def add_new_runs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--runs",
        metavar="DIR",
        type=Path,
        default=Path("runs"),
        help="folder in which run folders are created (default: runs)",
    )


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of every command that produces results."""
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    add_live_page(parser)


def add_override(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--override-check-standard",
        metavar="REASON",
        help="run although the check standard of the bench is not in control; the reason is stored in the run (with --override-by)",
    )
    parser.add_argument(
        "--override-by",
        metavar="NAME",
        help="the person who decides to run: a name in `may_override` of the bench file",
    )


def override_of(args: argparse.Namespace) -> Override | None:
    why, by = args.override_check_standard, args.override_by
    if bool(why) != bool(by):
        message = "--override-check-standard and --override-by belong together"
        raise InputError.of_usage(message, "give both or neither")
    if not why:
        return None
    from planrunner.tasks.check_standard import Override

    return Override(by, why)


def identity(text: str) -> str:
    if not re.fullmatch(r"[0-9a-f]{6,32}", text):
        raise argparse.ArgumentTypeError(f"write 6 to 32 digits from 0 to 9 and a to f: {text!r}")
    return text


def run(args: argparse.Namespace) -> int:
    sound = sound_plan(args.plan, args.bench, args.parameter)
    info = gather(sound.plan, args.set, args.info)
    admission = _admission(args, sound, info)
    from planrunner.execution.stopping import StopRequest
    from planrunner.tasks import run as running

    with run_progress(args.quiet) as (progress, notify), StopRequest(notify) as stop:
        folder, outcome = running.start(
            sound,
            info=info,
            runs=args.runs,
            stop=stop,
            data_root=args.data,
            seed=args.seed,
            durability="flushed" if args.flushed else "durable",
            progress=progress,
            operator=operator_of(args, notify),
            identity=args.id,
            admission=admission,
        )
    if not outcome.ok:
        return tell(folder, outcome, as_json=args.json)
    return evaluate(folder, outcome, args, sound, standard=sound.bench.check_standard is not None)


def _admission(args: argparse.Namespace, sound: Sound, info: Mapping[str, Json]) -> Admission | None:
    """Checks whether the check standard of the bench permits a run to begin, and prints the warnings of this check. Returns the
    permission; None if the bench has no check standard and no override is given."""
    override = override_of(args)
    if sound.bench.check_standard is None and override is None:
        return None
    from planrunner.tasks.check_standard import admit

    with reading_progress(args.quiet) as notice:
        found = admit(sound.bench, sound.name, info, args.runs, override, notice)
    print_findings(found.findings)
    return found

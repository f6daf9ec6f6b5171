"""`planrunner pause`: ask a running run to wait, with its bench safe, before its next segment."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner import cli
from planrunner.archive import pausing
from planrunner.plan.findings import InputError, Mark


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="run folder")


def run(args: argparse.Namespace) -> int:
    folder: Path = args.run_folder
    if not pausing.is_written(folder):
        raise InputError.at(
            Mark(str(folder)),
            "run-not-running",
            "no planrunner writes this run",
            "give the folder of a run that is going on",
        )
    pausing.ask_to_pause(folder)
    print(f"The run waits after this segment, with the bench safe. Go on with: planrunner resume {folder}")
    return cli.DONE

"""`planrunner pause`: asks an active run to wait before its next segment, with its bench in the safe state."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.archive import pausing
from planrunner.archive.verifying import open_run
from planrunner.base.findings import InputError, Mark
from planrunner.cli import exit_codes
from planrunner.cli.printing import print_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="run folder")
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")


def run(args: argparse.Namespace) -> int:
    folder = open_run(args.run_folder)
    if not pausing.is_written(folder):
        raise InputError.at(
            Mark(str(folder.path)),
            "run-not-running",
            "no planrunner process is writing this run",
            "give the folder of a run that is in progress",
        )
    pausing.ask_to_pause(folder)
    if args.json:
        print_json({"run": str(folder.path), "asked": "pause"})
        return exit_codes.DONE
    print(
        f"The run pauses after this segment, with the bench in the safe state. Continue with: planrunner resume {folder.path}"
    )
    return exit_codes.DONE

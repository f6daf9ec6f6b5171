"""`planrunner sign`: an electronic signature of a sealed run, with its meaning."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.cli import exit_codes
from planrunner.cli.printing import print_json
from planrunner.cli.signer import add_signer, signer_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="folder of a sealed run")
    parser.add_argument(
        "--as",
        dest="meaning",
        required=True,
        choices=("reviewed", "approved", "released"),
        help="what the signature means",
    )
    add_signer(parser)
    parser.add_argument("--name", required=True, help="name of the signer, as it is printed")
    parser.add_argument("--comment", default="", help="a remark that is part of the signature")
    parser.add_argument("--json", action="store_true", help="print the signature as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner.tasks.sign import sign

    made = sign(args.run_folder, signer_of(args), args.meaning, args.name, args.comment)
    if args.json:
        print_json(made.to_json())
    else:
        print(f"{made.meaning} by {made.name}, {made.signed}, key {made.key}: {made.file}")
    return exit_codes.DONE

"""`planrunner sign`: makes an electronic signature of a sealed run; the signature states its meaning, for example "reviewed"."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.base.findings import InputError
from planrunner.cli import exit_codes
from planrunner.cli.printing import print_json
from planrunner.cli.signer import add_signer, signer_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="folder of a sealed run")
    parser.add_argument(
        "--as",
        dest="meaning",
        required=True,
        choices=("reviewed", "approved", "released", "recorded"),
        help="what the signature means; recorded: the key of the bench signs what it could not sign at the end of the run",
    )
    add_signer(parser)
    parser.add_argument("--name", help="name of the signer, as it is printed (not with --as recorded)")
    parser.add_argument("--comment", default="", help="a remark that is part of the signature")
    parser.add_argument("--json", action="store_true", help="print the signature as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner.tasks.sign import sign, sign_later

    by_bench = args.meaning == "recorded"
    if by_bench != (args.name is None):
        message = "the bench signs under its own name" if by_bench else "--name is missing"
        raise InputError.of_usage(message, "leave out --name" if by_bench else "give your name, as it is to be printed")
    if by_bench:
        given = args.by is not None or args.agent is not None
        found = sign_later(args.run_folder, signer_of(args) if given else None)
    else:
        found = (sign(args.run_folder, signer_of(args), args.meaning, args.name, args.comment),)
    if args.json:
        print_json([one.to_json() for one in found] if by_bench else found[0].to_json())
        return exit_codes.DONE
    for made in found:
        print(f"{made.meaning} by {made.name}, {made.signed}, key {made.key}: {made.file}")
    if not found:
        print("nothing to sign: the bench has signed the seal and all analyses")
    return exit_codes.DONE

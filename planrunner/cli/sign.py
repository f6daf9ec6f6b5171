"""`planrunner sign`: an electronic signature of a sealed run, with its meaning."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.base.findings import COMMAND_LINE, InputError
from planrunner.cli import exit_codes
from planrunner.cli.passphrase import add_passphrase, passphrase
from planrunner.cli.printing import print_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="folder of a sealed run")
    parser.add_argument(
        "--as",
        dest="meaning",
        required=True,
        choices=("reviewed", "approved", "released"),
        help="what the signature means",
    )
    parser.add_argument("--by", metavar="KEY", type=Path, help="file with the private key")
    parser.add_argument(
        "--agent", metavar="KEY.pub", type=Path, help="sign with this key of the running ssh-agent, instead of --by"
    )
    parser.add_argument("--name", required=True, help="name of the signer, as it is printed")
    parser.add_argument("--comment", default="", help="a remark that is part of the signature")
    parser.add_argument("--json", action="store_true", help="print the signature as JSON")
    add_passphrase(parser)


def run(args: argparse.Namespace) -> int:
    from planrunner.signing.keys import Signer, is_encrypted, read_private, read_public
    from planrunner.tasks.sign import sign

    if (args.by is None) == (args.agent is None):
        message = "give one key: --by KEY or --agent KEY.pub"
        raise InputError.at(COMMAND_LINE, "command-usage", message, "`planrunner key new` makes a key")
    signer: Signer
    if args.agent is not None:
        from planrunner.signing.ssh_agent import AgentKey

        signer = AgentKey(read_public(args.agent))
    else:
        signer = read_private(args.by, passphrase(args) if is_encrypted(args.by) else None)
    made = sign(args.run_folder, signer, args.meaning, args.name, args.comment)
    if args.json:
        print_json(made.to_json())
    else:
        print(f"{made.meaning} by {made.name}, {made.signed}, key {made.key}: {made.file}")
    return exit_codes.DONE

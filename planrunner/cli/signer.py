"""The key that signs: a file, or a key of the running ssh-agent."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.findings import COMMAND_LINE, InputError
from planrunner.cli.passphrase import add_passphrase, passphrase

if TYPE_CHECKING:
    from planrunner.signing.keys import Signer


def add_signer(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--by", metavar="KEY", type=Path, help="file with the private key")
    parser.add_argument(
        "--agent", metavar="KEY.pub", type=Path, help="sign with this key of the running ssh-agent, instead of --by"
    )
    add_passphrase(parser)


def signer_of(args: argparse.Namespace) -> Signer:
    """Raises `InputError` unless exactly one key is given."""
    from planrunner.signing.keys import is_encrypted, read_private, read_public

    if (args.by is None) == (args.agent is None):
        message = "give one key: --by KEY or --agent KEY.pub"
        raise InputError.at(COMMAND_LINE, "command-usage", message, "`planrunner key new` makes a key")
    if args.agent is not None:
        from planrunner.signing.ssh_agent import AgentKey

        return AgentKey(read_public(args.agent))
    return read_private(args.by, passphrase(args) if is_encrypted(args.by) else None)

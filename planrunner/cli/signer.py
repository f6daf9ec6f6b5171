"""Finds the key that signs: a key file, or a key of the running ssh-agent.

The passphrase of a key comes from a file descriptor, the environment or the terminal. The passphrase never comes from the command
line, because other users can see it there.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.findings import COMMAND_LINE, InputError
from planrunner.signing.passphrase import VARIABLE, of_environment

if TYPE_CHECKING:
    from planrunner.signing.keys import Signer


_MOST = 1024  # bytes


def add_passphrase(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--passphrase-fd",
        type=int,
        metavar="N",
        help=f"read the passphrase from this file descriptor (default: {VARIABLE} in the environment, or the terminal)",
    )


def passphrase(args: argparse.Namespace, *, twice: bool = False) -> bytes:
    """Returns the passphrase, without a line break at its end. `twice`: True if the terminal asks for the passphrase a second time,
    to detect a typing error. Raises `InputError` if there is no passphrase."""
    if args.passphrase_fd is not None:
        try:
            data = os.read(args.passphrase_fd, _MOST)
        except OSError as error:
            message = f"the file descriptor {args.passphrase_fd} cannot be read: {error.strerror}"
            raise InputError.at(COMMAND_LINE, "key-passphrase", message, "redirect a file to it") from None
        return data.partition(b"\n")[0]
    if (stated := of_environment()) is not None:
        return stated
    if sys.stdin is None or not sys.stdin.isatty():
        hint = f"set {VARIABLE} in the environment, or give --passphrase-fd"
        raise InputError.at(COMMAND_LINE, "key-passphrase", "there is no terminal to ask for the passphrase", hint)
    from getpass import getpass

    text = getpass("Passphrase: ")
    if twice and getpass("Again: ") != text:
        raise InputError.at(COMMAND_LINE, "key-passphrase", "the two passphrases differ", "type them again")
    return text.encode()


def add_signer(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--by", metavar="KEY", type=Path, help="file with the private key")
    parser.add_argument(
        "--agent", metavar="KEY.pub", type=Path, help="sign with this key of the running ssh-agent, instead of --by"
    )
    add_passphrase(parser)


def signer_of(args: argparse.Namespace) -> Signer:
    """Returns the signer that the options name. Raises `InputError` if no key or more than one key is given."""
    from planrunner.signing.keys import is_encrypted, read_private, read_public

    if (args.by is None) == (args.agent is None):
        raise InputError.of_usage("give one key: --by KEY or --agent KEY.pub", "`planrunner key new` makes a key")
    if args.agent is not None:
        from planrunner.signing.ssh_agent import AgentKey

        return AgentKey(read_public(args.agent))
    return read_private(args.by, passphrase(args) if is_encrypted(args.by) else None)

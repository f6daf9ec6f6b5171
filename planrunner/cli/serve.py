"""`planrunner serve`: serves the live page of an archive, to browsers on this computer only."""

from __future__ import annotations

import argparse
import sys

from planrunner.cli import exit_codes
from planrunner.cli.arguments import add_archive
from planrunner.cli.printing import print_json

PORT = 8765


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_archive(parser)
    parser.add_argument(
        "--port", metavar="N", type=int, default=PORT, help=f"port of the page; 0 for a free one (default: {PORT})"
    )
    parser.add_argument("--json", action="store_true", help="print the address as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner.live.monitor import Monitor
    from planrunner.live.server import LiveServer

    server = LiveServer(Monitor(args.archive), args.port)
    with server:
        if args.json:
            print_json({"address": server.address})
        else:
            print(
                f"{server.address}\nOpen this address on this computer; it contains the token. Ctrl-C ends the server."
            )
        sys.stdout.flush()
        try:
            server.serve_forever(poll_interval=0.2)
        finally:
            server.watching.stop()
    return exit_codes.DONE

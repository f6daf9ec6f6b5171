"""`planrunner bench`: the shipped benches and the installed instrument drivers; whether a bench's instruments answer."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner import cli, plugins
from planrunner.bench.model import read_bench, shipped_benches
from planrunner.reporting.printable import printable

if TYPE_CHECKING:
    from planrunner.pinging import Ping


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    actions.add_parser("list", help="the shipped benches and the installed drivers")
    pinging = actions.add_parser("ping", help="ask every instrument of a bench who it is; nothing moves")
    pinging.add_argument("bench", help="bench file, or the name of a shipped bench")
    pinging.add_argument("--data", type=Path, metavar="DIR", help="folder that recordings lie beneath")
    pinging.add_argument("--json", action="store_true", help="print what they answer as JSON")


def run(args: argparse.Namespace) -> int:
    return _ping(args) if args.action == "ping" else _list()


def _list() -> int:
    print("Shipped benches (use with --bench NAME, or `bench: NAME` in a plan):")
    for name in shipped_benches():
        bench, _, _ = read_bench(name)
        print(f"  {name:<24} {' '.join((bench.description or bench.name).split())}")
    print("Instrument drivers (`driver: NAME` in a bench file):")
    for name in plugins.names(plugins.INSTRUMENTS):
        driver = plugins.load(plugins.INSTRUMENTS, name)
        about = (driver.__doc__ or driver.__name__).strip().partition("\n")[0]
        print(f"  {name:<24} {driver.role}: {about}")
    return cli.DONE


def _ping(args: argparse.Namespace) -> int:
    from planrunner.cli.printing import print_json
    from planrunner.pinging import ping

    bench, _, shown = read_bench(args.bench)
    answers = ping(bench, shown, args.data)
    if args.json:
        print_json({"bench": bench.name, "instruments": [answer.to_json() for answer in answers]})
    else:
        for answer in answers:
            print(printable(_row(answer)))
    return cli.FAULT if any(answer.failure for answer in answers) else cli.DONE


def _row(answer: Ping) -> str:
    head = f"{answer.name:<12} {answer.driver:<20} "
    if answer.failure:
        return f"{head}FAILED: {answer.failure}"
    said = " ".join(text for text in answer.identity.values() if text)
    state = ", ".join(f"{name} {value:.6g}" for name, value in answer.readings.items())
    trip = "" if answer.round_trip is None else f"{answer.round_trip * 1000:.1f} ms"
    faults = "reports " + "; ".join(answer.faults) if answer.faults else ""
    return head + " | ".join(text for text in (said, state, trip, faults) if text)

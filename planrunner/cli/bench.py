"""`planrunner bench`: lists the shipped benches and the installed instrument drivers; checks whether the instruments of a bench
answer, and whether its check standard is in control."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base import plugins
from planrunner.base.findings import InputError, Mark
from planrunner.bench.model import read_bench, shipped_benches
from planrunner.cli import exit_codes
from planrunner.cli.arguments import add_index, day_of, report_left_out, workers_of
from planrunner.cli.printing import name_file, print_json, print_line
from planrunner.cli.signer import add_signer, signer_of

if TYPE_CHECKING:
    from planrunner.tasks.ping import Ping


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list the shipped benches and the installed drivers")
    listing.add_argument("--json", action="store_true", help="print them as JSON")
    pinging = actions.add_parser("ping", help="ask every instrument of a bench for its identification; nothing moves")
    pinging.add_argument("bench", help="bench file, or the name of a shipped bench")
    pinging.add_argument("--data", type=Path, metavar="DIR", help="folder that contains the recordings")
    pinging.add_argument("--json", action="store_true", help="print the answers as JSON")
    standard = actions.add_parser(
        "check-standard",
        help="show whether the check standard of a bench is in control, according to the runs of an archive",
    )
    standard.add_argument("bench", help="bench file, or the name of a shipped bench")
    standard.add_argument(
        "--runs", metavar="ARCHIVE", type=Path, default=Path("runs"), help="folder of the runs (default: runs)"
    )
    add_index(standard)
    standard.add_argument("--json", action="store_true", help="print the state as JSON")
    standard.epilog = "Exit codes: 0 in control, 1 not in control, 2 wrong input, 4 a run in the archive is damaged."

    over = actions.add_parser("override", help="sign an override of the check standard of a bench with a key ring")
    over.add_argument("bench", help="bench file")
    over.add_argument("--name", required=True, help="your name in the key ring, which `may_override` names")
    over.add_argument("--reason", required=True, help="why runs may begin; every run keeps it")
    over.add_argument("--until", metavar="DATE", required=True, help="last day on which runs may begin")
    add_signer(over)


def run(args: argparse.Namespace) -> int:
    if args.action == "override":
        return _override(args)
    if args.action == "check-standard":
        return _check_standard(args)
    return _ping(args) if args.action == "ping" else _list(as_json=args.json)


def _override(args: argparse.Namespace) -> int:
    from planrunner.tasks.check_standard import Override, sign_override

    until = day_of(args.until)
    assert until is not None  # the argument is required
    bench = read_bench(str(args.bench), Path())[0]
    name_file(sign_override(bench, Override(args.name, args.reason), until, signer_of(args)), as_json=False)
    return exit_codes.DONE


def _check_standard(args: argparse.Namespace) -> int:
    from planrunner.cli.progress import reading_progress
    from planrunner.tasks.check_standard import control_state
    from planrunner.tasks.history import Freshness

    bench, _, shown = read_bench(args.bench, Path())
    with reading_progress(args.quiet or args.json) as notice:
        fresh = Freshness(not args.no_refresh, args.rebuild, notice, workers_of(args, None))
        state = control_state(bench, args.runs, index=args.index, fresh=fresh)
    if state is None:
        hint = "declare it under `check_standard:` in the bench file"
        raise InputError.at(Mark(shown), "bench-check-standard", "this bench has no check standard", hint)
    code = report_left_out(state.damaged)
    if args.json:
        print_json(state.to_json())
    else:
        from planrunner.reporting import terminal
        from planrunner.reporting.history_tables import control_table

        if state.coefficients:
            terminal.print_tables(control_table(state))
        print_line(state.words())
    return code or (exit_codes.DONE if state.in_control else exit_codes.LIMIT_FAILED)


def _list(*, as_json: bool) -> int:
    benches = {name: read_bench(name)[0] for name in shipped_benches()}
    drivers = {name: plugins.load(plugins.INSTRUMENTS, name) for name in plugins.names(plugins.INSTRUMENTS)}
    places = {name: " ".join((bench.description or bench.name).split()) for name, bench in benches.items()}
    abouts = {name: (driver.__doc__ or driver.__name__).strip().partition("\n")[0] for name, driver in drivers.items()}
    if as_json:
        print_json(
            {
                "benches": [{"name": name, "description": text} for name, text in places.items()],
                "drivers": [
                    {"name": name, "role": drivers[name].role, "description": text} for name, text in abouts.items()
                ],
            }
        )
        return exit_codes.DONE
    print("Shipped benches (use with --bench NAME, or `bench: NAME` in a plan):")
    for name, text in places.items():
        print(f"  {name:<24} {text}")
    print("Instrument drivers (`driver: NAME` in a bench file):")
    for name, text in abouts.items():
        print(f"  {name:<24} {drivers[name].role}: {text}")
    return exit_codes.DONE


def _ping(args: argparse.Namespace) -> int:
    from planrunner.tasks.ping import ping

    bench, _, shown = read_bench(args.bench)
    answers = ping(bench, shown, args.data)
    if args.json:
        print_json({"bench": bench.name, "instruments": [answer.to_json() for answer in answers]})
    else:
        for answer in answers:
            print(_row(answer))
    return exit_codes.FAULT if any(answer.failure for answer in answers) else exit_codes.DONE


def _row(answer: Ping) -> str:
    head = f"{answer.name:<12} {answer.driver:<20} "
    if answer.failure:
        return f"{head}FAILED: {answer.failure}"
    said = " ".join(text for text in answer.identity.values() if text)
    state = ", ".join(f"{name} {value:.6g}" for name, value in answer.readings.items())
    trip = "" if answer.round_trip is None else f"{answer.round_trip * 1000:.1f} ms"
    faults = "reports " + "; ".join(answer.faults) if answer.faults else ""
    return head + " | ".join(text for text in (said, state, trip, faults) if text)

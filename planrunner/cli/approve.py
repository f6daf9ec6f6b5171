"""`planrunner approve`: shows a plan with its benches and signs its approval; also withdraws and lists approvals."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.findings import COMMAND_LINE, InputError, count_of
from planrunner.cli import exit_codes
from planrunner.cli.arguments import day_of
from planrunner.cli.printing import print_findings, print_json, print_line
from planrunner.cli.signer import add_signer, signer_of

if TYPE_CHECKING:
    from planrunner.review.approvals import JudgedApproval
    from planrunner.tasks.approve import BenchApprovals, PreparedApproval


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PLAN", type=Path, help="plan file")
    parser.add_argument(
        "--bench",
        metavar="BENCH",
        action="append",
        default=[],
        help="approve for this bench: a shipped name or a file; may be repeated (default: the bench of the plan)",
    )
    add_signer(parser)
    parser.add_argument("--name", default="", help="name of the reviewer, as it is printed")
    parser.add_argument("--until", metavar="DATE", help="last day on which the approval counts")
    parser.add_argument(
        "--statement", default="", help="the statement that you sign, in words; with --withdraw: the reason"
    )
    parser.add_argument("--yes", action="store_true", help="sign without asking at the terminal")
    parser.add_argument(
        "--no-predictions", action="store_true", help="compare only the meaning with that of the last approved version"
    )
    parser.add_argument(
        "--withdraw", action="store_true", help="withdraw all approvals of this plan that were signed with your key"
    )
    parser.add_argument("--list", action="store_true", help="list all approvals, and state for each whether it counts")
    parser.add_argument("--keys", metavar="RING", type=Path, help="with --list: use this key ring")
    parser.add_argument("--json", action="store_true", help="print the approvals as JSON")


def run(args: argparse.Namespace) -> int:
    if args.list and args.withdraw:
        raise InputError.of_usage("--list and --withdraw exclude each other", "give one")
    if args.list:
        return _list(args)
    if not args.name.strip():
        raise InputError.of_usage("the name of the reviewer is missing", "write for example --name 'Anna Example'")
    return _withdraw(args) if args.withdraw else _approve(args)


def _approve(args: argparse.Namespace) -> int:
    from planrunner.tasks.approve import approvals_on, approve, prepare

    prepared = prepare(args.plan, args.bench, day_of(args.until), foresee=not args.no_predictions)
    out = sys.stderr if args.json else sys.stdout
    _show(prepared, args.statement)
    if not args.yes:
        _ask()
    file = approve(prepared, signer_of(args), args.name, args.statement)
    found = [approvals_on(args.plan, sound) for sound in prepared.sound]
    if args.json:
        print_json(next(one.to_json() for one in found[0].approvals if one.stated.file == file))
    print_line(f"approved by {args.name}: {file}", out)
    for one in found:
        own = next(item for item in one.approvals if item.stated.file == file)
        if one.rule is not None:
            word = "this approval counts" if own.standing == "counts" else f"this approval does not count: {own.why}"
            print_line(f"bench '{one.bench}': {word}; {_enough(one)}", out)
    return exit_codes.DONE


def _withdraw(args: argparse.Namespace) -> int:
    from planrunner.tasks.approve import withdraw

    file, count = withdraw(args.plan, signer_of(args), args.name, args.statement)
    if args.json:
        print_json({"file": file, "withdrawn": count})
    else:
        print(f"{count_of(count, 'approval')} withdrawn: {file}")
    return exit_codes.DONE


def _list(args: argparse.Namespace) -> int:
    from planrunner.plan import source
    from planrunner.signing.key_ring import read_ring
    from planrunner.tasks.approve import approvals_on
    from planrunner.tasks.check import Document, check_plan

    ring = None if args.keys is None else read_ring(args.keys)
    document = Document(source.read_bytes(args.plan), str(args.plan))
    found = [approvals_on(args.plan, check_plan(document, name).sound(), ring) for name in args.bench or (None,)]
    if args.json:
        print_json(
            [
                {"bench": one.bench, "met": one.met, "approvals": [item.to_json() for item in one.approvals]}
                for one in found
            ]
        )
        return exit_codes.DONE
    for one in found:
        print_line(f"bench '{one.bench}': {_enough(one)}")
        for item in one.approvals:
            for line in _lines(item):
                print_line(f"    {line}")
    return exit_codes.DONE


def _enough(one: BenchApprovals) -> str:
    if one.rule is None:
        return "the bench requires no approvals"
    persons = len({item.person for item in one.approvals if item.standing == "counts"})
    return f"the plan has {persons} of {one.rule.required} required approvals{'' if one.met else ', so it cannot run'}"


def _lines(item: JudgedApproval) -> list[str]:
    from planrunner.review.approvals import StatedApproval

    stated, count = item.stated, "counts" if item.standing == "counts" else f"does not count: {item.why}"
    if not isinstance(stated, StatedApproval):
        return [f"{stated.file}: {count}"]
    until = "" if stated.what.until is None else f" until {stated.what.until}"
    key = stated.envelope.key if item.key is None else f"key of {item.key.name}"
    benches = ", ".join(bench.name for bench in stated.what.benches)
    return [
        f"{stated.name}, {stated.signed:%Y-%m-%d %H:%M} UTC{until}, for {benches} ({key}): {count}",
        f"    {stated.digest}",
    ]


def _show(prepared: PreparedApproval, statement: str) -> None:
    """Prints the warnings of the check on stderr, then the content of the approval to be signed."""
    from planrunner.reporting.words import duration
    from planrunner.review.approvals import DECLARED

    for sound in prepared.sound:
        print_findings(sound.findings)
    what, first = prepared.what, prepared.sound[0]
    facts = [
        ("plan", f"{prepared.plan}: {what.title}"),
        ("author", ", ".join(what.author) or "not stated"),
        ("meaning", f"{what.plan} (SHA-256)"),
        ("estimates", ", ".join(first.plan.estimates) or "none"),
        ("limits", str(len(first.plan.limits))),
    ]
    for bench, sound in zip(what.benches, prepared.sound, strict=False):
        length = f"{count_of(len(sound.schedule.segments), 'segment')}, {duration(sound.schedule.total)}"
        facts.append(("bench", f"{bench.name}, {bench.sha256} (SHA-256): {length}"))
    facts.append(("until", "not limited" if what.until is None else what.until.isoformat()))
    facts.append(("statement", statement.strip() or DECLARED))
    for name, text in facts:
        print_line(f"{name + ':':<11}{text}", sys.stderr)
    _show_last(prepared)


def _show_last(prepared: PreparedApproval) -> None:
    if prepared.last is None:
        print("No earlier approved version is at hand.", file=sys.stderr)
        return
    from planrunner.reporting import terminal
    from planrunner.reporting.difference_tables import difference_tables, headline, notes

    before, compared = prepared.last
    said = f"Since the version that {before.name} approved on {before.signed:%Y-%m-%d}: {headline(compared)}"
    print_line(said, sys.stderr)
    console = terminal.console(file=sys.stderr)
    for table in difference_tables(compared):
        console.print(terminal.data_table(table))
    for line in notes(compared):
        print_line(line, sys.stderr)


def _ask() -> None:
    """Asks the reviewer for consent. Raises `InputError` if the reviewer does not agree at the terminal."""
    if sys.stdin is None or not sys.stdin.isatty():
        message = "there is no terminal to confirm the approval at"
        raise InputError.at(COMMAND_LINE, "approval-unconfirmed", message, "read what is printed above, then add --yes")
    print("Sign this approval? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise InputError.at(
            COMMAND_LINE, "approval-unconfirmed", "the approval was not confirmed", "nothing was signed"
        )

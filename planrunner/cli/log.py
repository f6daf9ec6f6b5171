"""`planrunner log`: manages the log of an archive, which reveals removed and replaced runs. Also makes the tree heads and proofs of
the log."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.findings import InputError, count_of
from planrunner.base.regular_files import RefusedFileError, read_regular
from planrunner.cli import exit_codes
from planrunner.cli.each_run import run_folders
from planrunner.cli.printing import print_json, print_line, write_file
from planrunner.cli.signer import add_passphrase, passphrase
from planrunner.plan.source import refused_input

if TYPE_CHECKING:
    from planrunner.archive.run_log import TreeHead
    from planrunner.signing.key_ring import KeyRing
    from planrunner.signing.tree_heads import RememberedHead
    from planrunner.tasks.run_log import LogVerification


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    archive = "folder that contains the runs"

    def add(name: str, help_: str) -> argparse.ArgumentParser:
        action = actions.add_parser(name, help=help_)
        action.add_argument("archive", metavar="ARCHIVE", type=Path, help=archive)
        action.add_argument("--json", action="store_true", help="print the result as JSON")
        return action

    add("new", "begin a log; from then on every run in this folder is entered")
    append = actions.add_parser("append", help="enter the seals of runs that are not in the log")
    append.add_argument("runs", metavar="RUN", nargs="+", type=Path, help="folders of sealed runs")
    append.add_argument("--log", metavar="ARCHIVE", type=Path, help="folder with the log (default: that of the run)")
    append.add_argument("--json", action="store_true", help="print the result as JSON")
    retire = add("retire", "record that a run is taken out of the archive")
    retire.add_argument("name", metavar="NAME", help="name of the run")
    retire.add_argument("--why", required=True, help="reason, and where the run is now")
    head = add("head", "print the tree head, to keep it elsewhere")
    head.add_argument("--by", metavar="KEY", type=Path, help="sign it with this private key")
    add_passphrase(head)
    prove = add("prove", "print a proof that a run is in the log, or that the log only grew")
    prove.add_argument("name", metavar="NAME", nargs="?", help="name of the run")
    prove.add_argument("--from", dest="first", metavar="HEAD", type=Path, help="file with an earlier tree head")
    prove.add_argument("--output", metavar="FILE", type=Path, help="write the proof to a file")
    check = actions.add_parser("check", help="verify a log, or a proof without the log")
    check.add_argument("archive", metavar="ARCHIVE", nargs="?", type=Path, help=archive)
    check.add_argument("--proof", metavar="FILE", type=Path, help="verify this proof; the log is not needed")
    check.add_argument(
        "--run",
        dest="run_folder",
        metavar="RUN",
        type=Path,
        help="with --proof: the run folder that the proof is about",
    )
    check.add_argument("--json", action="store_true", help="print the result as JSON")
    add_heads(check)


def add_heads(parser: argparse.ArgumentParser) -> None:
    """Adds the options --head and --keys."""
    parser.add_argument(
        "--head",
        metavar="FILE",
        action="append",
        default=[],
        type=Path,
        help="file with a tree head that was printed earlier and kept",
    )
    parser.add_argument("--keys", metavar="RING", type=Path, help="key ring that signatures are verified with")


def run(args: argparse.Namespace) -> int:
    actions: dict[str, Callable[[argparse.Namespace], int]] = {
        "new": _new,
        "append": _append,
        "retire": _retire,
        "head": _head,
        "prove": _prove,
        "check": _check,
    }
    return actions[args.action](args)


def _new(args: argparse.Namespace) -> int:
    from planrunner.tasks.run_log import begin_log
    from planrunner.tasks.verify import runs_in

    return _tell(args, begin_log(args.archive, runs_in(args.archive)))


def _append(args: argparse.Namespace) -> int:
    from planrunner.tasks.run_log import append_run, require_log

    heads = []
    for run in run_folders(args.runs):
        log = require_log(run.absolute().parent if args.log is None else args.log)
        head = append_run(log, run)
        heads.append({"run": str(run), "head": None if head is None else head.to_json()})
        if not args.json:
            print_line(f"{run}: {'already in the log' if head is None else f'entry {head.size}'}")
    if args.json:
        print_json(heads)
    return exit_codes.DONE


def _retire(args: argparse.Namespace) -> int:
    from planrunner.tasks.run_log import require_log, retire_run

    return _tell(args, retire_run(require_log(args.archive), args.name, args.why))


def _head(args: argparse.Namespace) -> int:
    from planrunner.archive.run_log import require_growth
    from planrunner.tasks.run_log import require_log

    log = require_log(args.archive)
    if args.by is None:
        content = log.read()
        require_growth(content, log.path)
        print(content.head().to_bytes().decode(), end="")
        return exit_codes.DONE
    from planrunner.signing.keys import is_encrypted, read_private
    from planrunner.signing.tree_heads import sign_head

    signer = read_private(args.by, passphrase(args) if is_encrypted(args.by) else None)
    print(sign_head(log, signer).decode(), end="")
    return exit_codes.DONE


def _tell(args: argparse.Namespace, head: TreeHead) -> int:
    if args.json:
        print_json(head.to_json())
    else:
        print(f"{_entries(head.size)}, root {head.root}")
    return exit_codes.DONE


def _entries(size: int) -> str:
    return count_of(size, "entry", "entries")


def _prove(args: argparse.Namespace) -> int:
    from planrunner.archive.run_log import MOST_HEAD
    from planrunner.signing.tree_heads import remembered_head
    from planrunner.tasks.run_log import growth_proof, inclusion_proof, proof_bytes, require_log

    if (args.name is None) == (args.first is None):
        message = "give the name of a run, or an earlier tree head with --from"
        raise InputError.of_usage(message, "`planrunner log head` prints a tree head")
    log = require_log(args.archive)
    if args.name is not None:
        proof = inclusion_proof(log, args.name.rstrip("/").rpartition("/")[2])
    else:
        proof = growth_proof(log, remembered_head(_read(args.first, MOST_HEAD), args.first, None).head)
    if args.output is not None:
        write_file(args.output, proof_bytes(proof).decode())
    else:
        print_json(proof)
    return exit_codes.DONE


def _check(args: argparse.Namespace) -> int:
    if (args.archive is None) == (args.proof is None):
        raise InputError.of_usage("give an archive, or a proof with --proof", "`planrunner log prove` makes a proof")
    if args.proof is not None:
        return _check_proof(args)
    from planrunner.tasks.run_log import require_log, verify_log

    ring = ring_of(args)
    found = verify_log(require_log(args.archive), None, ring, heads_of(args.head, ring))
    code = exit_codes.INTEGRITY if found.changes else exit_codes.DONE
    if args.json:
        print_json({"exit_code": code, **found.to_json()})
    else:
        show_log(found)
    return code


def _check_proof(args: argparse.Namespace) -> int:
    from planrunner.archive.formats import parse_json
    from planrunner.archive.storage import digest
    from planrunner.tasks.run_log import PROOF_FORMAT, check_proof

    proof = parse_json(_read(args.proof, MOST_PROOF), args.proof, "log-proof", "planrunner_log_proof", PROOF_FORMAT)
    heads = list(heads_of(args.head, ring_of(args)).values())
    if len(heads) > 1:
        raise InputError.of_usage("a proof is verified with one --head", "give one tree head")
    seal = None
    if args.run_folder is not None:
        from planrunner.archive.seal import MOST_BYTES, NAME

        seal = digest(_read(args.run_folder / NAME, MOST_BYTES))
    shown = check_proof(proof, args.proof, heads[0].head if heads else None, seal)
    if args.json:
        print_json({"proof": str(args.proof), "kind": proof["kind"], "head_given": bool(heads), "shows": shown})
    else:
        print_line(shown)
        if not heads:
            print("NOT VERIFIED: the tree head is the one in the proof; give one from another source with --head")
    return exit_codes.DONE


MOST_PROOF = 2**16


def ring_of(args: argparse.Namespace) -> KeyRing | None:
    from planrunner.signing.key_ring import read_ring

    return None if args.keys is None else read_ring(args.keys)


def heads_of(files: Sequence[Path], ring: KeyRing | None) -> dict[str, RememberedHead]:
    """Reads tree heads from files; returns them by the name of the file. Raises `InputError` if a file cannot be read, and
    `IntegrityError` if a file does not contain a tree head."""
    from planrunner.archive.run_log import MOST_HEAD
    from planrunner.signing.tree_heads import remembered_head

    return {str(file): remembered_head(_read(file, MOST_HEAD), file, ring) for file in files}


def _read(path: Path, most: int) -> bytes:
    try:
        return read_regular(path, most)
    except RefusedFileError as refused:
        raise refused_input(refused, str(path)) from None


def show_log(found: LogVerification) -> None:
    """Prints the result of the verification of a log."""
    content = found.content
    told = "" if content is None else f", {_entries(len(content.entries))}, root {content.root(len(content.entries))}"
    print_line(f"log {found.path}: {'CHANGED' if found.changes else 'unchanged'}{told}")
    for change, finding in found.changes:
        print_line(f"    {change}: {finding.message}")
    if found.signed is not None and found.signed.owner:
        one = found.signed
        print_line(
            f"    tree head of {_entries(one.head.size)} signed {one.head.at}: valid, key of {one.owner} ({one.key})"
        )
    for finding in found.remarks:
        print_line(f"    {finding.message}")
    for hint in dict.fromkeys(finding.hint for _, finding in found.changes if finding.hint):
        print_line(f"    hint: {hint}")

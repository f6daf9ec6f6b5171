"""`planrunner key`: makes a key, shows its public part, and adds public keys to a key ring."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.base.findings import COMMAND_LINE, InputError, Mark
from planrunner.cli import exit_codes
from planrunner.cli.arguments import day_of
from planrunner.cli.printing import print_json, write_file, write_new
from planrunner.cli.signer import add_passphrase, passphrase


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    new = actions.add_parser("new", help="make a private key with a passphrase, and its public key")
    new.add_argument("file", metavar="FILE", type=Path, help="new file for the private key; FILE.pub is the public key")
    new.add_argument(
        "--for-bench",
        action="store_true",
        help="FILE is the name of a bench: make its signing key, without a passphrase, in the folder of signing keys of this computer",
    )
    add_passphrase(new)
    show = actions.add_parser("show", help="print a public key and its fingerprint")
    show.add_argument("file", metavar="FILE.pub", type=Path, help="file with a public key")
    add = actions.add_parser("add", help="add a public key to a key ring")
    add.add_argument("ring", metavar="RING", type=Path, help="key ring; made if it does not exist")
    add.add_argument("name", metavar="NAME", help="owner of the key")
    add.add_argument("file", metavar="FILE.pub", type=Path, help="file with the public key")
    add.add_argument("--role", metavar="ROLE", action="append", default=[], help="role of the owner, such as reviewer")
    add.add_argument("--until", metavar="DATE", help="last day on which the key is valid")
    for action in (new, show, add):
        action.add_argument("--json", action="store_true", help="print the key as JSON")


def run(args: argparse.Namespace) -> int:
    return {"new": _new, "show": _show, "add": _add}[args.action](args)


def _new(args: argparse.Namespace) -> int:
    from planrunner.signing.keys import generate, write_private

    if args.for_bench:
        return _new_for_bench(args)
    key, public = generate(), args.file.with_name(f"{args.file.name}.pub")
    if public.exists():
        raise InputError.at(Mark(str(public)), "key-exists", "this file exists already", "choose another name")
    write_private(args.file, key, passphrase(args, twice=True))
    _write_public(args.file, f"{key.public.line} {args.file.stem}\n")
    return _tell(args, key.public.line, key.public.fingerprint)


def _new_for_bench(args: argparse.Namespace) -> int:
    import re

    from planrunner.signing.bench_key import BenchKeyError, new_bench_key

    if args.passphrase_fd is not None:
        message = "the key of a bench has no passphrase, because nobody may be present when it signs"
        raise InputError.of_usage(message, "leave --passphrase-fd out")
    name = str(args.file)
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,79}", name):
        message = f"'{name}' is not a name for the key of a bench"
        raise InputError.at(COMMAND_LINE, "key-name", message, "use letters, digits, - and _")
    try:
        path, key = new_bench_key(name)
    except BenchKeyError as error:
        hint = "set PLANRUNNER_STATE to a folder that belongs to you"
        raise InputError.at(COMMAND_LINE, "bench-signing-key", str(error), hint) from None
    _write_public(path, f"{key.public.line} {name}\n")
    if not args.json:
        print(f"private key: {path}\nadd to the bench file:\nsigning: {{key: {key.public.line}}}")
    return _tell(args, key.public.line, key.public.fingerprint)


def _write_public(private: Path, line: str) -> None:
    """Writes the public key next to its private key. If this fails, removes the private key, because a private key without its
    public key is useless."""
    try:
        write_new(private.with_name(f"{private.name}.pub"), line.encode())
    except InputError:
        private.unlink(missing_ok=True)
        raise


def _show(args: argparse.Namespace) -> int:
    from planrunner.signing.keys import read_public

    key = read_public(args.file)
    return _tell(args, key.line, key.fingerprint)


def _add(args: argparse.Namespace) -> int:
    import re

    from planrunner.bench.signatures import ROLE
    from planrunner.signing.key_ring import NAME, entry_text, read_ring
    from planrunner.signing.keys import read_public

    key = read_public(args.file)
    wrong = [role for role in args.role if not re.fullmatch(ROLE, role)]
    if not re.fullmatch(NAME, args.name) or wrong:
        message = f"'{(wrong or [args.name])[0]}' is not a name for a key ring"
        hint = "use letters, digits, - and _, beginning with a letter; roles are in lower case"
        raise InputError.at(COMMAND_LINE, "key-name", message, hint)
    day_of(args.until)
    text = "planrunner_keys: 1\nkeys:\n"
    if args.ring.exists():
        from planrunner.plan.source import read_text

        known = read_ring(args.ring)
        for one in known.keys.values():
            if one.name == args.name or one.public == key:
                message = f"the key ring already has this name or key: '{one.name}', {one.public.fingerprint}"
                raise InputError.at(Mark(str(args.ring)), "key-twice", message, "edit the file to replace a key")
        text = read_text(args.ring)
        if known.keys:
            text = text if text.endswith("\n") else f"{text}\n"
    whole = text + entry_text(args.name, key, tuple(args.role), args.until)
    _require_ring(whole, args.ring, args.name)
    write_file(args.ring, whole)
    return _tell(args, key.line, key.fingerprint)


def _require_ring(text: str, path: Path, name: str) -> None:
    """Checks the text of a key ring after an entry was added. Raises `InputError` if the text is not a key ring that contains
    `name`."""
    from planrunner.signing.key_ring import parse_ring

    try:
        known = {one.name for one in parse_ring(text, str(path)).keys.values()}
    except InputError:
        known = set()
    if name not in known:
        message = "the entry cannot be added at the end of this file"
        raise InputError.at(Mark(str(path)), "key-ring", message, "put `keys:` last, or add the entry in an editor")


def _tell(args: argparse.Namespace, line: str, fingerprint: str) -> int:
    if args.json:
        print_json({"public": line, "fingerprint": fingerprint})
    else:
        print(f"{line}\n{fingerprint}")
    return exit_codes.DONE

"""`planrunner new`: the shipped plans, to list and to copy."""

from __future__ import annotations

import argparse
import errno
import shutil
from pathlib import Path

from planrunner import cli
from planrunner.plan import source
from planrunner.plan.findings import InputError, Mark, closest
from planrunner.shipped import shipped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", nargs="?", metavar="NAME", help="shipped plan to copy; without it they are listed")
    parser.add_argument("target", nargs="?", metavar="FILE", help="where to write it (default: NAME.yaml here)")


def run(args: argparse.Namespace) -> int:
    plans = {file.stem: file for file in sorted(shipped("plans").glob("*.yaml"))}
    if args.plan is None:
        for name, file in plans.items():
            title = source.load(file).get("title")
            print(f"{name:<36} {title.text if isinstance(title, source.Scalar) else ''}")
        print("\nCopy one with: planrunner new NAME [FILE]")
        return cli.DONE
    if args.plan not in plans:
        raise InputError.at(
            Mark(args.plan), "new-unknown", f"no shipped plan is called '{args.plan}'", closest(args.plan, plans)
        )
    target = Path(args.target or f"{args.plan}.yaml")
    try:
        with plans[args.plan].open("rb") as original, target.open("xb") as copy:
            shutil.copyfileobj(original, copy)
    except OSError as error:
        if not isinstance(error, FileExistsError):
            if error.errno == errno.ENOSPC:
                target.unlink(missing_ok=True)
            message = f"the file cannot be written: {error.strerror or error}"
            hint = "make room, or name a file in another folder"
            raise InputError.at(Mark(str(target)), "file-unwritable", message, hint) from None
        raise InputError.at(Mark(str(target)), "new-exists", "this file exists already", "name another one") from None
    print(f"{target}: check it with `planrunner check {target}`")
    return cli.DONE

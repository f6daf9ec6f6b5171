"""`planrunner archive`: copies sealed runs to and from an archive on object storage."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.base.findings import InputError, count_of
from planrunner.cli import exit_codes
from planrunner.cli.each_run import Done, each_run
from planrunner.cli.printing import print_json
from planrunner.cli.progress import reading_progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    push = actions.add_parser("push", help="write sealed runs to a remote archive; existing files are never replaced")
    push.add_argument("runs", metavar="RUN", nargs="+", type=Path, help="run folders, or an archive with --all")
    push.add_argument("url", metavar="URL", help="the remote archive, such as s3://bucket/archive")
    push.add_argument("--all", action="store_true", help="RUN is an archive: push every run folder in it")
    pull = actions.add_parser("pull", help="copy a remote run or archive into a folder, and verify each run")
    pull.add_argument("url", metavar="URL", help="the remote run or archive, such as s3://bucket/archive")
    pull.add_argument(
        "folder", metavar="DIR", type=Path, help="folder that receives the run folders; existing run folders are kept"
    )
    for action in (push, pull):
        action.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner.archive.remote import is_url

    if not is_url(args.url):
        message = f"'{args.url}' is not the URL of a remote archive"
        raise InputError.of_usage(message, "write for example s3://bucket/archive")
    return _push(args) if args.action == "push" else _pull(args)


def _push(args: argparse.Namespace) -> int:
    from planrunner.archive.remote import push_run
    from planrunner.cli.each_run import runs_of

    def push(run: Path) -> Done:
        pushed = push_run(run, args.url)
        if not args.json:
            print(f"{run.name}: {count_of(pushed.written, 'file')} written, {pushed.present} existed already")
        return Done(exit_codes.DONE, {"written": pushed.written, "present": pushed.present})

    return each_run(runs_of(args), push, as_json=args.json)


def _pull(args: argparse.Namespace) -> int:
    from planrunner.archive.remote import fetched, pull_runs

    with reading_progress() as notice:
        copy = fetched(args.url, anew=True, notice=notice)
    pulled = pull_runs(copy, args.folder)
    if args.json:
        print_json({"pulled": [str(run) for run in pulled.runs], "present": pulled.present})
    else:
        for run in pulled.runs:
            print(run)
        print(f"{count_of(len(pulled.runs), 'run')} copied and verified, {pulled.present} existed already")
    return exit_codes.DONE

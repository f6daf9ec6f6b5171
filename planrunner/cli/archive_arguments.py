"""Arguments of the commands that read an archive of runs, or the index of an archive."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.cli import exit_codes
from planrunner.cli.jobs import add_workers, workers_of
from planrunner.cli.printing import print_line

if TYPE_CHECKING:
    from planrunner.night.history.index import Index
    from planrunner.night.history.rows import FaultRow


def folder_argument(text: str, *, anew: bool = False) -> Path:
    """Reads a command-line argument that names a run or a folder of runs. Returns the path of the folder. If the argument is a URL,
    the folder is copied to this computer immediately (`archive.remote`), because commands read only local folders. `anew`: True to
    copy even files that have not changed since an earlier copy."""
    if "://" not in text:
        return Path(text)
    from planrunner.archive.remote import fetched
    from planrunner.cli.progress import reading_progress

    with reading_progress() as notice:
        return fetched(text, anew=anew, notice=notice)


def folder_to_verify(text: str) -> Path:
    """Does the same as `folder_argument`, except that all files of a URL are copied again, because an older copy does not show the
    present state."""
    return folder_argument(text, anew=True)


def add_archive(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "archive",
        metavar="ARCHIVE",
        nargs="?",
        type=folder_argument,
        default=Path("runs"),
        help="folder that contains the run folders, or its URL, such as s3://bucket/archive (default: runs)",
    )


def add_runs_folder(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--runs",
        metavar="ARCHIVE",
        type=folder_argument,
        default=Path("runs"),
        help="folder or URL of the runs (default: runs)",
    )


def add_period(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--since", default="", metavar="DATE", help="runs from this day or moment on (UTC)")
    parser.add_argument("--until", default="", metavar="DATE", help="runs up to this day or moment (UTC)")


def add_index(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--index",
        metavar="FILE|URL",
        help="SQLite file, or URL of a PostgreSQL database (default: the environment variable PLANRUNNER_INDEX, else a file of this user)",
    )
    parser.add_argument(
        "--rebuild", action="store_true", help="read all runs again, not only those that are new or changed"
    )
    parser.add_argument("--no-refresh", action="store_true", help="use the index as it is")
    add_workers(parser, "processes that read the runs (default: one for each processor)")
    parser.add_argument("--quiet", action="store_true", help="show no progress")


@contextmanager
def opened_index(args: argparse.Namespace, archive: Path) -> Iterator[Index]:
    """Opens the index of an archive and updates it."""
    from planrunner.cli.progress import reading_progress
    from planrunner.tasks.history import Freshness, opened

    workers = workers_of(args, None)
    with reading_progress(args.quiet or args.json) as notice:
        index = opened(archive, args.index, Freshness(not args.no_refresh, args.rebuild, notice, workers))
    with index:
        yield index


def report_left_out(faults: Sequence[FaultRow]) -> int:
    """Prints on stderr the damaged runs that a command omits. Returns the exit code that these runs cause."""

    for fault in faults:
        print_line(f"not in the index: {fault.folder}: {fault.message}", sys.stderr)
    return exit_codes.INTEGRITY if faults else exit_codes.DONE

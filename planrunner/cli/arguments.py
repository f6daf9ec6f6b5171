"""Arguments that several commands have: numbers and dates, the place of computation, and the archive of runs or its index.

`--jobs` selects processes on this computer, and `--scheduler` selects a Dask cluster.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.findings import COMMAND_LINE, InputError
from planrunner.base.workers import Workers
from planrunner.cli import exit_codes
from planrunner.cli.printing import print_line

if TYPE_CHECKING:
    from planrunner.night.history.index import Index
    from planrunner.night.history.rows import FaultRow


def whole_number(what: str, least: int, most: int | None = None) -> Callable[[str], int]:
    """Returns a function that reads a whole number from `least` to `most`, for the option `type` of a command-line argument. The
    function raises `argparse.ArgumentTypeError` for any other text. `what`: a description of the number, for messages."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{what} must be a whole number: {text!r}") from None
        if value < least or (most is not None and value > most):
            bounds = f"at least {least}" if most is None else f"from {least} to {most}"
            raise argparse.ArgumentTypeError(f"{what} must be {bounds}: {value}")
        return value

    return read


SEED = whole_number("the seed", 0)


def day_of(text: str | None) -> date | None:
    """Reads a date in ISO 8601 form; returns None if the text is None. Raises `InputError` for any other text."""
    try:
        return None if text is None else date.fromisoformat(text)
    except ValueError:
        message = f"'{text}' is not a calendar date"
        raise InputError.at(COMMAND_LINE, "meaning-date", message, "write for example 2028-12-31") from None


HERE = "processes"
"""Value of `--scheduler` that selects processes on this machine."""


def scheduler(text: str) -> str:
    """Reads the address of a Dask scheduler, or the word `processes`. Raises `argparse.ArgumentTypeError` for any other text."""
    if text != HERE and not re.fullmatch(r"(tcp|tls)://[^/\s]+:\d+", text):
        raise argparse.ArgumentTypeError(f"must be an address such as tcp://10.0.0.5:8786, or {HERE}: {text}")
    return text


def add_workers(parser: argparse.ArgumentParser, jobs: str) -> None:
    """Adds the options --jobs, with the given help text, and --scheduler."""
    parser.add_argument("--jobs", metavar="N", type=whole_number("the number", 1), help=jobs)
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        type=scheduler,
        help=f"compute on the Dask cluster of this scheduler, such as tcp://10.0.0.5:8786. With the word `{HERE}`, compute on this "
        "machine, with one process per processor. The results are the same to the last digit. The cluster and this computer can run "
        "programs on each other: give only an address that you trust",
    )


def workers_of(args: argparse.Namespace, jobs: int | None = 1) -> Workers:
    """Determines the workers that the options request. `jobs`: number of processes if neither --jobs nor --scheduler is given.
    Raises `InputError` if both --jobs and a cluster are given."""
    if args.scheduler is None:
        return Workers(jobs if args.jobs is None else args.jobs)
    if args.scheduler == HERE:
        return Workers(args.jobs)
    if args.jobs is not None:
        message = "--jobs sets the number of processes on this machine and cannot be used with a cluster"
        raise InputError.of_usage(message, "give --jobs or --scheduler")
    return Workers(1, args.scheduler)


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


def add_data(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", metavar="DIR", type=Path, help="folder that contains the recordings to play back")


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
    add_workers(parser, "number of processes that read the runs (default: one for each processor)")
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

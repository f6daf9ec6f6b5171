"""Arguments of the commands that read an archive of runs, or its index."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planrunner.night.history.index import Index


def add_archive(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "archive",
        metavar="ARCHIVE",
        nargs="?",
        type=Path,
        default=Path("runs"),
        help="folder that contains the run folders (default: runs)",
    )


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
    parser.add_argument("--quiet", action="store_true", help="show no progress")


@contextmanager
def opened_index(args: argparse.Namespace, archive: Path) -> Iterator[Index]:
    """The index, up to date."""
    from planrunner.cli.progress import reading_progress
    from planrunner.tasks.history import Freshness, opened

    with reading_progress(args.quiet or args.json) as notice:
        index = opened(archive, args.index, Freshness(not args.no_refresh, args.rebuild, notice))
    with index:
        yield index

"""Defines the options that determine where a command computes: `--jobs` for processes on this computer, and `--scheduler` for a
Dask cluster."""

from __future__ import annotations

import argparse
import re

from planrunner.base.findings import InputError
from planrunner.base.workers import Workers
from planrunner.cli.arguments import whole_number

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
        help=f"compute on the Dask cluster of this scheduler, such as tcp://10.0.0.5:8786; {HERE}: on one process per processor of this "
        "machine. The results are the same to the last digit. The cluster and this computer can run programs on each other: give only an "
        "address that you trust",
    )


def workers_of(args: argparse.Namespace, jobs: int | None = 1) -> Workers:
    """Determines the workers that the options request. `jobs`: number of processes if neither --jobs nor --scheduler is given."""
    if args.scheduler is None:
        return Workers(jobs if args.jobs is None else args.jobs)
    if args.scheduler == HERE:
        return Workers(args.jobs)
    if args.jobs is not None:
        message = "--jobs is for the processes of this machine, not for a cluster"
        raise InputError.of_usage(message, "give --jobs or --scheduler")
    return Workers(1, args.scheduler)

"""The number of `--jobs`."""

from __future__ import annotations

import argparse


def number_of_jobs(text: str) -> int:
    """A number of processes or threads, at least 1. Raises `argparse.ArgumentTypeError`."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a whole number: {text}") from None
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1: {value}")
    return value

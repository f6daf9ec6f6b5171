"""Kinds of argument that several commands have."""

from __future__ import annotations

import argparse
from collections.abc import Callable


def whole_number(what: str, least: int, most: int | None = None) -> Callable[[str], int]:
    """Makes a function that reads a whole number from `least` to `most`, for the option `type` of a command-line argument. `what`:
    a description of the number, for messages."""

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

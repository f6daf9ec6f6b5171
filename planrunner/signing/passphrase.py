"""Reads the passphrase of private keys from the environment. The module is small, so that commands can use it without importing the
code for keys."""

from __future__ import annotations

import os

VARIABLE = "PLANRUNNER_PASSPHRASE"


def of_environment() -> bytes | None:
    """Returns the passphrase in the environment variable; None if the variable is not set."""
    text = os.environ.get(VARIABLE)
    return None if text is None else text.encode()

"""The passphrase of private keys in the environment. Light, so that a command line can name it without reading keys."""

from __future__ import annotations

import os

VARIABLE = "PLANRUNNER_PASSPHRASE"


def of_environment() -> bytes | None:
    """None if the variable is not set."""
    text = os.environ.get(VARIABLE)
    return None if text is None else text.encode()

"""Defines the types of values in JSON documents: contents of files, journals, replies of other processes, and data of templates.

A value is None, a boolean, a number, a text, a list of values, or an object that maps names to values. A schema in `schemas/`
states the type of each value in a document. This type is checked when the document is read, not by mypy.
"""

from __future__ import annotations

import math
from typing import Any

Json = Any
JsonObject = dict[str, Json]


def finite(value: float) -> float | None:
    """Converts a number to a value that JSON can represent: NaN and infinities become null."""
    return value if math.isfinite(value) else None

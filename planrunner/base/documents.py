"""Values of JSON documents: what files, journals, replies of other processes and templates hold.

A value is None, a boolean, a number, a text, a list of values, or an object of values by name. A schema in `schemas/` says which of them a
document has where; the type of each is checked when it is read, not by mypy.
"""

from __future__ import annotations

import math
from typing import Any

Json = Any
JsonObject = dict[str, Json]


def finite(value: float) -> float | None:
    """A number for JSON, which has neither NaN nor infinities: both are null."""
    return value if math.isfinite(value) else None

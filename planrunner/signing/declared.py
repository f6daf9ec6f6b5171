"""Reads keys of the bench file in a run without validating the file, so that the run can be verified even if the bench file is not
valid."""

from __future__ import annotations

from planrunner.base.documents import Json
from planrunner.plan import source


def declared(bench: bytes | None, key: str) -> Json:
    """Returns the value of a key in the text of a bench file; None if the key is absent or the file cannot be read."""
    if bench is None:
        return None
    try:
        found = source.plain(source.parse(source.decode(bench, "bench"), "bench"))
    except Exception:  # the bench of a run need not be readable for its digests to be verified
        return None
    return found.get(key) if isinstance(found, dict) else None

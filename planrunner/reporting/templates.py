"""Templates into pages: the shipped ones in this process, a user's own in a child process with limits on time and memory.

Both are laid out in the sandbox. A shipped template is part of the program and is tested with it; a template that came from elsewhere may
loop for ever or fill the memory without leaving the sandbox, and a run of hours must not end with that. So the data go to the child as
JSON, the page or the error comes back, and whatever happens to the child is a `ReportError`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from planrunner.reporting.sandbox import MAX_OUTPUT, ReportError, available, lay_out
from planrunner.reporting.template_data import to_json

__all__ = ["ReportError", "available", "render"]

MAX_SECONDS = 30.0
"""Of computing time that a user's template may take."""
MAX_MEMORY = 1 << 30
"""Bytes of memory that laying out a user's template may take, with the program that does it."""
PATIENCE = 10
"""Times `MAX_SECONDS` until the child is ended from outside, on a computer that has other work."""


def render(name: str, given: Mapping[str, Any], folder: Path | None = None) -> str:
    """The text that the template `name` (with or without `.j2`) makes of `given`, which must be plain data.

    A language may stand before the ending: `certificate.zh.html`. folder: a user's template folder, searched before the shipped one.
    Raises `ReportError`.
    """
    return lay_out(name, given) if folder is None else _lay_out_apart(name, given, folder)


def _lay_out_apart(name: str, given: Mapping[str, Any], folder: Path) -> str:
    request = {
        "name": name,
        "folder": str(folder.resolve()),
        "given": to_json(given),
        "most": MAX_OUTPUT,
        "seconds": MAX_SECONDS,
        "memory": MAX_MEMORY,
    }
    import subprocess

    command = [sys.executable, "-m", "planrunner.reporting.template_process"]
    try:
        done = subprocess.run(
            command, input=json.dumps(request).encode(), capture_output=True, timeout=PATIENCE * MAX_SECONDS
        )
    except subprocess.TimeoutExpired:
        raise ReportError(f"{name}: the template takes longer than {PATIENCE * MAX_SECONDS:g} s; {_LOOK}") from None
    except OSError as error:
        raise ReportError(f"{name}: no process can be started for it: {error.strerror or error}") from None
    try:
        answer = json.loads(done.stdout)
    except ValueError:  # ended by the system, most likely for its memory or its time
        limits = f"{MAX_SECONDS:g} s of computing or {MAX_MEMORY / 1e9:.1f} GB of memory"
        raise ReportError(f"{name}: the template takes more than {limits}; {_LOOK}") from None
    if "page" not in answer:
        raise ReportError(answer["error"])
    page: str = answer["page"]
    return page


_LOOK = "check its loops"

"""Comparison of a text with the one that was read and agreed upon. PLANRUNNER_GOLDEN=write replaces it, to be reviewed again."""

from __future__ import annotations

import difflib
import os
from pathlib import Path

FOLDER = Path(__file__).parent / "golden"


def check(name: str, text: str) -> None:
    path = FOLDER / name
    text = "\n".join(line.rstrip() for line in text.splitlines()) + "\n"
    if os.environ.get("PLANRUNNER_GOLDEN") == "write":
        path.write_text(text, encoding="utf-8")
    agreed = path.read_text(encoding="utf-8")
    changes = difflib.unified_diff(agreed.splitlines(), text.splitlines(), "agreed", "now", lineterm="")
    assert text == agreed, "\n".join(changes)

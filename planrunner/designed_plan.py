"""Writing the plan that a design study proposes: beside the one it was made for, and only once it passes its checks."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from planrunner.checking import Checked, check_plan
from planrunner.estimators.interface import EstimationError


class Proposal(Protocol):
    """text: the proposed plan; checked: the one it was made for."""

    @property
    def text(self) -> str: ...
    @property
    def checked(self) -> Checked: ...


def write_plan(study: Proposal, path: Path, bench: str | None = None) -> Checked:
    """Writes the plan with what was designed, once it passes its checks. Raises `InputError` with what is wrong, and
    `EstimationError` rather than writing over the plan that was designed for."""
    if path.exists() and path.samefile(study.checked.file):
        raise EstimationError(f"{path} is the plan itself: write to another file")
    aside = path.with_name(f".{path.name}.tmp")
    aside.write_text(study.text, encoding="utf-8", newline="")
    try:
        check_plan(aside, bench=bench).sound()
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)
    return check_plan(path, bench=bench)

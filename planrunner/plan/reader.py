"""Reads plan files into `Plan` records, with all findings about form and about the meaning of single values."""

from __future__ import annotations

from pathlib import Path

from planrunner.base.findings import Findings, InputError
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.model import Plan


def read_plan(root: source.Mapping, log: Findings | None = None) -> tuple[Plan | None, Findings]:
    """The plan in a document, as far as it can be read, and the findings about it (added to `log`, if given).

    A part with an error is left out (a segment is marked as not sound), so that all other parts can still be checked.
    """
    log = Findings() if log is None else log
    if root.get("planrunner") is None and root.get("planrunner_bench") is not None:
        log.error("form-bench", root.mark, "this is a bench file, not a plan", "give it with --bench")
        return None, log
    return RecordOf(Plan).read(root, log), log


def parse_plan(text: str, shown: str) -> tuple[Plan | None, Findings]:
    """The plan in `text` and all findings about it. shown: file name in findings. Never raises because of the content."""
    log = Findings()
    try:
        root = source.parse(text, shown, log)
    except InputError as error:
        return None, Findings(error.findings)
    return read_plan(root, log)


def load_plan(path: Path, shown: str | None = None) -> tuple[Plan | None, Findings]:
    """Like `parse_plan`, from a file."""
    try:
        text = source.read_text(path, shown)
    except InputError as error:
        return None, Findings(error.findings)
    return parse_plan(text, shown or str(path))

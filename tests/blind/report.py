"""The score of a campaign as text and JSON: one column for each who answered, one row for each figure of the target table."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.blind import folder as store
from tests.blind.effects import SHOWS_UNDER
from tests.blind.scoring import Rate, closure_against, closure_held_out, plain, score

ORDER = ("planrunner", "oracle", "whitened-bic", "stepwise-bic", "lasso", "stlsq")


def scored(folder: Path, file: Path | None = None, first: int | None = None) -> str:
    """Verifies the commitments, scores every set of answers to all cases, or to the first so many, writes JSON where asked, and returns
    the table.

    Raises BrokenSealError where a label is not the one committed to, ValueError where nothing was answered.
    """
    labels = dict(sorted(store.verified_labels(folder).items())[:first])
    whose = sorted(path.name for path in (folder / "answers").glob("*") if path.is_dir())
    if not whose:
        raise ValueError(f"nothing in {folder} is answered yet: python -m tests.blind answer {folder}")
    answers = {who: store.answers(folder, who) for who in whose}
    figures = {who: score(labels, given, SHOWS_UNDER) for who, given in answers.items() if who != "closure"}
    held_out = answers.pop("closure", None)
    if held_out is not None and (own := figures.get("planrunner")) is not None:
        own["closure on segments held out"] = closure_held_out(labels, held_out)
    if "oracle" in answers:
        for who, given in answers.items():
            figures[who]["closure against the oracle's"] = closure_against(labels, given, answers["oracle"])
    if file is not None:
        file.write_text(
            json.dumps({"cases": len(labels), "answers": plain(figures)}, indent=1) + "\n", encoding="utf-8"
        )
    return table(len(labels), figures)


def table(cases: int, figures: Mapping[str, Mapping[str, Any]]) -> str:
    whose = sorted(figures, key=lambda who: (ORDER.index(who) if who in ORDER else len(ORDER), who))
    columns = {who: dict(_rows(figures[who], "")) for who in whose}
    names = list(dict.fromkeys(name for rows in columns.values() for name in rows))
    wide = max(len(name) for name in names)
    each = {who: max(len(who), *(len(text) for text in rows.values())) for who, rows in columns.items()}
    lines = [f"{cases} cases, commitments verified; shares with 95 % intervals"]
    lines.append("  ".join([" " * wide, *(who.rjust(each[who]) for who in whose)]).rstrip())
    for name in names:
        texts = [columns[who].get(name, "").rjust(each[who]) for who in whose]
        lines.append("  ".join([name.ljust(wide), *texts]).rstrip())
    return "\n".join(lines) + "\n"


def _rows(figures: Mapping[str, Any], before: str) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for name, value in figures.items():
        label = f"{before}{name}"
        if isinstance(value, Rate):
            found.append((label, _share(value)))
        elif isinstance(value, Mapping):
            found += _rows(value, f"{label}: ")
        elif isinstance(value, int | float):
            found.append((label, f"{value:.3g}" if isinstance(value, float) else str(value)))
    return found


def _share(rate: Rate) -> str:
    if not rate.n:
        return "-"
    low, high = rate.interval
    return f"{rate.value:.3f} [{low:.3f}, {high:.3f}] of {rate.n}"

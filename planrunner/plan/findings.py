"""Findings: what is wrong with a file, where, and what to do about it.

Every check of a plan or bench adds to one `Findings` list, so that a quality engineer sees all of them in one run. The codes
are documented in `docs/findings.md`, and a test holds the two together.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True, slots=True)
class Mark:
    """A place in a file. Lines and columns count from 1, as editors show them."""

    file: str
    line: int = 1
    column: int = 1

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding; `str()` gives the line that the terminal shows, without the hint."""

    mark: Mark
    code: str
    severity: Severity
    message: str
    hint: str = ""

    def __str__(self) -> str:
        return f"{self.mark}: {self.severity}[{self.code}]: {self.message}"

    def to_json(self) -> dict[str, Any]:
        row = asdict(self)
        return {**row.pop("mark"), **row}


@dataclass(slots=True)
class Findings:
    """A growing list of findings; identical ones are kept once."""

    items: list[Finding] = field(default_factory=list)

    def error(self, code: str, mark: Mark, message: str, hint: str = "") -> None:
        self._add(Finding(mark, code, "error", message, hint))

    def warning(self, code: str, mark: Mark, message: str, hint: str = "") -> None:
        self._add(Finding(mark, code, "warning", message, hint))

    def note(self, code: str, mark: Mark, message: str, hint: str = "") -> None:
        self._add(Finding(mark, code, "note", message, hint))

    def _add(self, finding: Finding) -> None:
        if finding not in self.items:
            self.items.append(finding)

    @property
    def errors(self) -> list[Finding]:
        return [item for item in self.items if item.severity == "error"]

    def __iter__(self) -> Iterator[Finding]:
        return iter(sorted(self.items, key=lambda item: (item.mark.file, item.mark.line, item.mark.column)))

    def __len__(self) -> int:
        return len(self.items)


class InputError(Exception):
    """The input is wrong (exit code 2). Carries findings; the command line prints them, never a traceback."""

    def __init__(self, findings: Iterable[Finding]):
        self.findings = list(findings)
        super().__init__("\n".join(map(str, self.findings)))

    @classmethod
    def at(cls, mark: Mark, code: str, message: str, hint: str = "") -> InputError:
        return cls([Finding(mark, code, "error", message, hint)])


def closest(word: str, known: Iterable[str]) -> str:
    """A hint naming the closest known word, or all of them when none is close."""
    names = sorted(known)
    match = difflib.get_close_matches(word[:80], names, n=1, cutoff=0.6)
    if match:
        return f"did you mean '{match[0]}'?"
    return f"known here: {', '.join(names)}" if names else ""

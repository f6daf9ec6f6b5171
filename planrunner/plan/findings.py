"""Findings: what is wrong with a file, where, and what to do about it.

Every check of a plan or bench adds to one `Findings` list, so that a quality engineer sees all of them in one run. The codes
are documented in `docs/findings.md`, and a test holds the two together.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from functools import lru_cache
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
    """A growing list of findings; identical ones are kept once. Iterating gives them in the order of the file."""

    items: list[Finding] = field(default_factory=list)
    _seen: set[Finding] = field(default_factory=set, repr=False, compare=False)
    _errors: list[Finding] = field(default_factory=list, repr=False, compare=False)

    def __post_init__(self) -> None:
        given, self.items = self.items, []
        self.extend(given)

    def error(self, code: str, mark: Mark, message: str, hint: str = "") -> None:
        self._add(Finding(mark, code, "error", message, hint))

    def warning(self, code: str, mark: Mark, message: str, hint: str = "") -> None:
        self._add(Finding(mark, code, "warning", message, hint))

    def note(self, code: str, mark: Mark, message: str, hint: str = "") -> None:
        self._add(Finding(mark, code, "note", message, hint))

    def extend(self, findings: Iterable[Finding]) -> None:
        for finding in findings:
            self._add(finding)

    def _add(self, finding: Finding) -> None:
        if finding not in self._seen:
            self._seen.add(finding)
            self.items.append(finding)
            if finding.severity == "error":
                self._errors.append(finding)

    @property
    def errors(self) -> list[Finding]:
        """The errors among them, in the order in which they were found."""
        return self._errors

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
    return _closest(word[:80], tuple(sorted(known)))


@lru_cache(maxsize=1024)
def _closest(word: str, names: tuple[str, ...]) -> str:
    letters = set(word.lower())
    # Comparing sequences is slow; a word that shares less than half of its letters cannot be close.
    likely = {name.lower(): name for name in names if 2 * len(letters & set(name.lower())) >= len(letters)}
    match = difflib.get_close_matches(word.lower(), likely, n=1, cutoff=0.6)
    if match:
        return f"did you mean '{likely[match[0]]}'?"
    shown = names if len(names) <= _MOST_NAMES else (*names[:_MOST_NAMES], f"and {len(names) - _MOST_NAMES} more")
    return f"known here: {', '.join(shown)}" if names else ""


_MOST_NAMES = 25

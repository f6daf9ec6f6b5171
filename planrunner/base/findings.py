"""Represents findings, which are faults of a file with their positions and remedies.

Every check of a plan or bench adds to one `Findings` list, so that a quality engineer sees all findings in one run. The codes are
documented in `docs/findings.md`; a test checks that no code is missing in this file.

A check that depends on other parts of the file names these parts with `Findings.resting_on`. If one of these parts already has an
error, the findings of the check are consequences of this error. The list contains the consequences together with the error, but
shows only the error.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from functools import lru_cache
from typing import Literal

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import JsonObject

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True, slots=True)
class Mark:
    """A position in a file, or `COMMAND_LINE`. Lines and columns count from 1, as editors show them.

    `end`: line and column just after the marked text, if known. `text`: the whole file as read, for excerpts.
    """

    file: str
    line: int = 1
    column: int = 1
    end: tuple[int, int] | None = field(default=None, compare=False, repr=False)
    text: str | None = field(default=None, compare=False, repr=False)

    def covers(self, other: Mark) -> bool:
        """Returns True if another position lies within this one."""
        if self.file != other.file:
            return False
        begin, there = (self.line, self.column), (other.line, other.column)
        return begin == there if self.end is None else begin <= there < max(self.end, (self.line, self.column + 1))

    def __str__(self) -> str:
        if self == COMMAND_LINE:  # it has no lines
            return "command line"
        return f"{self.file}:{self.line}:{self.column}"


COMMAND_LINE = Mark("<command line>")
"""Place that is stated for errors in the arguments of a command."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding. `str()` gives the finding as a line for the terminal, without the hint.

    `cause`: the error from which this finding follows. A finding with a cause is stored, but not shown.
    """

    mark: Mark
    code: str
    severity: Severity
    message: str
    hint: str = ""
    cause: Finding | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return f"{self.mark}: {self.severity}[{self.code}]: {self.message}"

    def to_json(self) -> JsonObject:
        place = {"file": self.mark.file, "line": self.mark.line, "column": self.mark.column}
        return {
            **place,
            "code": self.code,
            "severity": self.severity,
            "message": self.message,
            "hint": self.hint,
        }


@dataclass(slots=True)
class Findings:
    """A growing list of findings. Identical findings are kept once.

    Iteration yields the findings that are shown, in the order of the file. Findings that follow from another error in the list are
    omitted.
    """

    items: list[Finding] = field(default_factory=list)
    _seen: set[Finding] = field(default_factory=set, repr=False, compare=False)
    _errors: list[Finding] = field(default_factory=list, repr=False, compare=False)
    _cause: Finding | None = field(default=None, repr=False, compare=False)
    raised: int = field(default=0, init=False, repr=False, compare=False)
    """Number of errors added, including repeated ones. Compare it before and after a check to see if the check found errors."""

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

    @contextmanager
    def resting_on(self, *parts: Mark) -> Iterator[None]:
        """Encloses checks that assume that the given parts of the file are correct (a context manager). If one of the parts has an
        error when the context is entered, the findings that are added within the context are recorded as consequences of the first
        such error.

        A check must therefore run after the checks of the parts on which it depends. A part may also be the mark of a known error.
        """
        before = self._cause
        self._cause = before or self.error_in(*parts)
        try:
            yield
        finally:
            self._cause = before

    def error_in(self, *parts: Mark) -> Finding | None:
        """Returns the first error in one of these parts, or the error that caused it; None if there is no error."""
        found = next((error for error in self._errors if any(part.covers(error.mark) for part in parts)), None)
        return found if found is None or found.cause is None else found.cause

    def _add(self, finding: Finding) -> None:
        if self._cause is not None and finding.cause is None:
            finding = replace(finding, cause=self._cause)
        self.raised += finding.severity == "error"
        if finding not in self._seen:
            self._seen.add(finding)
            self.items.append(finding)
            if finding.severity == "error":
                self._errors.append(finding)

    @property
    def errors(self) -> list[Finding]:
        """Returns all errors in the order in which they were found, including those that follow from other errors."""
        return self._errors

    def __iter__(self) -> Iterator[Finding]:
        shown = [item for item in self.items if item.cause is None]
        return iter(sorted(shown, key=lambda item: (item.mark.file, item.mark.line, item.mark.column)))

    def __len__(self) -> int:
        return len(self.items)


class InputError(Exception):
    """The input is wrong (exit code 2). The exception contains findings, which the command line prints without a traceback."""

    def __init__(self, findings: Iterable[Finding]):
        self.findings = list(findings)
        super().__init__("\n".join(map(str, self.findings)))

    @classmethod
    def of_usage(cls, message: str, hint: str) -> InputError:
        """Makes the error for contradictory arguments of a command."""
        return cls.at(COMMAND_LINE, "command-usage", message, hint)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.findings,)

    @classmethod
    def at(cls, mark: Mark, code: str, message: str, hint: str = "") -> InputError:
        return cls([Finding(mark, code, "error", message, hint)])


def count_of(number: int, one: str, several: str = "") -> str:
    """Returns a number with its noun, such as `1 run` and `2 runs`. `several`: the plural of the noun; by default the noun with an
    s."""
    return f"{number} {one if number == 1 else several or f'{one}s'}"


def elsewhere(marks: Sequence[Mark], first: Mark) -> str:
    """Returns a text for the message of a finding that names the other lines concerned, such as ' (also on lines 12 and 13)'. The
    text is empty if the finding concerns only the line of `first`."""
    lines = sorted({mark.line for mark in marks} - {first.line})
    if not lines:
        return ""
    shown = [str(line) for line in lines[:_MOST_LINES]]
    if len(lines) > _MOST_LINES:
        shown.append(f"{len(lines) - _MOST_LINES} more")
    return f" (also on line{'s' if len(lines) > 1 else ''} {' and '.join([', '.join(shown[:-1]), shown[-1]] if shown[1:] else shown)})"


_MOST_LINES = 8


MISLEADING = re.compile("[\x80-\x9f\u061c\u200b\u200e\u200f\u202a-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb]")
"""Invisible characters that change how text looks: reading-order marks, zero-width characters, terminal controls. A name with such a
character looks like another name."""


def closest(word: str, known: Iterable[str]) -> str:
    """Returns a hint with the closest known word, or with all known words if none is close."""
    names = tuple(sorted(known))
    near = _nearest(word[:80], names)
    if near is not None:
        return f"did you mean '{near}'?"
    shown = names if len(names) <= _MOST_NAMES else (*names[:_MOST_NAMES], f"and {len(names) - _MOST_NAMES} more")
    return f"known here: {', '.join(shown)}" if names else ""


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Returns the known word that a misspelt word probably means; None if no word is close."""
    return _nearest(word[:80], tuple(sorted(known)))


@lru_cache(maxsize=1024)
def _nearest(word: str, names: tuple[str, ...]) -> str | None:
    import difflib  # takes milliseconds that a sound plan does not need

    letters = set(word.lower())
    # Comparing sequences is slow, and a word that shares fewer than half of its letters cannot be close.
    likely = {name.lower(): name for name in names if 2 * len(letters & set(name.lower())) >= len(letters)}
    match = difflib.get_close_matches(word.lower(), likely, n=1, cutoff=_ALIKE)
    return likely[match[0]] if match else None


_MOST_NAMES = 25
_ALIKE = 0.66
"""A word counts as a misspelling of another word if their similarity is above this value. 'mim' and 'min' have the similarity 0.67;
'vibration' and 'orientation' have 0.60."""

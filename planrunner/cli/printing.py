"""Prints findings on the command line: `file:line:column: error[code]: …`, the source line with a caret, then the hint.

    12 |     dwell: 30
       |            ^^

The source line is shown as it was read, even if the file was changed or removed later, or was a pipe. Before columns are counted,
control characters are replaced by codes, and characters that the encoding lacks are replaced by escape sequences.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterable
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import TextIO

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.base.findings import Finding, InputError, Mark
from planrunner.reporting.printable import beneath, printable

_INDENT = "    "
_TAB = "    "
_CUT = "..."
_SIMPLE = "\u0300"  # all printable characters below this code take one column
_BREAK = re.compile("\r\n|\r|\n")


@dataclass(frozen=True, slots=True)
class Excerpt:
    """A source line for display.

    `gutter`: the line number. `blank`: as many spaces as the line number has characters. `line`: the text of the line, cut to the
    available width. `carets`: the marks below the text.
    """

    gutter: str
    blank: str
    line: str
    carets: str


def excerpt(mark: Mark, width: int, encoding: str = "utf-8") -> Excerpt | None:
    """Returns the source line that a mark refers to, cut to `width` columns, for a stream with this encoding; None if the text of
    the file is not known."""
    if mark.text is None:
        return None
    lines = _lines(mark.text)
    if mark.line > len(lines):
        return None
    text = lines[mark.line - 1]
    cells = [_cell(char, encoding) for char in text]
    first = min(mark.column - 1, len(cells))
    last = first + 1
    if mark.end is not None and mark.end[0] == mark.line:
        last = max(last, min(mark.end[1] - 1, len(cells)))
    gutter = f"{_INDENT}{mark.line} | "
    blank = f"{_INDENT}{'':{len(str(mark.line))}} | "
    shown, before, under = _fitted(cells, first, last, max(width - len(gutter), 3 * len(_CUT) + 1))
    return Excerpt(gutter, blank, shown.rstrip(), " " * before + "^" * under)


@lru_cache(maxsize=4)
def _lines(text: str) -> list[str]:
    return _BREAK.split(text)


def _cell(char: str, encoding: str) -> tuple[str, int]:
    """Returns the text that is shown for one character of a file, and the number of columns that the text takes."""
    if char == "\t":
        return _TAB, len(_TAB)
    shown = printable(char, keep="").encode(encoding, "backslashreplace").decode(encoding)
    if shown != char or char < _SIMPLE:
        return shown, len(shown)
    from rich.cells import get_character_cell_size

    return char, get_character_cell_size(char)


def _fitted(cells: list[tuple[str, int]], first: int, last: int, room: int) -> tuple[str, int, int]:
    """Returns the part of a line that fits into `room` columns and contains the cells from `first` to `last`. Also returns the
    number of columns before these cells, and the number of columns that these cells occupy."""
    widths = [width for _, width in cells]
    begin, end = 0, len(cells)
    if sum(widths) > room:
        inner = room - 2 * len(_CUT)
        begin = first
        taken = 0
        while begin > 0 and taken + widths[begin - 1] <= inner // 3:  # a third of the width for text before the place
            begin -= 1
            taken += widths[begin]
        end = begin
        taken = 0
        while end < len(cells) and (taken + widths[end] <= inner or end == first):
            taken += widths[end]
            end += 1
        while begin > 0 and taken + widths[begin - 1] <= inner:  # the place is near the end of the line
            begin -= 1
            taken += widths[begin]
        if begin <= len(_CUT):  # no longer than the ellipsis
            begin = 0 if sum(widths[:end]) <= inner + len(_CUT) else begin
    left, right = _CUT if begin else "", _CUT if end < len(cells) else ""
    shown = left + "".join(text for text, _ in cells[begin:end]) + right
    under = sum(widths[first : min(last, end)])
    return shown, len(left) + sum(widths[begin:first]), max(1, under)


_COLOURS = {"error": "31;1", "warning": "33;1", "note": "36"}

WIDE = 160
"""Number of columns if the output is not a terminal."""

EXCERPTS = ContextVar("EXCERPTS", default=True)
"""True if findings are printed with their source line. `--no-excerpt` sets it to False."""


def columns(stream: TextIO) -> int:
    """Returns the maximum width of a line: the width of the terminal, or `WIDE` if the output is a pipe or a file."""
    return shutil.get_terminal_size((WIDE, 24)).columns if stream.isatty() else WIDE


def print_findings(findings: Iterable[Finding], file: TextIO | None = None) -> None:
    """Prints findings to stderr, or to `file` if it is given. The output is coloured if it goes to a terminal. Each finding is one
    line, followed by its source line and a hint."""
    out = beneath(file or sys.stderr)
    colour = out.isatty() and not os.environ.get("NO_COLOR")
    width = columns(out)
    for finding in findings:
        text = printable(str(finding), keep="")
        if colour:
            word = f"{finding.severity}[{finding.code}]"
            text = text.replace(word, _coloured(word, finding), 1)
        print(text, file=out)
        shown = excerpt(finding.mark, width, out.encoding or "utf-8") if EXCERPTS.get() else None
        if shown is not None:
            print(f"{shown.gutter}{shown.line}".rstrip(), file=out)
            print(f"{shown.blank}{_coloured(shown.carets, finding) if colour else shown.carets}", file=out)
        if finding.hint:
            print(printable(f"    hint: {finding.hint}", keep=""), file=out)


def _coloured(text: str, finding: Finding) -> str:
    return f"\033[{_COLOURS[finding.severity]}m{text}\033[0m"


def print_line(text: str, file: TextIO | None = None) -> None:
    """Prints a line with text from files, such as a label. Control characters and line breaks in the text are shown as codes."""
    print(printable(text, keep=""), file=file)


def name_file(path: Path, as_json: bool) -> None:
    """Prints the name of a file that was written. With `--json`, the name is printed on stderr, because stdout contains the
    JSON."""
    print(path, file=sys.stderr if as_json else sys.stdout)


def write_file(path: Path, text: str) -> None:
    """Writes a file that the user named. If the disk is full, nothing is written, and an existing file stays unchanged. Raises
    `InputError` if the file cannot be written."""
    if path.exists() and not path.is_file():  # such as /dev/stdout
        path.write_text(text, encoding="utf-8")
        return
    aside = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        try:
            aside.write_text(text, encoding="utf-8")
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(path, error) from None


def write_named(path: Path, text: str, as_json: bool) -> None:
    """Writes a file that the user named, as `write_file` does, and prints its name, as `name_file` does."""
    write_file(path, text)
    name_file(path, as_json)


def write_new(path: Path, text: bytes) -> None:
    """Writes a new file. If this fails, no part of the file remains. Raises `InputError`, for example if the file already exists."""
    try:
        with path.open("xb") as file:
            try:
                file.write(text)
                file.flush()
            except OSError:
                path.unlink(missing_ok=True)
                raise
    except FileExistsError:
        raise InputError.at(Mark(str(path)), "new-exists", "this file exists already", "choose another name") from None
    except OSError as error:
        raise _unwritable(path, error) from None


def _unwritable(path: Path, error: OSError) -> InputError:
    message = f"the file cannot be written: {error.strerror or error}"
    return InputError.at(
        Mark(str(path)), "file-unwritable", message, "free disk space, or choose a file in another folder"
    )


def print_json(value: Json) -> None:
    """Prints JSON to stdout. If the encoding of stdout is not UTF-8, characters are escaped so that the output stays valid JSON."""
    plain = (sys.stdout.encoding or "").lower().replace("-", "") != "utf8"
    import json

    text = json.dumps(value, indent=1, ensure_ascii=plain, allow_nan=False)
    print(printable(text, code=lambda char: json.dumps(char)[1:-1]))  # invisible characters occur only in strings

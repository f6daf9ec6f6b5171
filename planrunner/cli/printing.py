"""How the command line prints findings: `file:line:column: error[code]: …`, the line it points at with a caret, then the hint."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterable
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TextIO

from planrunner.base.findings import Finding, InputError, Mark
from planrunner.cli.excerpt import excerpt
from planrunner.reporting.printable import beneath, printable

_COLOURS = {"error": "31;1", "warning": "33;1", "note": "36"}

WIDE = 160
"""Columns, away from a terminal."""

EXCERPTS = ContextVar("EXCERPTS", default=True)
"""Whether findings are printed with the line that they point at (`--no-excerpt`)."""


def columns(stream: TextIO) -> int:
    """How wide a line may be: that of the terminal, or `WIDE` for a pipe or a file."""
    return shutil.get_terminal_size((WIDE, 24)).columns if stream.isatty() else WIDE


def print_findings(findings: Iterable[Finding], file: TextIO | None = None) -> None:
    """To standard error unless `file` is given; coloured on a terminal. Each finding is one line, whatever its text holds, with the line of
    the file that it points at and a hint beneath."""
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


def write_file(path: Path, text: str) -> None:
    """Write a file that the user named, whole or, when the disk is full, not at all. Raises `InputError`."""
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
        message = f"the file cannot be written: {error.strerror or error}"
        raise InputError.at(
            Mark(str(path)), "file-unwritable", message, "make room, or name a file in another folder"
        ) from None


def print_json(value: Any) -> None:
    """To standard output, as escapes where its encoding is not UTF-8, so that it stays JSON."""
    plain = (sys.stdout.encoding or "").lower().replace("-", "") != "utf8"
    text = json.dumps(value, indent=1, ensure_ascii=plain, allow_nan=False)
    print(printable(text, code=lambda char: json.dumps(char)[1:-1]))  # what has no shape stands in strings alone

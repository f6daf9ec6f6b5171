"""How the command line prints findings: one line each as `file:line:column: error[code]: …`, then the hint."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TextIO

from planrunner.plan.findings import Finding, InputError, Mark
from planrunner.reporting.printable import beneath, printable

_COLOURS = {"error": "31;1", "warning": "33;1", "note": "36"}


def print_findings(findings: Iterable[Finding], file: TextIO | None = None) -> None:
    """To standard error unless `file` is given; coloured on a terminal. Each finding is one line, whatever its text holds."""
    out = beneath(file or sys.stderr)
    colour = out.isatty() and not os.environ.get("NO_COLOR")
    for finding in findings:
        text = printable(str(finding), keep="")
        if colour:
            word = f"{finding.severity}[{finding.code}]"
            text = text.replace(word, f"\033[{_COLOURS[finding.severity]}m{word}\033[0m", 1)
        print(text, file=out)
        if finding.hint:
            print(printable(f"    hint: {finding.hint}", keep=""), file=out)


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

"""How the command line prints findings: one line each as `file:line:column: error[code]: …`, then the hint."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable
from typing import Any, TextIO

from planrunner.plan.findings import Finding
from planrunner.reporting.printable import printable

_COLOURS = {"error": "31;1", "warning": "33;1", "note": "36"}


def print_findings(findings: Iterable[Finding], file: TextIO | None = None) -> None:
    """To standard error unless told otherwise; coloured on a terminal."""
    out = file or sys.stderr
    colour = out.isatty() and not os.environ.get("NO_COLOR")
    for finding in findings:
        text = printable(str(finding))
        if colour:
            word = f"{finding.severity}[{finding.code}]"
            text = text.replace(word, f"\033[{_COLOURS[finding.severity]}m{word}\033[0m", 1)
        print(text, file=out)
        if finding.hint:
            print(printable(f"    hint: {finding.hint}"), file=out)


def print_json(value: Any) -> None:
    json.dump(value, sys.stdout, indent=1, ensure_ascii=False, allow_nan=False)
    print()

"""Generates the reference of all keys of a suite, `docs/suite-keys.md`, from the record classes with which suites are read.

The command `python -m planrunner.night.reference docs` writes this file. A test checks that the file is up to date.
"""

from __future__ import annotations

import sys
from pathlib import Path

from planrunner.night.suite import SECTIONS
from planrunner.plan.kinds import keys_of
from planrunner.plan.reference import first_line, section

_HEAD = """\
# Every key of a suite

Generated from the source code with `python -m planrunner.night.reference docs`; do not edit.
[running-a-night.md](running-a-night.md) explains the keys with complete examples. A key in **bold** is required.
Write a time as a number with its unit, for example `45 min`.
"""


def suite_reference() -> str:
    """Returns the text of `docs/suite-keys.md`."""
    parts = [section(title, about or first_line(record), keys_of(record)) for title, about, record in SECTIONS]
    return "\n".join([_HEAD, *parts])


if __name__ == "__main__":
    (Path(sys.argv[1]) / "suite-keys.md").write_text(suite_reference(), encoding="utf-8")

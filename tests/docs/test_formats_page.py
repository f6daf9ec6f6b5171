"""The examples of docs/recording-formats.md are instruments of a bench."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from planrunner.base.findings import Findings
from planrunner.bench.model import INSTRUMENT
from planrunner.instruments.formats.choice import ENDINGS, FORMATS
from planrunner.plan import source

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "recording-formats.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES)
def test_each_example_describes_a_recording(example: str) -> None:
    document = source.parse(example, "bench.yaml")
    assert isinstance(document, source.Mapping)
    ((_, node),) = document.entries
    log = Findings()
    assert INSTRUMENT.read(node, log) is not None
    assert list(log) == []


def test_the_table_names_every_format_and_ending() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*?) \|", PAGE, re.MULTILINE))
    assert set(rows) == set(FORMATS)
    for name, row in rows.items():
        assert set(re.findall(r"`(\.\w+)`", row)) == {ending for ending, kind in ENDINGS.items() if kind == name}

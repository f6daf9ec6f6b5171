"""Every code that the source can give stands in docs/findings.md with an example and a remedy, and no other does."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROW = re.compile(r"^\| `([a-z-]+)` \| (.+) \| (.+) \|$", re.MULTILINE)
CODE = re.compile(r"syntax|[a-z]+(-[a-z]+)+")

# Where a call carries its code.
PLACES = {
    "error": 0,
    "warning": 0,
    "note": 0,
    "_once": 0,
    "add": 0,
    "QuantityError": 0,
    "at": 1,
    "Finding": 1,
    "Remark": 0,
    "_Reason": 0,
    "_Known": 1,
    "IntegrityError": 1,
    "_error": 1,
}


def codes_in(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        given: list[ast.expr] = []
        if name in PLACES and len(node.args) >= 2:
            given = node.args[PLACES[name] : PLACES[name] + 1]
        elif name == "Plugged":
            given = [*node.args[-1:], *(word.value for word in node.keywords if word.arg == "code")]
        for item in given:
            if isinstance(item, ast.Constant) and isinstance(item.value, str) and CODE.fullmatch(item.value):
                yield item.value


def test_the_codes_in_the_docs_are_those_of_the_source() -> None:
    source = {code for path in (ROOT / "planrunner").rglob("*.py") for code in codes_in(path)}
    documented = [row[0] for row in ROW.findall((ROOT / "docs" / "findings.md").read_text(encoding="utf-8"))]
    assert len(source) > 80
    assert len(documented) == len(set(documented))
    assert sorted(source - set(documented)) == [], "add these to docs/findings.md"
    assert sorted(set(documented) - source) == [], "nothing gives these any more"


def test_every_code_has_an_example_and_a_remedy() -> None:
    for code, example, remedy in ROW.findall((ROOT / "docs" / "findings.md").read_text(encoding="utf-8")):
        assert example.strip(), code
        assert remedy.strip().endswith((".", ".)")), code

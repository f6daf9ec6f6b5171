"""Every example in docs/plan-language.md is read and checked.

The word after `yaml` says what a block is: a whole `plan`; top-level `keys`; a list of `segments`; or the keys of one `state`.
What is not said comes from a plan around it. `refused=code` means that the block must be refused with that code.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from planrunner.base.findings import Finding
from planrunner.plan.expand import expand
from planrunner.plan.meaning import check_meaning
from planrunner.plan.model import parse_plan
from planrunner.plan.motion import motion_of
from planrunner.plan.quantity import Quantity
from planrunner.plan.reference import keys_reference

DOCS = Path(__file__).resolve().parents[2] / "docs"
BLOCK = re.compile(r"^```yaml(?: (\w+)(?: refused=([a-z-]+))?)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BLOCKS = BLOCK.findall((DOCS / "plan-language.md").read_text(encoding="utf-8"))
AROUND = {
    "planrunner": "1",
    "title": "An example",
    "sensor": "{kind: flexure-gyro, outputs: [torquer_x, torquer_y]}",
    "defaults": "{orientation: unknown, dwell: 2 min}",
    "segments": "[{label: P1}]",
    "estimates": "{drift: {estimator: flexure_gyro_static, segments: '*'}}",
}


def whole(kind: str, block: str) -> str:
    """The plan around a block."""
    if kind == "plan":
        return str(block)
    if kind == "state":
        block = "segments:\n  - label: P1\n" + re.sub("^", "    ", block, flags=re.MULTILINE).rstrip() + "\n"
    elif kind == "segments":
        block = "segments:\n" + re.sub("^", "  ", block, flags=re.MULTILINE).rstrip() + "\n"
    else:
        assert kind == "keys", f"say what this block is: {block}"
    said = set(re.findall(r"^(\w+):", block, re.MULTILINE))
    return "".join(f"{key}: {value}\n" for key, value in AROUND.items() if key not in said) + block


def findings(text: str) -> list[Finding]:
    plan, log = parse_plan(text, "example")
    if plan is not None:
        segments = expand(plan, log)
        check_meaning(plan, segments, ["report.html", "summary.md"], log)
        for segment in segments:
            dwell = segment.state.dwell
            motion_of(segment.state, segment.marks, dwell.value if isinstance(dwell, Quantity) else None, log)
    return list(log)


@pytest.mark.parametrize(
    ("kind", "refused", "block"), BLOCKS, ids=[f"{index}-{kind}" for index, (kind, *_) in enumerate(BLOCKS)]
)
def test_the_examples_of_the_guide(kind: str, refused: str, block: str) -> None:
    found = [item for item in findings(whole(kind, block)) if item.severity == "error"]
    assert [item.code for item in found] == ([refused] if refused else []), list(map(str, found))


def test_there_are_examples_of_every_sort() -> None:
    assert {kind for kind, *_ in BLOCKS} == {"plan", "keys", "segments", "state"}
    assert len(BLOCKS) > 15


def test_labels_that_the_guide_names() -> None:
    text = (DOCS / "plan-language.md").read_text(encoding="utf-8")
    for named in ("hot/spin", "R+10/r1/20degC"):
        assert f"`{named}`" in text
        assert any(named in labels(kind, block) for kind, refused, block in BLOCKS if not refused)


def labels(kind: str, block: str) -> list[str]:
    plan, log = parse_plan(whole(kind, block), "example")
    assert plan is not None
    return [segment.label for segment in expand(plan, log)]


def test_the_reference_of_keys_is_up_to_date() -> None:
    written = (DOCS / "plan-keys.md").read_text(encoding="utf-8")
    assert written == keys_reference(), "run `python -m planrunner.plan.reference docs`"

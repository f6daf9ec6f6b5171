"""One mistake gives one finding, at its place: nothing that merely follows from it is shown.

Every shipped plan is given one mistake at a time: a misspelt key, unit, value, label, reference, estimator, bench or report, a key or a
segment left out. A plan of the shipped set has no errors, so that whatever error appears is about the mistake.
"""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from planrunner.base.findings import Finding, Findings, Mark
from planrunner.plan import source
from planrunner.tasks.check import check_plan

from .mutation import SHIPPED_PLANS

Path_ = tuple[str | int, ...]


@dataclass(frozen=True)
class Mistake:
    """The text of a plan with one mistake; `place` is where it stands, None where only its consequences have a place.

    missing: how many errors it may give. A sweep or `defaults` left out takes as many keys with it as it has, and a key of a segment that
    holds others is then missing in each of these. A segment that is left out has no place any more: what it leaves wrong is each estimate
    that needs it and each name that meant it, and any of these may be what is to be mended.
    """

    what: str
    text: str
    place: Mark | None
    missing: int = 1


def nodes(node: source.Node, path: Path_ = ()) -> Iterator[tuple[Path_, source.Scalar, bool]]:
    """Every scalar with its path and whether it is a key."""
    if isinstance(node, source.Scalar):
        yield path, node, False
    elif isinstance(node, source.Sequence):
        for index, item in enumerate(node.items):
            yield from nodes(item, (*path, index))
    else:
        for name, item in node.entries:
            yield (*path, name.text), name, True
            yield from nodes(item, (*path, name.text))


def names_a_thing(path: Path_, is_key: bool) -> bool:
    """Whether a text is a name that the plan itself gives: misspelt, it is the references to it that are wrong."""
    if not is_key:
        return path[-1] == "label"
    return path[-2:-1] in (("estimates",), ("mounting",), ("record",), ("orientation",), ("motion",), ("cycle",)) and (
        path[0] != "defaults"
    )


def misspelt(word: str) -> str:
    """With another last letter: of a quantity that is the unit, of a reference the name."""
    return word[:-1] + ("q" if word[-1] != "q" else "z") if word[-1].isalpha() else word + "q"


def typing_mistakes(text: str, name: str) -> Iterator[Mistake]:
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    seen: set[Mark] = set()
    for path, node, is_key in nodes(source.parse(text, name)):
        if node.mark in seen or path[0] in ("title", "description"):
            continue  # what an alias repeats; words for people
        seen.add(node.mark)
        assert node.mark.end is not None
        begin = starts[node.mark.line - 1] + node.mark.column - 1
        end = starts[node.mark.end[0] - 1] + node.mark.end[1] - 1
        wrong = misspelt(text[begin:end].rstrip("\"'")) + text[begin:end][len(text[begin:end].rstrip("\"'")) :]
        place = None if names_a_thing(path, is_key) else node.mark
        yield Mistake(f"{name} {path}: {wrong}", text[:begin] + wrong + text[end:], place)


def omissions(text: str, name: str) -> Iterator[Mistake]:
    """Each key and each segment left out in turn. The plan is written as JSON, which is YAML."""
    data: Any = source.plain(source.parse(text, name))
    for path in entries(data):
        if path[0] in ("title", "description", "limits", "report", "estimates", "diagnosis") and len(path) == 1:
            continue
        left = copy.deepcopy(data)
        holder = left
        for step in path[:-1]:
            holder = holder[step]
        gone = holder.pop(path[-1])
        if holder:
            text_left = json.dumps(left, ensure_ascii=False, indent=1)
            yield Mistake(f"{name} without {path}", text_left, None, missing_without(path, gone, holder, data))


def missing_without(path: Path_, gone: Any, holder: Any, data: Any) -> int:
    """How many errors may be about something that is left out. holder: what held it."""
    if path == ("defaults",):
        return len(gone)
    if isinstance(path[-1], int) or path[-1] == "steps":
        return uses(data)
    if path[-1] == "for_each":
        return max(len(gone), uses(data))
    return len(holder["steps"]) if "steps" in holder else 1


def uses(data: Any) -> int:
    """How many estimates there are and, in them, further names of segments; one of a plan without estimates, for the segment itself."""
    named = [estimate.get("segments") for estimate in data.get("estimates", {}).values()]
    return max(1, sum(max(len(names), 1) if isinstance(names, list) else 1 for names in named))


def entries(data: Any, path: Path_ = ()) -> Iterator[Path_]:
    """Keys of records, and segments; entries of other lists and names that the plan gives are no mistakes by themselves."""
    if isinstance(data, dict):
        for key, value in data.items():
            if not names_a_thing((*path, key), is_key=True):
                yield (*path, key)
            yield from entries(value, (*path, key))
    elif isinstance(data, list) and path[-1:] in (("segments",), ("steps",)) and "estimates" not in path:
        for index, value in enumerate(data):
            yield (*path, index)
            yield from entries(value, (*path, index))


def found(path: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> Findings:
    """What check says of a shipped plan with another text."""
    read = source.read_bytes

    def instead(asked: Path, *args: Any, **options: Any) -> bytes:
        return text.encode() if asked == path else read(asked, *args, **options)

    with monkeypatch.context() as patched:
        patched.setattr(source, "read_bytes", instead)
        return check_plan(path).findings


def shown_errors(findings: Findings) -> list[Finding]:
    return [finding for finding in findings if finding.severity == "error"]


def hold_against(path: Path, mistake: Mistake, monkeypatch: pytest.MonkeyPatch) -> None:
    findings = found(path, mistake.text, monkeypatch)
    errors = shown_errors(findings)
    said = f"{mistake.what}\n" + "\n".join(map(str, errors))
    assert len(errors) <= mistake.missing, said
    assert len({(error.mark, error.code) for error in errors}) == len(errors), said
    if not errors or mistake.place is None:
        return
    assert stands_at(errors[0].mark, mistake.place, mistake.text), f"{mistake.what}\n{errors[0]}"
    follows = [item for item in findings if item.severity == "warning" and item not in shown_before(path)]
    assert not follows, f"{mistake.what}\n" + "\n".join(map(str, follows))


@cache
def shown_before(path: Path) -> frozenset[Finding]:
    """The warnings of the plan as it is shipped."""
    return frozenset(check_plan(path).findings)


def stands_at(mark: Mark, place: Mark, text: str) -> bool:
    """Whether a finding stands in the line that was mistyped, or at the estimate that holds it, which an estimator judges as a whole."""
    if place.line == mark.line:
        return True
    estimates = source.parse(text, place.file).get("estimates")
    records = [record.mark for _, record in estimates.entries] if isinstance(estimates, source.Mapping) else []
    return any(record == mark and record.covers(place) for record in records)


def mistakes(path: Path) -> list[Mistake]:
    text = path.read_text(encoding="utf-8")
    return [*typing_mistakes(text, str(path)), *omissions(text, str(path))]


QUICK = [
    path for path in SHIPPED_PLANS if path.stem not in ("rotation_stop_navigation", "imu_recorded_over_temperature")
]


@pytest.mark.parametrize("path", QUICK, ids=lambda path: path.stem)
def test_one_mistake_gives_one_finding(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for mistake in random.Random(path.stem).sample(mistakes(path), 3):
        hold_against(path, mistake, monkeypatch)


_AT_ONCE = 40  # of a plan's mistakes, which may take a second each


@pytest.mark.slow
@pytest.mark.parametrize("path", SHIPPED_PLANS, ids=lambda path: path.stem)
def test_many_single_mistakes_give_one_finding_each(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not shown_errors(found(path, path.read_text(encoding="utf-8"), monkeypatch))
    wrong = []
    every = mistakes(path)
    for mistake in random.Random(path.name).sample(every, min(len(every), _AT_ONCE)):
        try:
            hold_against(path, mistake, monkeypatch)
        except AssertionError as error:
            wrong.append(str(error))
    assert not wrong, "\n\n".join(wrong)

"""Differences by meaning: what is matched, what is named, and what counts as none."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from respelling import respelled
from test_meaning import SHIPPED, SMALL, meaning

from planrunner.plan.quantity import parse_quantity
from planrunner.review.difference import MeaningDifference, SegmentChange, difference, equal_to_rounding
from planrunner.review.meaning import StatedValue


def diff(before: str, after: str) -> MeaningDifference:
    return difference(meaning(before), meaning(after))


def only(found: MeaningDifference) -> SegmentChange:
    (change,) = found.segments
    return change


LINE = "  - {label: B, motion: {rate: 10 deg/s}}\n"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_plan_does_not_differ_from_another_spelling(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    found = diff(text, respelled(text, random.Random(f"{path.stem} again")))
    assert found.empty and found == MeaningDifference("plan", pairs=found.pairs)


def test_a_segment_added_or_removed() -> None:
    added = only(diff(SMALL.replace(LINE, ""), SMALL))
    assert (added.before, added.after, added.positions, added.moved) == (None, "B", (None, 2), False)
    assert {change.place for change in added.changes} >= {("orientation",), ("motion",), ("dwell",)}
    removed = only(diff(SMALL, SMALL.replace(LINE, "")))
    assert (removed.before, removed.after, removed.positions) == ("B", None, (2, None))


def test_a_renamed_segment_is_recognised_by_its_content() -> None:
    renamed = only(diff(SMALL, SMALL.replace("label: B", "label: other")))
    assert renamed.renamed and not renamed.moved and not renamed.changes


def test_a_renamed_segment_with_another_value_is_recognised_by_its_place() -> None:
    renamed = only(diff(SMALL, SMALL.replace("label: B, motion: {rate: 10", "label: other, motion: {rate: 12")))
    assert renamed.renamed
    assert [change.shown for change in renamed.changes] == [("10 deg/s", "12 deg/s")]


def test_a_moved_segment_is_one_change() -> None:
    first = "  - {label: A, temperature: 25 degC}\n"
    moved = only(diff(SMALL, SMALL.replace(first, "") + first))
    assert (moved.before, moved.after, moved.positions, moved.moved, moved.changes) == ("A", "A", (1, 3), True, ())


def test_moved_segments_are_as_few_as_possible() -> None:
    """The longest common order of 1 … 9 and 9, 1 … 8 has eight members."""
    rows = [f"  - {{label: S{k}}}\n" for k in range(1, 10)]
    head = SMALL.partition("segments:\n")[0] + "segments:\n"
    found = diff(head + "".join(rows), head + "".join([rows[-1], *rows[:-1]]))
    assert only(found).after == "S9"


def test_a_renamed_segment_is_no_change_of_the_estimates_that_use_it() -> None:
    text = SMALL + "estimates: {d: {estimator: flexure_gyro_static, segments: [A, B]}}\n"
    found = diff(text, text.replace("label: B", "label: Z").replace("[A, B]", "[A, Z]"))
    assert found.parts == () and only(found).renamed
    other = diff(text, text.replace("[A, B]", "[A, C]"))
    (change,) = other.parts
    assert (change.place, change.gained, change.lost) == (("estimates", "d", "segments"), ("C",), ("B",))


def test_all_segments_stay_all_segments() -> None:
    text = SMALL + "estimates: {d: {estimator: flexure_gyro_static}}\n"
    found = diff(text.replace(LINE, ""), text)
    assert found.parts == () and len(found.segments) == 1


LIMIT = SMALL + "estimates: {d: {estimator: flexure_gyro_static}}\nlimits: [{quantity: d.X, %s}]\n"


@pytest.mark.parametrize(
    ("before", "after", "tendency"),
    [
        ("within: ±1 deg/h", "within: ±2 deg/h", "loosened"),
        ("within: ±2 deg/h", "within: ±1 deg/h", "tightened"),
        ("within: ±1 deg/h", "at_least: -1 deg/h, at_most: 2 deg/h", "loosened"),
        ("within: ±1 deg/h", "at_most: 0.5 deg/h", "both"),
        ("within: ±1 deg/h", "at_least: -1 deg/h", "loosened"),
        ("within: ±1 deg/h", "within: ±1 deg/h, rule: simple", "loosened"),
        ("within: ±1 deg/h", "within: ±1 deg/h, guard_band: 2", "tightened"),
        ("within: ±1 deg/h", "within: ±1 deg/h, coverage: 0.99", "tightened"),
        ("within: ±1 deg/h", "within: ±2 deg/h, guard_band: 2", "both"),
        ("within: ±1 deg/h", "within: ±1 deg/h, prior: 0 deg/h ± 1 deg/h", ""),
    ],
)
def test_limits_are_loosened_or_tightened(before: str, after: str, tendency: str) -> None:
    (change,) = diff(LIMIT % before, LIMIT % after).limits
    assert (change.place, change.tendency) == (("limits", "d.X"), tendency)


def test_a_limit_added_tightens_and_one_removed_loosens() -> None:
    without = (LIMIT % "within: ±1 deg/h").partition("limits:")[0]
    for before, after, tendency in ((without, LIMIT, "tightened"), (LIMIT, without, "loosened")):
        (change,) = diff(before.replace("%s", "within: ±1 deg/h"), after.replace("%s", "within: ±1 deg/h")).limits
        assert change.tendency == tendency


@pytest.mark.parametrize(
    ("one", "other", "equal"),
    [
        ("30 deg/s", "0.5236 rad/s", True),  # 0.523 598 8 rad/s
        ("30 deg/s", "0.52 rad/s", False),  # 29.8 deg/s
        ("30 deg/s", "0.5235 rad/s", False),  # 29.994 deg/s
        ("30 deg/s", "30.00001 deg/s", False),
        ("54.7356 deg", "0.955316 rad", True),  # 54.735 574 deg
        ("54.7356 deg", "0.9553 rad", False),  # 54.7347 deg: not the value in deg, as written
        ("1 g", "9.80665 m/s^2", True),
        ("1 g", "9.81 m/s^2", False),
        ("5 min", "300 s", True),
    ],
)
def test_equal_to_the_digits_written(one: str, other: str, equal: bool) -> None:
    a, b = parse_quantity(one), parse_quantity(other)
    assert equal_to_rounding(a, b) is equal
    assert equal_to_rounding(b, a) is equal


def test_a_rounded_quantity_is_listed_but_no_difference() -> None:
    found = diff(SMALL, SMALL.replace("10 deg/s", "0.17453 rad/s"))
    assert found.empty
    assert [(change.place, change.shown) for change in found.rounded] == [
        (("motion", "rate"), ("10 deg/s", "0.17453 rad/s"))
    ]


def test_texts_for_readers_are_no_difference() -> None:
    found = diff(SMALL, SMALL.replace("title: t", "title: another"))
    assert found.empty and [change.shown for change in found.texts] == [("t", "another")]


def test_every_pair_is_listed_once() -> None:
    rng = random.Random(5)
    head = SMALL.partition("segments:\n")[0] + "segments:\n"
    names = [f"S{k}" for k in range(40)]
    for _ in range(20):
        one, other = rng.sample(names, 25), rng.sample(names, 25)
        found = diff(
            *(
                head + "".join(f"  - {{label: {name}, settle: {name[1:]} s}}\n" for name in side)
                for side in (one, other)
            )
        )
        left, right = zip(*found.pairs, strict=True)
        assert sorted(i for i in left if i is not None) == list(range(25))
        assert [j for j in right if j is not None] == list(range(25))
        same = {(i, j) for i, j in found.pairs if i is not None and j is not None and one[i] == other[j]}
        assert len(same) == len(set(one) & set(other))


def test_an_empty_value_is_no_value() -> None:
    assert StatedValue(None, "none").quantity is None

"""The table of real sets in docs/real-recordings.md is what `python -m tests.real_sets` finds now.

Numbers may change in their last digits between machines: compared are the rows, and whether each agrees with what is known.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.real_sets.__main__ import PAGE
from tests.real_sets.running import found
from tests.real_sets.sets import SETS, RealSet
from tests.real_sets.table import of_page, rows

FAST = ("ring-laser unit at rest, x up and down", "MPU-6050 turned by 90°", "Ferraris calibration in counts")


def _stated(title: str) -> list[tuple[str, str]]:
    """What and agreement of the rows of a recording."""
    return [(row[1], row[4].partition(":")[0]) for row in of_page(PAGE.read_text(encoding="utf-8")) if row[0] == title]


def _found(one: RealSet, data: Path) -> list[tuple[str, str]]:
    return [(what, agrees.partition(":")[0]) for what, _, _, agrees in rows(one, found(one, data))]


def test_every_set_is_in_the_table() -> None:
    listed = dict.fromkeys(row[0] for row in of_page(PAGE.read_text(encoding="utf-8")))
    assert list(listed) == [one.title for one in SETS]


@pytest.mark.parametrize("title", FAST)
def test_cheap_sets_give_what_the_table_says(data_root: Path, title: str) -> None:
    (one,) = (one for one in SETS if one.title == title)
    assert _found(one, data_root) == _stated(title)


@pytest.mark.slow
@pytest.mark.parametrize("one", [one for one in SETS if one.title not in FAST], ids=lambda one: one.title)
def test_all_sets_give_what_the_table_says(data_root: Path, one: RealSet) -> None:
    assert _found(one, data_root) == _stated(one.title)

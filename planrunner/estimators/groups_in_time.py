"""Proposes groups of repeats if the plan does not name groups. Groups are formed by the labels of the repeats, by long pauses, or
by thirds of the sequence.

If the day, the switch-on or the mounting changed between two groups, repeats of one group agree better than repeats of different
groups.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array, Integers
from planrunner.base.dataclass import dataclass

_PAUSE = 3.0  # times the median pause between repeats, that separates groups
_LEAST = 4  # repeats in each third


@dataclass(frozen=True, slots=True)
class Grouping:
    """A division of n repeats into groups. `group`: array of shape (n,), index of the group of each repeat. `names`: names of the
    groups, for messages."""

    group: Integers
    names: tuple[str, ...]


def groupings(labels: Sequence[str], pauses: Array | None) -> list[Grouping]:
    """Returns the divisions into groups that a test can use. The repeats must be in the order of time. Every returned division has
    at least two groups, and on average more than two repeats per group.

    `labels`: labels of the repeats, such as day1/r2 or startup-b-07. The last number in a label counts the repeats of a group.
    `pauses`: array of shape (n − 1,), time between successive repeats, s; None if this is not known.
    """
    stems = [re.sub(r"\d+$", "", label) for label in labels]
    found = [
        Grouping(
            np.array([list(dict.fromkeys(stems)).index(stem) for stem in stems]),
            tuple(f"{one}*" for one in dict.fromkeys(stems)),
        )
    ]
    if pauses is not None and len(pauses):
        found.append(
            _ranges(labels, np.concatenate([[0], np.cumsum(pauses > _PAUSE * np.median(pauses))]).astype(np.int64))
        )
    if len(labels) >= 3 * _LEAST:
        found.append(_ranges(labels, np.arange(len(labels)) * 3 // len(labels)))
    distinct = {one.group.tobytes(): one for one in reversed(found)}
    return [one for one in reversed(distinct.values()) if 1 < len(one.names) < len(labels) / 2]


def _ranges(labels: Sequence[str], group: Integers) -> Grouping:
    """Makes groups of neighbouring repeats, and names each group by its first and last repeat."""
    held = [
        [label for label, own in zip(labels, group, strict=True) if own == one] for one in range(int(group[-1]) + 1)
    ]
    return Grouping(group, tuple(one[0] if len(one) == 1 else f"{one[0]} … {one[-1]}" for one in held))

"""Selects the segments for an estimate, by patterns of labels or by detecting spans in the data."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase, translate
from functools import lru_cache

from planrunner.base.findings import Findings, closest
from planrunner.plan import source
from planrunner.plan.kinds import Choice, ListOf, QuantityOf, Record, RecordOf, Schema, Text, key
from planrunner.plan.quantity import Quantity

# Each pattern is compared with every label, so their number is limited.
_PATTERN = Text(r"[^\x00-\x1f]{1,80}", "a label, or a pattern with the wildcards * and ?")
_PATTERNS = ListOf(_PATTERN, single=True, minimum=1, maximum=100)


class Detection(Record):
    """Intervals at rest that are detected in the data, for hand-held recordings."""

    detect: str = key(Choice(("still",)), "What to detect: intervals in which the sensor does not move.", "still")
    within: tuple[str, ...] = key(_PATTERNS, "Labels of the segments to search.", "tumble", default=("*",))
    channels: tuple[str, ...] = key(
        ListOf(Text("", "a channel's name"), minimum=1),
        "Channels that must be still.",
        ["accel_x", "accel_y", "accel_z"],
        default=("accel_x", "accel_y", "accel_z"),
    )
    window: Quantity = key(
        QuantityOf("time", "positive"), "Length of the window in which the standard deviation is computed.", "0.5 s"
    )
    threshold: Quantity = key(
        QuantityOf("acceleration", "positive"),
        "An interval is still if the standard deviation of every channel is below this value.",
        "0.05 m/s^2",
    )
    at_least: Quantity = key(QuantityOf("time", "positive"), "Shortest interval that counts.", "1 s")


class SelectionKind:
    """Reads a selection in a plan: `P*`, `[P*, V1]` or `{detect: still, …}`."""

    def read(self, node: source.Node, log: Findings) -> tuple[str, ...] | Detection | None:
        if isinstance(node, source.Mapping):
            found: Detection | None = RecordOf(Detection).read(node, log)
            return found
        return _PATTERNS.read(node, log)

    def schema(self) -> Schema:
        return {"anyOf": [_PATTERNS.schema(), RecordOf(Detection).schema()]}


def matches(label: str, pattern: str) -> bool:
    """Returns True if a label matches a pattern. A pattern with '/' is compared with the whole label; any other pattern is compared
    with each part of the label."""
    if "/" in pattern:
        return fnmatchcase(label, pattern)
    return any(fnmatchcase(part, pattern) for part in label.split("/"))


def select(labels: Sequence[str], patterns: Sequence[str]) -> list[int]:
    """Returns the indices of the labels that match at least one pattern, in the order of the labels."""
    return list(_selected(tuple(labels), tuple(patterns)))


# Plans repeat their labels.
@lru_cache(maxsize=64)
def _selected(labels: tuple[str, ...], patterns: tuple[str, ...]) -> tuple[int, ...]:
    return tuple(index for index, label in enumerate(labels) if any(matches(label, pattern) for pattern in patterns))


def spelt_alike(recorded: str, planned: str) -> bool:
    """Returns True if a recorded label equals the planned label apart from plus signs, which older labels lack."""
    return recorded == planned or recorded.replace("+", "") == planned.replace("+", "")


def closest_label(label: str, known: Iterable[str]) -> str:
    """Returns a hint that suggests the known label, or the pattern, that was probably meant.

    A label that differs only in plus signs is suggested first. The reason is that the table of a recording, or a plan written under
    an older rule for labels, may lack the plus sign in the label of a sweep. Such a label is only suggested; it does not count as a
    match.
    """
    names = list(known)
    bare = label.replace("+", "")
    expression = re.compile(translate(bare))
    if bare != label and any(expression.match(name) for name in names):
        return f"did you mean '{bare}'?"
    signed = next((name for name in names if expression.match(name.replace("+", ""))), None)
    return f"did you mean '{signed}'?" if signed is not None else closest(label, names[:_MOST_COMPARED])


# Comparing words is slow, and a plan may have 10 000 labels.
_MOST_COMPARED = 50


class Labels:
    """Prepares the labels of a plan for comparison with many patterns: each distinct part of a label is compared with a pattern
    only once."""

    def __init__(self, labels: Sequence[str]):
        self._whole: dict[str, list[int]] = {}
        self._parts: dict[str, list[int]] = {}
        for index, label in enumerate(labels):
            self._whole.setdefault(label, []).append(index)
            for part in dict.fromkeys(label.split("/")):
                self._parts.setdefault(part, []).append(index)
        self._found: dict[str, set[int]] = {}

    def closest(self, pattern: str) -> str:
        """Returns a hint for a pattern that matches no label (see `closest_label`)."""
        return closest_label(pattern, [*self._parts, *(self._whole if "/" in pattern else ())])

    def meant_by(self, pattern: str) -> set[int]:
        """Returns the indices of the labels that match a pattern (see `matches`)."""
        if pattern not in self._found:
            known = self._whole if "/" in pattern else self._parts
            if any(sign in pattern for sign in "*?["):
                expression = re.compile(translate(pattern))
                found = {index for name, indices in known.items() if expression.match(name) for index in indices}
            else:
                found = set(known.get(pattern, ()))
            self._found[pattern] = found
        return self._found[pattern]

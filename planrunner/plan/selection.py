"""Choosing segments for an estimate: by label patterns, or by finding spans in the data."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase

from planrunner.plan import source
from planrunner.plan.findings import Findings
from planrunner.plan.kinds import Choice, ListOf, QuantityOf, Record, RecordOf, Schema, Text, key
from planrunner.plan.quantity import Quantity

_PATTERN = Text(r"[^\x00-\x1f]{1,80}", "a label or a pattern with * and ?")


class Detection(Record):
    """Spans that are found in the data instead of being commanded: for hand-held recordings."""

    detect: str = key(Choice(("still",)), "What to look for: spans in which nothing moves.", "still")
    within: tuple[str, ...] = key(ListOf(_PATTERN, single=True), "Labels of the segments to look in.", "tumble", ("*",))
    channels: tuple[str, ...] = key(
        ListOf(Text("", "a channel's name"), minimum=1),
        "Channels that must be still.",
        ["accel_x", "accel_y", "accel_z"],
        ("accel_x", "accel_y", "accel_z"),
    )
    window: Quantity = key(QuantityOf("time", "positive"), "Length of the window in which the standard deviation is taken.", "0.5 s")
    threshold: Quantity = key(
        QuantityOf("acceleration", "positive"), "Still means every channel's standard deviation stays below this.", "0.05 m/s^2"
    )
    at_least: Quantity = key(QuantityOf("time", "positive"), "Shortest span that counts.", "1 s")


class SelectionKind:
    """`P*`, `[P*, V1]` or `{detect: still, …}`."""

    def read(self, node: source.Node, log: Findings) -> tuple[str, ...] | Detection | None:
        if isinstance(node, source.Mapping):
            found: Detection | None = RecordOf(Detection).read(node, log)
            return found
        return ListOf(_PATTERN, single=True, minimum=1).read(node, log)

    def schema(self) -> Schema:
        return {"anyOf": [ListOf(_PATTERN, single=True, minimum=1).schema(), RecordOf(Detection).schema()]}


def matches(label: str, pattern: str) -> bool:
    """Whether a pattern means a label: one with '/' is held against all of it, one without against each of its parts."""
    if "/" in pattern:
        return fnmatchcase(label, pattern)
    return any(fnmatchcase(part, pattern) for part in label.split("/"))


def select(labels: Sequence[str], patterns: Sequence[str]) -> list[int]:
    """Indices of the labels that any pattern means, in their own order."""
    return [index for index, label in enumerate(labels) if any(matches(label, pattern) for pattern in patterns)]

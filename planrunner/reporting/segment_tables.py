"""Tables of segments: what each was to hold and what its channels showed, a row a segment.

Paper and screens are only so wide: where there are many channels, they stand in tables of a few each.
"""

from __future__ import annotations

from collections.abc import Sequence

from planrunner.estimators.interface import Table
from planrunner.reporting import words
from planrunner.reporting.context import SegmentSummary
from planrunner.reporting.rounding import in_parentheses

ABREAST = 6
"""So many channels stand beside each other, six being those of an inertial measurement unit."""
_MEANS = "mean, with its standard uncertainty u in the last digits: 1.234(12) for u = 0.012"
_IDLE = {"Motion": {"rest"}, "Rejected": {"0"}, "Remarks": {""}, "Temperature [°C]": {"–"}}

Column = tuple[str, list[str]]


def segment_table(segments: Sequence[SegmentSummary]) -> Table:
    """Everything in one table; columns that no segment needs are left out."""
    plan, channels, remarks = _plan(segments), _channels(segments), _remarks(segments)
    return _table(f"Segments: {_MEANS}", [*plan, *channels, *remarks])


def segment_tables(segments: Sequence[SegmentSummary]) -> list[Table]:
    """The same in one table, or, with more channels than stand beside each other, in several: what the segments were, then the channels,
    with the segments' numbers and labels in each."""
    channels = _channels(segments)
    if len(channels) <= ABREAST:
        return [segment_table(segments)]
    plan = _plan(segments)
    parts = [channels[first : first + ABREAST] for first in range(0, len(channels), ABREAST)]
    return [
        _table("Segments", [*plan, *_remarks(segments)]),
        *(_table(f"Channels: {_MEANS}", [*plan[:2], *part]) for part in parts),
    ]


def _table(title: str, columns: Sequence[Column]) -> Table:
    kept = [(name, cells) for name, cells in columns if not set(cells) <= _IDLE.get(name, set())]
    return Table(title, tuple(name for name, _ in kept), tuple(zip(*(cells for _, cells in kept), strict=True)))


def _plan(segments: Sequence[SegmentSummary]) -> list[Column]:
    return [
        ("#", [str(item.segment.index + 1) for item in segments]),
        ("Segment", [item.segment.label for item in segments]),
        ("Orientation", [words.orientation(item.segment) for item in segments]),
        ("Motion", [words.motion(item.segment.motion) for item in segments]),
        ("Temperature [°C]", [words.temperature(item.segment) for item in segments]),
        ("Recorded [s]", [_recorded(item) for item in segments]),
        ("Samples", ["–" if item.statistics is None else str(item.statistics.count) for item in segments]),
        ("Rejected", [str(item.statistics.rejected) if item.statistics else "0" for item in segments]),
    ]


def _remarks(segments: Sequence[SegmentSummary]) -> list[Column]:
    return [("Remarks", [item.remark for item in segments])]


def _channels(segments: Sequence[SegmentSummary]) -> list[Column]:
    units: dict[str, str] = {}
    for item in segments:
        units.update({name: unit for name, unit in item.units.items() if item.statistics is not None})
    return [
        (f"{name} [{unit}]" if unit and unit != "1" else name, [_mean(item, name) for item in segments])
        for name, unit in units.items()
    ]


def _recorded(item: SegmentSummary) -> str:
    if item.statistics is None or not item.statistics.count:
        return "–"
    return words.number(round(item.statistics.duration, 3), 9)


def _mean(item: SegmentSummary, channel: str) -> str:
    if item.statistics is None or channel not in item.statistics.channels or not item.statistics.count:
        return "–"
    place = item.statistics.of(channel)
    return in_parentheses(float(item.statistics.mean[place]), float(item.statistics.standard_error[place]))

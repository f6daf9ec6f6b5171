"""Tables of segments: what each was to hold and what its channels showed, a row a segment.

Paper and screens are only so wide: where there are many channels, they stand in tables of a few each.
"""

from __future__ import annotations

from collections.abc import Sequence

from planrunner.estimators.interface import Role, Table, TableColumn
from planrunner.reporting import words
from planrunner.reporting.columns import Shown, table_of
from planrunner.reporting.context import SegmentSummary
from planrunner.reporting.rounding import in_parentheses

ABREAST = 6
"""So many channels stand beside each other, six being those of an inertial measurement unit."""
_MEANS = "mean, with its standard uncertainty u in the last digits: 1.234(12) for u = 0.012"


def segment_table(segments: Sequence[SegmentSummary]) -> Table:
    """Everything in one table; columns that no segment needs are left out."""
    return table_of(f"Segments: {_MEANS}", [*NAMED, *HELD, *_channels(segments), *REMARKS], segments)


def segment_tables(segments: Sequence[SegmentSummary]) -> list[Table]:
    """The same in one table, or, with more channels than stand beside each other, in several: what the segments were, then the channels,
    with the segments' numbers and labels in each."""
    channels = _channels(segments)
    if len(channels) <= ABREAST:
        return [segment_table(segments)]
    parts = [channels[first : first + ABREAST] for first in range(0, len(channels), ABREAST)]
    return [
        table_of("Segments", [*NAMED, *HELD, *REMARKS], segments),
        *(table_of(f"Channels: {_MEANS}", [*NAMED, *part], segments) for part in parts),
    ]


def _channels(segments: Sequence[SegmentSummary]) -> list[Shown[SegmentSummary]]:
    units: dict[str, str] = {}
    for item in segments:
        units.update({name: unit for name, unit in item.units.items() if item.statistics is not None})
    return [_channel(name, unit) for name, unit in units.items()]


def _channel(name: str, unit: str) -> Shown[SegmentSummary]:
    return Shown(TableColumn(name, Role.VALUE, unit), lambda item: _mean(item, name))


def _recorded(item: SegmentSummary) -> str:
    if item.statistics is None or not item.statistics.count:
        return "–"
    return words.number(round(item.statistics.duration, 3), 9)


def _samples(item: SegmentSummary) -> str:
    return "–" if item.statistics is None else str(item.statistics.count)


def _rejected(item: SegmentSummary) -> str:
    return "0" if item.statistics is None else str(item.statistics.rejected)


def _mean(item: SegmentSummary, channel: str) -> str:
    if item.statistics is None or channel not in item.statistics.channels or not item.statistics.count:
        return "–"
    place = item.statistics.of(channel)
    return in_parentheses(float(item.statistics.mean[place]), float(item.statistics.standard_error[place]))


NAMED: tuple[Shown[SegmentSummary], ...] = (
    Shown(TableColumn("#", Role.COUNT), lambda item: str(item.segment.index + 1)),
    Shown(TableColumn("Segment"), lambda item: item.segment.label),
)
"""What names a segment in each table."""
HELD: tuple[Shown[SegmentSummary], ...] = (
    Shown(TableColumn("Orientation"), lambda item: words.orientation(item.segment)),
    Shown(TableColumn("Motion"), lambda item: words.motion(item.segment.motion), (words.AT_REST,)),
    Shown(TableColumn("Temperature", Role.NUMBER, "°C"), lambda item: words.temperature(item.segment), ("–",)),
    Shown(TableColumn("Recorded", Role.NUMBER, "s"), _recorded),
    Shown(TableColumn("Samples", Role.COUNT), _samples),
    Shown(TableColumn("Rejected", Role.COUNT), _rejected, ("0",)),
)
"""What a segment was to hold and how much of it was recorded."""
REMARKS: tuple[Shown[SegmentSummary], ...] = (Shown(TableColumn("Remarks"), lambda item: item.remark, ("",)),)

"""Makes tables of segments. Each segment has a row, with the planned state and the statistics of the channels.

Because paper and screens have a limited width, many channels are distributed over several tables.
"""

from __future__ import annotations

from collections.abc import Sequence

from planrunner.estimators.tables import Role, Shown, Table, TableColumn, table_of
from planrunner.reporting import words
from planrunner.reporting.context import SegmentSummary
from planrunner.reporting.rounding import in_parentheses

ABREAST = 6
"""Maximum number of channels side by side; an inertial measurement unit has six."""
_MEANS = "means; the digits in parentheses are the standard uncertainty u in units of the last digits, for example 1.234(12) for u = 0.012"


def segment_table(segments: Sequence[SegmentSummary]) -> Table:
    """Returns the table of segments with all its columns; columns that no segment needs are omitted."""
    return table_of(f"Segments: {_MEANS}", [*NAMED, *HELD, *_channels(segments), *REMARKS], segments)


def segment_tables(segments: Sequence[SegmentSummary]) -> list[Table]:
    """Returns the content of `segment_table` in one table if there are few channels. Otherwise, the first table shows the states of
    the segments, and the following tables show the channels. Each table repeats the numbers and labels of the segments."""
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
"""Columns that identify a segment in each table."""
HELD: tuple[Shown[SegmentSummary], ...] = (
    Shown(TableColumn("Orientation"), lambda item: words.orientation(item.segment)),
    Shown(TableColumn("Motion"), lambda item: words.motion(item.segment.motion), (words.AT_REST,)),
    Shown(TableColumn("Temperature", Role.NUMBER, "°C"), lambda item: words.temperature(item.segment), ("–",)),
    Shown(TableColumn("Supply", Role.NUMBER, "V"), lambda item: words.supply(item.segment), ("–",)),
    Shown(TableColumn("Pressure", Role.NUMBER, "hPa"), lambda item: words.pressure(item.segment), ("–",)),
    Shown(TableColumn("Recorded", Role.NUMBER, "s"), _recorded),
    Shown(TableColumn("Samples", Role.COUNT), _samples),
    Shown(TableColumn("Rejected", Role.COUNT), _rejected, ("0",)),
)
"""Columns of the planned state and of the recorded length."""
REMARKS: tuple[Shown[SegmentSummary], ...] = (Shown(TableColumn("Remarks"), lambda item: item.remark, ("",)),)

"""Segments with many channels stand in tables that paper is wide enough for; nothing of them is lost."""

from __future__ import annotations

import numpy as np
import pytest
from reporting_example import schedule

from planrunner.archive.recording import Statistics
from planrunner.reporting.context import SegmentSummary
from planrunner.reporting.segment_tables import segment_table, segment_tables

LABELS = [segment.label for segment in schedule().segments[:2]]


def summaries(channels: int) -> list[SegmentSummary]:
    """Two segments whose channel k has the mean 10·k, then 10·k + 1, each ± 0.01; the second has a remark."""
    names = tuple(f"c{k}" for k in range(channels))
    found = []
    for row, segment in enumerate(schedule().segments[:2]):
        mean = 10.0 * np.arange(channels, dtype=float) + row
        error = np.full(channels, 0.01)
        statistics = Statistics(names, 100, 0, mean, mean, mean, np.eye(channels), error, 32, 0.0, 60.0, 0.1)
        found.append(SegmentSummary(segment, statistics, dict.fromkeys(names, "mg"), "again" if row else ""))
    return found


@pytest.mark.parametrize(("channels", "tables"), [(1, 1), (6, 1), (7, 3), (12, 3), (13, 4)])
def test_channels_stand_in_tables_of_six(channels: int, tables: int) -> None:
    found = segment_tables(summaries(channels))
    assert len(found) == tables
    whole = segment_table(summaries(channels))
    if tables == 1:
        assert found == [whole]
    shown: dict[str, tuple[object, ...]] = {}
    for table in found:
        assert table.headings[:2] == ("#", "Segment") and [row[1] for row in table.rows] == LABELS
        assert sum(title.endswith("[mg]") for title in table.headings) <= 6
        shown |= {title: tuple(row[k] for row in table.rows) for k, title in enumerate(table.headings)}
    assert shown == {title: tuple(row[k] for row in whole.rows) for k, title in enumerate(whole.headings)}
    assert shown[f"c{channels - 1} [mg]"] == (f"{10 * channels - 10}.000(10)", f"{10 * channels - 9}.000(10)")
    assert shown["Remarks"] == ("", "again")


def test_no_segments_make_an_empty_table() -> None:
    (empty,) = segment_tables([])
    assert empty.rows == () and empty.columns == ()

"""Segments without bad samples: means by hand, and samples read one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from planrunner.archive.recording import Find, FindKind, RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.instruments.interfaces import Block
from planrunner.observation.screening import rows_of, without_bad
from planrunner.plan.schedule import Rest, Segment

TIME = np.arange(1000) / 10
X, Y = np.arange(1000.0), np.sin(np.arange(1000.0))


def blocks(names: Sequence[str]) -> Iterator[Block]:
    table = {"x": X, "y": Y}
    for low in range(0, 1000, 7):
        part = slice(low, low + 7)
        yield Block(TIME[part], {name: table[name][part] for name in names})


def recorded(*finds: Find) -> RecordedSegment:
    statistics = statistics_of(blocks(("x", "y")), ("x", "y"), 1000)
    planned = Segment(0, "A", None, "as tested", Rest(), 100.0)
    return RecordedSegment(planned, {"x": "V", "y": "V"}, statistics, blocks, finds=finds)


def find(kind: FindKind, channel: str, first: int, rows: int, *, bad: bool = True) -> Find:
    return Find(kind, channel, first, rows, first / 10, rows / 10, 1.0, 1.0, -1.0, -5.0, bad=bad)


def read(one: RecordedSegment, *channels: str) -> dict[str, np.ndarray]:
    pieces = list(one.blocks(channels))
    found = {name: np.concatenate([piece.channels[name] for piece in pieces]) for name in channels}
    return found | {"time": np.concatenate([piece.time for piece in pieces])}


def test_a_segment_without_bad_finds_is_itself() -> None:
    one = recorded(find(FindKind.STEP, "x", 500, 0, bad=False))
    assert without_bad(one) is one


def test_a_channel_does_without_its_own_bad_rows_and_keeps_those_of_others() -> None:
    one = without_bad(recorded(find(FindKind.SPIKE, "x", 10, 3), find(FindKind.STUCK, "y", 500, 200)))
    kept_x, kept_y = np.delete(np.arange(1000), [10, 11, 12]), np.delete(np.arange(1000), np.arange(500, 700))
    known = one.statistics
    assert known.mean == pytest.approx([X[kept_x].mean(), Y[kept_y].mean()], rel=1e-12)
    assert np.diag(known.covariance) == pytest.approx([X[kept_x].var(ddof=1), Y[kept_y].var(ddof=1)], rel=1e-9)
    both = np.intersect1d(kept_x, kept_y)
    assert known.covariance[0, 1] == pytest.approx(np.cov(X[both], Y[both])[0, 1], rel=1e-9)
    assert known.maximum[0] == 999 and one.share == pytest.approx(0.8)
    assert (known.count, known.start, known.end) == (1000, 0.0, 99.9)


def test_short_stretches_are_filled_on_a_line_and_long_ones_read_as_missing() -> None:
    one = without_bad(recorded(find(FindKind.SPIKE, "x", 10, 3), find(FindKind.STUCK, "y", 500, 200)))
    got = read(one, "x", "y")
    assert got["x"][9:14] == pytest.approx([9, -2, -3, -4, 13])
    assert np.isnan(got["y"][500:700]).all() and np.isfinite(np.delete(got["y"], np.arange(500, 700))).all()
    assert np.isfinite(read(one, "x")["x"]).all()


def test_a_repeated_sample_is_dropped_in_all_channels() -> None:
    got = read(without_bad(recorded(find(FindKind.REPEATED, "", 20, 1))), "x", "y")
    assert len(got["time"]) == 999 and 2.0 not in got["time"] and 20.0 not in got["x"]


def test_a_segment_that_is_bad_throughout_has_no_usable_samples() -> None:
    assert without_bad(recorded(find(FindKind.STUCK, "", 0, 1000))).statistics.count == 0


def test_rows_of_overlapping_finds_count_once() -> None:
    assert rows_of([find(FindKind.SPIKE, "x", 10, 5), find(FindKind.SPIKE, "y", 12, 5)]) == 7

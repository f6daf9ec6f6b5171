"""Reports the progress of reading recorded samples, for passes that take long."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from planrunner.archive.recording import RecordedSegment
from planrunner.base.progress import Announce, Pace
from planrunner.instruments.interfaces import Block


class RowsRead:
    """Counts the rows that are read from several segments with a known total number of rows, and reports the progress."""

    def __init__(self, what: str, rows: float, notice: Announce | None):
        self._pace = Pace(what, rows, notice)
        self._done = 0

    def through(self, blocks: Iterator[Block]) -> Iterator[Block]:
        """Yields the given blocks unchanged and counts their rows."""
        for block in blocks:
            yield block
            self._done += len(block.time)
            self._pace.reached(self._done)


def announced(recording: Sequence[RecordedSegment], what: str, notice: Announce | None) -> tuple[RecordedSegment, ...]:
    """Returns the given segments, changed so that the progress is reported while their samples are read. If a pass over the samples
    takes long, `notice` is called with the name `what` and the fraction of all rows that have been read at least once. After all
    rows have been read, the next pass starts again from zero."""
    if notice is None:
        return tuple(recording)
    passes = _Passes([item.statistics.count + item.statistics.rejected for item in recording], what, notice)
    return tuple(
        item if item.expected else replace(item, blocks=partial(passes.through, index, item.blocks))
        for index, item in enumerate(recording)
    )


class _Passes:
    """Counts the rows that have been read from the segments. A row counts once, even if it is read several times. `rows`: number of
    rows of each segment."""

    def __init__(self, rows: Sequence[int], what: str, notice: Announce):
        self._rows, self._what, self._notice = rows, what, notice
        self._begin()

    def _begin(self) -> None:
        self._reached = [0] * len(self._rows)
        self._pace = Pace(self._what, sum(self._rows), self._notice)

    def through(
        self, index: int, read: Callable[[Sequence[str]], Iterator[Block]], channels: Sequence[str]
    ) -> Iterator[Block]:
        if sum(self._reached) in (0, sum(self._rows)):
            self._begin()
        row = 0
        for block in read(channels):
            yield block
            row += len(block.time)
            self._reached[index] = max(self._reached[index], row)
            self._pace.reached(sum(self._reached))

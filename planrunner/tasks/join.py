"""Recordings of one sensor made one after the other, such as of a plan and of what was proposed after it, as one recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from planrunner.archive.recording import RecordedSegment
from planrunner.base.findings import InputError, Mark
from planrunner.instruments.interfaces import Block
from planrunner.tasks.diagnose import Recorded, recorded_run


def joined(first: Recorded, runs: Sequence[Path]) -> Recorded:
    """A recording and later runs of the same sensor, which stayed switched on in between.

    Times go on: a later run begins as much later as the run folders say, but not before the end of the one before it. Raises
    `InputError` where a run has other channels, and for what stands against reading it.
    """
    whole, origin = first, first.created
    for run in runs:
        further = recorded_run(run)
        if dict(further.segments[0].units) != dict(first.segments[0].units):
            message = "its channels differ from those of the recording before it"
            raise InputError.at(
                Mark(str(run)), "gap-other-sensor", message, "join only runs of one sensor on one bench"
            )
        made = further.created
        later = 0.0 if made is None or origin is None else (made - origin).total_seconds()
        end = max(item.statistics.end for item in whole.segments)
        later = max(later, end - min(0.0, min(item.statistics.start for item in further.segments)))
        segments = tuple(_moved(item, later, f"{run.name}/") for item in further.segments)
        whole = replace(whole, segments=whole.segments + segments, remarks=whole.remarks + further.remarks)
    return whole


def _moved(item: RecordedSegment, seconds: float, before: str) -> RecordedSegment:
    """A segment as much later, under a label that no other run has."""
    segment = replace(item.segment, label=before + item.label, start=item.segment.start + seconds)
    known = item.statistics
    statistics = replace(known, start=known.start + seconds, end=known.end + seconds)
    return replace(item, segment=segment, statistics=statistics, blocks=partial(_later, item, seconds))


def _later(item: RecordedSegment, seconds: float, channels: Sequence[str]) -> Iterator[Block]:
    for block in item.blocks(channels):
        yield Block(block.time + seconds, block.channels)

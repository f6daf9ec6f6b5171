"""Segments without the samples that screening found to be wrong.

Means, scatter and extremes of a channel are computed without its bad samples. For integration and filtering, samples are read one
by one. A short bad stretch is then filled by a straight line from the level before it to the level after it. A long stretch reads
as missing numbers, which each reader treats like samples that were never recorded. A repeated sample is dropped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planrunner.archive.recording import Find, FindKind, RecordedSegment, Statistics
from planrunner.archive.statistics import statistics_of
from planrunner.instruments.interfaces import Block

FILLED = 64
"""Rows of a bad stretch that is filled on a straight line, at most; a longer one reads as missing."""


def without_bad(recorded: RecordedSegment) -> RecordedSegment:
    """The segment without its bad samples; the segment itself if it has none.

    Times, counts and gaps are those of the recording. Samples are read once more for each set of channels with the same bad rows.
    """
    bad = [one for one in recorded.finds or () if one.bad]
    if not bad:
        return recorded
    read, units = recorded.blocks, tuple(recorded.units)
    own = {name: tuple(one for one in bad if one.channel in ("", name)) for name in units}

    def blocks(channels: Sequence[str]) -> Iterator[Block]:
        return _without(read(channels), {name: own[name] for name in channels}, FILLED)

    statistics, share = _statistics(recorded, own)
    return replace(recorded, statistics=statistics, blocks=blocks, share=share)


def rows_of(finds: Iterable[Find]) -> int:
    """Number of rows that the findings cover."""
    covered, end = 0, 0
    for one in sorted(finds, key=lambda one: one.first):
        covered += max(0, one.first + one.rows - max(end, one.first))
        end = max(end, one.first + one.rows)
    return covered


def _statistics(recorded: RecordedSegment, own: Mapping[str, tuple[Find, ...]]) -> tuple[Statistics, float]:
    """Statistics of each channel from its own good rows. Covariances between channels use rows that are good in all channels. Also
    returns the fraction of good rows in the channel with the fewest good rows."""
    raw = recorded.statistics
    rows = raw.count + raw.rejected
    sets: dict[frozenset[tuple[int, int]], list[str]] = {}
    for name in raw.channels:
        sets.setdefault(frozenset((one.first, one.rows) for one in own[name]), []).append(name)
    every = tuple({(one.first, one.rows): one for finds in own.values() for one in finds}.values())
    together = _of(recorded, raw.channels, dict.fromkeys(raw.channels, every), rows)
    mean, low, high, error = (
        one.copy() for one in (together.mean, together.minimum, together.maximum, together.standard_error)
    )
    covariance, widest = together.covariance.copy(), together
    if together.count < 2:
        covariance[:] = 0.0
    for names in sets.values():
        one = _of(recorded, tuple(names), {name: own[name] for name in names}, rows)
        at = [raw.of(name) for name in names]
        mean[at], low[at], high[at], error[at] = one.mean, one.minimum, one.maximum, one.standard_error
        covariance[np.ix_(at, at)] = one.covariance
        widest = max(widest, one, key=lambda each: each.batches)
    count = raw.count if np.isfinite(mean).any() else 0
    share = 1 - max(rows_of(finds) for finds in own.values()) / max(rows, 1)
    made = replace(
        raw,
        count=count,
        mean=mean,
        minimum=low,
        maximum=high,
        covariance=covariance,
        standard_error=error,
        batches=widest.batches,
        course=widest.course,
        mean_covariance=together.mean_covariance,
    )
    return made, max(share, 1 / max(rows, 1))


def _of(
    recorded: RecordedSegment, channels: Sequence[str], finds: Mapping[str, tuple[Find, ...]], rows: int
) -> Statistics:
    return statistics_of(_without(recorded.blocks(channels), finds, 0), channels, rows, motion=recorded.segment.motion)


def _without(blocks: Iterable[Block], finds: Mapping[str, tuple[Find, ...]], filled: int) -> Iterator[Block]:
    """The blocks in which bad rows are filled if at most `filled` of them are adjacent; otherwise they are missing."""
    row = 0
    for block in blocks:
        end = row + len(block.time)
        channels, dropped = dict(block.channels), set[int]()
        for name, own in finds.items():
            here = [one for one in own if one.first < end and one.first + one.rows > row]
            if not here:
                continue
            values = np.array(channels[name], dtype=float)
            for one in here:
                place = np.arange(max(one.first, row), min(one.first + one.rows, end))
                if one.kind is FindKind.REPEATED:
                    dropped.update((place - row).tolist())
                elif one.rows <= filled:
                    part = (place - one.first + 1) / (one.rows + 1)
                    values[place - row] = one.before + (one.after - one.before) * part
                else:
                    values[place - row] = np.nan
            channels[name] = values
        if dropped:
            kept = np.delete(np.arange(end - row), sorted(dropped))
            yield Block(block.time[kept], {name: np.asarray(values)[kept] for name, values in channels.items()})
        else:
            yield Block(block.time, channels)
        row = end

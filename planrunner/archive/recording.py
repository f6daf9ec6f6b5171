"""A recording as estimators see it: segments with their planned state, statistics made in one pass, and samples in blocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Segment

Array = NDArray[np.float64]
IN_MODE = "sensor.in_mode_s"
"""The reading under which the executor keeps how long the sensor has been in its mode when a record begins [s]."""
_SHOWN = 64  # samples of an expected segment
BATCHES = 32
"""Batch means at most that the standard error of a segment's mean comes from."""


@dataclass(frozen=True, slots=True)
class Statistics:
    """One-pass statistics of one segment. Arrays run over `channels`; values are in the channels' units.

    count: samples (rows with a NaN in any channel are left out and counted in `rejected`). mean, minimum, maximum: (k,).
    covariance: (k, k) between samples. standard_error: (k,) of the mean, from the scatter of `batches` consecutive batch means, so
    that noise correlated within a batch is accounted for. start, end: s, of the first and the last sample; largest_gap: s between
    consecutive samples.
    """

    channels: tuple[str, ...]
    count: int
    rejected: int
    mean: Array
    minimum: Array
    maximum: Array
    covariance: Array
    standard_error: Array
    batches: int
    start: float
    end: float
    largest_gap: float

    @property
    def period(self) -> float:
        """Seconds from sample to sample, the largest step left out; NaN for fewer than two samples."""
        if self.count < 2:
            return math.nan
        if self.count == 2:
            return self.end - self.start
        return (self.end - self.start - self.largest_gap) / (self.count - 2)

    @property
    def duration(self) -> float:
        """Seconds that the samples stand for: each of them for one period, so that 12 000 at 100 Hz last 120 s; 0 for fewer than two."""
        return self.end - self.start + self.period if self.count > 1 else 0.0

    def of(self, channel: str) -> int:
        """The index of a channel. Raises KeyError."""
        try:
            return self.channels.index(channel)
        except ValueError:
            raise KeyError(channel) from None


def duration_of(statistics: Iterable[Statistics]) -> float | None:
    """From the first sample to the last [s]; None where nothing was recorded."""
    held = [item for item in statistics if item.count]
    return max(item.end for item in held) - min(item.start for item in held) if held else None


@dataclass(frozen=True)
class RecordedSegment:
    """A segment as carried out. `statistics` were made in one pass; `blocks()` reads the samples again, block by block. expected: it was
    not recorded; the statistics are those that the schedule leads one to expect, whose noise is known and whose means have none."""

    segment: Segment
    units: dict[str, str]
    statistics: Statistics
    blocks: Callable[[Sequence[str]], Iterator[Block]] = field(repr=False)
    truncated: bool = False
    readings: dict[str, float] = field(default_factory=dict)
    expected: bool = False

    @property
    def label(self) -> str:
        return self.segment.label

    @property
    def in_mode(self) -> float | None:
        """Seconds for which the sensor had been in its mode when the record began; None where nobody has recorded that."""
        return self.readings.get(IN_MODE)


def expected_segment(segment: Segment, units: dict[str, str], statistics: Statistics) -> RecordedSegment:
    """A segment that is not recorded yet, with the statistics to expect; a few samples of that mean and scatter, whatever the dwell."""

    def blocks(channels: Sequence[str]) -> Iterator[Block]:
        count = min(statistics.count, _SHOWN)
        time: Array = statistics.start + np.arange(count, dtype=np.float64) * (statistics.period if count > 1 else 1.0)
        sense = np.where(np.arange(count) % 2, 1.0, -1.0)
        places = {name: statistics.of(name) for name in channels}
        yield Block(
            time,
            {name: statistics.mean[k] + sense * math.sqrt(statistics.covariance[k, k]) for name, k in places.items()},
        )

    return RecordedSegment(segment, units, statistics, blocks, expected=True)


def in_time_order(recording: Sequence[RecordedSegment]) -> tuple[RecordedSegment, ...]:
    """The segments as they followed each other in time, whatever their order in the plan; those without a sample last."""
    return tuple(sorted(recording, key=lambda item: item.statistics.start if item.statistics.count else math.inf))

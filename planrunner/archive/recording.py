"""Describes a recording in the form that estimators use: segments with their planned state, their statistics, and their samples in
blocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from enum import StrEnum
from typing import Protocol

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Segment

IN_MODE = "sensor.in_mode_s"
"""Name of the reading that states how long [s] the sensor has been in its mode when a record begins."""
_SHOWN = 64  # number of samples of an expected segment
BATCHES = 32
"""Maximum number of batch means for the standard error of a segment's mean."""


@dataclass(frozen=True, slots=True)
class Statistics:
    """Contains the statistics of one segment, computed in one pass over its samples. The arrays describe k = `len(channels)`
    channels, in the units of the channels.

    `count`: number of samples, without rows that have a NaN in any channel. `rejected`: number of rows with a NaN. `mean`,
    `minimum`, `maximum`: arrays of shape (k,), mean, smallest and largest sample of each channel. `covariance`: array of shape (k,
    k), covariance of the samples of each pair of channels. `standard_error`: array of shape (k,), standard errors of the means,
    computed from the scatter of `batches` consecutive batch means; noise that is correlated within a batch is therefore taken into
    account. If a known motion changes the output within the segment, a periodic signal (`course`) is fitted to the output;
    `covariance` and `standard_error` then describe the differences from the fitted signal. `start`, `end`: times of the first and
    of the last sample, s. `largest_gap`: longest time between consecutive samples, s. `course`: array of shape (p, batches),
    averages over each batch of the p functions of the periodic signal. The fit reduces the degrees of freedom of the scatter of the
    batch means. The averages are scaled so that, for uncorrelated samples, the sum of the squared averages equals this reduction of
    the degrees of freedom. `mean_covariance`: array of shape (k, k), covariance matrix of the channels' means, from the same batch
    means as `standard_error`; shape (0, 0) if it is unknown.
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
    course: Array = field(default_factory=lambda: np.zeros((0, 0)))
    mean_covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def freedom(self) -> float:
        """Returns the degrees of freedom of the standard error; 0 if the standard error is unknown."""
        return max(self.batches - 1 - float(np.sum(self.course**2)), 0.0)

    @property
    def period(self) -> float:
        """Returns the mean sample interval [s], computed without the largest step; NaN for fewer than two samples."""
        if self.count < 2:
            return math.nan
        if self.count == 2:
            return self.end - self.start
        return (self.end - self.start - self.largest_gap) / (self.count - 2)

    @property
    def duration(self) -> float:
        """Returns the duration [s], which includes one period for each sample: 12 000 samples at 100 Hz last 120 s. The duration is
        0 for fewer than two samples."""
        return self.end - self.start + self.period if self.count > 1 else 0.0

    def of(self, channel: str) -> int:
        """Returns the index of a channel. Raises KeyError if the segment does not have the channel."""
        try:
            return self.channels.index(channel)
        except ValueError:
            raise KeyError(channel) from None


def duration_of(statistics: Iterable[Statistics]) -> float | None:
    """Returns the time [s] from the first to the last sample; None if nothing was recorded."""
    held = [item for item in statistics if item.count]
    return max(item.end for item in held) - min(item.start for item in held) if held else None


class FindKind(StrEnum):
    """Kinds of faults that the screening finds in samples."""

    SPIKE = "spike"
    BURST = "burst"
    STUCK = "stuck"
    CLIPPED = "clipped"
    REPEATED = "repeated"
    LOST = "lost"
    STEP = "step"


@dataclass(frozen=True, slots=True)
class Find:
    """Describes samples of a segment that are faulty or suspect.

    `channel`: name of the channel; empty if all channels are affected. `first`: index of the first row in the segment, counted from
    zero. `rows`: number of rows. `time`: time of the first row, s. `seconds`: duration of the faulty or suspect samples. `size`:
    largest distance from the surrounding samples, in the channel's unit; for a stuck or clipped stretch, the value of its samples;
    for lost samples, their number. `noise`: standard deviation of the surrounding samples in the channel's unit; NaN if unknown.
    `before`, `after`: levels of the signal before and after these samples, in the channel's unit. `count`: number of findings that
    this finding represents. `bad`: True if the screening excludes the samples.
    """

    kind: FindKind
    channel: str
    first: int
    rows: int
    time: float
    seconds: float
    size: float
    noise: float = math.nan
    before: float = math.nan
    after: float = math.nan
    count: int = 1
    bad: bool = True


@dataclass(frozen=True, slots=True)
class RepeatedValues:
    """Describes how often a sample of a channel is equal to the previous sample, and which values are repeated.

    `values`: array of shape (n,), values of the first sequences of equal samples, in the channel's unit. Parts of the segment
    without repeated samples are left out. `share`: fraction of the samples that are equal to the previous sample.
    """

    values: Array
    share: float


@dataclass(frozen=True, slots=True)
class TemperatureReadings:
    """Describes the readings of a thermometer in one segment, in the thermometer's unit.

    `values`: array of shape (n,), a part of the distinct readings, in ascending order. `share`: fraction of the readings that are
    equal to the previous reading. `first`, `last`: means of a few readings at the beginning and at the end of the segment.
    """

    values: Array
    share: float
    first: float
    last: float


@dataclass(frozen=True)
class RecordedSegment:
    """A recorded segment. `statistics` are computed in one pass; `blocks()` reads the samples again, block by block.

    `expected`: True if the segment was not recorded. The statistics of the segment are then predicted from the schedule: the
    scatter follows from the declared noise, and the means contain no noise. `finds`: findings of the screening; None if the segment
    has not been screened. `share`: the fraction of the segment's samples that is used. `summary`: True if only the statistics were
    recorded, so that there are no samples to read. `repeats`: maps each screened output to its repeated values.
    `parts`: maps each output at rest or at a constant rate to the means of equal parts of the segment, in the channel's unit.
    `readings_of`: maps each thermometer to its readings.
    """

    segment: Segment
    units: dict[str, str]
    statistics: Statistics
    blocks: Callable[[Sequence[str]], Iterator[Block]] = field(repr=False)
    truncated: bool = False
    readings: dict[str, float] = field(default_factory=dict)
    expected: bool = False
    finds: tuple[Find, ...] | None = None
    share: float = 1.0
    summary: bool = False
    repeats: Mapping[str, RepeatedValues] = field(default_factory=dict)
    parts: Mapping[str, Array] = field(default_factory=dict)
    readings_of: Mapping[str, TemperatureReadings] = field(default_factory=dict)

    def watched(self, watcher: Watcher) -> RecordedSegment:
        """Returns the segment with the results of a watcher that has seen all its samples."""
        return replace(
            self,
            finds=watcher.finds(),
            repeats=watcher.repeats(),
            parts=watcher.parts(),
            readings_of=watcher.readings(),
        )

    @property
    def label(self) -> str:
        return self.segment.label

    @property
    def in_mode(self) -> float | None:
        """Returns the time [s] for which the sensor had been in its mode when the recording of the segment began; None if it is
        unknown."""
        return self.readings.get(IN_MODE)


def expected_segment(segment: Segment, units: dict[str, str], statistics: Statistics) -> RecordedSegment:
    """Returns a segment that is not recorded yet. The segment has the expected statistics, and a few samples with their mean and
    scatter. The number of these samples does not grow with the dwell."""

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


@dataclass(frozen=True, slots=True)
class Ranges:
    """Contains the smallest and the largest value of each channel and of the time steps in a block. A watcher uses these values to
    skip blocks that cannot contain faults. `values`: smallest and largest value by channel name; NaN if a sample is missing.
    `steps`: smallest and largest time step between consecutive rows, s; infinite for a single row, NaN if unknown."""

    values: Mapping[str, tuple[float, float]]
    steps: tuple[float, float]


class Watcher(Protocol):
    """Examines samples while they are read for their statistics."""

    def add(self, block: Block, ranges: Ranges | None = None) -> None:
        """Processes the next samples. `ranges`: smallest and largest values in these samples, if known."""

    def finds(self) -> tuple[Find, ...]:
        """Returns the findings, after all blocks have been processed."""

    def repeats(self) -> Mapping[str, RepeatedValues]:
        """Maps each output to its repeated values; call this method after `finds`."""

    def parts(self) -> Mapping[str, Array]:
        """Returns the means of equal parts of the segment for each output, after the findings have been returned."""

    def readings(self) -> Mapping[str, TemperatureReadings]:
        """Maps each thermometer to its readings; call this method after `finds`."""


WatcherOf = Callable[[Segment, Mapping[str, str], int], Watcher]
"""Function that makes the watcher of a segment. Its arguments are the channels (name → unit) and the number of rows."""


def in_time_order(recording: Sequence[RecordedSegment]) -> tuple[RecordedSegment, ...]:
    """Returns the segments in chronological order, regardless of their order in the plan; segments without samples come last."""
    return tuple(sorted(recording, key=lambda item: item.statistics.start if item.statistics.count else math.inf))

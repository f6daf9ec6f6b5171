"""Finds still spans in a long recording in one pass. In a still span, the standard deviation in a sliding window stays small."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.instruments.sample_rates import SampleRates
from planrunner.observation.refusals import EstimationError
from planrunner.plan.selection import Detection
from planrunner.plan.span import Span
from planrunner.plan.units import DIMENSIONS, unit

_MOST_BATCHES = 64


@dataclass(frozen=True, slots=True)
class StillSpan:
    """Describes a span of time in which the sensor is still. `count`: number of samples. `mean`, `standard_error`: arrays of shape
    (k,), the means of the channels that the detection uses, and the standard errors of these means, in the units of the channels.
    The standard errors are computed from `batches` consecutive batch means; NaN if there are fewer than two batches."""

    span: Span
    count: int
    mean: Array
    standard_error: Array
    batches: int


def still_spans(recorded: RecordedSegment, detection: Detection) -> list[StillSpan]:
    """Finds the still spans of a recorded segment and their means, in one pass over the samples.

    A sample is still if the standard deviation of every channel, in a window of the length `detection.window` around the sample, is
    below `detection.threshold`. A span is a run of still samples with a duration of at least `detection.at_least`. A span therefore
    begins half a window after a motion, and ends half a window before the next motion. A change of the sample rate ends a span.
    Rows with a missing value are left out. A window that lasts more than 1.5 times `detection.window`, because rows are missing,
    does not count as still. Raises `EstimationError` if a channel is missing or is not an acceleration.
    """
    limits = _limits(recorded, detection)
    found: list[StillSpan] = []
    current: _Growing | None = None
    for times, values, quiet, length, restarts in _centred(recorded, detection, limits):
        if restarts and current is not None:
            _close(current, detection, found)
            current = None
        edges = np.flatnonzero(np.diff(quiet)) + 1
        for low, high in zip(np.append(0, edges), np.append(edges, len(quiet)), strict=True):
            if high <= low:
                continue
            if quiet[low]:
                current = current or _Growing(length, recorded.statistics.period)
                current.add(times[low:high], values[low:high])
            elif current is not None:
                _close(current, detection, found)
                current = None
    if current is not None:
        _close(current, detection, found)
    return found


def _limits(recorded: RecordedSegment, detection: Detection) -> Array:
    """Returns the threshold in the unit of each channel, shape (k,)."""
    return detection_limits(detection, recorded.units, f"segment '{recorded.label}'")


def longest_span(dwell: float, detection: Detection) -> float:
    """Returns the longest span [s] that can be found in a dwell at rest; half a window is lost at each end."""
    return dwell - detection.window.value


_CHANNELS = "name the accelerometers of the sensor under `channels` of `segments`"


def detection_limits(detection: Detection, units: Mapping[str, str], what: str) -> Array:
    """Returns the threshold of each channel in the channel's unit, shape (k,). `units`: units of the recorded channels. `what`:
    name of the recording, used in messages. Raises `EstimationError` if a channel is missing or is not an acceleration."""
    limits = []
    for channel in detection.channels:
        if channel not in units:
            message = f"{what} has no channel '{channel}' to search for intervals at rest: {closest(channel, units)}"
            raise EstimationError(message, _CHANNELS, "segments")
        resolved = unit(units[channel])
        if resolved.dimension != DIMENSIONS["acceleration"]:
            message = (
                f"channel '{channel}' is recorded in {resolved.text}: intervals at rest are found from accelerations"
            )
            raise EstimationError(message, _CHANNELS, "segments")
        limits.append(detection.threshold.value / resolved.factor)
    return np.array(limits)


def _centred(
    recorded: RecordedSegment, detection: Detection, limits: Array
) -> Iterator[tuple[Array, Array, NDArray[np.bool_], int, bool]]:
    """Yields the samples that are centres of windows, in pieces. Each piece consists of times (n,), values (n, k), a mask (n,) of
    the still samples, the number of samples per window, and a flag that is True if the sample rate has changed before the piece.
    Rows with a missing number are left out. A window that lasts more than 1.5 times its nominal length, because rows are missing,
    does not count as still. `limits`: array of shape (k,), threshold of each channel."""
    window = detection.window.value
    times, values = np.empty(0), np.empty((0, len(limits)))
    length, restarted = 0, False
    for added, own, restarts in _at_one_rate(recorded, detection.channels):
        if restarts:
            times, values, length, restarted = np.empty(0), np.empty((0, len(limits))), 0, True
        times = np.concatenate([times, added])
        values = np.vstack([values, own])
        if not length and len(times) > 1:
            length = max(2, round(window / float(np.median(np.diff(times)))))
        if not length or len(times) < length:
            continue
        quiet = np.all(_sliding_variance(values, length) < limits**2, axis=1)
        quiet &= times[length - 1 :] - times[: len(times) - length + 1] <= 1.5 * window
        middle = slice(length // 2, length // 2 + len(quiet))
        yield times[middle], values[middle], quiet, length, restarted
        restarted = False
        times, values = times[len(quiet) :], values[len(quiet) :]


def _at_one_rate(recorded: RecordedSegment, channels: Sequence[str]) -> Iterator[tuple[Array, Array, bool]]:
    """Yields the complete rows, in pieces with a constant sample rate. Each piece consists of times (n,), values (n, k), and a flag
    that is True if the rate has changed before the piece."""
    divider: SampleRates[np.float64] = SampleRates()
    for block in recorded.blocks(channels):
        own = np.column_stack([block.channels[name] for name in channels])
        complete = np.isfinite(own).all(axis=1)
        for part in divider.take(block.time[complete], own[complete]):
            yield part.time, part.data, part.changed
    for part in divider.rest():
        yield part.time, part.data, part.changed


def _sliding_variance(values: Array, length: int) -> Array:
    """Returns the sample variance in every window of `length` rows, shape (n − length + 1, k).

    `values`: array of shape (n, k), without missing numbers."""
    centred = values - values.mean(axis=0)
    zero = np.zeros((1, values.shape[1]))
    sums = np.vstack([zero, np.cumsum(centred, axis=0)])
    squares = np.vstack([zero, np.cumsum(centred**2, axis=0)])
    total = sums[length:] - sums[:-length]
    variance: Array = (squares[length:] - squares[:-length] - total**2 / length) / (length - 1)
    return variance


@dataclass
class _Growing:
    """A still span that has not ended yet. The span stores sums over batches of `size` samples. When there are too many batches,
    pairs of batches are combined."""

    size: int
    period: float
    start: float = 0.0
    last: float = 0.0
    count: int = 0
    sums: list[Array] = field(default_factory=list)
    pending: Array | None = None

    @property
    def span(self) -> Span:
        """Returns the span of time from the first sample to one sample period after the last sample."""
        return Span(self.start, self.last + self.period)

    def add(self, times: Array, values: Array) -> None:
        if not self.count:
            self.start = float(times[0])
        self.last = float(times[-1])
        self.count += len(times)
        waiting = values if self.pending is None else np.vstack([self.pending, values])
        while len(waiting) >= self.size:
            self.sums.append(waiting[: self.size].sum(axis=0))
            waiting = waiting[self.size :]
            if len(self.sums) == _MOST_BATCHES:
                self.sums = [a + b for a, b in zip(self.sums[::2], self.sums[1::2], strict=True)]
                self.size *= 2
        self.pending = waiting.copy()

    def finish(self) -> StillSpan:
        assert self.pending is not None
        total = self.pending.sum(axis=0) + np.sum(self.sums, axis=0)
        mean = total / self.count
        batches = len(self.sums)
        if batches < 2:
            return StillSpan(self.span, self.count, mean, np.full_like(mean, np.nan), batches)
        means = np.array(self.sums) / self.size
        error = np.std(means, axis=0, ddof=1) / np.sqrt(batches)
        return StillSpan(self.span, self.count, mean, error, batches)


def _close(growing: _Growing, detection: Detection, found: list[StillSpan]) -> None:
    if growing.span.seconds >= detection.at_least.value * (1 - 1e-9):
        found.append(growing.finish())

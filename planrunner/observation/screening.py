"""Screens recordings: finds spikes, bursts, stuck and clipped stretches, lost and repeated samples, and steps, and removes wrong
samples.

Samples are read in pieces of fixed size, counted from the start of the segment. The findings therefore do not depend on the
division into blocks, and the memory use does not grow with the data. For most pieces, a few sums are sufficient. Only a piece with a large
change between neighbours is examined further.

*Spikes and bursts.* A sample is an outlier if it lies more than g scale estimates from the median of the samples around it (the
Hampel identifier, 1985). The factor g depends on the number of samples. The factor is chosen so that a sample of white Gaussian
noise is an outlier with the probability `CHANCE` (Davies and Gather, "The Identification of Multiple Outliers", J. Am. Stat. Assoc.
88 (1993) 782-792). The local median follows the motion, so that a turning or rocking sensor is compared with its own motion. The
scale is the median absolute deviation from the local median (Rousseeuw and Croux, "Alternatives to the Median Absolute Deviation",
ibid. 1273-1283). The median absolute deviation is zero if more than half of the samples have one value. The scale therefore has
three lower limits: a trimmed mean of the deviations, half a count, and a fraction of the typical change from sample to sample.

*Stuck.* Runs of equal samples are compared with the other runs of the same segment. A run is stuck if it is more than `RUN` times
as long as 99 % of the others, and if the noise of the segment would have moved its samples to another count. A smooth signal, or a
channel whose noise does not reach the next count, is therefore never reported as stuck.

*Segments without wrong samples.* The mean, the standard deviation and the extremes of a channel are computed without its bad
samples. Integration and filtering read samples one by one. For them, a short bad stretch is filled by a straight line from the
level before it to the level after it. The values of a longer bad stretch are replaced by NaN, which is treated like samples that
were never recorded. Repeated samples are dropped.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import (
    Find,
    FindKind,
    Ranges,
    RecordedSegment,
    RepeatedValues,
    Statistics,
    TemperatureReadings,
    WatcherOf,
)
from planrunner.archive.statistics import statistics_of
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import OutputModel, SensorModel
from planrunner.observation.angle_spikes import AngleSpikes
from planrunner.observation.standing import PER_SIGMA, RUN, leaves_count, with_standing
from planrunner.plan.schedule import Cycle, Rest, Segment, Spin
from planrunner.plan.units import DIMENSIONS, UnknownUnitError, measures, unit

RowNumbers = NDArray[np.int64]
Numbered = RowNumbers | range
"""Numbers of rows. If no row is missing, this is a `range`, which needs no memory."""

CHANCE = 1e-12
"""Probability that a sample of white Gaussian noise counts as an outlier. Among 10⁸ samples, an outlier is found with a probability
of 10⁻⁴."""

_PIECE = 1 << 14  # samples that are examined together
_BESIDE = 64  # samples of context on either side of a piece
_NEAR, _FAR = 7, 65  # samples of the running medians
_NEAR_SCALE, _FAR_SCALE = (
    1.80,
    1.50,
)  # σ per median absolute deviation from them, of white Gaussian noise; checked by a test
_NEAR_WIDER, _FAR_WIDER = 1.10, 1.02  # standard deviation of an independent sample from such a median, σ
_LARGE = 6.2  # mean changes: a piece with a larger change between neighbours, 7σ in white noise, is examined
_APART = 4.7  # mean changes, 5.3σ in white noise: a piece is examined if a sample next to a large change is farther from its median
_SPARSE, _STRETCH = 16, 64  # every 16th stretch of 64 samples is used to estimate the noise of a piece quickly
_FEW = 50  # most large changes that are examined one by one
_SAMPLED = 4096  # distances from which the scale is taken
_SLOPE_FROM = 16  # differences from which the slope at an end is known well enough
_UNTRIMMED = 1.113  # mean of all changes of white Gaussian noise over the mean of the smallest 95 %
_SETTLED = 0.25  # s after a turn: a later change is not part of the turn
_JERK = 1.5  # mean changes around a sample, in a segment that may move freely: a smaller deviation is not an outlier
_LEAST = 16  # samples of a segment that is examined
_TOGETHER = 8  # good samples between outliers of one burst, at most
_ROUGH = 1 / 6  # of the squared second differences of white noise: value for a sine with six samples per period
_SPIKE = 3  # samples of a spike, at most
_MANY, _SHARE, _BURSTS = (
    20,
    1e-3,
    0.05,
)  # more findings than both, or a larger fraction of samples in bursts, belong to the noise
_KEPT = 10_000  # finds of one kind and channel
_HELD = 2_000  # most stretches of equal samples that are kept for the test at the end
_SHORT = 64  # lengths of runs that are counted one by one
_SHOWN = 256  # runs of equal samples whose values are kept, to show the count of a channel
_READINGS = 4096  # different readings of a thermometer that are kept
_AT_END = 10  # readings of a thermometer whose mean is kept for either end of a segment
_RUNS = 20  # fewest runs from which the usual length is determined
_BINS, _FEWEST_BINS = 1024, 64  # means in which steps are sought
PARTS = 16
"""Number of equal parts of a segment whose means are kept, to show transients."""
_STEP = 8.0  # robust standard deviations of the differences between neighbouring means
_LEVEL = 0.25  # of a step: largest change of the level on either side of the step
_STEP_LENGTHS = (4, 16)  # means on either side
_PAUSE, _EARLY = 1.5, 0.5  # sample intervals: a sample is lost, or has come twice
_JITTER = 0.01  # share of irregular intervals from which the clock jitters
_LONG_PAUSE = 5.5  # sample intervals: samples are lost, even with jitter
_ANGLES = 192  # deviations that show how widely a recorded angle scatters
_LARGEST = 1e100  # a larger number is not a measurement
_CLIPPED = 10  # samples at the largest value


def screened(recording: Sequence[RecordedSegment], sensor: SensorModel) -> tuple[RecordedSegment, ...]:
    """Adds findings to the segments. Segments that were not screened during recording are read again."""
    watch = watch_of(sensor)
    found = [item if item.finds is not None or item.expected else _screened(item, watch) for item in recording]
    channels = [output.name for output in sensor.outputs if varies(output)]
    return with_standing(found, sensor, channels, CHANCE)


def _screened(item: RecordedSegment, watch: WatcherOf) -> RecordedSegment:
    watcher = watch(item.segment, item.units, item.statistics.count + item.statistics.rejected)
    for block in item.blocks(tuple(item.units)):
        watcher.add(block)
    return item.watched(watcher)


_STANDING = (DIMENSIONS["temperature"], DIMENSIONS["angle"])


def varies(output: OutputModel) -> bool:
    """Returns True if an output always shows noise. Thermometers and encoders may keep one value, so they are excluded."""
    return not output.constant and unit(output.unit).dimension not in _STANDING


def watch_of(sensor: SensorModel) -> WatcherOf:
    """Returns a function that makes a `Screening` for each segment. The screening covers the sensor's outputs, and searches all
    recorded angles for spikes. Thermometers are not screened, because they may keep one value for a long time; a part of their
    readings is kept to show their counts."""

    def watch(segment: Segment, units: Mapping[str, str], rows: int) -> Screening:
        counts, scales, angles = {}, {}, []
        thermometers = [name for name, text in units.items() if measures(text, "temperature")]
        for name in units:
            if (angle := _angle(units[name])) is not None:
                output = sensor.output(name)
                count = output.noise.resolution if output is not None else 0.0
                angles.append(AngleSpikes(name, 1 / angle, count, threshold(_ANGLES)))
        for output in sensor.outputs:
            if output.name in units and varies(output):
                counts[output.name], scales[output.name] = output.noise.resolution, output.full_scale
        steady = isinstance(segment.motion, Rest | Spin) and segment.attitude is not None
        still = steady and isinstance(segment.motion, Rest)
        stopping = isinstance(segment.motion, Cycle)
        return Screening(
            counts,
            scales,
            rows,
            steady=steady,
            still=still,
            stopping=stopping,
            angles=angles,
            thermometers=thermometers,
        )

    return watch


def _angle(name: str) -> float | None:
    """Returns the size of a unit of angle in rad; None if the unit is unknown or belongs to another quantity."""
    try:
        found = unit(name)
    except UnknownUnitError:
        return None
    return found.factor if found.dimension == DIMENSIONS["angle"] else None


def threshold(samples: int) -> float:
    """Returns the factor g for windows with this number of samples. A sample is an outlier if its distance exceeds g scale
    estimates. For few samples, g is larger, because the scale estimate is less certain."""
    from scipy.special import stdtrit

    return -float(stdtrit(max(0.3 * samples, 3.0), CHANCE / 2))


@dataclass(frozen=True, slots=True)
class _Run:
    """A run of equal samples.

    `row`, `time`: row and time [s] of the first sample of the run. `length`: number of samples in the run. `value`: value of these
    samples. `last`: time of the last sample of the run, s. `before`, `after`: values of the samples next to the run on either side.
    """

    row: int
    length: int
    time: float
    last: float
    value: float
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class _Last:
    """The last sample of a channel before the samples that are examined now: its row, its time [s] and its value."""

    row: int
    time: float
    value: float


@dataclass
class _Window:
    """A piece of one channel, together with those neighbouring samples that exist.

    `low`, `high`: bounds of the piece, which is values[low:high]. `usual`, `count`: mean change between neighbouring samples, and
    size of a count, both at the time of the examination of the piece. `places`: array of shape (n,), index of the sample before
    each large change in the piece. In the methods, `values`, `rows` and `times` have the same meaning as in `_Runs`.
    """

    values: Array
    rows: RowNumbers
    times: Array
    low: int
    high: int
    usual: float
    count: float
    places: RowNumbers

    def preceded(self, values: Array, rows: RowNumbers, times: Array) -> None:
        """Adds preceding samples to the window."""
        self.values = np.concatenate([values, self.values])
        self.rows = np.concatenate([rows, self.rows])
        self.times = np.concatenate([times, self.times])

    def extended(self, values: Array, rows: RowNumbers, times: Array) -> None:
        """Adds those of the following samples that belong to the context of the piece."""
        more = slice(0, max(self.high + _BESIDE - len(self.values), 0))
        self.values = np.concatenate([self.values, values[more]])
        self.rows = np.concatenate([self.rows, rows[more]])
        self.times = np.concatenate([self.times, times[more]])


@dataclass
class _Runs:
    """The runs of equal samples in one channel.

    `lengths`: number of runs of each length; the last entry counts all longer runs. `long`: the longest runs. `row`, `time`: row
    and time of the first sample of the current run. `before`: value of the sample before the current run. `length`: number of
    samples in the current run so far. `count`: smallest change between samples, taken as the size of a count. `bend`: sum of the
    absolute second differences of the samples. `bends`: number of second differences. `values`: values of the first runs in those
    pieces in which samples repeat; `shown`: number of these values. In the methods, `values`, `rows` and `times`
    are arrays of shape (n,): values, row numbers and times [s] of successive samples.
    """

    lengths: RowNumbers = field(default_factory=lambda: np.zeros(_SHORT + 1, dtype=np.int64))
    long: list[_Run] = field(default_factory=list)
    row: int = 0
    time: float = math.nan
    before: float = math.nan
    length: int = 0
    count: float = math.inf
    bend: float = 0.0
    bends: int = 0
    values: list[Array] = field(default_factory=list)
    shown: int = 0

    def add(self, values: Array, rows: RowNumbers, times: Array) -> None:
        """Adds the next samples (n,). Except in the first call, the first of these samples must be the last sample of the previous
        call."""
        if not self.length:
            self.row, self.time, self.length = int(rows[0]), float(times[0]), 1
        ends = np.append(
            np.flatnonzero(np.diff(values)), len(values) - 1
        )  # the last samples of runs, and of these samples
        lengths = np.diff(ends, prepend=-1)
        lengths[0] += self.length - 1
        closed = lengths[:-1]
        self.lengths += np.bincount(np.minimum(closed, _SHORT), minlength=_SHORT + 1)
        for k in np.flatnonzero(closed >= RUN):
            self._hold(values, rows, times, int(ends[k - 1]) if k else -1, int(ends[k]), int(closed[k]))
        if len(closed):
            begin = int(ends[-2])
            self.row, self.time, self.before = int(rows[begin + 1]), float(times[begin + 1]), float(values[begin])
            steps = np.abs(values[ends[:-1] + 1] - values[ends[:-1]])
            self.count = min(self.count, float(steps.min()))
            self._show(values[ends[:-1]])
        self.length = int(lengths[-1])
        self.bend += float(np.abs(np.diff(values, 2)).sum())
        self.bends += max(len(values) - 2, 0)

    def add_changing(self, values: Array, rows: Numbered, times: Array, last: _Last | None) -> None:
        """Adds the next samples, each of which differs from the sample before it. Unlike the samples passed to `add`, these samples
        do not begin with the last sample of the previous call."""
        if last is not None:
            if self.length >= RUN:
                two = np.array([last.value, values[0]])
                self._hold(two, np.array([last.row, rows[0]]), np.array([last.time, times[0]]), -1, 0, self.length)
            self.lengths[min(self.length, _SHORT)] += 1
            self.before = last.value
        self.lengths[1] += len(values) - 1
        if len(values) > 1:
            self.before = float(values[-2])
        self.row, self.time, self.length = int(rows[-1]), float(times[-1]), 1

    def _hold(self, values: Array, rows: RowNumbers, times: Array, before: int, last: int, length: int) -> None:
        """Stores a run that ends at the index `last`. `before`: index of the sample before the run; negative if the run began in an
        earlier piece."""
        went_on = before < 0
        row, time = (self.row, self.time) if went_on else (int(rows[before + 1]), float(times[before + 1]))
        left = self.before if went_on else float(values[before])
        after = float(values[last + 1]) if last + 1 < len(values) else math.nan
        self.long.append(_Run(row, length, time, float(times[last]), float(values[last]), left, after))
        if len(self.long) > 2 * _HELD:
            self.long = sorted(self.long, key=lambda one: -one.length)[:_HELD]

    def _show(self, values: Array) -> None:
        """Stores the values of runs, as far as there is room."""
        if self.shown < _SHOWN:
            self.values.append(values[: _SHOWN - self.shown].copy())
            self.shown += len(self.values[-1])

    def repeats(self, samples: int) -> RepeatedValues:
        """Returns how often samples are repeated, and which values. It requires that `finish` has ended the last run of equal
        samples. `samples`: number of samples."""
        values = np.concatenate(self.values) if self.values else np.empty(0)
        return RepeatedValues(values, 1 - int(self.lengths.sum()) / max(samples, 1))

    def finish(self, values: Array, rows: RowNumbers, times: Array) -> None:
        """Ends the current run at the last of these samples."""
        self.lengths[min(self.length, _SHORT)] += 1
        self._show(values[-1:])
        if self.length >= RUN:
            self._hold(values, rows, times, -1, len(values) - 1, self.length)

    def stuck(self) -> list[_Run]:
        """Returns the stuck runs: runs whose length cannot be explained by the noise of the channel and the size of its count."""
        runs = int(self.lengths.sum())
        usual = int(np.searchsorted(np.cumsum(self.lengths), 0.99 * runs))
        longer = [one for one in self.long if one.length > RUN * max(usual, 1)]
        bends = self.bends - sum(one.length - 2 for one in longer)
        if runs < _RUNS or usual >= _SHORT or not longer or bends <= 0:
            return []
        noise = self.bend / bends / PER_SIGMA
        return [one for one in longer if leaves_count(noise, self.count, one.length, CHANCE)]


class _Readings:
    """Keeps a part of the readings of a thermometer: of each block, a few readings at equal distances, and whether the first
    readings repeat. The readings at the beginning and at the end of the segment are kept as well."""

    def __init__(self) -> None:
        self.values: Array = np.empty(0)
        self.seen = self.repeated = 0
        self.begin: Array = np.empty(0)
        self.end: Array = np.empty(0)

    def add(self, values: Array) -> None:
        """Adds the next readings, shape (n,)."""
        head, tail = values[:_SHOWN], values[-_AT_END:]
        self.repeated += int(np.count_nonzero(head[1:] == head[:-1]))
        self.seen += max(len(head) - 1, 0)
        if len(self.begin) < _AT_END:
            self.begin = np.concatenate([self.begin, _numbers_only(head)])[:_AT_END]
        self.end = np.concatenate([self.end, _numbers_only(tail)])[-_AT_END:]
        if len(self.values) < _READINGS:
            some = values[:: max(len(values) // _SHOWN, 1)]
            self.values = np.union1d(self.values, _numbers_only(some))[:_READINGS]

    def shown(self) -> TemperatureReadings:
        ends = [float(one.mean()) if len(one) else math.nan for one in (self.begin, self.end)]
        return TemperatureReadings(self.values, self.repeated / max(self.seen, 1), *ends)


def _numbers_only(values: Array) -> Array:
    return np.asarray(values[np.abs(values) < _LARGEST])  # false for NaN as well


class Screening:
    """Screens one segment in one pass over its samples. In the methods, k is the index of a channel, and `values`, `rows` and
    `times` are arrays of shape (n,): values of a channel, row numbers and times [s] of successive samples."""

    def __init__(
        self,
        counts: Mapping[str, float],
        full_scales: Mapping[str, float],
        rows: int,
        *,
        steady: bool,
        still: bool = False,
        stopping: bool = False,
        angles: Sequence[AngleSpikes] = (),
        thermometers: Sequence[str] = (),
    ):
        """`counts`: declared count of each channel, 0 if none is declared. `full_scales`: full scale of each channel, for both
        signs. Counts and full scales are in the channel's unit. `steady`: True if the sensor is planned to be at rest or to rotate
        at a constant rate, so that the motion causes no changes within the segment. `still`: True if the sensor is planned to be at
        rest. `stopping`: True if the segment is planned as turns with stops in between."""
        self.channels, self.steady, self.still, self.stopping = tuple(counts), steady, still, stopping
        self.angles = angles
        self.thermometers = {name: _Readings() for name in thermometers}
        self.counts = np.array([counts[name] for name in self.channels])
        self.full_scales = full_scales
        k, room = len(self.channels), min(_PIECE, max(rows, 1))
        # The piece that is not complete yet, and the samples before it.
        self.values, self.time, self.rows = np.empty((k, room)), np.empty(room), np.empty(room, dtype=np.int64)
        self.filled = 0
        self.low, self.high = np.full(k, math.inf), np.full(k, -math.inf)  # of the blocks that it comes from
        self.steps = (math.inf, -math.inf)  # of the same blocks, and of the steps between them
        self.last = math.nan  # time of the last sample
        self.before, self.times_before = np.empty((k, 0)), np.empty(0)
        self.rows_before = np.empty(0, dtype=np.int64)
        self.waiting: list[tuple[int, _Window]] = []
        self.row, self.done = 0, 0
        self.runs = [_Runs() for _ in self.channels]
        self.levels: list[list[float]] = [[] for _ in self.channels]
        self.usual = [math.inf] * k  # mean change between neighbours
        self.largest, self.smallest = np.full(k, -math.inf), np.full(k, math.inf)
        self.at_top, self.at_bottom = np.zeros((2, k)), np.zeros((2, k))  # samples at an extreme value, and beside it
        self.bin = int(2 ** min(14, max(4, math.ceil(math.log2(max(rows / _BINS, 1))))))
        self.means: list[list[Array]] = [[] for _ in self.channels]
        self.bin_times: list[Array] = []
        self.in_parts: dict[str, Array] = {}
        self.found: list[list[Find]] = [[] for _ in self.channels]
        self.more = [0] * k  # finds that were not kept
        self.in_time: list[Find] = []
        self.pauses = 0
        self.interval, self.begin = math.nan, math.nan
        self.work = np.empty(room)  # differences of time

    def add(self, block: Block, ranges: Ranges | None = None) -> None:
        """Adds the next samples. Rows with a missing number are skipped. `ranges`: smallest and largest sample of each channel; if
        None, they are computed when they are needed."""
        count = len(block.time)
        rows: Numbered = range(self.row, self.row + count)
        for angle in self.angles if count else ():
            angle.add(block.channels[angle.channel], self.row, block.time)
        for name, readings in self.thermometers.items():
            readings.add(block.channels[name])
        self.row += count
        if not self.channels or not count:
            return
        time, columns = block.time, [block.channels[name] for name in self.channels]
        known = (
            [(one.min(), one.max()) for one in columns]
            if ranges is None
            else [ranges.values[one] for one in self.channels]
        )
        low, high = np.array(known).T
        steps = (math.nan, math.nan) if ranges is None else ranges.steps
        if not (low.min() > -_LARGEST and high.max() < _LARGEST):  # true for NaN and infinity as well
            good = np.all([np.abs(column) < _LARGEST for column in columns], axis=0)
            time, rows, columns = time[good], _numbers(rows)[good], [column[good] for column in columns]
            if not len(time):
                return
            low, high = np.array([(one.min(), one.max()) for one in columns]).T
            steps = (math.nan, math.nan)
        if not math.isnan(self.last):
            steps = _widened(steps, (float(time[0]) - self.last,) * 2)
        self.last = float(time[-1])
        at, room = 0, len(self.time)
        while at < len(time):
            whole = (len(time) - at) // _PIECE * _PIECE
            if not self.filled and whole:
                part = slice(at, at + whole)
                self._look(time[part], rows[part], [one[part] for one in columns], low, high, steps)
                at += whole
                continue
            step = min(room - self.filled, len(time) - at)
            place, part = slice(self.filled, self.filled + step), slice(at, at + step)
            for row, one in zip(self.values, columns, strict=True):
                row[place] = one[part]
            self.time[place], self.rows[place] = time[part], _numbers(rows[part])
            self.filled, at = self.filled + step, at + step
            np.minimum(self.low, low, out=self.low)
            np.maximum(self.high, high, out=self.high)
            self.steps = _widened(self.steps, steps)
            if self.filled == room:
                self._look_at_filled()

    def finds(self) -> tuple[Find, ...]:
        """Returns all findings, in chronological order. The method must be called once, after the last samples."""
        if self.filled:
            self._look_at_filled()
        self._examine_waiting()
        for k, runs in enumerate(self.runs if self.done else ()):
            runs.finish(self.before[k, -1:], self.rows_before[-1:], self.times_before[-1:])
        out = [item for k in range(len(self.channels)) for item in self._of_channel(k)]
        for angle in self.angles:
            spikes = angle.finish()
            out += _as_one(spikes) if len(spikes) > max(_MANY, _SHARE * self.row) else spikes
        return tuple(sorted((*out, *self._of_time()), key=lambda item: item.first))

    def repeats(self) -> dict[str, RepeatedValues]:
        """Returns how the samples of each channel repeat. The method must be called after `finds`."""
        return {name: runs.repeats(self.done) for name, runs in zip(self.channels, self.runs, strict=True) if self.done}

    def parts(self) -> dict[str, Array]:
        """Returns the means of equal parts of the segment without bad samples, shape (PARTS,), for each channel with enough
        samples. The result is empty unless the sensor is at rest or at a constant rate. The method must be called after `finds`."""
        return self.in_parts

    def readings(self) -> dict[str, TemperatureReadings]:
        """Returns the readings of each thermometer."""
        return {name: one.shown() for name, one in self.thermometers.items()}

    def _look_at_filled(self) -> None:
        place = slice(0, self.filled)
        self._look(self.time[place], self.rows[place], list(self.values[:, place]), self.low, self.high, self.steps)
        self.filled = 0
        self.steps = (math.inf, -math.inf)
        self.low.fill(math.inf)
        self.high.fill(-math.inf)

    def _look(
        self, time: Array, rows: Numbered, columns: list[Array], low: Array, high: Array, steps: tuple[float, float]
    ) -> None:
        """Examines whole pieces or the last, shorter piece. `low`, `high`: bounds within which all samples of each channel lie.
        `steps`: smallest and largest step of the time, if known."""
        for k, window in self.waiting:
            window.extended(columns[k][:_BESIDE], _numbers(rows[:_BESIDE]), time[:_BESIDE])
        self._examine_waiting()
        if not self.done:
            self.begin = float(time[0])
        if not (steps[0] >= _EARLY * self.interval and steps[1] <= _PAUSE * self.interval):  # true where one is NaN
            self._times(time, rows, columns)
        whole = len(time) - len(time) % self.bin
        if whole and self.steady:
            self.bin_times.append(time[: whole : self.bin].copy())
        for k, values in enumerate(columns):
            means = values[:whole].reshape(-1, self.bin).sum(axis=1) / self.bin if whole and self.steady else None
            if means is not None:
                self.means[k].append(means)
            self._channel(k, values, rows, time, means, float(low[k]), float(high[k]))
        values = np.array([one[-_BESIDE:] for one in columns])
        self.before = np.concatenate([self.before, values], axis=1)[:, -_BESIDE:]
        self.rows_before = np.concatenate([self.rows_before, _numbers(rows[-_BESIDE:])])[-_BESIDE:]
        self.times_before = np.concatenate([self.times_before, time[-_BESIDE:]])[-_BESIDE:]
        self.done += len(time)

    def _channel(
        self, k: int, values: Array, rows: Numbered, times: Array, means: Array | None, low: float, high: float
    ) -> None:
        """Examines whole pieces of one channel, or the last, shorter piece. A piece contains no findings if no sample is far from
        the mean and each sample differs from the previous one. This fast check is made for several pieces together. `k`: index of
        the channel. `values`, `times`: arrays of shape (n,). `means`: means over short groups of samples, if known. `low`, `high`:
        bounds within which all values lie."""
        last = self._last(k)
        pieces = max(len(values) // _PIECE, 1)
        size = len(values) // pieces
        if size < _SAMPLED:
            self._piece(k, values, rows, times, 0, size, last)
            return
        shaped = values.reshape(pieces, size)
        seen = shaped[:, : size - size % (_SPARSE * _STRETCH)].reshape(pieces, -1, _STRETCH)[:, ::_SPARSE]
        changes = seen[:, :, 1:] - seen[:, :, :-1]
        levels = np.add.reduce(np.abs(changes, out=changes), axis=(1, 2)) / (changes.shape[1] * changes.shape[2])
        sums = shaped if means is None or size % self.bin else means.reshape(pieces, -1)
        centres = np.add.reduce(sums, axis=1) / sums.shape[1]
        changing = not (values[1:] == values[:-1]).any() and (last is None or last.value != values[0])
        if changing and max(high - centres.min(), centres.max() - low) <= _APART * levels.min():
            self.runs[k].add_changing(values, rows, times, last)
            for level in levels:
                self._level(k, float(level))
            return
        for piece, (level, centre) in enumerate(zip(levels, centres, strict=True)):
            begin, end = piece * size, piece * size + size
            if begin:
                last = _Last(int(rows[begin - 1]), float(times[begin - 1]), float(values[begin - 1]))
            own = shaped[piece]
            alike = (own[1:] == own[:-1]).any() or (last is not None and last.value == own[0])
            if not alike and max(own.max() - centre, centre - own.min()) <= _APART * level:
                self.runs[k].add_changing(own, rows[begin:end], times[begin:end], last)
                self._level(k, float(level))
            else:
                self._piece(k, values, rows, times, begin, end, last)

    def _last(self, k: int) -> _Last | None:
        if not self.done:
            return None
        return _Last(int(self.rows_before[-1]), float(self.times_before[-1]), float(self.before[k, -1]))

    def _examine_waiting(self) -> None:
        for k, window in self.waiting:
            self._examine(k, window)
        self.waiting.clear()

    def _level(self, k: int, level: float) -> None:
        if level > 0 and len(self.levels[k]) < _RUNS:
            self.levels[k].append(level)
            self.usual[k] = float(np.median(self.levels[k]))

    def _piece(
        self, k: int, values: Array, rows: Numbered, times: Array, begin: int, end: int, last: _Last | None
    ) -> None:
        """Examines the piece of the channel k from the index `begin` to the index `end` of the given samples. `last`: the sample
        before the piece, if any."""
        own, own_rows, own_times = values[begin:end], _numbers(rows[begin:end]), times[begin:end]
        if last is not None:
            own = np.concatenate([[last.value], own])
            own_rows, own_times = np.concatenate([[last.row], own_rows]), np.concatenate([[last.time], own_times])
        if len(own) < 2:
            self.runs[k].add(own, own_rows, own_times)
            return
        changes = np.abs(np.diff(own))
        level, runs = float(np.add.reduce(changes)) / len(changes), self.runs[k]
        if changes.min() > 0:
            runs.add_changing(values[begin:end], rows[begin:end], times[begin:end], last)
        else:
            runs.add(own, own_rows, own_times)
            self._extremes(k, values[begin:end], level)
        if level > 0:
            usual, count = min(level, self.usual[k]), self._count(k)
            large = max(_LARGE * usual, 3 * count)
            if changes.max() > large:  # perhaps by turns, which also enlarge the mean change
                usual = min(usual, _UNTRIMMED * _trimmed(changes))
                large = max(_LARGE * usual, 3 * count)
                around = slice(max(begin - _BESIDE, 0), end + _BESIDE)
                low = _BESIDE if begin else len(self.rows_before)
                places = np.flatnonzero(changes > large) + low - (last is not None)
                window = _Window(
                    values[around], _numbers(rows[around]), times[around], low, low + end - begin, usual, count, places
                )
                if not begin:
                    window.preceded(self.before[k], self.rows_before, self.times_before)
                if end + _BESIDE <= len(values):
                    self._examine(k, window)
                else:
                    self.waiting.append((k, window))
        self._level(k, level)

    def _count(self, k: int) -> float:
        """Returns the size of a count of the channel, declared or detected; 0 if it is neither declared nor detected."""
        seen = self.runs[k].count
        return max(float(self.counts[k]), seen if math.isfinite(seen) else 0.0)

    def _extremes(self, k: int, values: Array, level: float) -> None:
        """Counts the samples at the largest and at the smallest value, and those close to these values. `k`: index of the channel.
        `level`: mean change from sample to sample."""
        beside = max(0.1 * level, 1.01 * self._count(k))
        for sign, extreme, tally in ((1.0, self.largest, self.at_top), (-1.0, -self.smallest, self.at_bottom)):
            own = sign * values
            top, known = float(own.max()), float(extreme[k])
            if top > known:
                tally[1, k] = tally[:, k].sum() if known > top - beside else 0.0
                tally[0, k] = 0.0
                known = top
            tally[0, k] += np.count_nonzero(own == known)
            tally[1, k] += np.count_nonzero((own < known) & (own >= known - beside))
            if sign > 0:
                self.largest[k] = known
            else:
                self.smallest[k] = -known

    def _examine(self, k: int, window: _Window) -> None:
        """Finds outliers near large changes, by their distance from local medians. `k`: index of the channel."""
        x = window.values
        if len(x) < _LEAST or not _stands_out(window):
            return
        g, changes = threshold(len(x)), np.abs(np.diff(x))
        near = np.zeros(len(x) + 1, dtype=np.int64)
        np.add.at(near, np.maximum(window.places - _FAR, 0), 1)
        np.add.at(near, np.minimum(window.places + _FAR, len(x)), -1)
        looked = np.flatnonzero(np.cumsum(near[:-1]))
        looked = looked[(looked >= window.low) & (looked < window.high)]
        outlying = np.zeros(len(looked), dtype=bool)
        moving = np.flatnonzero(
            (np.append(changes, 1.0) > 0) & (np.append(1.0, changes) > 0)
        )  # a stretch that is stuck has no scale
        sampled = moving[:: max(1, len(moving) // _SAMPLED)] if len(moving) >= _LEAST else np.arange(len(x))
        for size, factor, wider in ((_NEAR, _NEAR_SCALE, _NEAR_WIDER), (_FAR, _FAR_SCALE, _FAR_WIDER)):
            if len(x) < 3 * size or (size == _FAR and not self.steady):
                continue
            ordered = np.sort(_off(x, size, sampled))
            usual = max(
                factor * float(ordered[len(ordered) // 2]),
                1.395 * float(ordered[: max(1, int(0.95 * len(ordered)))].mean()),
                0.3 * _trimmed(changes),
                0.6 * float(np.median(np.abs(np.diff(x, 2)))),  # in a steep ramp, many samples are the median
                window.count / 2,
            )
            off, noise = _off(x, size, looked), g * wider * usual
            far = np.flatnonzero(off > noise)
            if not self.steady and len(far):
                around = self._changes_around(x, changes, looked[far], noise)
                far = far[off[far] > g * wider * _JERK * around]
            outlying[far] = True
        found = looked[outlying]
        for group in np.split(found, np.flatnonzero(np.diff(found) > _TOGETHER) + 1) if len(found) else ():
            self._note(k, window, int(group[0]), int(group[-1]) + 1)

    def _changes_around(self, x: Array, changes: Array, places: RowNumbers, noise: float) -> Array:
        """Returns a typical change from sample to sample around each of the samples x[places]: the mean of the changes. In a
        segment of turns and stops, the mean is taken over a short time. A change at a single sample that is followed by the
        opposite change is subtracted, because it is not part of a turn. A turn on one side of a sample must not increase the
        result. Therefore, the samples on the other side and the next two samples on the side of the turn are compared. If all these
        samples lie on one level, the result is at most the largest change among them. `x`: array of shape (n,). `changes`: array of
        shape (n - 1,), absolute differences of x. `noise`: largest distance from a level that noise can cause."""
        padded = np.append(changes, changes[-1])
        if not self.stopping:
            return np.asarray(_mean_around(padded, _FAR)[places])
        size = min(_FAR, max(_NEAR, 2 * round(_SETTLED / self.interval) + 1))
        back = np.zeros(len(x))
        to_and_fro = np.diff(x[:-1]) * np.diff(x[1:]) < 0
        back[1:-1] = np.where(to_and_fro, 2 * np.minimum(changes[:-1], changes[1:]), 0.0)
        around = np.maximum(_mean_around(padded, size) - back / size, 0.0)[places]
        before = _changes_before(x, size, places, noise)
        after = _changes_before(x[::-1], size, len(x) - 1 - places, noise)
        return np.minimum(around, np.minimum(before, after))

    def _note(self, k: int, window: _Window, low: int, high: int) -> None:
        """Stores a spike or a burst that covers the indices `low` to `high` of the window."""
        values, rows, times = window.values, window.rows, window.times
        around = np.concatenate([values[max(0, low - _FAR) : low], values[high : high + _FAR]])
        beside = 1 if self.stopping else 4  # a turn may begin or end two samples away
        before, after = values[max(0, low - beside) : low], values[high : high + beside]
        before, after = (before if len(before) else after), (after if len(after) else before)
        level = (float(np.median(before)) + float(np.median(after))) / 2 if self.stopping else float(np.median(around))
        own = values[low:high] - level
        if len(self.found[k]) >= _KEPT:
            self.more[k] += 1
            return
        beyond = values[max(0, low - 2) : high + 2] - level
        self.found[k].append(
            Find(
                FindKind.SPIKE if high - low <= _SPIKE else FindKind.BURST,
                self.channels[k],
                int(rows[low]),
                int(rows[high - 1] - rows[low]) + 1,
                float(times[low]),
                float(times[high - 1] - times[low]) + self.interval,
                float(own[np.argmax(np.abs(own))]),
                1.4826 * float(np.median(np.abs(around - np.median(around)))),
                float(np.median(before)),
                float(np.median(after)),
                bad=high - low <= _SPIKE or self.still or _is_rough(beyond),
            )
        )

    def _of_channel(self, k: int) -> list[Find]:
        """Returns the findings of one channel, after the whole segment has been read."""
        stuck = [self._stretch(k, one) for one in self.runs[k].stuck()][:_KEPT]
        if not self.steady and (len(stuck) > _MANY or 2 * sum(one.rows for one in stuck) > self.done):
            stuck = _as_one(stuck)  # a sensor that moves occasionally and has coarse counts or no noise at rest
        spikes: list[Find] = []
        bursts: list[Find] = []
        for one in self.found[k]:
            if not any(
                one.first < other.first + other.rows + _FAR and other.first - _FAR < one.first for other in stuck
            ):
                (spikes if one.kind is FindKind.SPIKE else bursts).append(self._judged(one))
        samples = max(self.done, 1)
        many = self.more[k] > 0 or len(spikes) + len(bursts) > max(_MANY, _SHARE * samples)
        long = sum(one.rows for one in bursts) > max(_MANY, _BURSTS * samples)
        found = [*stuck, *(_as_one(spikes) if many else spikes), *(_as_one(bursts) if many or long else bursts)]
        return [*found, *self._flat_tops(k, found), *self._steps(k, found)]

    def _judged(self, one: Find) -> Find:
        """Decides whether a burst counts as bad. In a segment with motion, a smooth burst at the start or the end may be the motion
        itself; such a burst is reported, but its samples are kept. Any other burst counts as bad."""
        at_an_end = one.first < _SPIKE or one.first + one.rows > self.row - _SPIKE
        return one if at_an_end else replace(one, bad=True)

    def _stretch(self, k: int, run: _Run) -> Find:
        """Makes the finding for a run of equal samples. The run counts as clipped if its value is the full scale. A run also counts
        as clipped if its value is an extreme of the segment and occurs outside the run as well."""
        extremes = ((self.largest[k], self.at_top[0, k]), (self.smallest[k], self.at_bottom[0, k]))
        limit = 0.99 * self.full_scales.get(self.channels[k], math.inf)
        clipped = abs(run.value) >= limit or any(run.value == value and at > run.length + 1 for value, at in extremes)
        seconds = run.last - run.time + (self.interval if math.isfinite(self.interval) else 0.0)
        kind = FindKind.CLIPPED if clipped else FindKind.STUCK
        before, after = (run.after if math.isnan(run.before) else run.before), run.after
        after = before if math.isnan(after) else after
        return Find(kind, self.channels[k], run.row, run.length, run.time, seconds, run.value, math.nan, before, after)

    def _flat_tops(self, k: int, known: Sequence[Find]) -> list[Find]:
        """Finds noise that is clipped at the largest or smallest value. The noise is clipped if far more samples have exactly this
        value than a value close to it. `known`: other findings, which may explain samples at the extreme values."""
        runs = self.runs[k]
        if not runs.bends or runs.bend / runs.bends / PER_SIGMA <= 1.1 * runs.count:
            return []
        found = []
        for value, (at, beside) in ((self.largest[k], self.at_top[:, k]), (self.smallest[k], self.at_bottom[:, k])):
            own = at - sum(one.rows for one in known if one.bad or one.size == value)
            if own >= _CLIPPED and own > 4 * beside:
                kind, begin = FindKind.CLIPPED, self.begin
                found.append(Find(kind, self.channels[k], 0, int(own), begin, 0.0, float(value), bad=False))
        return found

    def _steps(self, k: int, found: Sequence[Find]) -> list[Find]:
        """Finds steps, which are lasting changes of the level. At a step, the difference between neighbouring means is far larger
        than elsewhere in the segment."""
        if not self.steady or not self.means[k]:
            return []
        means, times = np.concatenate(self.means[k]), np.concatenate(self.bin_times)
        if len(means) < PARTS:
            return []
        for one in found:
            touched = (times + self.bin * self.interval >= one.time) & (times <= one.time + one.seconds)
            if np.count_nonzero(~touched) > 0:
                means[touched] = np.interp(np.flatnonzero(touched), np.flatnonzero(~touched), means[~touched])
        self.in_parts[self.channels[k]] = np.array([part.mean() for part in np.array_split(means, PARTS)])
        if len(means) < _FEWEST_BINS:
            return []
        out: list[Find] = []
        for length in _STEP_LENGTHS:
            sums = np.concatenate(([0.0], np.cumsum(means - means.mean())))
            inner = np.arange(length, len(means) - length + 1)
            if len(inner) < _FEWEST_BINS:
                break
            rise = (sums[inner + length] - 2 * sums[inner] + sums[inner - length]) / length
            off = rise - np.median(rise)
            half = length // 2
            before = (sums[inner] - 2 * sums[inner - half] + sums[inner - length]) / half
            after = (sums[inner + length] - 2 * sums[inner + half] + sums[inner]) / half
            level = np.maximum(np.abs(before), np.abs(after)) < _LEVEL * np.abs(
                rise
            )  # a transient or a ramp changes there too
            scale = max(1.4826 * float(np.median(np.abs(off))), 1.2533 * _trimmed(np.abs(off)), self.counts[k] / length)
            taken = np.zeros(len(rise), dtype=bool)
            while True:
                left = np.where(taken | ~level, 0.0, np.abs(off))
                at = int(np.argmax(left))
                if left[at] <= _STEP * scale or len(out) >= _MANY:
                    break
                taken[max(0, at - 2 * length) : at + 2 * length + 1] = True
                time = float(times[inner[at]])
                if all(abs(time - other.time) > 2 * length * self.bin * self.interval for other in out):
                    row = int(inner[at]) * self.bin
                    name = self.channels[k]
                    out.append(Find(FindKind.STEP, name, row, 0, time, 0.0, float(rise[at]), scale, bad=False))
        return out

    def _times(self, time: Array, rows: Numbered, columns: Sequence[Array]) -> None:
        """Finds lost and repeated samples."""
        if len(time) > len(self.work):
            self.work = np.empty(len(time))
        first = 0 if self.done else 1
        steps = self.work[: len(time) - first]
        np.subtract(time[1:], time[:-1], out=steps[1 - first :])
        if self.done:
            steps[0] = time[0] - self.times_before[-1]
        if not len(steps):
            return
        if math.isnan(self.interval):
            self.interval = float(np.median(steps[: _PIECE - 1]))
        if float(steps.max()) > _PAUSE * self.interval:
            for place in np.flatnonzero(steps > _PAUSE * self.interval):
                self.pauses += 1
                if len(self.in_time) < _KEPT:
                    gap, at = float(steps[place]), first + int(place)
                    missing = max(round(gap / self.interval) - 1, 0)
                    if missing:
                        row, begin = int(rows[at]), float(time[at]) - gap
                        lost = Find(FindKind.LOST, "", row, 0, begin, gap, float(missing), bad=False)
                        self.in_time.append(lost)
        if float(steps.min()) < _EARLY * self.interval:
            for place in np.flatnonzero(steps < _EARLY * self.interval):
                self.pauses += 1
                at = first + int(place)
                same = all(
                    values[at] == (values[at - 1] if at else old[-1])
                    for values, old in zip(columns, self.before, strict=True)
                )
                if same and len(self.in_time) < _KEPT:
                    row, kind = int(rows[at]), FindKind.REPEATED
                    self.in_time.append(Find(kind, "", row, 1, float(time[at]), self.interval, 1.0))

    def _of_time(self) -> list[Find]:
        """Returns the findings of lost and repeated samples. Deviations that the jitter of the clock explains are not reported."""
        if self.pauses <= _JITTER * max(self.done, 1):
            return self.in_time
        return [one for one in self.in_time if one.kind is FindKind.LOST and one.seconds > _LONG_PAUSE * self.interval]


def _widened(steps: tuple[float, float], others: tuple[float, float]) -> tuple[float, float]:
    """Returns the smallest range that contains two ranges; NaN if one of them is NaN."""
    low, high = np.minimum(steps[0], others[0]), np.maximum(steps[1], others[1])
    return float(low), float(high)


def _stands_out(window: _Window) -> bool:
    """Returns True if there are many large changes, or if a sample next to a large change lies far from the samples around it. A
    single large change is not sufficient evidence, because two opposite deviations of ordinary size can cause it."""
    if len(window.places) > _FEW:
        return True
    for place in window.places:
        around = window.values[max(0, place - _TOGETHER) : place + 2 + _TOGETHER]
        off = np.abs(window.values[place : place + 2] - np.median(around))
        if off.max() > _APART * window.usual:
            return True
    return False


def _is_rough(values: Array) -> bool:
    """Returns True if values (n,) change too irregularly to be a sampled motion. The measure is the sum of the squared second
    differences relative to its expectation for white noise, 6·Σx². The measure is 1/6 for a sine with six samples per period, and
    at most 1/12 for four or more samples on one new level. A motion that changes faster than this averages out over its periods, so
    its values need not be kept."""
    return bool(np.sum(np.diff(values, 2) ** 2) > _ROUGH * 6 * np.sum(values**2))


def _changes_before(x: Array, size: int, places: RowNumbers, noise: float) -> Array:
    """Returns, for each of the samples x[places], the largest change from sample to sample among the `size` samples before it and
    the two samples after it; the sample itself is left out. The result is finite only if all these samples are within the distance
    `noise` of one level. Otherwise, and near the ends, the result is infinite. The condition excludes the ripple that a filter
    causes next to a turn, because the ripple does not keep a level. `x`: array of shape (n,)."""
    found = np.full(len(places), np.inf)
    inner = np.flatnonzero((places >= size) & (places < len(x) - 2))
    others = x[places[inner, None] + np.append(np.arange(-size, 0), (1, 2))]
    level = np.all(np.abs(others - np.median(others, axis=1)[:, None]) <= noise, axis=1)
    found[inner] = np.where(level, np.abs(np.diff(others, axis=1)).max(axis=1), np.inf)
    return found


def _numbers(rows: Numbered) -> RowNumbers:
    return np.arange(rows.start, rows.stop) if isinstance(rows, range) else rows


def _as_one(finds: Sequence[Find]) -> list[Find]:
    """Combines findings into one. This function is used if there are too many findings to be outliers. Their samples then belong to
    the noise, so the combined finding does not count as bad."""
    if not finds:
        return []
    largest = max(finds, key=lambda one: abs(one.size))
    return [replace(largest, rows=sum(one.rows for one in finds), count=len(finds), bad=False)]


def _off(values: Array, size: int, places: RowNumbers) -> Array:
    """Returns the distances of the selected values from local medians. Each median is taken over the `size` values around the
    selected value. Beyond each end, the values (n,) are extended along a straight line that has the slope of the values at this
    end; if `size` is below 2·`_SLOPE_FROM`, the slope is 0. The deviations of the values from this line are mirrored at the end. A
    slow change of the values therefore does not count as a distance."""
    half = size // 2
    wide = np.pad(values, half, mode="reflect")
    if half >= _SLOPE_FROM:
        begin = float(np.median(values[half : 2 * half] - values[:half]))
        end = float(np.median(values[-half:] - values[-2 * half : -half]))
        rise = 2 * np.arange(1, half + 1) / half
        wide[:half] -= begin * rise[::-1]
        wide[-half:] += end * rise
    windows = np.lib.stride_tricks.sliding_window_view(wide, size)
    return np.asarray(np.abs(values[places] - np.median(windows[places], axis=1)))


def _mean_around(values: Array, size: int) -> Array:
    """Returns, for each of n values, the mean of the `size` values around it, shape (n,)."""
    sums = np.concatenate(([0.0], np.cumsum(np.pad(values, size // 2, mode="reflect"))))
    return np.asarray((sums[size:] - sums[:-size]) / size)


def _trimmed(sizes: Array) -> float:
    """Returns the mean of the smallest 95 % of n absolute values."""
    return float(np.sort(sizes)[: max(1, int(0.95 * len(sizes)))].mean())


FILLED = 64
"""Maximum number of rows of a bad stretch that is filled by linear interpolation. A longer stretch counts as missing."""


def without_bad(recorded: RecordedSegment) -> RecordedSegment:
    """Returns the segment without its bad samples, or the same segment if it has none.

    Times, counts and gaps do not change. The samples are read once more for each group of channels that have the same bad rows.
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
    """Returns the number of rows that the findings cover; overlapping rows count once."""
    covered, end = 0, 0
    for one in sorted(finds, key=lambda one: one.first):
        covered += max(0, one.first + one.rows - max(end, one.first))
        end = max(end, one.first + one.rows)
    return covered


def _statistics(recorded: RecordedSegment, own: Mapping[str, tuple[Find, ...]]) -> tuple[Statistics, float]:
    """Returns the statistics of each channel, computed from its good rows. Covariances between channels are computed from the rows
    that are good in all channels. Also returns the fraction of good rows in the channel that has the fewest good rows."""
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
    """Yields the blocks after bad rows have been replaced: a stretch of at most `filled` bad rows is filled by a straight line; a
    longer stretch becomes missing numbers."""
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

"""Computes the phase of one output: its running integral over each stretch of regular samples, read block by block.

A gap (missing or non-finite samples) ends a stretch, and the next sample begins a new stretch. No difference is taken across a gap.
A gap of at most `bridge` seconds is filled by linear interpolation instead. If a record has more than `LONGEST` samples, only every
D-th phase point is stored. Deviations at averaging times of D samples or more do not change; shorter averaging times are not
available.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.estimators.interface import EstimationError, UnfitDataError

LONGEST = 2**25  # phase points, 268 MB
SHORTEST = 3  # phase points that give one second difference
_PAUSE = 1.5  # sample intervals; a longer time between two samples is a gap


@dataclass(frozen=True)
class Phase:
    """The phase record of one output.

    `runs`: the phase points of each run, in the output's unit times the sample interval; each run begins with 0. `interval`: time
    between phase points, s. `decimation`: number of samples from one phase point to the next. `samples`: number of samples used.
    `lost`: number of samples that are not used, because their run is too short or because they follow the last complete phase point
    of a run. `missing`: number of samples in the gaps. `gaps`: number of gaps that ended a run. `bridged`: number of samples filled
    in.
    """

    runs: tuple[Array, ...]
    interval: float
    decimation: int
    samples: int
    missing: int
    gaps: int
    bridged: int
    lost: int

    @property
    def lengths(self) -> NDArray[np.int64]:
        return np.array([run.size for run in self.runs], dtype=np.int64)


class _Integrator:
    """Integrates samples to phase. All runs are stored in one array, so that no further memory is needed."""

    def __init__(self, capacity: int, decimation: int):
        self.flat = np.empty(capacity)
        self.decimation = decimation
        self.used = 0
        self.starts: list[int] = []
        self.carry, self.count = 0.0, 0

    def begin(self) -> None:
        self._room(1)
        self.starts.append(self.used)
        self.flat[self.used] = 0.0
        self.used += 1
        self.carry, self.count = 0.0, 0

    def push(self, values: Array, offset: float) -> None:
        from planrunner.estimators.allan.kernel import integrate

        values = np.ascontiguousarray(values, dtype=float)
        if self.decimation == 1:
            self._room(values.size)
            target = self.flat[self.used : self.used + values.size]
            self.carry = integrate(values, offset, self.carry, target)
            self.used += values.size
        else:
            target = np.empty(values.size)
            self.carry = integrate(values, offset, self.carry, target)
            kept = target[self.decimation - 1 - self.count % self.decimation :: self.decimation] / self.decimation
            self._room(kept.size)
            self.flat[self.used : self.used + kept.size] = kept
            self.used += kept.size
        self.count += values.size

    def runs(self) -> tuple[Array, ...]:
        ends = [*self.starts[1:], self.used][: len(self.starts)]
        return tuple(self.flat[low:high] for low, high in zip(self.starts, ends, strict=True) if high - low >= SHORTEST)

    def _room(self, size: int) -> None:
        if self.used + size > self.flat.size:
            grown = np.empty(max(self.used + size, self.flat.size + self.flat.size // 4))
            grown[: self.used] = self.flat[: self.used]
            self.flat = grown


class _Stretches:
    """Cuts a stream of samples at its gaps, and passes each stretch to the integrator."""

    def __init__(self, integrator: _Integrator, bridge: float):
        self.integrator, self.bridge = integrator, bridge
        self.interval = math.nan
        self.last_time, self.last_value = math.nan, math.nan
        self.regular, self.steps = 0.0, 0
        self.missing, self.gaps, self.bridged, self.samples = 0, 0, 0, 0

    def segment(self, recorded: RecordedSegment, output: str) -> None:
        """Adds all samples of one segment, without joining them to the samples of the preceding segment."""
        statistics = recorded.statistics
        offset = float(statistics.mean[statistics.of(output)]) if output in statistics.channels else 0.0
        offset = offset if math.isfinite(offset) else 0.0
        self.last_time = math.nan
        for block in recorded.blocks([output]):
            time = np.asarray(block.time, dtype=float)
            values = np.asarray(block.channels[output], dtype=float)
            good = np.isfinite(values) & np.isfinite(time)
            if not good.all():
                time, values = time[good], values[good]
            if time.size:
                self._block(recorded.label, time, values, offset)

    def _block(self, label: str, time: Array, values: Array, offset: float) -> None:
        fresh = math.isnan(self.last_time)
        steps = np.diff(time) if fresh else np.diff(time, prepend=self.last_time)
        self._learn_interval(label, steps)
        if fresh:
            self.integrator.begin()
        regular = (steps > 0) & (steps <= _PAUSE * self.interval) if steps.size else np.zeros(0, dtype=bool)
        self.regular += float(steps[regular].sum())
        self.steps += int(np.count_nonzero(regular))
        first = 0
        for place in np.flatnonzero(~regular):
            index = int(place) + (1 if fresh else 0)
            if index > first:
                self.integrator.push(values[first:index], offset)
            before = float(values[index - 1]) if index else self.last_value
            self._gap(float(steps[place]), before, float(values[index]), offset)
            first = index
        self.integrator.push(values[first:], offset)
        self.samples += values.size
        self.last_time, self.last_value = float(time[-1]), float(values[-1])

    def _learn_interval(self, label: str, steps: Array) -> None:
        forward = steps[steps > 0]
        if not forward.size:
            return
        own = float(np.median(forward))
        if math.isnan(self.interval):
            self.interval = own
        elif forward.size > 100 and abs(own / self.interval - 1) > 0.01:
            raise EstimationError(
                f"segment '{label}' is sampled every {own:.4g} s, but others every {self.interval:.4g} s: choose "
                f"`segments` with one sample rate"
            )

    def _gap(self, step: float, before: float, after: float, offset: float) -> None:
        count = max(0, round(step / self.interval) - 1)
        self.missing += count
        if step > 0 and count * self.interval <= self.bridge * (1 + 1e-9):
            self.bridged += count
            self.integrator.push(np.linspace(before, after, count + 2)[1:-1], offset)
        else:
            self.gaps += 1
            self.integrator.begin()


def read_phase(segments: Sequence[RecordedSegment], output: str, bridge: float = 0.0) -> Phase:
    """Reads the phase of one output over all segments; each sample is read once. `bridge`: length of the longest gap that is
    filled, s. Raises `EstimationError` if the samples cannot be integrated."""
    for recorded in segments:
        if output not in recorded.units:
            raise EstimationError(
                f"segment '{recorded.label}' has no channel '{output}': {closest(output, tuple(recorded.units))}"
            )
    total = sum(recorded.statistics.count + recorded.statistics.rejected for recorded in segments)
    decimation = max(1, -(-total // LONGEST))
    integrator = _Integrator(total // decimation + len(segments) + 64, decimation)
    stretches = _Stretches(integrator, bridge)
    for recorded in segments:
        stretches.segment(recorded, output)
    runs = integrator.runs()
    if not runs or math.isnan(stretches.interval):
        raise UnfitDataError(
            f"'{output}' has no two consecutive usable samples in the chosen segments, so no Allan deviation can be formed"
        )
    interval = stretches.regular / stretches.steps if stretches.steps else stretches.interval
    kept = sum((run.size - 1) * decimation for run in runs)
    return Phase(
        runs,
        interval * decimation,
        decimation,
        stretches.samples,
        stretches.missing,
        stretches.gaps,
        stretches.bridged,
        stretches.samples + stretches.bridged - kept,
    )

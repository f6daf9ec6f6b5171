"""Computes increments of angle and velocity from recorded samples, block by block. The module converts units, fills short gaps, and
determines the time of each sample.

A sample is the mean over the interval that ends at its time stamp, so an increment is the sample times the interval. Outputs that
already are increments of angle or velocity are used unchanged. A gap of at most `bridge` seconds is filled by linear interpolation.
A longer gap is an error, because the attitude after it is unknown.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.estimators.interface import EstimationError
from planrunner.plan.units import DIMENSIONS, UnknownUnitError, unit

REFERENCES = {
    "reference_latitude": "angle",
    "reference_longitude": "angle",
    "reference_height": "length",
    "reference_velocity_east": "speed",
    "reference_velocity_north": "speed",
    "reference_velocity_up": "speed",
}
"""Channels that contain the true position of a moving carrier, and their dimensions."""
_KINDS = (("angular rate", "angle", "deg/s"), ("acceleration", "speed", "m/s^2"))
_PAUSE = 1.5  # sample intervals; after a longer interval, a sample is missing
_JUMP = 0.5  # sample intervals; after a shorter interval, the clock is wrong
_RATE_TOLERANCE = 0.02


@dataclass(frozen=True, slots=True)
class Increments:
    """Contains the increments of angle and velocity in a part of a recording.

    `values`: array of shape (6, n), rad and m/s along the body axes x, y, z. `interval`: array of shape (n,) in s, the length of
    time that each increment covers. `time`: array of shape (n,) in s, the end of this time. `reference`: maps each reference
    channel to its values (n,), SI. `kelvin`: array of shape (n,), readings of the sensor's thermometer, K; None without a
    thermometer.
    """

    time: Array
    interval: Array
    values: Array
    reference: Mapping[str, Array]
    kelvin: Array | None = None


class IncrementReader:
    """Reads the increments of successive segments. The first increment of a segment begins at the last sample of the preceding
    segment, unless `part` has recorded a gap."""

    def __init__(self, channels: Sequence[str], sample_rate: float, bridge: float, thermometer: str | None = None):
        """`channels`: names of three gyros and three accelerometers, each in the order x, y, z. `sample_rate`: sample rate, Hz.
        `bridge`: length of the longest gap that is filled, s. `thermometer`: a temperature channel that is read together with the
        other channels."""
        self.channels = tuple(channels)
        self.interval = 1 / sample_rate
        self.bridge = bridge
        self.bridged = 0
        self.thermometer = thermometer
        self._last: float | None = None
        self._before: Array | None = None

    def part(self) -> None:
        """Records that there is a gap before the next segment."""
        self._last = self._before = None

    def blocks(self, recorded: RecordedSegment) -> Iterator[Increments]:
        """Yields the increments of one segment. Each sample is read once. Raises `EstimationError` if the samples are unsuitable."""
        factors, integrated = scales(recorded, self.channels)
        references = [name for name in REFERENCES if name in recorded.units]
        to_si = [_reference_unit(recorded, name) for name in references]
        needed = [*self.channels, *references]
        names = needed if self.thermometer is None else [*needed, self.thermometer]
        warmth = None if self.thermometer is None else unit(recorded.units[self.thermometer])
        for block in recorded.blocks(names):
            rows = np.vstack([block.time, *(block.channels[name] for name in names)])
            rows = rows[:, np.isfinite(rows[: len(needed) + 1]).all(axis=0)]
            if not rows.size:
                continue
            interval, rows = self._clock(recorded.label, rows)
            values = rows[1:7] * factors[:, None]
            values *= np.where(integrated[:, None], 1.0, interval)
            found = {name: rows[7 + k] * to_si[k] for k, name in enumerate(references)}
            kelvin = None if warmth is None else rows[-1] * warmth.factor + warmth.offset
            yield Increments(rows[0], interval, values, found, kelvin)

    def _clock(self, label: str, rows: Array) -> tuple[Array, Array]:
        """Fills short gaps. Returns the interval [s] that each of the n samples covers, shape (n,), and the samples in the form of
        `rows`. `rows`: array with one column for each sample; row 0 contains the times, s."""
        time = rows[0]
        begin = time[0] - self.interval if self._last is None else self._last
        steps = np.diff(time, prepend=begin)
        self._check_rate(label, steps[1:])
        backwards = np.flatnonzero(steps < _JUMP * self.interval)
        if backwards.size:
            k = int(backwards[0])
            raise EstimationError(
                f"segment '{label}': the clock goes from {time[k] - steps[k]:.6f} s to {time[k]:.6f} s between two samples; "
                "navigation needs time stamps that increase evenly"
            )
        wide = np.flatnonzero(steps > _PAUSE * self.interval)
        if wide.size:
            rows, steps = self._fill(label, rows, steps, wide)
        self._last, self._before = float(rows[0, -1]), rows[:, -1].copy()
        return steps, rows

    def _check_rate(self, label: str, steps: Array) -> None:
        if steps.size < 10:
            return
        found = float(np.median(steps))
        if abs(found / self.interval - 1) > _RATE_TOLERANCE:
            raise EstimationError(
                f"segment '{label}' has a sample every {found:.6g} s, but the plan and the bench give {self.interval:.6g} s: "
                "correct the `sample_rate` of the segment"
            )

    def _fill(self, label: str, rows: Array, steps: Array, wide: NDArray[np.int64]) -> tuple[Array, Array]:
        missing = np.rint(steps[wide] / self.interval).astype(np.int64) - 1
        longest = int(np.argmax(steps[wide]))
        if missing[longest] * self.interval > self.bridge * (1 + 1e-9):
            at = rows[0, wide[longest]] - steps[wide[longest]]
            raise EstimationError(
                f"segment '{label}': samples are missing for {steps[wide[longest]]:.4g} s after {at:.3f} s, more than the "
                f"{self.bridge:g} s that `bridge` allows; the motion of the unit in this time is not known, so navigation ends there"
            )
        pieces, done = [], 0
        for k, count in zip(wide.tolist(), missing.tolist(), strict=True):
            before = rows[:, k - 1] if k else self._before
            assert before is not None
            pieces += [rows[:, done:k], np.linspace(before, rows[:, k], count + 2, axis=1)[:, 1:-1]]
            done = k
            self.bridged += count
        filled = np.hstack([*pieces, rows[:, done:]])
        begin = rows[0, 0] - steps[0]
        return filled, np.diff(filled[0], prepend=begin)


def scales(recorded: RecordedSegment, channels: Sequence[str]) -> tuple[Array, NDArray[np.bool_]]:
    """Returns the factors that convert the channels to SI units, shape (6,). Also returns an array that is True for each channel
    that gives increments. Raises `EstimationError` for a missing channel, and for a channel whose unit is not a unit of a rate or
    of an increment."""
    factors, integrated = np.empty(len(channels)), np.zeros(len(channels), dtype=np.bool_)
    for k, name in enumerate(channels):
        if name not in recorded.units:
            raise EstimationError(
                f"segment '{recorded.label}' has no channel '{name}': {closest(name, tuple(recorded.units))}"
            )
        rate, increment, example = _KINDS[k // 3]
        try:
            found = unit(recorded.units[name])
        except UnknownUnitError as error:
            raise EstimationError(f"channel '{name}': {error}") from None
        if found.dimension not in (DIMENSIONS[rate], DIMENSIONS[increment]):
            raise EstimationError(
                f"channel '{name}' is in {found.text}, which is neither {_with_article(rate)} nor an increment of {increment}: "
                f"record it in {example}"
            )
        factors[k], integrated[k] = found.factor, found.dimension == DIMENSIONS[increment]
    return factors, integrated


def reference_mean(recorded: RecordedSegment, name: str) -> float:
    """Returns the mean of a reference channel over a segment, SI. Raises `EstimationError` if the channel has an unsuitable unit."""
    statistics = recorded.statistics
    return float(statistics.mean[statistics.of(name)]) * _reference_unit(recorded, name)


def reference_speed(recorded: RecordedSegment) -> float:
    """Returns the largest absolute velocity [m/s] that the reference channels show; 0 without such channels. Raises
    `EstimationError` for a reference channel with an unsuitable unit."""
    statistics, largest = recorded.statistics, 0.0
    for name, dimension in REFERENCES.items():
        if dimension == "speed" and name in recorded.units:
            k = statistics.of(name)
            extreme = max(abs(statistics.minimum[k]), abs(statistics.maximum[k]))
            largest = max(largest, float(extreme) * _reference_unit(recorded, name))
    return largest


def _reference_unit(recorded: RecordedSegment, name: str) -> float:
    try:
        found = unit(recorded.units[name])
    except UnknownUnitError as error:
        raise EstimationError(f"channel '{name}': {error}") from None
    if found.dimension != DIMENSIONS[REFERENCES[name]]:
        raise EstimationError(f"channel '{name}' is in {found.text}, which is not {_with_article(REFERENCES[name])}")
    return found.factor


def _with_article(words: str) -> str:
    return ("an " if words[0] in "aeiou" else "a ") + words

"""The information that further segments would provide about given columns, computed before these segments are measured.

Only a few seconds of each segment, with whole turns or periods, are sampled in the same way as the recording. The rest of the
segment counts as a repetition of these seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import Column
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence import slow_noise
from planrunner.physics.sampled_motion import motion_at
from planrunner.plan.schedule import Rest, Rock, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS

Columns = Callable[[Observed], Sequence[Sequence[Column]]]
LATER = 600.0  # s after the recording's end, when a segment is taken to begin
_SAMPLED = 2.0  # s of a segment at rest; for turns and periods, the whole number that lasts at least this long
_STUB = 8  # samples that represent each segment while a few are examined closely
_CHUNK = 25  # segments examined closely at a time; limits memory
_CHANGED = 1.0  # K


@dataclass(frozen=True)
class Foreseen:
    """Information that a segment gives about P columns from K channels, in units of the noise.

    `within`: array of shape (P, P), information per second from changes within the segment. `means`: array of shape (K, P), mean of
    each column over the segment. `noise`: array of shape (K,), white noise density of each channel. `flicker`: array of shape (K,),
    declared bias instability of each channel.
    """

    segment: Segment
    within: Array
    means: Array
    noise: Array
    flicker: Array

    @cached_property
    def whole(self) -> Array:
        """The information (P, P) for the planned dwell of the segment."""
        return self.information(self.segment.dwell or 0.0)

    def information(self, seconds: float) -> Array:
        """The information (P, P) for a dwell of the given length [s]. Slow noise limits the information of the mean."""
        slow = slow_noise.flicker(np.zeros(1), np.full(1, seconds))[0, 0]
        variance = self.noise**2 / seconds + self.flicker**2 * slow
        products: Array = seconds * self.within + (self.means / variance[:, None]).T @ self.means
        return products


def foresee(
    observed: Observed, white: Array, segments: Sequence[Segment], columns: Columns, widths: Sequence[int]
) -> Iterator[Foreseen]:
    """Yields the information that each segment would give if it were measured after the recording. `white`: array of shape (K,),
    standard deviation of the white noise of a sample.

    `columns`: function that computes groups of columns for a recording. `widths`: number of columns in each group. A column is
    identified by its place among the columns of all groups. A column is zero in a channel that it does not affect.
    """
    noise = white / math.sqrt(observed.sample_rate)
    flicker = np.array([channel.flicker for channel in observed.channels])
    for first in range(0, len(segments), _CHUNK):
        near = range(first, min(first + _CHUNK, len(segments)))
        planned, places = following(observed, segments, near)
        table = [np.zeros((len(planned.time), sum(widths))) for _ in planned.channels]
        at = 0
        for group, width in zip(columns(planned), widths, strict=True):
            for offset, column in enumerate(group):
                here = 1.0 if column.segments is None else column.segments[planned.owner]
                for channel, part in column.parts.items():
                    table[channel][:, at + offset] = part * (column.magnitude * here)
            at += width
        for index in near:
            rows = [part[places[index]] for part in table]
            means = np.array([part.mean(0) for part in rows])
            within = sum(
                (part - mean).T @ (part - mean) / (len(part) * sigma**2)
                for part, mean, sigma in zip(rows, means, noise, strict=True)
            )
            within -= _hidden(planned, len(observed) + index, rows, noise, segments[index].dwell or 0.0)
            yield Foreseen(segments[index], np.asarray(within), means, noise, flicker)


def _hidden(planned: Observed, number: int, rows: Sequence[Array], noise: Array, seconds: float) -> Array:
    """Information (P, P) per second that a segment loses because the angle of the turning table is unknown.

    `rows`: for each channel, the columns (n, P). `noise`: array of shape (K,), white noise density. `seconds`: dwell.

    A component c·√2·cos θ, which is in phase with the turning, competes with the input of amplitude A and unknown phase
    (`Observed.unknown_phase`). Let the samples have the covariance σ²·I + A²·w·wᵀ, where w = cos θ and |w|² = T/2 for a dwell T and
    unit density of the noise. Then the fraction A²T/2 ÷ (σ² + A²T/2) of the information about this component is lost (Sherman and
    Morrison). The same holds for sin θ."""
    amplitude = np.abs(planned.unknown_phase[number])
    size = rows[0].shape[1]
    lost = np.zeros((size, size))
    angle = planned.angle[planned.segments()[number]]
    waves = np.sqrt(2) * np.column_stack([np.cos(angle), np.sin(angle)])
    for channel in np.flatnonzero(amplitude).tolist():
        power, variance = amplitude[channel] ** 2 * seconds / 2, noise[channel] ** 2
        seen = waves.T @ rows[channel] / len(angle)
        lost += power / (variance + power) * (seen.T @ seen) / variance
    return lost


def following(
    observed: Observed, segments: Sequence[Segment], near: Sequence[int] | range
) -> tuple[Observed, list[slice]]:
    """Returns the recording followed by additional segments, which have a motion but no outputs, and for each additional segment
    the slice of its samples.

    Segments whose index is not in `near` are represented by a few samples. Thus properties of the whole set of segments, such as
    its orientations, do not depend on how many segments are sampled in full.
    """
    stubs = np.concatenate([np.arange(p.start, min(p.start + _STUB, p.stop)) for p in observed.segments()])
    counts = [min(_STUB, p.stop - p.start) for p in observed.segments()]
    warm = float(observed.temperature[-1])
    arrays: dict[str, list[Array]] = {name: [own[stubs]] for name, own in observed.sampled.items()}
    places, changes, begin = [], [], len(stubs)
    for index, segment in enumerate(segments):
        since = _times(segment, observed.sample_rate) if index in near else np.arange(_STUB) / observed.sample_rate
        part = motion_at(segment.motion, since, None)
        start, end = _temperatures(segment, warm)
        slope = (end - start) / segment.dwell if segment.dwell else 0.0
        part |= {"time": observed.time[-1] + LATER + since, "temperature": start + slope * since}
        part["temperature_rate"] = np.full(len(since), slope)
        for name, parts in arrays.items():  # supply and pressure stay as they are
            parts.append(part[name] if name in part else np.full(len(since), getattr(observed, name)[-1]))
        changes.append(np.sign(end - warm) if abs(end - warm) > _CHANGED else observed.last_change[-1])
        places.append(slice(begin, begin + len(since)))
        begin += len(since)
        counts.append(len(since))
    joined: dict[str, Any] = {name: np.concatenate(parts) for name, parts in arrays.items()}
    made = replace(
        observed,
        labels=(*observed.labels, *(segment.label for segment in segments)),
        motions=(*observed.motions, *(segment.motion for segment in segments)),
        attitude=np.concatenate([observed.attitude, [segment.attitude for segment in segments]]),
        bounds=np.concatenate(([0], np.cumsum(counts))).astype(np.int64),
        last_change=np.concatenate([observed.last_change, changes]),
        values=np.zeros((begin, len(observed.channels))),
        fitted=None,
        bins=None if observed.bins is None else observed.bins.followed(len(segments)),
        **joined,
    )
    return made, places


def _times(segment: Segment, rate: float) -> Array:
    """Sample times from the start of the segment: all times for a ramp; for other motions, a few seconds with whole turns or
    periods."""
    assert segment.dwell is not None
    span, begin = _SAMPLED, 0.0
    if segment.ramp_to is not None:
        return np.linspace(0.0, segment.dwell, max(_STUB, min(2000, round(segment.dwell * rate))))
    if isinstance(segment.motion, Spin):
        turn = 2 * math.pi / abs(segment.motion.rate)
        span = turn * math.ceil(_SAMPLED / turn)
    elif isinstance(segment.motion, Rock):
        span = math.ceil(_SAMPLED * segment.motion.frequency) / segment.motion.frequency
        begin = segment.motion.steady
    else:
        assert isinstance(segment.motion, Rest)
    return begin + np.arange(max(_STUB, round(span * rate))) / rate


def _temperatures(segment: Segment, now: float) -> tuple[float, float]:
    """Temperature [degC] at a segment's start and end."""
    start = now if segment.temperature is None else segment.temperature - ZERO_CELSIUS
    return start, start if segment.ramp_to is None else segment.ramp_to - ZERO_CELSIUS

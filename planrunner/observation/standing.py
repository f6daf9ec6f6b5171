"""Finds channels that keep one value from the start of a segment to its end.

Such a segment does not show the noise of the channel. The noise is therefore taken from the bench file, or from other segments at
rest or at a constant rate in which the channel changes. The channel counts as stuck if noise of this size would have moved it to
another count. Three cases are therefore not reported: channels with coarse counts at rest, signals without noise, and channels
(such as setpoints) that keep one value in most segments.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from planrunner.archive.recording import Find, FindKind, RecordedSegment
from planrunner.base.arrays import Array
from planrunner.instruments.models import OutputModel, SensorModel
from planrunner.plan.schedule import Rest, Spin

_LEAST = 100  # fewest samples of a segment that is tested
_READ = 1 << 14  # samples from which the noise of another segment is taken
_COMPARED = 3  # other segments, the nearest in time
_WHITE = 1.0
"""A signal counts as smooth, and shows no noise, if the ratio of its mean second difference to its mean first difference is below
this value. The ratio is 1.73 for white noise, and far below 1 for a smooth signal."""
RUN = 10
"""A stretch of equal samples counts as stuck only if it is more than this many times as long as the other runs of equal samples in
the channel."""
PER_SIGMA = 1.954
"""Mean absolute second difference of white noise, in standard deviations of the noise."""


def with_standing(
    recording: Sequence[RecordedSegment], sensor: SensorModel, channels: Collection[str], chance: float
) -> tuple[RecordedSegment, ...]:
    """Adds a finding to a segment for each channel that keeps one value although its noise would have changed this value. The
    finding does not count as bad, because an estimate excludes the samples of bad findings, and the channel would then have no data
    in this segment. A person must decide what to do.

    `chance`: a channel counts as stuck if the probability that noise leaves its value constant is at most `chance`.
    """
    found: dict[int, list[Find]] = {}
    for name in channels:
        held = [item for item in recording if not item.expected and name in item.units and _steady(item)]
        standing = [item for item in held if _range(item, name) == 0 and item.statistics.count >= _LEAST]
        if not standing:
            continue
        changing = [item for item in held if _range(item, name) > 0]
        output = sensor.output(name)
        for item in standing:
            many = len(standing) > len(changing)
            if (not many and _by_others(item, changing, name, chance)) or _by_declaration(
                item, output, sensor.sample_rate, chance
            ):
                found.setdefault(id(item), []).append(_find(item, name, output))
    return tuple(
        replace(item, finds=(*(item.finds or ()), *found[id(item)])) if id(item) in found else item
        for item in recording
    )


def _steady(item: RecordedSegment) -> bool:
    return isinstance(item.segment.motion, Rest | Spin)


def _range(item: RecordedSegment, name: str) -> float:
    """Returns the largest minus the smallest sample of a channel; NaN if there are no samples."""
    place = item.statistics.of(name)
    return float(item.statistics.maximum[place] - item.statistics.minimum[place])


def _by_others(item: RecordedSegment, changing: Sequence[RecordedSegment], name: str, chance: float) -> bool:
    """Returns True if noise as large as in other segments would have changed the value of the channel in this segment. The noise is
    taken from the nearest segments in which the channel changes. `chance`: the same as in `leaves_count`."""
    still = isinstance(item.segment.motion, Rest)
    alike = [one for one in changing if not still or isinstance(one.segment.motion, Rest)]
    nearest = sorted(alike, key=lambda one: abs(one.statistics.start - item.statistics.start))[:_COMPARED]
    return bool(nearest) and all(_moves(_samples(one, name), item.statistics.count, chance) for one in nearest)


def _samples(item: RecordedSegment, name: str) -> Array:
    """Returns the first samples of a channel, shape (n,); missing numbers are left out."""
    parts, count = [], 0
    for block in item.blocks((name,)):
        values = np.asarray(block.channels[name], dtype=float)[: _READ - count]
        parts.append(values[np.isfinite(values)])
        count += len(values)
        if count >= _READ:
            break
    return np.concatenate(parts) if parts else np.empty(0)


def _moves(values: Array, samples: int, chance: float) -> bool:
    """Determines the noise of the values (n,). Returns True if noise of this size would change at least one of `samples` samples.
    `chance`: the same as in `leaves_count`."""
    if len(values) < _LEAST:
        return False
    first, second = np.abs(np.diff(values)), np.abs(np.diff(values, 2))
    if not first.any() or second.mean() < _WHITE * first.mean():
        return False
    changes = np.flatnonzero(first)
    longest = int(np.diff(changes, prepend=-1, append=len(first)).max())
    noise = float(second.mean()) / PER_SIGMA
    return samples > RUN * longest and leaves_count(noise, float(first[changes].min()), samples, chance)


def leaves_count(noise: float, count: float, samples: int, chance: float) -> bool:
    """Returns True if white noise with the standard deviation `noise` would move at least one of `samples` samples to another
    count. A move counts as certain if the probability that all samples stay within one count is at most `chance`. A part of the
    variance, 0.3 count², is not attributed to noise, because a channel that alternates between two counts has such a variance even
    without noise."""
    beyond = noise**2 - 0.3 * count**2
    if beyond <= 0:
        return False
    stays = math.erf(count / (2 * math.sqrt(2 * beyond)))
    return samples * -math.log(max(stays, 1e-300)) > -math.log(chance)


def _by_declaration(item: RecordedSegment, output: OutputModel | None, rate: float, chance: float) -> bool:
    """Returns True if the noise that the bench file declares for single samples would have moved the channel to another count.
    `rate`: sample rate, Hz. `chance`: the same as in `leaves_count`."""
    if output is None or not output.noise.white > 0 or output.noise.counted:
        return False
    noise = output.noise.white * math.sqrt(item.segment.sample_rate or rate)
    return leaves_count(noise, output.noise.resolution, item.statistics.count, chance)


def _find(item: RecordedSegment, name: str, output: OutputModel | None) -> Find:
    known = item.statistics
    value = float(known.mean[known.of(name)])
    limit = math.inf if output is None else 0.99 * output.full_scale
    kind = FindKind.CLIPPED if abs(value) >= limit else FindKind.STUCK
    rows = known.count + known.rejected
    return Find(kind, name, 0, rows, known.start, known.duration, value, math.nan, value, value, bad=False)

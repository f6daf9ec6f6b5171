"""Stretches of repeated samples: where outputs keep one value for longer than their noise allows.

White noise repeats a count with a probability r, so that the number of equal samples is geometric: P(L) = (1 − r)·r^(L−1). r is the
share of samples in a segment that repeat the sample before, without the longest run. A stuck stretch may have any length, equally
likely in its logarithm. The evidence compares stuck stretches with the repeats of white noise; one stuck stretch is expected in the
recording. Real noise is correlated, so √r is used instead of r. Channels with coarse counts are not used, because their noise stays
within a count for long. Means over bins do not show repeated samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.error_model.observed import Observed

_RUNS = 20  # runs of a segment from which r is known
_MOST = 0.3  # r above which a channel is not used: r then differs between the middle of a count and its edges


@dataclass(frozen=True, slots=True)
class RepeatedStretch:
    """Consecutive samples of a channel, each equal to the sample before it. channel: index of the channel; first: index of the
    first of these samples; count: number of these samples."""

    channel: int
    first: int
    count: int


@dataclass(frozen=True)
class Repeated:
    """The stuck stretches of a recording. log_bayes: log BF of stuck stretches against none. stretches: the likely ones, the longest
    first. held: (N, K), true for the samples of the stretches."""

    log_bayes: float
    stretches: tuple[RepeatedStretch, ...]
    held: NDArray[np.bool_]


def repeated(observed: Observed) -> Repeated:
    """The stuck stretches of a recording of single samples."""
    held = np.zeros(observed.values.shape, dtype=bool)
    found: list[RepeatedStretch] = []
    total, chance = 0.0, 1.0 / max(held.size, 2)
    parts = observed.segments() if observed.bins is None else []
    for part in parts:
        for channel in range(len(observed.channels)):
            values = observed.values[part, channel]
            ends = np.append(np.flatnonzero(values[1:] != values[:-1]), len(values) - 1)
            lengths = np.diff(ends, prepend=-1)
            longest = int(lengths.max())
            repeats = (len(values) - len(lengths) - (longest - 1)) / max(len(values) - longest, 1)
            if len(lengths) < _RUNS or repeats > _MOST:
                continue
            r = np.sqrt(max(repeats, 1 / len(lengths)))
            usual = np.log1p(-r) + (lengths - 1) * np.log(r)
            stuck = -np.log(lengths * np.log(len(values))) - usual + np.log(chance)
            total += float(np.logaddexp(np.log1p(-chance), stuck).sum())
            for run in np.flatnonzero(stuck > 0):
                first = part.start + int(ends[run] - lengths[run]) + 2
                found.append(RepeatedStretch(channel, first, int(lengths[run]) - 1))
                held[first : first + int(lengths[run]) - 1, channel] = True
    return Repeated(total, tuple(sorted(found, key=lambda one: -one.count)), held)

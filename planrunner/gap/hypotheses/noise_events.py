"""Describes the rare events in the noise of real sensors, for example knocks.

An event lasts for a few seconds. It appears in the coefficients as a short offset (`hypotheses.short_offsets`), or outside them as a
burst (`hypotheses.outside`). Every hypothesis contains such events, so they are no evidence for a cause. Their times follow a Poisson
process. The rate of this process is not known. Each event has its own size and channels, independently of the other events. A
cause outside the catalogue differs from these events: it acts in the same channels each time, it may be larger, and it may recur more
often.

In array shapes, E is the number of events and Q is the number of rates.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from planrunner.base.arrays import Array
from planrunner.gap.evidence.bayes_factors import log_mean_exp

RATES = np.array([1e-5, 1e-4, 1e-3, 1e-2])
"""Possible rates of events, 1/s: from one event in a day to one in 100 s. All are equally probable."""
LARGEST = 50.0
"""Nats, half the energy of an event of 10 standard deviations. A larger event does not count as noise, so an event has at most this
evidence."""


@dataclass(frozen=True)
class Events:
    """Contains the events that the coefficients show.

    `gains`: array of shape (E,), log Bayes factor of each event, multiplied by the seconds in which it can begin (the sum over all
    windows of the same kind is the duration of the run). `channels`: for each event, the indices of its channels. `seconds`: duration
    of the run, s.
    """

    gains: Array
    channels: tuple[frozenset[int], ...]
    seconds: float

    @property
    def none(self) -> Array:
        """Returns the log probability of no event at each rate, shape (Q,)."""
        return np.asarray(-RATES * self.seconds)

    def log_bayes(self, without: Collection[int] = ()) -> Array:
        """Returns the log Bayes factor of the events at each rate, relative to noise without events, shape (Q,). Events in the channels
        `without` do not count."""
        used = np.array([own.isdisjoint(without) for own in self.channels], dtype=bool)
        grown = np.log(RATES)[:, None] + self.gains[used]
        return np.asarray(np.logaddexp(0.0, grown).sum(1) + self.none)


def averaged_over_rates(log_bayes: Array) -> Array:
    """Returns the log Bayes factor of noise with events of an unknown rate, shape (…). It is zero if noise without events is more
    probable. `log_bayes`: array of shape (…, Q), sum of the log Bayes factors of the events in the coefficients and outside them."""
    return np.asarray(np.maximum(log_mean_exp(log_bayes, -1), 0.0))

"""Publishes the live state of a run in its folder: progress, remaining time, statistics and strip charts of the channels, prompts
and notices.

Publishing must never disturb a run. Therefore a failure to write is ignored, and the state is written at most once in `EVERY`
seconds of real time. Between two writes, blocks of samples are only copied.
"""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.journal import utc_now
from planrunner.archive.live import (
    Answer,
    LiveChannel,
    LiveNotice,
    LiveState,
    Question,
    Strip,
    publish,
    take_answer,
    withdraw,
)
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.execution.progress import Advanced
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Segment

EVERY = 1.0
"""Minimum real time between two publications of the state, s."""
MOST_CHANNELS = 16
"""Maximum number of channels that are shown."""
STRIP = 180
"""Number of intervals in a strip chart."""
MOST_WAITING = 50_000
"""Number of samples that are collected before they are summarised."""
NOTICES = 20


@dataclass(slots=True)
class _Moments:
    """Contains, for each channel, the count, mean, sum of squared deviations, minimum and maximum of the samples; the arrays have
    the shape (channels,)."""

    count: int
    mean: NDArray[np.float64]
    squares: NDArray[np.float64]
    least: NDArray[np.float64]
    greatest: NDArray[np.float64]

    @classmethod
    def of(cls, samples: NDArray[np.float64]) -> _Moments:
        """Returns the moments of samples. `samples`: array of shape (channels, n), n > 0."""
        mean = samples.mean(axis=1)
        squares = np.square(samples - mean[:, None]).sum(axis=1)
        return cls(samples.shape[1], mean, squares, samples.min(axis=1), samples.max(axis=1))

    def joined(self, other: _Moments) -> _Moments:
        """Returns the moments of two sets of samples together (Chan, Golub and LeVeque, Updating formulae and a pairwise algorithm
        for computing sample variances, 1979, equation 2.1)."""
        m, n = self.count, other.count
        delta = other.mean - self.mean
        return _Moments(
            m + n,
            self.mean + delta * n / (m + n),
            self.squares + other.squares + delta**2 * m * n / (m + n),
            np.minimum(self.least, other.least),
            np.maximum(self.greatest, other.greatest),
        )


@dataclass(slots=True)
class _Samples:
    """Contains the samples of the current segment: the samples that are not yet summarised, and the moments of all others."""

    units: Mapping[str, str]
    waiting: list[NDArray[np.float64]] = field(default_factory=list)
    rows: int = 0
    last: float = math.nan
    moments: _Moments | None = None
    strip: deque[tuple[float, _Moments]] = field(default_factory=lambda: deque(maxlen=STRIP))

    def take(self, block: Block) -> None:
        if not block.time.size:
            return
        self.waiting.append(np.array([block.channels[name] for name in self.units], dtype=np.float64))
        self.rows += block.time.size
        self.last = float(block.time[-1])
        if self.rows >= MOST_WAITING:
            self.summarise()

    def summarise(self) -> None:
        if not self.waiting:
            return
        with np.errstate(all="ignore"):  # samples may be anything
            new = _Moments.of(np.concatenate(self.waiting, axis=1))
            self.moments = new if self.moments is None else self.moments.joined(new)
        self.waiting, self.rows = [], 0
        self.strip.append((self.last, new))

    def begin(self) -> None:
        """Starts a new set of samples; the strip charts of recent statistics continue."""
        self.waiting, self.rows, self.moments = [], 0, None


class LiveReport:
    """The live state of one run. `folder`: the run folder. `segments`: number of segments in the schedule."""

    def __init__(self, folder: GuardedFolder, segments: int):
        self._folder, self._segments = folder, segments
        self._index, self._label, self._activity = 0, "", "preparing the bench"
        self._fraction = 0.0
        self._left: float | None = None
        self._samples = _Samples({})
        self._hidden = 0
        self._paused = False
        self._question: Question | None = None
        self._notices: deque[LiveNotice] = deque(maxlen=NOTICES)
        self._published = -math.inf

    def announce(self, channels: Mapping[str, str]) -> None:
        """Sets the sensor's channels and their units."""
        shown = dict(list(channels.items())[:MOST_CHANNELS])
        self._samples, self._hidden = _Samples(shown), len(channels) - len(shown)

    def begin(self, segment: Segment) -> None:
        """Begins a segment: resets the statistics of the segment, and continues the strip charts."""
        self._index, self._label = segment.index, segment.label
        self._samples.begin()

    def advance(self, event: Advanced) -> None:
        """Reports progress within a segment."""
        self._fraction, self._left, self._activity = event.fraction, event.time_left, event.activity
        self.beat()

    def take(self, block: Block) -> None:
        """Adds samples of the segment to the statistics."""
        if self._samples.units:
            self._samples.take(block)

    def notice(self, text: str) -> None:
        self._notices.append(LiveNotice(utc_now(), text))

    def reject(self, label: str, reason: str) -> None:
        """Resets the statistics because the segment will be recorded again, if the plan allows this."""
        self._samples.begin()
        self.notice(f"segment '{label}' was rejected: {reason}")

    def ask(self, prompt: str) -> Question:
        """Publishes a prompt as a question. After that, `answer` returns the answer to the question, and `asked` withdraws the
        prompt."""
        self._question = Question(os.urandom(8).hex(), prompt)
        self._activity = "waiting for the operator"
        self._publish()
        return self._question

    def answer(self, question: Question) -> Answer | None:
        return take_answer(self._folder, question.id)

    def asked(self) -> None:
        self._question = None
        self._publish()

    def pause(self, paused: bool) -> None:
        self._paused = paused
        if paused:
            self._activity = "paused in the safe state"
        self._publish()

    def beat(self) -> None:
        """Publishes the state if a publication is due. The method is called often."""
        if time.monotonic() - self._published >= EVERY:
            self._publish()

    def end(self) -> None:
        withdraw(self._folder)

    def _publish(self) -> None:
        self._published = time.monotonic()
        self._samples.summarise()
        with suppress(OSError):
            publish(self._folder, self._state())

    def _state(self) -> LiveState:
        samples = self._samples
        return LiveState(
            utc_now(),
            self._index,
            self._label,
            self._segments,
            self._fraction,
            self._left,
            self._activity,
            self._paused,
            self._question,
            tuple(_channel(samples, place, name, unit) for place, (name, unit) in enumerate(samples.units.items())),
            tuple(end for end, _ in samples.strip),
            self._hidden,
            tuple(self._notices),
        )


def _channel(samples: _Samples, place: int, name: str, unit: str) -> LiveChannel:
    strip = Strip(
        tuple(float(one.least[place]) for _, one in samples.strip),
        tuple(float(one.mean[place]) for _, one in samples.strip),
        tuple(float(one.greatest[place]) for _, one in samples.strip),
    )
    found = samples.moments
    if found is None:
        return LiveChannel(name, unit, 0, math.nan, math.nan, math.nan, math.nan, strip)
    deviation = math.sqrt(float(found.squares[place]) / (found.count - 1)) if found.count > 1 else math.nan
    return LiveChannel(
        name,
        unit,
        found.count,
        float(found.mean[place]),
        deviation,
        float(found.least[place]),
        float(found.greatest[place]),
        strip,
    )

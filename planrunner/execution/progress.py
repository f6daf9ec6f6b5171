"""Progress of a run as typed events, measured in planned time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from planrunner.base.progress import EVERY, Underway
from planrunner.instruments.interfaces import KnowsLength
from planrunner.plan.schedule import Schedule, Segment


@dataclass(frozen=True, slots=True)
class SegmentBegun:
    """fraction: completed fraction of the planned time of the run, 0 to 1. time_left: s of real time, None while unknown."""

    index: int
    label: str
    segments: int
    fraction: float
    time_left: float | None


@dataclass(frozen=True, slots=True)
class Advanced:
    """Progress within a segment; activity: current activity of the bench."""

    index: int
    label: str
    segments: int
    fraction: float
    time_left: float | None
    activity: str


@dataclass(frozen=True, slots=True)
class SegmentFinished:
    """The segment is acknowledged."""

    index: int
    label: str
    segments: int
    fraction: float
    time_left: float | None


ProgressEvent = Underway | SegmentBegun | Advanced | SegmentFinished
"""`Underway` before the first segment, while a recording is examined that is to be played back."""
ProgressCallback = Callable[[ProgressEvent], None]


def planned_seconds(segment: Segment) -> float:
    """Planned time of one segment, s: transition, soak, settling and dwell."""
    return segment.transition + segment.soak + segment.settle + (segment.dwell or 0.0)


def with_lengths(schedule: Schedule, sensor: object) -> Schedule:
    """The schedule with a dwell also for the segments that last as long as their recording, as far as the sensor knows it."""
    if not isinstance(sensor, KnowsLength):
        return schedule
    segments = (replace(one, dwell=sensor.length_of(one)) if one.dwell is None else one for one in schedule.segments)
    return replace(schedule, segments=tuple(segments))


class Meter:
    """Turns the position of the executor into events.

    The time left is the remaining planned time at the pace so far, so it is real time on a simulated bench too. A callback that raises is
    not called again, because a display must not end a run.
    """

    def __init__(self, schedule: Schedule, callbacks: Sequence[ProgressCallback], behind: float):
        self._segments = len(schedule.segments)
        self._planned = {segment.index: segment for segment in schedule.segments}
        self._total = sum(planned_seconds(segment) for segment in schedule.segments)
        self._by_count = self._total <= 0
        self._callbacks = tuple(callbacks)
        self._first = self._behind = behind
        self._began = self._shown = time.monotonic()
        self._segment: Segment | None = None
        self._segment_clock = 0.0

    def begin(self, segment: Segment, clock: float) -> None:
        self._segment, self._segment_clock = self._planned[segment.index], clock
        self._send(SegmentBegun, self._behind)

    def advance(self, clock: float, activity: str) -> None:
        """Called often; sends an event if one is due."""
        now = time.monotonic()
        if self._segment is None or now - self._shown < EVERY:
            return
        self._shown = now
        within = min(max(clock - self._segment_clock, 0.0), planned_seconds(self._segment))
        self._send(Advanced, self._behind + (0.0 if self._by_count else within), activity)

    def finish(self) -> None:
        assert self._segment is not None
        self._behind += 1.0 if self._by_count else planned_seconds(self._segment)
        self._send(SegmentFinished, self._behind)
        self._segment = None

    def _send(self, kind: type, behind: float, *more: str) -> None:
        if self._segment is None:
            return
        total = float(self._segments) if self._by_count else self._total
        fraction = min(1.0, behind / total) if total else 1.0
        done = behind - self._first
        left = (time.monotonic() - self._began) / done * max(0.0, total - behind) if done > 0 else None
        event = kind(self._segment.index, self._segment.label, self._segments, fraction, left, *more)
        for callback in self._callbacks:
            try:
                callback(event)
            except Exception:
                self._callbacks = tuple(other for other in self._callbacks if other is not callback)


def seconds_behind(schedule: Schedule, done: Callable[[int], bool]) -> float:
    """Planned time of the completed segments (or their number if no segment has a planned time)."""
    times = [planned_seconds(segment) for segment in schedule.segments if done(segment.index)]
    return sum(times) if any(planned_seconds(segment) for segment in schedule.segments) else float(len(times))

"""Reports the progress of a run as typed events. Progress is measured in planned time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from planrunner.base.progress import EVERY, Underway
from planrunner.instruments.interfaces import KnowsLength
from planrunner.plan.schedule import Schedule, Segment


@dataclass(frozen=True, slots=True)
class SegmentBegun:
    """The event that a segment has begun. `fraction`: completed fraction of the planned time of the run, 0 to 1. `time_left`:
    expected remaining real time [s]; None if it is not yet known."""

    index: int
    label: str
    segments: int
    fraction: float
    time_left: float | None


@dataclass(frozen=True, slots=True)
class Advanced:
    """Reports that the run has advanced within a segment. `activity`: what the bench is doing."""

    index: int
    label: str
    segments: int
    fraction: float
    time_left: float | None
    activity: str


@dataclass(frozen=True, slots=True)
class SegmentFinished:
    """The event that a segment has been acknowledged."""

    index: int
    label: str
    segments: int
    fraction: float
    time_left: float | None


ProgressEvent = Underway | SegmentBegun | Advanced | SegmentFinished
"""Event of a run. Before the first segment, `Underway` reports the progress of the check of a recording that will be played
back."""
ProgressCallback = Callable[[ProgressEvent], None]


def with_lengths(schedule: Schedule, sensor: object) -> Schedule:
    """Returns the schedule after the unknown dwells have been set. A dwell is unknown if it lasts as long as a recording; it is set
    if the sensor knows the length of the recording."""
    if not isinstance(sensor, KnowsLength):
        return schedule
    segments = (replace(one, dwell=sensor.length_of(one)) if one.dwell is None else one for one in schedule.segments)
    return replace(schedule, segments=tuple(segments))


class Meter:
    """Converts the position of the executor to events.

    The time left is estimated from the remaining planned time and the speed so far, so it is in real time even on a simulated
    bench. `callback`: receives all events. If it raises an exception, it is not called again, because a display must not end a run.
    `live`: a callback that receives only the progress within segments. If `callback` is None, no events are made for the beginning
    and the end of a segment.
    """

    def __init__(
        self, schedule: Schedule, callback: ProgressCallback | None, live: Callable[[Advanced], None], behind: float
    ):
        self._segments = len(schedule.segments)
        self._planned = {segment.index: segment for segment in schedule.segments}
        self._total = sum(segment.seconds for segment in schedule.segments)
        self._by_count = self._total <= 0
        self._callback, self._live = callback, live
        self._first = self._behind = behind
        self._began = self._shown = time.monotonic()
        self._segment: Segment | None = None
        self._segment_clock = 0.0

    def begin(self, segment: Segment, clock: float) -> None:
        self._segment, self._segment_clock = self._planned[segment.index], clock
        if self._callback is not None:
            self._tell(SegmentBegun(segment.index, segment.label, self._segments, *self._pace(self._behind)))

    def advance(self, clock: float, activity: str) -> None:
        """Sends an event if one is due. The method is called often. `clock`: time on the bench's clock, s. `activity`: what the
        bench is doing."""
        now = time.monotonic()
        segment = self._segment
        if segment is None or now - self._shown < EVERY:
            return
        self._shown = now
        within = 0.0 if self._by_count else min(max(clock - self._segment_clock, 0.0), segment.seconds)
        event = Advanced(segment.index, segment.label, self._segments, *self._pace(self._behind + within), activity)
        self._live(event)
        self._tell(event)

    def finish(self) -> None:
        segment, self._segment = self._segment, None
        assert segment is not None
        self._behind += 1.0 if self._by_count else segment.seconds
        if self._callback is not None:
            self._tell(SegmentFinished(segment.index, segment.label, self._segments, *self._pace(self._behind)))

    def _pace(self, behind: float) -> tuple[float, float | None]:
        """Returns the completed fraction of the planned time, and the expected remaining time [s]; None instead of this time if
        nothing has been completed yet. `behind`: completed planned time, s."""
        total = float(self._segments) if self._by_count else self._total
        fraction = min(1.0, behind / total) if total else 1.0
        done = behind - self._first
        left = (time.monotonic() - self._began) / done * max(0.0, total - behind) if done > 0 else None
        return fraction, left

    def _tell(self, event: ProgressEvent) -> None:
        if self._callback is None:
            return
        try:
            self._callback(event)
        except Exception:
            self._callback = None


def seconds_behind(schedule: Schedule, done: Callable[[int], bool]) -> float:
    """Returns the planned time [s] of the completed segments. If no segment of the schedule has a planned time, returns the number
    of completed segments. `done`: returns True if the segment with this index is completed."""
    times = [segment.seconds for segment in schedule.segments if done(segment.index)]
    return sum(times) if any(segment.seconds for segment in schedule.segments) else float(len(times))

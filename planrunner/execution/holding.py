"""Supervision of a segment while it records: readings are checked against the limits of the plan, and the frame counts at the end."""

from __future__ import annotations

from collections.abc import Callable

from planrunner.execution.connected_bench import ConnectedBench
from planrunner.execution.lookout import Lookout
from planrunner.execution.readings import DRIFT_OVER, frames_outside, outside, readings_of, unread
from planrunner.instruments.interfaces import FrameCounts
from planrunner.plan.schedule import Segment, Watch


class LimitPassedError(Exception):
    """A limit of the plan was exceeded while a segment recorded. The message names the limit."""


class Holding:
    """One attempt at one segment, from the beginning of its dwell."""

    def __init__(
        self, bench: ConnectedBench, lookout: Lookout, segment: Segment, counts: Callable[[], FrameCounts] | None = None
    ):
        """counts: frame counter of the sensor, if it has one."""
        self._clock, self._lookout = bench.clock, lookout
        self._counts = counts
        self._watch = segment.watch or Watch()
        self._readings = readings_of(bench, segment, DRIFT_OVER)
        self._moves = segment.ramp_to is not None
        self._looks = lookout.looks
        self._begun = False
        self._seen: set[str] = set()

    def check(self, fresh: bool = False) -> None:
        """Check the bench if a check is due, or now. Raises `LimitPassedError` and the errors of `Lookout.look`."""
        self._lookout.look(fresh=fresh or not self._begun)
        self._begun = True
        if self._looks == self._lookout.looks:
            return
        self._looks = self._lookout.looks
        conditions = self._lookout.conditions
        values = self._readings.take(self._clock.now(), conditions)
        self._seen.update(values)
        passed = outside(self._watch.limits, values)
        if self._watch.doubts:
            passed += [
                f"'{name}' marks its samples as doubtful ({doubt})"
                for name, now in conditions.items()
                for doubt in now.doubts
            ]
        if passed:
            raise LimitPassedError("; ".join(passed))

    def finish(self) -> FrameCounts | None:
        """The frame counts of the sensor, after a last check that finds failures up to the end. Raises the errors of `check`, and
        `LimitPassedError` if too many frames are lost or corrupt."""
        self.check(fresh=True)
        counts = self.counts()
        passed = [] if counts is None else frames_outside(self._watch, counts)
        if passed:
            raise LimitPassedError("; ".join(passed))
        return counts

    def counts(self) -> FrameCounts | None:
        return None if self._counts is None else self._counts()

    def unjudged(self) -> list[str]:
        """In words, the limited quantities without a reading during the dwell, on a bench that has readings."""
        if not self._looks or self._moves:
            return []
        return unread(self._watch.limits, self._seen)

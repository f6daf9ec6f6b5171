"""The executor: carries a schedule out on a bench and leaves a recording.

For each segment it brings the bench to the state (temperature, orientation, motion), settles, lets the sensor's
samples through to the run folder, takes readings and comes to rest. It knows instruments only by what they can do,
and time only by the bench's clock. Whatever happens, the bench is brought to its safe state before anything else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from planrunner.archive.run_folder import RunWriter
from planrunner.execution.outcome import Failure, Outcome
from planrunner.execution.progress import Meter, ProgressCallback, seconds_behind
from planrunner.execution.reaching import Patience, Reaching, StoppedAtOnceError
from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import Clock, InstrumentError, Readable, Resumable, StreamsSamples
from planrunner.plan.schedule import Schedule, Segment

SAFE_ATTEMPTS = 3


class OpenBench(Protocol):
    """A bench whose instruments are connected. `instruments` holds all of them by name, those named by role
    included."""

    clock: Any
    table: Any
    chamber: Any
    sensor: Any
    monitors: Any
    instruments: Mapping[str, Any]

    def make_safe(self) -> list[Any]:
        """Bring every instrument to its safe state; returns what failed."""


def execute(
    schedule: Schedule,
    bench: OpenBench,
    writer: RunWriter,
    *,
    stop: StopRequest,
    progress: ProgressCallback | None = None,
    start_at: int = 0,
    patience: Patience | None = None,
) -> Outcome:
    """Carry out the segments of `schedule` from `start_at` that `writer` has not acknowledged.

    Never raises for what instruments or the disk do: failures are in the outcome, and the bench is safe. A finished
    run is sealed.
    """
    return _Execution(schedule, bench, writer, stop, progress, start_at, patience or Patience()).carry_out()


class _Execution:
    def __init__(
        self,
        schedule: Schedule,
        bench: OpenBench,
        writer: RunWriter,
        stop: StopRequest,
        progress: ProgressCallback | None,
        start_at: int,
        patience: Patience,
    ):
        self.schedule, self.bench, self.writer, self.stop = schedule, bench, writer, stop
        self.clock: Clock = bench.clock
        self.start_at = start_at
        self.completed = 0
        self.through = False
        self.segment: Segment | None = None
        self.activity = ""
        self.doing = "preparing the bench"
        self.streams = isinstance(bench.sensor, StreamsSamples)
        self.readable = {name: item for name, item in bench.instruments.items() if isinstance(item, Readable)}
        self.resumable = {name: item for name, item in bench.instruments.items() if isinstance(item, Resumable)}
        self.channels: Mapping[str, str] = {}
        self.meter: Meter | None = None
        if progress is not None:
            self.meter = Meter(schedule, progress, seconds_behind(schedule, self._done))
        self.reaching = Reaching(bench, stop, patience, self._say)

    # -- from beginning to end -----------------------------------------------------------------------------------------

    def carry_out(self) -> Outcome:
        failures: list[Failure] = []
        unsafe: list[str] = []
        try:
            self._attend(self._on_tick)
            self._prepare()
            self._segments()
        except StoppedAtOnceError:
            pass
        except KeyboardInterrupt:
            self.stop.request(at_once=True, reason="interrupted")
        except BaseException as error:  # whatever a driver raises
            failures.append(Failure.of(error, self._where()))
        finally:
            unsafe += _make_safe(self.bench)
            self._attend(None)
        return self._account(failures, unsafe)

    def _account(self, failures: list[Failure], unsafe: list[str]) -> Outcome:
        """Write down how it ended; the bench is safe already."""
        complete = self._complete() and not failures
        cut, self.segment = self.segment, None
        stopped = None if complete or not self.stop.after_segment else self._how()
        finished = False
        try:
            self.doing = "writing the run folder"
            for failure in failures:
                self.writer.note("failed", where=failure.where, kind=failure.kind, message=failure.message)
            if stopped is not None:
                self.writer.note("stopped", how=stopped, reason=self.stop.reason)
            self.writer.note("safe", failures=unsafe)
            reason = str(failures[0]) if failures else f"stopped {stopped}: {self.stop.reason}"
            if not complete:
                keeps = cut is not None and cut.on_break == "keep"
                self.writer.break_off(reason, self.clock.now(), self._states_if_known() if keeps else {})
            else:
                self.writer.finish()
                finished = True
        except BaseException as error:  # the disk, or a driver's checkpoint; resuming settles what is missing
            failures.append(Failure.of(error, self.doing))
        return Outcome(self.completed, len(self.schedule.segments), finished, stopped, tuple(failures), tuple(unsafe))

    def _how(self) -> Any:
        return "at once" if self.stop.at_once else "after the segment"

    def _done(self, index: int) -> bool:
        return index < self.start_at or self.writer.acknowledged(index)

    def _complete(self) -> bool:
        """Whether the run has all its segments, those from before this start included."""
        return self.through and all(self.writer.acknowledged(index) for index in range(self.start_at))

    def _prepare(self) -> None:
        self.doing = "asking the instruments what they are"
        known = self.writer.resume_point.instruments
        identities = {}
        for name, instrument in self.bench.instruments.items():
            identities[name] = {key: str(value) for key, value in instrument.identify().items()}
            before, now = known.get(name, {}).get("serial"), identities[name].get("serial")
            if before is not None and now != before:
                raise InstrumentError(
                    f"'{name}' had serial {before} when the run began and has {now} now: put it back, or start a new run"
                )
        self.channels = dict(self.bench.sensor.channels()) if self.streams else {}
        self._restore()
        self.doing = "writing the run folder"
        self.writer.note("instruments", instruments=identities)
        resumed = self.writer.resume_point.resumed
        count = len(self.schedule.segments)
        self.writer.note("started", segments=count, start_at=self.start_at, clock=self.clock.now(), resumed=resumed)

    # -- one segment after the other -----------------------------------------------------------------------------------

    def _segments(self) -> None:
        for segment in self.schedule.segments[self.start_at :]:
            if self.stop.after_segment:
                return
            if not self._done(segment.index):
                self._segment(segment)
        self.through = True

    def _segment(self, segment: Segment) -> None:
        now = self.clock.now
        self.segment = segment
        if self.meter is not None:
            self.meter.begin(segment, now())
        self._say("writing the run folder")
        self.writer.begin(segment, now(), self.channels)
        self.reaching.reach(segment)
        self._dwell(segment)
        readings = self._read()
        self.reaching.come_to_rest(segment)
        self._say("noting the instruments' state")
        states = self._states()
        self._say("writing the run folder")
        self.writer.acknowledge(now(), states, readings)
        self.completed += 1
        if self.meter is not None:
            self.meter.finish()
        self.segment = None

    def _dwell(self, segment: Segment) -> None:
        self._say("recording")
        if not self.streams:
            if segment.dwell is None:
                raise InstrumentError(
                    f"'{segment.label}' lasts as long as its recording, but the sensor does not stream samples"
                )
            self.reaching.pause(segment.dwell)
            return
        stream = self.bench.sensor.stream(segment)
        try:
            for block in stream:
                self._say("writing samples")
                self.writer.append(block, self.clock.now())
                if self.stop.at_once:
                    raise StoppedAtOnceError
                self._say("recording")
        finally:
            close = getattr(stream, "close", None)
            if close is not None:
                close()

    def _read(self) -> dict[str, float]:
        """Readings of every instrument that has some, as `instrument.quantity_unit`."""
        if not self.readable:
            return {}
        self._say("taking readings")
        return {
            f"{name}.{key}": float(value) for name, item in self.readable.items() for key, value in item.read().items()
        }

    # -- state that must come back after a crash -----------------------------------------------------------------------

    def _states(self) -> dict[str, Any]:
        """Empty on a real bench, whose state stands in the laboratory."""
        if not self.resumable:
            return {}
        reaching, attitude = self.reaching, self.reaching.attitude
        executor = {
            "temperature": reaching.temperature,
            "attitude": None if attitude is None else attitude.tolist(),
            "soak_again": reaching.soak_again,
            "mode": reaching.mode,
            "moving_perhaps": reaching.moving_perhaps,
        }
        return {"executor": executor, "instruments": {name: item.checkpoint() for name, item in self.resumable.items()}}

    def _states_if_known(self) -> dict[str, Any]:
        self.reaching.forget()
        try:
            return self._states()
        except BaseException:  # a driver that has failed need not know its state
            return {}

    def _restore(self) -> None:
        point = self.writer.resume_point
        if not point.resumed:
            return
        self.doing = "going back to where the run broke off"
        self.clock.set(point.clock)  # type: ignore[attr-defined]
        self.reaching.forget()
        # What is simulated is as it was, to the second: as new, when nothing was acknowledged.
        simulated_table = isinstance(self.bench.table, Resumable)
        simulated_chamber = isinstance(self.bench.chamber, Resumable)
        self.reaching.moving_perhaps = not simulated_table
        if not point.states:
            return
        executor, instruments = point.states["executor"], point.states["instruments"]
        for name, item in self.resumable.items():
            if name in instruments:
                item.restore(instruments[name])
        if simulated_table:
            attitude = executor["attitude"]
            self.reaching.attitude = None if attitude is None else np.array(attitude, dtype=np.float64)
            self.reaching.moving_perhaps = executor["moving_perhaps"]
        if isinstance(self.bench.sensor, Resumable):
            self.reaching.mode = executor["mode"]
        if simulated_chamber:
            self.reaching.temperature, self.reaching.soak_again = executor["temperature"], executor["soak_again"]

    # -- words for people ----------------------------------------------------------------------------------------------

    def _say(self, activity: str) -> None:
        self.activity = activity
        if self.meter is not None:
            self.meter.advance(self.clock.now(), activity)

    def _where(self) -> str:
        return self.doing if self.segment is None else f"segment '{self.segment.label}', {self.activity}"

    def _on_tick(self) -> bool:
        """Called by a real clock while it sleeps; ends the sleep when the run is to stop at once."""
        if self.meter is not None:
            self.meter.advance(self.clock.now(), self.activity)
        return self.stop.at_once

    def _attend(self, callback: Callable[[], bool] | None) -> None:
        attend = getattr(self.clock, "attend", None)
        if attend is not None:
            attend(callback)


def _make_safe(bench: OpenBench) -> list[str]:
    """Whatever was pressed or raised meanwhile: making safe is asked again, and what fails is told."""
    told = "the bench could not be made safe: switch the table and the chamber off by hand"
    for _ in range(SAFE_ATTEMPTS):
        try:
            return [str(failure) for failure in bench.make_safe()]
        except KeyboardInterrupt:
            continue
        except BaseException as error:
            told = f"the bench could not be made safe ({type(error).__name__}: {error}): switch it off by hand"
    return [told]

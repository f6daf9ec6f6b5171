"""Executes a schedule on a bench and makes a recording.

For each segment, the executor brings the bench to the required state (temperature, orientation, motion), waits for settling, writes
the samples of the sensor to the run folder, takes readings, and ends the motion. It uses instruments only through the interfaces of
their capabilities, and time only through the clock of the bench. If a limit of the plan is exceeded during a segment, the segment
is rejected and repeated, as often as the plan allows. After any failure, the bench is first brought to its safe state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Literal

from planrunner.archive.journal import finite
from planrunner.archive.recording import IN_MODE
from planrunner.archive.run_folder import RunWriter
from planrunner.base.documents import JsonObject
from planrunner.base.findings import Finding
from planrunner.execution.connected_bench import ConnectedBench
from planrunner.execution.live import LiveReport
from planrunner.execution.lookout import EVERY, Lookout, StoppedAtOnceError
from planrunner.execution.operator import Boundary, Operator
from planrunner.execution.progress import Meter, ProgressCallback, seconds_behind, with_lengths
from planrunner.execution.reaching import Continuity, Holding, LimitPassedError, Patience, Reaching
from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import (
    Closes,
    Counting,
    FrameCounts,
    InstrumentError,
    Readable,
    SelfLimiting,
    StreamsSamples,
    Summarises,
)
from planrunner.plan.schedule import Schedule, Segment

SAFE_ATTEMPTS = 3


@dataclass(frozen=True, slots=True)
class Failure:
    """A failure of a run.

    `where`: what the executor was doing. `kind`: the class of the exception. `message`: text for a quality engineer.
    """

    where: str
    kind: str
    message: str

    def __str__(self) -> str:
        return f"{self.where}: {self.message}"

    @classmethod
    def of(cls, error: BaseException, where: str) -> Failure:
        kind = type(error).__name__
        if isinstance(error, InstrumentError):
            message = str(error)
        elif isinstance(error, OSError) and error.strerror:
            message = f"{error.strerror}{f' ({error.filename})' if error.filename else ''}"
        else:
            message = f"{kind}: {error}" if str(error) else kind
        return cls(where, kind, message)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of executing a schedule.

    `completed`: number of segments acknowledged in this execution. A segment is acknowledged when the journal records that it is
    complete. `segments`: number of segments in the schedule. `stopped`: how the operator stopped the run; None if the operator did
    not stop it. `unsafe`: failures in making instruments safe. `untouched`: instruments that were never commanded, and are
    therefore left as they were. `finished`: True if every segment is acknowledged and the folder is sealed. `remarks`: information
    that the user needs even if the run is complete. `unsigned`: the reason why the bench did not sign the seal although it should
    have.
    """

    completed: int
    segments: int
    finished: bool
    stopped: Literal["after the segment", "at once"] | None = None
    failures: tuple[Failure, ...] = ()
    unsafe: tuple[str, ...] = ()
    untouched: tuple[str, ...] = ()
    remarks: tuple[Finding, ...] = ()
    unsigned: tuple[Finding, ...] = ()

    @property
    def ok(self) -> bool:
        return self.finished and not self.failures and not self.unsafe


def execute(
    schedule: Schedule,
    bench: ConnectedBench,
    writer: RunWriter,
    *,
    stop: StopRequest,
    progress: ProgressCallback | None = None,
    start_at: int = 0,
    patience: Patience | None = None,
    operator: Operator | None = None,
) -> Outcome:
    """Executes the segments of `schedule`, beginning with the index `start_at`. Segments that `writer` has already acknowledged are
    skipped.

    `operator`: receives the prompts of the plan; None on a simulated bench, where prompts are skipped. Failures of instruments or
    of the disk do not raise exceptions; the outcome contains them, and the bench is brought to its safe state. A finished run is
    sealed.
    """
    return _Execution(schedule, bench, writer, stop, progress, start_at, patience or Patience(), operator).carry_out()


class _Execution:
    def __init__(
        self,
        schedule: Schedule,
        bench: ConnectedBench,
        writer: RunWriter,
        stop: StopRequest,
        progress: ProgressCallback | None,
        start_at: int,
        patience: Patience,
        operator: Operator | None,
    ):
        self.schedule, self.bench, self.writer, self.stop = schedule, bench, writer, stop
        self.clock = bench.clock
        self.start_at = start_at
        self.completed = 0
        self.through = False
        self.segment: Segment | None = None
        self.activity = ""
        self.doing = "preparing the bench"
        self.streaming = bench.sensor if isinstance(bench.sensor, StreamsSamples) else None
        # Asked once: what a class can do does not change, and asking takes longer than a short step.
        self.summarising = bench.sensor if isinstance(bench.sensor, Summarises) else None
        self.counts = bench.sensor.counts if isinstance(bench.sensor, Counting) else None
        self.readable = {name: item for name, item in bench.instruments.items() if isinstance(item, Readable)}
        self.channels: Mapping[str, str] = {}
        self.live = LiveReport(writer.folder, len(schedule.segments))
        planned = with_lengths(schedule, bench.sensor)
        self.meter = Meter(planned, progress, self.live.advance, seconds_behind(planned, self._done))
        self.lookout = Lookout(bench, stop, self._notice)
        self.reaching = Reaching(bench, self.lookout, patience, self._say)
        self.continuity = Continuity(bench, self.reaching)
        self.boundary = Boundary(writer, self.lookout, stop, operator, self.live, self._wait_safely, self._protect)

    # -- from beginning to end -----------------------------------------------------------------------------------------

    def carry_out(self) -> Outcome:
        failures: list[Failure] = []
        unsafe: list[str] = []
        try:
            self.live.beat()
            self.clock.attend(self._on_tick)
            self._prepare()
            self._segments()
        except StoppedAtOnceError:
            pass
        except KeyboardInterrupt:
            self.stop.request(at_once=True, reason="interrupted")
        except BaseException as error:  # a driver may raise anything
            failures.append(Failure.of(error, self._where()))
        finally:
            unsafe += _make_safe(self.bench)
            self.clock.attend(None)
            self.live.end()
        return self._account(failures, unsafe)

    def _account(self, failures: list[Failure], unsafe: list[str]) -> Outcome:
        """Records in the run folder how the run ended. The bench is already safe."""
        complete = self._complete() and not failures
        cut, self.segment = self.segment, None
        stopped = None if complete or not self.stop.after_segment else self._how()
        finished, untouched = False, tuple(self.bench.untouched)
        try:
            self.doing = "writing the run folder"
            for failure in failures:
                self.writer.note("failed", where=failure.where, kind=failure.kind, message=failure.message)
            if stopped is not None:
                self.writer.note("stopped", how=stopped, reason=self.stop.reason)
            left = {"untouched": list(untouched)} if untouched else {}
            self.writer.note("safe", failures=unsafe, **left)
            reason = str(failures[0]) if failures else f"stopped {stopped}: {self.stop.reason}"
            if not complete:
                keeps = cut is not None and cut.on_break == "keep"
                self.writer.break_off(reason, self.clock.now(), self.continuity.states_if_known() if keeps else {})
            else:
                self.writer.finish()
                finished = True
        except BaseException as error:  # disk or driver checkpoint failed; resuming completes the rest
            failures.append(Failure.of(error, self.doing))
        count = len(self.schedule.segments)
        return Outcome(self.completed, count, finished, stopped, tuple(failures), tuple(unsafe), untouched)

    def _how(self) -> Literal["at once", "after the segment"]:
        return "at once" if self.stop.at_once else "after the segment"

    def _done(self, index: int) -> bool:
        return index < self.start_at or self.writer.acknowledged(index)

    def _complete(self) -> bool:
        """Returns True if all segments of the run are recorded, including those before `start_at`."""
        return self.through and all(self.writer.acknowledged(index) for index in range(self.start_at))

    def _prepare(self) -> None:
        self.doing = "reading the identification of the instruments"
        known = self.writer.resume_point.instruments
        identities = {}
        for name, instrument in self.bench.instruments.items():
            identities[name] = {key: str(value) for key, value in instrument.identify().items()}
            before, now = known.get(name, {}).get("serial"), identities[name].get("serial")
            if before is not None and now != before:
                raise InstrumentError(
                    f"'{name}' had serial {before} when the run began and has {now} now: "
                    f"connect the original instrument again, or start a new run"
                )
        self.channels = {} if self.streaming is None else dict(self.streaming.channels())
        self.live.announce(self.channels)
        if self.writer.resume_point.resumed:
            self.doing = "returning to the state in which the run was interrupted"
            self.continuity.restore(self.writer.resume_point)
        self.doing = "setting the limits in the instruments"
        limits = self._protect()
        self.bench.take_control()
        self.doing = "writing the run folder"
        self.writer.note("instruments", instruments=identities)
        if limits:
            self.writer.note("protected", limits=limits)
        resumed = self.writer.resume_point.resumed
        count = len(self.schedule.segments)
        self.writer.note("started", segments=count, start_at=self.start_at, clock=self.clock.now(), resumed=resumed)

    def _protect(self) -> dict[str, list[str]]:
        """Sets the bench's limits in every instrument that supports them; returns the limits that each instrument enforces, by the
        name of the instrument."""
        told = {}
        for name, item in self.bench.instruments.items():
            if isinstance(item, SelfLimiting):
                self.bench.take_control(name)
                told[name] = [str(line) for line in item.limit(self.bench.limits)]
        return told

    # -- one segment after the other -----------------------------------------------------------------------------------

    def _segments(self) -> None:
        for segment in self.schedule.segments[self.start_at :]:
            if self.stop.after_segment:
                return
            if self._done(segment.index):
                continue
            self.doing = f"before segment '{segment.label}'"
            self.boundary.wait(segment, self.clock.now)
            if self.stop.after_segment:
                return
            self._segment(segment)
        self.through = True

    def _segment(self, segment: Segment) -> None:
        """Records a segment, and repeats it when a limit is exceeded, as often as the plan allows."""
        self.segment = segment
        self.meter.begin(segment, self.clock.now())
        self.live.begin(segment)
        retakes = segment.watch.retakes if segment.watch else 0
        for left in range(retakes, -1, -1):
            self._say("writing the run folder")
            summary = None if self.summarising is None else self.summarising.summary
            self.writer.begin(segment, self.clock.now(), self.channels, summary)
            self.lookout.begin_segment()
            self.reaching.reach(segment)
            in_mode = self._in_mode(segment)
            holding = Holding(self.bench, self.lookout, segment, self.counts)
            try:
                self._dwell(segment, holding)
                counts = holding.finish()
            except LimitPassedError as error:
                self.writer.set_aside(str(error), _frames(holding.counts()))
                self.live.reject(segment.label, str(error))
                if not left:
                    taken = f"; it was recorded {retakes + 1} times" if retakes else ""
                    raise InstrumentError(f"{error}{taken}. Check the bench, then resume the run") from None
                self.reaching.come_to_rest(segment)
                continue
            self._acknowledge(segment, holding, counts, in_mode)
            return

    def _in_mode(self, segment: Segment) -> dict[str, float]:
        """Returns the time [s] for which the sensor had been in the segment's mode when the record began, as a reading for the
        journal."""
        since = self.reaching.mode_since
        return {} if segment.mode is None or since is None else {IN_MODE: self.clock.now() - since}

    def _acknowledge(
        self, segment: Segment, holding: Holding, counts: FrameCounts | None, in_mode: Mapping[str, float]
    ) -> None:
        for text in holding.unjudged():
            self._notice("bench", text)
        readings = {**in_mode, **self._read()}
        self.reaching.come_to_rest(segment)
        self.lookout.hear()
        self._say("recording the state of the instruments")
        states = self.continuity.states()
        self._say("writing the run folder")
        self.writer.acknowledge(self.clock.now(), states, readings, frames=_frames(counts))
        self.completed += 1
        self.meter.finish()
        self.segment = None

    def _dwell(self, segment: Segment, holding: Holding) -> None:
        self._say("recording")
        if self.streaming is None:
            self._stand(segment, holding)
            return
        stream = self.streaming.stream(segment)
        try:
            for block in stream:
                self._say("writing samples")
                if block.time.size:
                    self.writer.append(block, self.clock.now())
                    self.live.take(block)
                holding.check()
                self._say("recording")
        finally:
            if isinstance(stream, Closes):
                stream.close()

    def _stand(self, segment: Segment, holding: Holding) -> None:
        """Waits for the duration of a dwell that is not recorded, and supervises the bench."""
        if segment.dwell is None:
            message = f"'{segment.label}' lasts as long as its recording, but the sensor does not stream samples"
            raise InstrumentError(message)
        end = self.clock.now() + segment.dwell
        while (left := end - self.clock.now()) > 0:
            self.lookout.pause(min(left, EVERY) if self.lookout.sees else left)
            holding.check()

    def _read(self) -> dict[str, float]:
        """Returns the readings of all instruments, under names of the form `instrument.quantity_unit`."""
        if not self.readable:
            return {}
        self._say("taking readings")
        return {
            f"{name}.{key}": float(value) for name, item in self.readable.items() for key, value in item.read().items()
        }

    # -- messages to the operator --------------------------------------------------------------------------------------

    def _say(self, activity: str) -> None:
        self.activity = activity
        self.meter.advance(self.clock.now(), activity)

    def _where(self) -> str:
        return self.doing if self.segment is None else f"segment '{self.segment.label}', {self.activity}"

    def _on_tick(self) -> bool:
        """A real-time clock calls this method while it sleeps. Returns True if the run must stop at once; this ends the sleep."""
        self.meter.advance(self.clock.now(), self.activity)
        return self.lookout.tick()

    def _notice(self, instrument: str, text: str) -> None:
        where = {} if self.segment is None else {"label": self.segment.label}
        self.writer.note("noticed", instrument=instrument, text=text, **where)
        self.live.notice(f"{instrument}: {text}")

    def _wait_safely(self) -> None:
        """Brings the bench to its safe state before a person approaches it. After that, the executor no longer relies on earlier
        commands."""
        self.reaching.forget()
        failures = [str(failure) for failure in self.bench.make_safe()]
        if failures:
            raise InstrumentError(
                "the bench cannot be brought into a state that is safe to approach: " + "; ".join(failures)
            )


def _frames(counts: FrameCounts | None) -> JsonObject | None:
    return None if counts is None else {**asdict(counts), "details": finite(counts.details)}


def _make_safe(bench: ConnectedBench) -> list[str]:
    """Makes the bench safe, with up to `SAFE_ATTEMPTS` attempts if a signal or an exception interrupts. Returns the failures."""
    told = "the bench could not be made safe: switch the table and the chamber off by hand"
    for _ in range(SAFE_ATTEMPTS):
        try:
            return [str(failure) for failure in bench.make_safe()]
        except KeyboardInterrupt:
            continue
        except BaseException as error:
            told = f"the bench could not be made safe ({type(error).__name__}: {error}): switch it off by hand"
    return [told]

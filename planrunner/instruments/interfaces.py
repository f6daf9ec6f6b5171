"""Capabilities of instruments as small protocols; a driver implements those that apply.

A driver is a class found through the entry-point group `planrunner.instruments`:

    class MyTable:
        role = "table"                       # table, chamber, sensor or monitor
        Parameters = MyTableParameters       # a Record: its keys in the bench file

        @classmethod
        def model(cls, parameters) -> TableModel      # known without connecting
        @classmethod
        def connect(cls, parameters, surroundings) -> MyTable

Commands return at once with their expected duration in seconds; the executor waits on its clock and then queries `holding()`. Connecting is
not commanding: an instrument that is only connected is closed unchanged. Every failure is an `InstrumentError`; the executor then calls
`make_safe` on every instrument that it commanded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.base.findings import Finding
from planrunner.base.progress import Announce
from planrunner.instruments.models import ChamberModel, SensorModel, TableModel
from planrunner.physics.earth import Site
from planrunner.plan.kinds import Record
from planrunner.plan.schedule import Motion, Segment

P = TypeVar("P", bound=Record)


class InstrumentError(Exception):
    """An instrument did not execute a request. The message names the instrument, the problem and what to check."""


class UnservedError(InstrumentError):
    """A schedule that cannot be executed. findings: all reasons."""

    def __init__(self, findings: Sequence[Finding]):
        self.findings = tuple(findings)
        super().__init__("; ".join(finding.message for finding in findings))

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.findings,)


class Clock(Protocol):
    """Interface of time for code that must work in the same way with simulated and real time."""

    def now(self) -> float:
        """Seconds since the run began."""

    def sleep(self, seconds: float) -> None: ...


class RunClock(Clock, Protocol):
    """The clock of a run: it can be set for a resumed run, and calls back while it sleeps."""

    def set(self, seconds: float) -> None:
        """Sets the time at which the clock continues when a run is resumed."""

    def attend(self, callback: Callable[[], bool] | None) -> None:
        """Sets a callback that is called during sleeps and returns whether to end the sleep. None: no callback."""


@runtime_checkable
class Hastens(Protocol):
    """A clock that runs `speed` times as fast as real time, for a bench of simulated instruments at that speed."""

    speed: float


@runtime_checkable
class Closes(Protocol):
    """An object that holds resources, such as a stream of samples that is not read to its end."""

    def close(self) -> None: ...


@dataclass(slots=True)
class Surroundings:
    """Context for connecting a driver: clock, site, the folder that must contain data files, the seed of the run, and the other
    instruments by role. world: shared by the drivers of a virtual bench; real drivers ignore it. real_time: the clock is a real-time
    clock, so simulated and played-back samples come in blocks of about a second. notice: receives the progress of work that takes long
    before the run begins, such as the examination of a recording."""

    clock: Clock
    site: Site
    data_root: Path | None = None
    seed: int = 0
    real_time: bool = False
    world: object = None
    notice: Announce | None = None
    instruments: dict[str, Instrument] = field(default_factory=dict)


class Driver(Protocol[P]):
    """The class-level side of a plug-in. P: the record of its keys in a bench file."""

    role: str
    Parameters: type[P]

    @classmethod
    def model(cls, parameters: P) -> TableModel | ChamberModel | SensorModel | None: ...
    @classmethod
    def connect(cls, parameters: P, surroundings: Surroundings) -> Instrument: ...


class OnlyRead:
    """Base of the sensors that receive no command and hold no resource."""

    def make_safe(self) -> None:
        """Does nothing: what is only read is always safe."""

    def close(self) -> None:
        """Does nothing: there are no open resources."""


class PlaysBack(OnlyRead):
    """Base of the drivers whose samples come from a recording, as do orientations, rates and temperatures."""


class TakesEffects(OnlyRead):
    """Base of the virtual sensors to whose outputs effects of the catalogue can be added."""


@runtime_checkable
class Addressed(Protocol):
    @classmethod
    def address(cls, parameters: Record) -> str:
        """Address of a real instrument that two runs cannot share, such as a VISA resource or a serial port."""


@runtime_checkable
class Instrument(Protocol):
    """Methods of every instrument."""

    def identify(self) -> Mapping[str, str]:
        """Manufacturer, model, serial number …, as reported by the instrument."""

    def make_safe(self) -> None:
        """Brings the instrument to its safe state (table stopped, chamber to ambient). It can be called repeatedly. It raises
        `InstrumentError` on every failure, because the last caller decides whether a watchdog must act.

        Commands may follow: a run that waits for its operator waits in the safe state."""

    def close(self) -> None: ...


@runtime_checkable
class HoldsOrientation(Protocol):
    def orient(self, attitude: Array) -> float:
        """Starts a move to an attitude (3, 3) at rest; returns the expected time [s]."""

    def holding(self) -> bool:
        """Whether the commanded state is reached and held."""


@runtime_checkable
class Moves(Protocol):
    def begin_motion(self, motion: Motion, seconds: float) -> float:
        """Starts a spin, rock or cycle that will be held for `seconds`; returns the expected time [s] until the motion is steady."""

    def end_motion(self) -> float:
        """Brings the table to rest; returns the expected time [s]."""


@runtime_checkable
class HoldsTemperature(Protocol):
    def set_temperature(self, kelvin: float) -> float:
        """Starts a change to a temperature; returns the expected time [s] until the air has reached it."""

    def at_temperature(self) -> bool: ...


@runtime_checkable
class Foresees(Protocol):
    def foresee(self, segments: Sequence[Segment]) -> None:
        """Checks, before anything moves, whether the instrument can execute a schedule. Raises `InstrumentError` if it cannot."""


@runtime_checkable
class KnowsLength(Protocol):
    def length_of(self, segment: Segment) -> float | None:
        """Time [s] of data for a segment whose dwell is not planned; None if not known. It is called after `foresee`, only for the
        display of progress."""


@runtime_checkable
class HasModes(Protocol):
    def set_mode(self, mode: str) -> float:
        """Starts a change to an operating mode of `SensorModel.modes`; returns the expected time [s] until the change is complete."""


@runtime_checkable
class Readable(Protocol):
    def read(self) -> Mapping[str, float]:
        """A few current readings for the journal (name_unit → value)."""


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive samples: `time` (n,) in s since power-on, strictly increasing, and each channel (n,) in its unit."""

    time: Array
    channels: Mapping[str, Array]


@dataclass(frozen=True, slots=True)
class SummaryChannels:
    """The meaning of the channels of a summary. In a summary, one sample stands for a whole segment: the sample contains the means
    of the channels, and further channels, named here, for their scatter. deviations: channel → channel of the standard deviation of
    the averaged samples, which count as independent. count: channel of the number of samples; seconds: channel of the duration."""

    deviations: Mapping[str, str]
    count: str
    seconds: str


@runtime_checkable
class Summarises(Protocol):
    """A sensor whose stream of a segment is a single sample, the summary. `StreamsSamples.channels` contains the channels of
    `summary`."""

    summary: SummaryChannels


@runtime_checkable
class StreamsSamples(Protocol):
    def channels(self) -> Mapping[str, str]:
        """Channel name → unit, in the order of the recording's columns."""

    def stream(self, segment: Segment) -> Iterator[Block]:
        """The samples of one segment's dwell as blocks of bounded size, as they arrive. The stream ends with the dwell.

        In real time a block is returned at least every second, even without rows if no sample has arrived, so that the bench can be
        supervised between blocks; a sensor that stays silent raises `InstrumentError`."""


@dataclass(frozen=True, slots=True)
class Condition:
    """The current state of an instrument, as measured by it.

    values: live quantities in SI units by name; standard names are `position_error` [rad] (following error, the largest of its
    axes), `rate_error` [rad/s], `temperature` [K]. faults: reasons why the instrument cannot continue, in words (interlock open,
    over-temperature, axis fault); they end the run. doubts: reasons why the samples may be invalid (status bits); the plan defines
    the consequence.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


@runtime_checkable
class Watched(Protocol):
    """An instrument with live readings, which determine settling and are compared with limits during a dwell."""

    def watch(self) -> Condition:
        """The current condition of the instrument, from one short exchange or from the last frame. Called about once a second, also
        between the blocks of a stream. Values that are not known at the moment are omitted."""


@runtime_checkable
class Alive(Protocol):
    """An instrument that can verify its link. A `Watched` instrument verifies its link by its readings and does not need this
    protocol."""

    def heartbeat(self) -> None:
        """Performs the shortest possible exchange; called every few seconds while there is no other communication. Raises
        `InstrumentError` if there is no reply."""


@dataclass(frozen=True, slots=True)
class OwnLimits:
    """Limits that an instrument must enforce itself, independent of the computer. None means that the driver takes the limit from
    its own keys, as it always does for travel.

    rate [rad/s], acceleration [rad/s²], position_error [rad]: limits of every axis. coldest, hottest: K. silence: time [s] without
    communication from the computer after which the instrument makes itself safe.
    """

    rate: float | None = None
    acceleration: float | None = None
    position_error: float | None = None
    coldest: float | None = None
    hottest: float | None = None
    silence: float | None = None


@runtime_checkable
class SelfLimiting(Protocol):
    def limit(self, limits: OwnLimits) -> Sequence[str]:
        """Sets the limits and time-outs that the instrument supports, before the first move and again after a wait in the safe
        state. Returns a line for the journal for each limit set. Raises `InstrumentError` if a supported limit cannot be set."""


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """Frames of one segment's stream. lost: frames missing according to the counter; corrupt: frames with a wrong checksum;
    overflowed: frames dropped because the computer did not read them in time; skipped_bytes: bytes between frames. details: further
    values (latency_s, clock_skew_ppm …)."""

    received: int = 0
    lost: int = 0
    corrupt: int = 0
    overflowed: int = 0
    skipped_bytes: int = 0
    details: Mapping[str, float] = field(default_factory=dict)


@runtime_checkable
class Counting(Protocol):
    def counts(self) -> FrameCounts:
        """Frame counts of the segment that is being streamed, or was streamed last."""


@runtime_checkable
class Remarking(Protocol):
    def remarks(self) -> Sequence[str]:
        """Unusual events since the last call, one line each, for the journal (a repeated exchange, a reopened link)."""


@runtime_checkable
class Resumable(Protocol):
    """A simulated instrument whose state is restored after a crash. Real instruments have nothing to restore."""

    def checkpoint(self) -> Mapping[str, Json]:
        """The state as JSON data."""

    def restore(self, state: Mapping[str, Json]) -> None: ...

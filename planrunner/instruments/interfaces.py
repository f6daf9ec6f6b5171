"""Defines what instruments can do, as small protocols. A driver implements the protocols that apply to its instrument.

A driver is a class found through the entry-point group `planrunner.instruments`:

    class MyTable:
        role = "table"                       # table, chamber, sensor or monitor
        Parameters = MyTableParameters       # a Record: its keys in the bench file

        @classmethod
        def model(cls, parameters) -> TableModel      # known without connecting
        @classmethod
        def connect(cls, parameters, surroundings) -> MyTable

Commands return at once and state how many seconds they will probably take. The executor waits on its clock, and then queries
`holding()`. Connecting does not count as a command. If an instrument was connected but received no command, closing it leaves it
unchanged. Every failure is an `InstrumentError`; the executor then calls `make_safe` on every instrument that it commanded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.base.findings import Finding, Findings
from planrunner.base.progress import Announce
from planrunner.instruments.models import ChamberModel, SensorModel, TableModel
from planrunner.physics.earth import Site
from planrunner.plan.kinds import Record
from planrunner.plan.schedule import Motion, Segment

P = TypeVar("P", bound=Record)


class InstrumentError(Exception):
    """Reports that an instrument did not execute a request. The message states the instrument, the problem, and what to check."""


class UnservedError(InstrumentError):
    """Reports that an instrument cannot execute a schedule. `findings`: all reasons."""

    def __init__(self, findings: Sequence[Finding]):
        self.findings = tuple(findings)
        super().__init__("; ".join(finding.message for finding in findings))

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.findings,)


class Clock(Protocol):
    """Gives the time to functions that must work in the same way with simulated and with real time."""

    def now(self) -> float:
        """Returns the time since the start of the run, s."""

    def sleep(self, seconds: float) -> None: ...


class RunClock(Clock, Protocol):
    """The clock of a run. The clock can be set when a run is resumed, and it calls a function while it sleeps."""

    def set(self, seconds: float) -> None:
        """Sets the time from which the clock continues when a run is resumed."""

    def attend(self, callback: Callable[[], bool] | None) -> None:
        """Sets a function that is called during sleeps; if it returns True, the sleep ends. Passing None removes the function."""


@runtime_checkable
class Hastens(Protocol):
    """A clock that runs `speed` times as fast as real time. Benches use this clock if their simulated instruments run at this
    speed."""

    speed: float


@runtime_checkable
class Closes(Protocol):
    """An object that holds resources, such as a stream of samples that is not read to its end."""

    def close(self) -> None: ...


@dataclass(slots=True)
class Surroundings:
    """Contains the data that a driver needs to connect: the clock, the site, the folder that must contain all data files, the seed
    of the run, and the other instruments by role.

    `world`: state that the drivers of a virtual bench share; real drivers ignore it. `real_time`: True if the clock shows real
    time; simulated and played-back samples then come in blocks of about a second. `notice`: function that receives the progress of
    long work before the run begins, such as the examination of a recording.
    """

    clock: Clock
    site: Site
    data_root: Path | None = None
    seed: int = 0
    real_time: bool = False
    world: object = None
    notice: Announce | None = None
    instruments: dict[str, Instrument] = field(default_factory=dict)


class Driver(Protocol[P]):
    """Lists the class methods that a driver must have; a driver may be a plug-in. P is the record with the driver's keys in a bench
    file."""

    role: str
    Parameters: type[P]

    @classmethod
    def model(cls, parameters: P) -> TableModel | ChamberModel | SensorModel | None: ...
    @classmethod
    def connect(cls, parameters: P, surroundings: Surroundings) -> Instrument: ...


class OnlyRead:
    """Base class for sensors that receive no commands and hold no resources."""

    def make_safe(self) -> None:
        """Does nothing, because an instrument that is only read is always safe."""

    def close(self) -> None:
        """Does nothing, because there are no open resources."""


class PlaysBack(OnlyRead):
    """Base class for drivers that play back a recording. Samples, orientations, rates and temperatures all come from the recording."""

    def look_over(self, segments: Sequence[Segment], log: Findings) -> None:
        """Examines the recording before the segments are played back, and adds errors and warnings to `log`. This default method
        calls `foresee`, and adds the reasons of an `UnservedError` to `log`."""
        if isinstance(self, Foresees):
            try:
                self.foresee(segments)
            except UnservedError as error:
                log.extend(error.findings)


class TakesEffects(OnlyRead):
    """Base class for virtual sensors whose outputs can be changed by effects of the catalogue."""


@runtime_checkable
class Addressed(Protocol):
    @classmethod
    def address(cls, parameters: Record) -> str:
        """Returns the address of a real instrument, such as a VISA resource or a serial port. Two runs cannot use the same address
        at the same time."""


@runtime_checkable
class Instrument(Protocol):
    """The methods that every instrument has."""

    def identify(self) -> Mapping[str, str]:
        """Returns manufacturer, model, serial number and further details, as the instrument reports them."""

    def make_safe(self) -> None:
        """Brings the instrument to its safe state (table stopped, chamber at ambient temperature). The method can be called
        repeatedly. The method raises `InstrumentError` after every failure, because the caller must then decide whether a watchdog
        has to act.

        Further commands may follow, because a run that waits for its operator waits in the safe state and then continues."""

    def close(self) -> None: ...


@runtime_checkable
class HoldsOrientation(Protocol):
    def orient(self, attitude: Array) -> float:
        """Starts a move to the attitude (3, 3), in which the table comes to rest; returns the expected time [s]."""

    def holding(self) -> bool:
        """Returns True if the commanded state has been reached and is held."""


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
        """Checks, before anything moves, whether the instrument can execute a schedule. Raises `InstrumentError` if the instrument
        cannot perform the segments."""


@runtime_checkable
class KnowsLength(Protocol):
    def length_of(self, segment: Segment) -> float | None:
        """Returns the time [s] for which data exist in a segment whose dwell is not planned; None if this is not known. The method
        is called after `foresee`, and only to display progress."""


@runtime_checkable
class HasModes(Protocol):
    def set_mode(self, mode: str) -> float:
        """Starts a change to one of the operating modes in `SensorModel.modes`; returns the expected time [s] until the change is
        complete."""


@runtime_checkable
class Readable(Protocol):
    def read(self) -> Mapping[str, float]:
        """Returns a few current readings for the journal. A key has the form `name_unit`: the name of a reading, followed by its
        unit."""


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive samples. `time`: array of shape (n,), s since power-on, strictly increasing. The values (n,) of each channel are
    in the channel's unit."""

    time: Array
    channels: Mapping[str, Array]


@dataclass(frozen=True, slots=True)
class SummaryChannels:
    """States the meaning of the channels of a summary. A summary is one sample that represents a whole segment. A summary contains
    the means of the channels and, in further channels, their scatter. The attributes name these further channels.

    `deviations`: for each channel, the further channel with the standard deviation of the averaged samples; these samples are
    treated as independent. `count`: channel with the number of samples. `seconds`: channel with the duration.
    """

    deviations: Mapping[str, str]
    count: str
    seconds: str


@runtime_checkable
class Summarises(Protocol):
    """A sensor that yields only one sample for each segment, the summary. `StreamsSamples.channels` includes the channels that
    `summary` names."""

    summary: SummaryChannels


@runtime_checkable
class StreamsSamples(Protocol):
    def channels(self) -> Mapping[str, str]:
        """Maps the name of each channel to its unit, in the order of the recording's columns."""

    def stream(self, segment: Segment) -> Iterator[Block]:
        """Yields the samples of one segment's dwell as they arrive, in blocks of bounded size. The stream ends with the dwell.

        In real time, a block is yielded at least every second, so that the bench can be supervised between blocks. If no sample has
        arrived, this block has no rows. If the sensor sends nothing for too long, `InstrumentError` is raised."""


@dataclass(frozen=True, slots=True)
class Condition:
    """Describes the current state of an instrument, as the instrument measures it.

    `values`: maps the name of each live quantity to its value in SI units. Standard names are `position_error` [rad] (following
    error, the largest of all axes), `rate_error` [rad/s] and `temperature` [K]. `faults`: reasons why the instrument cannot
    continue, in words (interlock open, over-temperature, axis fault); a fault ends the run. `doubts`: reasons why the samples may
    be invalid (status bits); the plan defines what then happens.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


@runtime_checkable
class Watched(Protocol):
    """An instrument with live readings. The readings determine when the instrument has settled, and are compared with limits during
    a dwell."""

    def watch(self) -> Condition:
        """Returns the current condition of the instrument, which is determined by one short exchange or from the last frame. The
        method is called about once a second, also between the blocks of a stream. Values that are unknown at the moment are
        omitted."""


@runtime_checkable
class Alive(Protocol):
    """An instrument that can check its link. A `Watched` instrument does not need this protocol, because its readings check the
    link."""

    def heartbeat(self) -> None:
        """Makes the shortest possible exchange with the instrument. The method is called every few seconds if there is no other
        communication. Raises `InstrumentError` if there is no reply."""


@dataclass(frozen=True, slots=True)
class OwnLimits:
    """Contains the limits that an instrument must enforce by itself, independently of the computer.

    None means that the driver uses the limit in its own keys. Limits of travel always come from these keys. `rate` [rad/s],
    `acceleration` [rad/s²] and `position_error` [rad] are limits of every axis. `coldest` and `hottest` are limits of the
    temperature [K]. `silence`: time [s] without communication from the computer after which the instrument makes itself safe.
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
        """Sets the limits and time-outs that the instrument supports. The method is called before the first move, and again after a
        wait in the safe state. Returns one line for the journal for each limit that was set. Raises `InstrumentError` if a
        supported limit cannot be set."""


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """Contains counts of the frames in the stream of one segment.

    `lost`: frames that are missing according to the counter. `corrupt`: frames with a wrong checksum. `overflowed`: frames that
    were lost because the computer did not read them in time. `skipped_bytes`: bytes between frames. `details`: maps names such as
    latency_s or clock_skew_ppm to further values.
    """

    received: int = 0
    lost: int = 0
    corrupt: int = 0
    overflowed: int = 0
    skipped_bytes: int = 0
    details: Mapping[str, float] = field(default_factory=dict)


@runtime_checkable
class Counting(Protocol):
    def counts(self) -> FrameCounts:
        """Returns the counts of the frames in the present segment or, between segments, in the last segment."""


@runtime_checkable
class Remarking(Protocol):
    def remarks(self) -> Sequence[str]:
        """Returns remarks on unusual events since the last call, such as a repeated exchange or a reopened link. Each remark is one
        line of text for the journal."""


@runtime_checkable
class Resumable(Protocol):
    """A simulated instrument that can continue from a saved state after a crash. A real instrument has no state to restore."""

    def checkpoint(self) -> Mapping[str, Json]:
        """Returns the state as JSON data."""

    def restore(self, state: Mapping[str, Json]) -> None: ...

"""Describes the schedule: an ordered list of the segments of a plan, as a certain bench executes them. Each segment is a state to
reach and hold.

Segments are pure data in SI units with radians. `planrunner.bench.scheduling` makes the schedule, and the executor executes it.
Estimators, reports and design studies read the schedule.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Mark


@dataclass(frozen=True, slots=True)
class Rest:
    """The motion of a segment at rest."""


@dataclass(frozen=True, slots=True)
class Spin:
    """A constant rate [rad/s] about a site direction `about` (ENU unit vector)."""

    rate: float
    about: tuple[float, float, float] = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Rock:
    """Sinusoidal rocking of the table's rings: angle_i = amplitude·sin(2π·frequency·(t − steady) + phases[i]) [rad], where t is the
    time since the record began [s].

    The rocking has its full amplitude for `duration` s. The rocking fades in during the period that ends at `steady`, and fades out
    during the period that begins at `steady` + `duration`. `phases`: one phase for each ring, the outermost first. `delay`: time at rest
    at the beginning of the record, s; if it is zero, the rocking fades in before the record begins.
    """

    amplitude: float
    frequency: float
    phases: tuple[float, ...]
    duration: float
    delay: float = 0.0

    @property
    def period(self) -> float:
        """Returns the period of the rocking [s]."""
        return 1 / self.frequency

    @property
    def lead_in(self) -> float:
        """Returns the time [s] from the command to the beginning of the record."""
        return 0.0 if self.delay else self.period

    @property
    def steady(self) -> float:
        """Returns the time [s] from the beginning of the record until the rocking has its full amplitude."""
        return self.delay + self.period if self.delay else 0.0

    @property
    def over(self) -> float:
        """Returns the time [s] from the beginning of the record until the table is at rest again."""
        return self.steady + self.duration + self.period


@dataclass(frozen=True, slots=True)
class Move:
    """Describes one move of a cycle: a rotation by `turn` [rad] from one named position to another. `turn` is positive for a
    right-handed rotation about the axis."""

    start: str
    turn: float
    end: str


@dataclass(frozen=True, slots=True)
class Cycle:
    """Turns and stops that are repeated during the dwell: the table stops at each position for `stop` [s], and then turns at the
    rate `rate` [rad/s]."""

    positions: Mapping[str, float]
    moves: tuple[Move, ...]
    rate: float
    stop: float


@dataclass(frozen=True, slots=True)
class RecordedMotion:
    """Describes a motion that was not commanded to a table, but that channels of the recording show.

    At least one of `angle`, `attitude`, `rates` and `forces` is stated. `angle`: channel of the encoder of an axis along the site
    direction `about`; the angle is zero in the segment's orientation. `attitude`: four channels that form a unit quaternion from
    the sensor's axes to East-North-Up, with the real part first. `rates`: three channels of angular rate along the sensor's x, y
    and z. `forces`: three channels of specific force along the sensor's x, y and z. `averaging`: time over which outputs and motion
    are averaged, s; 0 if the samples are used as they are.
    """

    angle: str = ""
    about: tuple[float, float, float] = (0.0, 0.0, 1.0)
    attitude: tuple[str, ...] = ()
    rates: tuple[str, ...] = ()
    forces: tuple[str, ...] = ()
    averaging: float = 0.0

    @property
    def channels(self) -> tuple[str, ...]:
        """Returns all channels that show the motion."""
        return (*([self.angle] if self.angle else []), *self.attitude, *self.rates, *self.forces)


Motion = Rest | Spin | Rock | Cycle | RecordedMotion


@dataclass(frozen=True, slots=True)
class Stability:
    """States the condition under which readings count as settled.

    `limits`: maps each reading to its largest permitted value in SI units, for example `temperature_drift` to a value in K/s.
    `duration`: time [s] for which the readings must stay within the limits without interruption. `patience`: time [s] after which
    the readings should have settled.
    """

    limits: Mapping[str, float]
    duration: float
    patience: float


@dataclass(frozen=True, slots=True)
class Watch:
    """Contains the conditions that must hold while a segment is recorded.

    `limits`: largest permitted value of each reading, as in `Stability`. `lost`, `corrupt`: permitted fractions of lost and of
    corrupt frames; None if any fraction is permitted. `doubts`: True if a limit also counts as exceeded when an instrument reports
    doubts about its samples. `retakes`: how often the segment may be repeated after a limit was exceeded.
    """

    limits: Mapping[str, float] = field(default_factory=dict)
    lost: float | None = None
    corrupt: float | None = None
    doubts: bool = False
    retakes: int = 0


@dataclass(frozen=True, slots=True)
class Segment:
    """One state to reach and hold while recording.

    `attitude`: array of shape (3, 3), attitude at the start of the motion; its rows are the sensor's x, y, z axes in East-North-Up of the
        site, so that v_sensor = attitude @ v_site. `attitude` is None if the plan states `unknown`.
    `temperature`: stated temperature [K]; None for a ramp.
    `ramp_to`: temperature [K] at the end of a ramp; None if the temperature does not ramp.
    `kept_temperature`: temperature [K] at which the chamber has kept the sensor since an earlier segment. None if no earlier
    segment states a temperature, or if the bench plays back a recording.
    `supply_voltage`, `ambient_pressure`: supply voltage [V] and ambient pressure [Pa]; None for a quantity that the plan does not state.
    `soak`, `settle`: waiting times before the dwell, s.
    `dwell`: duration of the dwell, s; None if the dwell lasts as long as the recording that is played back.
    `transition`: planned time to reach the state (moves, spin-up, temperature), s.
    `start`: planned time from the beginning of the run to the beginning of the dwell, s.
    `sample_rate`: sample rate, Hz; None for the sensor's own rate.
    `mode`: operating mode of the sensor; None if the plan does not set it.
    `on_break`: what happens to a segment that a crash interrupts: 'retake' repeats it, 'keep' keeps the recorded part.
    `stable`, `soaked`: conditions of stability under which the waits `settle` and `soak` end; None for a wait of fixed length.
    `watch`: conditions that are checked during the dwell.
    `prompts`: prompts to the operator before the segment.
    `marks`: positions of the segment's keys in the plan file, for messages.
    """

    index: int
    label: str
    attitude: Array | None
    orientation: str
    motion: Motion
    dwell: float | None
    settle: float = 0.0
    soak: float = 0.0
    temperature: float | None = None
    ramp_to: float | None = None
    kept_temperature: float | None = None
    supply_voltage: float | None = None
    ambient_pressure: float | None = None
    sample_rate: float | None = None
    mode: str | None = None
    on_break: str = "retake"
    stable: Stability | None = None
    soaked: Stability | None = None
    watch: Watch | None = None
    prompts: tuple[str, ...] = ()
    transition: float = 0.0
    start: float = 0.0
    marks: Mapping[str, Mark] = field(default_factory=dict, compare=False, repr=False)

    @property
    def waiting(self) -> float:
        """Returns the planned time [s] from reaching the state to the beginning of the dwell."""
        return self.soak + self.settle

    @property
    def seconds(self) -> float:
        """Returns the planned time of the segment, s. A dwell of unknown length counts as zero."""
        return self.transition + self.waiting + (self.dwell or 0.0)

    @property
    def begins_at(self) -> float | None:
        """Returns the temperature [K] at the beginning of the dwell: the stated temperature, otherwise the temperature at which the
        chamber keeps the sensor; None if neither of them is known."""
        return self.kept_temperature if self.temperature is None else self.temperature

    @property
    def rate(self) -> float:
        """Returns the commanded rate [rad/s]; zero if the table does not spin."""
        return self.motion.rate if isinstance(self.motion, Spin) else 0.0


@dataclass(frozen=True, slots=True)
class Schedule:
    segments: tuple[Segment, ...]
    total: float
    """Planned time from the first move to the safe state, s."""

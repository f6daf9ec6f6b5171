"""The schedule: what a plan becomes on a bench, an ordered list of segments, each a state to reach and hold.

Pure data in SI units with radians. `planrunner.bench.scheduling` makes it; the executor carries it out; estimators, reports and
design look at it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Mark

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Rest:
    """No motion."""


@dataclass(frozen=True, slots=True)
class Spin:
    """A constant rate [rad/s] about a site direction `about` (ENU unit vector)."""

    rate: float
    about: tuple[float, float, float] = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Rock:
    """angle_i = amplitude·sin(2π·frequency·(t − steady) + phases[i]) [rad] on the table's rings, outermost first, for `duration` s.

    t: s since the record began. The rocking fades in over a period before `steady` and fades out over a period after `steady` + `duration`.
    delay: s for which the table stands still at the beginning of the record; without one, the rocking fades in before the record begins.
    """

    amplitude: float
    frequency: float
    phases: tuple[float, ...]
    duration: float
    delay: float = 0.0

    @property
    def period(self) -> float:
        """Seconds."""
        return 1 / self.frequency

    @property
    def lead_in(self) -> float:
        """Seconds from the command to the beginning of the record."""
        return 0.0 if self.delay else self.period

    @property
    def steady(self) -> float:
        """Seconds from the beginning of the record until the rocking has its full amplitude."""
        return self.delay + self.period if self.delay else 0.0

    @property
    def over(self) -> float:
        """Seconds from the beginning of the record until the table stands still again."""
        return self.steady + self.duration + self.period


@dataclass(frozen=True, slots=True)
class Move:
    """One move of a cycle: from a named position by `turn` [rad, positive about the axis] to another."""

    start: str
    turn: float
    end: str


@dataclass(frozen=True, slots=True)
class Cycle:
    """Turns and stops repeated over the dwell: stop `stop` s at each position, then turn at `rate` rad/s."""

    positions: Mapping[str, float]
    moves: tuple[Move, ...]
    rate: float
    stop: float


Motion = Rest | Spin | Rock | Cycle


@dataclass(frozen=True, slots=True)
class Stability:
    """limits: reading → largest value, SI, such as `temperature_drift` in K/s. duration: s at a stretch within them; patience: s after
    which the readings should have settled."""

    limits: Mapping[str, float]
    duration: float
    patience: float


@dataclass(frozen=True, slots=True)
class Watch:
    """What must hold while a segment records. limits: as for `Stability`; lost, corrupt: share of the frames, None: any; doubts:
    whether an instrument's doubts about its samples count as a passed limit; retakes: how often the segment is then taken again."""

    limits: Mapping[str, float] = field(default_factory=dict)
    lost: float | None = None
    corrupt: float | None = None
    doubts: bool = False
    retakes: int = 0


@dataclass(frozen=True, slots=True)
class Segment:
    """One state to reach and hold while recording.

    attitude: shape (3, 3), rows are the sensor's x, y, z axes in site East-North-Up, so v_sensor = attitude @ v_site; at the start
        of the motion; None where the plan says `unknown`.
    temperature, ramp_to: K. soak, settle, dwell, transition, start: s; `dwell` is None for "as long as the recording lasts";
        `transition` is the planned time to get there (moves, spin-up, temperature), `start` the planned beginning of the dwell since
        the run began. sample_rate: Hz, None for the sensor's own.
    mode: of the sensor; None where the plan does not say.
    on_break: what happens to a segment cut short by a crash: 'retake' it or 'keep' what there is.
    stable, soaked: what must have settled after settling and soaking, where not the time alone says so; watch: what must hold during
        the dwell; prompts: what the operator is asked before the segment.
    marks: where the plan says so, by key, for messages.
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
    def rate(self) -> float:
        """The commanded rate [rad/s]; zero unless the table spins."""
        return self.motion.rate if isinstance(self.motion, Spin) else 0.0


@dataclass(frozen=True, slots=True)
class Schedule:
    segments: tuple[Segment, ...]
    total: float
    """Planned time from the first move to the safe state, s."""

"""Describes a design study: its options, the result of its search, and its printed output.

Positions, rates and cycles are three kinds of study. Each kind has its own search (`planrunner.tasks.design_positions` and so on),
whose result is a `Found…`. A module such as `planrunner.reporting.positions_study` adds facts, tables and pictures to this result,
and so makes a `Study`. All further steps are the same for all kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import field

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings
from planrunner.design.cycles import FoundCycle, StudiedCycle
from planrunner.design.efficiency import Efficiency, Merit
from planrunner.design.places import Place, Sight
from planrunner.estimators.interface import Coefficient, Design
from planrunner.estimators.tables import Plot, Table
from planrunner.physics.kinematics import TableAxis
from planrunner.plan.schedule import Schedule, Segment

SearchProgress = Callable[[str, float], None]
"""Function that is called with the stage of a search and the completed fraction of this stage."""


@dataclass(frozen=True, slots=True)
class Asked:
    """Options of a study; each kind of study uses only its own options.

    All kinds. `estimate`: name of the estimate; by default, the first estimate that can be designed. `criterion`: D, A, G or I; for
    rates, D or A. `time`: duration [s] of the whole plan, within which the dwells are chosen.

    Positions. `output`: name of the output for which the positions are designed; required if the outputs have different design
    matrices. `orientations`: the set of positions that is written into the plan (free, cardinal or planned). `restarts`, `seed`:
    number of restarts and seed of the search over free orientations.

    Rates. `rates`: True to design the rates, even if positions or cycles could be designed. `line_only`: True to design the rates
    only for the terms of the estimator, without the additional terms |rate| and rate³. `keep_lowest`: True to keep the lowest
    planned rate, because threshold and resolution are determined at this rate.

    Cycles. `segment`: label of the segment with the cycle, by default the first such segment. `order`: the cycle that is written
    into the plan (free or same).
    """

    estimate: str | None = None
    criterion: str = "D"
    time: float | None = None
    output: str | None = None
    orientations: str = "free"
    restarts: int = 8
    seed: int = 0
    rates: bool = False
    line_only: bool = False
    keep_lowest: bool = True
    segment: str | None = None
    order: str = "free"


@dataclass(frozen=True, slots=True)
class PositionSet:
    """One set of positions, in the order of the plan's labels.

    `of_found`: efficiency relative to the best set found among all reachable orientations. `of_bound`: efficiency relative to the
    bound of all continuous designs. `of_cardinal`: for a cardinal set, efficiency relative to the best cardinal set found.
    `schedule`: the plan with this set. `designs`: the expected results of the plan's estimates.
    """

    attitudes: tuple[Array, ...]
    texts: tuple[str, ...]
    merit: Merit
    of_found: Efficiency | None
    of_bound: Efficiency
    of_cardinal: Efficiency | None
    schedule: Schedule
    designs: Mapping[str, Design]

    @property
    def residual_ratios(self) -> dict[str, float]:
        """Maps `estimate.ratio_…` to the expected ratio of two residual sums of squares, for every comparison in the plan."""
        return {
            f"{estimate}.{key}": float(value)
            for estimate, design in self.designs.items()
            for key, value in design.extra.get("ratios", {}).items()
        }


@dataclass(frozen=True, slots=True)
class Bounds:
    """States how good a set of positions can be at best. `merit`: for each criterion, a bound that no set with this number of
    positions can improve on. `certificate`: largest variance of a predicted output for the D-optimal continuous design; it equals
    the number of terms if the optimum is exact."""

    merit: Merit
    certificate: float


@dataclass(frozen=True, slots=True)
class FoundPositions:
    """The result of a design of positions.

    `sets`: the sets that exist, by their names `planned`, `cardinal` and `free`. `best`: the best values that were found, for
    `free` and for `cardinal`. `bounds`: the bounds of the criteria, also for `free` and for `cardinal`. `dwells`: dwells of the
    chosen set, s; empty if they were not optimised. `dwell_gain`: efficiency of equal dwells, relative to the optimised `dwells`.
    `text`: the plan with the chosen set.
    """

    sight: Sight
    places: tuple[Place, ...]
    asked: Asked
    sets: Mapping[str, PositionSet]
    best: Mapping[str, Merit]
    bounds: Mapping[str, Bounds]
    search: str
    dwells: tuple[float, ...]
    dwell_gain: float
    text: str

    @property
    def chosen(self) -> PositionSet:
        return self.sets[self.asked.orientations]


@dataclass(frozen=True, slots=True)
class RateSet:
    """A set of rates with their dwells.

    `rates`: array of shape (n,) in rad/s, magnitudes of the rates, largest first. `dwells`: array of shape (n,) in s, dwell at each
    rate. `loss`: −ln|M| or tr M⁻¹, for terms divided by their magnitudes.

    `efficiency`: efficiency relative to the best rates found for the same number of observations. `per_hour`: efficiency relative
    to the best use of the same time. `variance`: variance of a predicted output at each rate in `FoundRates.course`. The unit is
    the variance of one observation at the largest rate. `predicted`: predicted results of the plan with these rates. `total`:
    duration [s] of this plan.
    """

    rates: tuple[float, ...]
    dwells: tuple[float, ...]
    loss: float
    efficiency: float
    per_hour: float
    variance: Array
    predicted: tuple[Coefficient, ...]
    total: float


@dataclass(frozen=True, slots=True)
class FoundRates:
    """The result of a design of rates.

    `sets`: the sets of rates named `planned` and `best`. `course`: the rates [rad/s] for which `RateSet.variance` is given.
    `excess`: the ratio of the largest derivative of the criterion to the mean derivative, minus 1; 0 at the optimum. `repeats`:
    number of repeats of each rate in the plan. `text`: the plan with the best rates.
    """

    estimate: str
    output: str
    terms: tuple[str, ...]
    asked: Asked
    sets: Mapping[str, RateSet]
    course: Array
    excess: float
    repeats: int
    text: str


@dataclass(frozen=True, slots=True)
class FoundCycles:
    """The result of a design of rotation cycles.

    `cycles`: the cycles named `planned` and, if found, `same order` and `free order`. `searches`: the results of the searches, by
    the name of the cycle. `reasons`: why a search was not possible, by the name of the cycle. `text`: the plan with the chosen
    cycle; empty if this cycle was not found.
    """

    segment: Segment
    axis: TableAxis
    cycles: Mapping[str, StudiedCycle]
    searches: Mapping[str, FoundCycle]
    reasons: Mapping[str, str]
    chosen: str
    text: str


@dataclass(frozen=True, slots=True)
class Subject:
    """States which plan a study is about, on which bench and at which site.

    `title`: title of the plan. `facts`: names of plan, bench and site. `file`: the plan file. `findings`: the findings of the check
    of the plan.
    """

    title: str
    facts: Mapping[str, str]
    file: str
    findings: Findings


@dataclass(frozen=True, slots=True)
class Pose:
    """One orientation to be drawn. `attitude`: array of shape (3, 3), sensor axes in site axes. `words`: the orientation as the
    plan writes it."""

    label: str
    attitude: Array
    words: str


@dataclass(frozen=True, slots=True)
class Study:
    """The output of a study.

    `varied`: name of the designed quantity, such as `positions`. `heading`: heading in one line. `poses`: rows of orientations to
    be drawn, by the title of the row. `footer`: explanation of the numbers. `data`: all results as plain data. `text`: the plan
    with the chosen design; empty if no design was chosen. `missing`: the reason why `text` is empty.
    """

    subject: Subject
    varied: str
    heading: str
    facts: Mapping[str, str]
    tables: tuple[Table, ...]
    notes: tuple[str, ...]
    footer: str
    data: Mapping[str, object]
    text: str
    missing: str = ""
    plots: tuple[Plot, ...] = ()
    poses: Mapping[str, tuple[Pose, ...]] = field(default_factory=dict)

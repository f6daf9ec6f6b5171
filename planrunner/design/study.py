"""A design study: its options, the result of its search, and its output.

Positions, rates and cycles are three kinds of study. Each kind has a search (`planrunner.tasks.design_positions` and so on), whose
result is a `Found…`. Modules such as `planrunner.reporting.positions_study` add its facts, tables and pictures, and so make a
`Study` of it. All further steps are the same for all kinds: one task, one command, one page.
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
"""Called with the stage of a search and the part of it that is done."""


@dataclass(frozen=True, slots=True)
class Asked:
    """Options of a study; each kind uses only its own options. estimate: name of the estimate; by default, the first estimate that
    can be designed. criterion: D, A, G or I; for rates, D or A. time: duration of the whole plan, s; dwells are allotted within it.

    For positions, output: name of the output to design for, if outputs differ; orientations: the set to put into the plan, free,
    cardinal or planned; restarts, seed: number of restarts and seed of the search over free orientations. For rates, rates: True
    designs the rates even if something else could be designed; line_only: True uses only the estimator's own terms; keep_lowest:
    True keeps the lowest planned rate, at which threshold and resolution are determined. For cycles, segment: label of the segment,
    by default the first one with a cycle; order: the cycle to put into the plan, free or same.
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
    """One set of positions in the order of the plan's labels. of_found: efficiency relative to the best set found among all
    reachable orientations; of_bound: efficiency relative to the continuous bound; of_cardinal: for cardinal sets, efficiency
    relative to the best cardinal set found. schedule: the plan with this set; designs: the expected results of its estimates."""

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
        """Maps `estimate.ratio_…` to the expected ratio of residual sums of squares, for every comparison in the plan."""
        return {
            f"{estimate}.{key}": float(value)
            for estimate, design in self.designs.items()
            for key, value in design.extra.get("ratios", {}).items()
        }


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds of the criteria. merit: for each criterion, the value that no set with this number of positions can improve on.
    certificate: largest variance of a predicted output for the D-optimal continuous design; exactly at the optimum, it equals the
    number of terms."""

    merit: Merit
    certificate: float


@dataclass(frozen=True, slots=True)
class FoundPositions:
    """Result of a design of positions. sets: the sets by name, `planned`, `cardinal` and `free`, as far as they exist; best,
    bounds: the best values found and the bounds, by domain (free, cardinal). dwells: dwells of the chosen set, s, empty if they
    were not optimised; dwell_gain: efficiency of equal dwells relative to the optimised `dwells`. text: the plan with the chosen
    set."""

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
    """A set of rates with their dwells. rates: (n,), rad/s, magnitudes of the rates, largest first; dwells: (n,), s. loss: −ln|M|
    or tr M⁻¹ of the scaled terms.

    efficiency: efficiency relative to the best rates found, for the same number of observations; per_hour: efficiency relative to
    the best use of the same time. variance: variance of a predicted output at each rate of `FoundRates.course`, in units of the
    variance of one observation at the largest rate. predicted, total: predicted results of the plan with these rates, and its
    duration [s].
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
    """Result of a design of rates. sets: `planned` and `best`. course: rates [rad/s] at which variances are given. excess: remaining
    distance from the certified bound. repeats: number of repeats of each rate in the plan. text: the plan with the best rates."""

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
    """Result of a design of rotation cycles. cycles: `planned` and, if found, `same order` and `free order`. searches: the results
    of the searches, by the name of the cycle; reasons: why a search was not possible, by the name of the cycle. text: the plan with
    the chosen cycle, empty if no such cycle was found."""

    segment: Segment
    axis: TableAxis
    cycles: Mapping[str, StudiedCycle]
    searches: Mapping[str, FoundCycle]
    reasons: Mapping[str, str]
    chosen: str
    text: str


@dataclass(frozen=True, slots=True)
class Subject:
    """Subject of the study. title: title of the plan; facts: plan, bench and site by name; file, findings: the file and the
    findings of the plan as it was checked."""

    title: str
    facts: Mapping[str, str]
    file: str
    findings: Findings


@dataclass(frozen=True, slots=True)
class Pose:
    """One orientation for drawing. attitude: (3, 3), sensor axes in site axes; words: the orientation as the plan writes it."""

    label: str
    attitude: Array
    words: str


@dataclass(frozen=True, slots=True)
class Study:
    """Output of a study. varied: the designed quantity, such as `positions`; heading: heading in one line; poses: rows of drawn
    orientations, by the title of the row; footer: explanation of the numbers; data: all results as plain data. text: the plan with
    the chosen design; empty if there is none, and `missing` gives the reason."""

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

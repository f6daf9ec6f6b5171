"""Describes a plan as data: the records of the language. Each key has a description and an example.

The code that reads plans, the JSON Schema in `schemas/` and the key reference in `docs/` are all derived from these records.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import Literal

from planrunner.base import plugins
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, InputError, Mark
from planrunner.plan import source
from planrunner.plan.kinds import (
    CHANNEL,
    Choice,
    Kind,
    ListOf,
    MapOf,
    Number,
    Plugged,
    QuantityOf,
    Record,
    RecordOf,
    Schema,
    Text,
    WordOr,
    key,
    optional,
)
from planrunner.plan.quantity import SYMMETRIC, Quantity, QuantityError, is_symmetric, parse_symmetric
from planrunner.plan.segments import (
    NAME,
    SegmentKind,
    SegmentSpec,
    State,
)
from planrunner.plan.selection import Detection, SelectionKind
from planrunner.plan.units import DIMENSIONS, EXAMPLES

NOMINAL_TERMS = (
    "gyro_bias",
    "gyro_scale_factor",
    "gyro_misalignment",
    "earth_rate",
    "accel_bias",
    "accel_scale_factor",
    "accel_misalignment",
)
"""Terms that a simulation can fit: for each triad a bias and a 3 by 3 matrix, and the known rotation of the Earth."""


class DiagnosisSpec(Record):
    """Declares how a recording of the plan is diagnosed."""

    nominal: tuple[str, ...] = key(
        ListOf(Choice(NOMINAL_TERMS)),
        "Terms of the simulation that are fitted to the recording. A term that is left out is a possible explanation of the gap, "
        "like any other effect.",
        ["accel_bias"],
        default=NOMINAL_TERMS,
    )
    outputs: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=1),
        "Outputs to analyse, such as those of one of two sensors in a recording; by default those of `sensor`.",
        ["bno_accel_x", "bno_accel_y", "bno_accel_z"],
        default_factory=tuple,
    )
    segments: tuple[str, ...] | Detection = key(
        SelectionKind(),
        "Labels of the segments to diagnose, or patterns with the wildcards * and ?. For a sensor that is tumbled by hand in unknown "
        "orientations, write {detect: still}.",
        "P*",
        default=("*",),
    )


class MonteCarloSpec(Record):
    """Declares how the Monte Carlo draws are made."""

    digits: int = key(
        Number(1, 2, integer=True),
        "Number of significant digits of the standard uncertainty; the tolerance is half a unit of the last digit.",
        1,
        default=1,
    )
    draws: int = key(
        Number(20_000, 10_000_000, integer=True),
        "Largest number of draws, if the results do not stabilise earlier.",
        1_000_000,
        default=1_000_000,
    )
    seed: int = key(Number(0, 2**31, integer=True), "Seed of the draws.", 1, default=1)


USUAL = MonteCarloSpec(digits=1, draws=1_000_000, seed=1)


PERSON = r"[A-Za-z][A-Za-z0-9_.@-]{0,59}"
"""Name of a person or a key in the key ring of a laboratory."""
FILE_NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}"


class Sensor(Record):
    """Describes the sensor under test, as the plan expects it."""

    kind: str = key(
        Text(NAME, "a sensor kind"),
        "Kind of sensor that the plan is for; the bench must have a sensor of this kind.",
        "flexure-gyro",
    )
    outputs: tuple[str, ...] = key(
        ListOf(Text(NAME, "an output's name"), minimum=1),
        "Outputs that are recorded and used.",
        ["torquer_x", "torquer_y"],
        fallback=(),
    )


class MountedAxis(Record):
    """States the direction of one input axis in a tilted fixture."""

    angle: Quantity = key(
        QuantityOf("angle", uncertain=True),
        "Angle between the input axis and the rotation axis.",
        "54.7356 deg ± 20 arcsec",
    )
    azimuth: Quantity | None = optional(
        QuantityOf("angle", uncertain=True),
        "Azimuth of the input axis about the rotation axis when the table is in its home position. "
        "It is measured from the sensor's x axis, right-handed about "
        "z.",
        "120 deg",
    )

    @property
    def direction(self) -> tuple[float, float, float]:
        """Returns the direction as a unit vector in the sensor's frame, whose z axis lies along the rotation axis. An azimuth that
        is not stated counts as zero."""
        angle, azimuth = self.angle.value, self.azimuth.value if self.azimuth else 0.0
        across = math.sin(angle)
        return across * math.cos(azimuth), across * math.sin(azimuth), math.cos(angle)


# -- results -----------------------------------------------------------------------------------------------------------


class EstimateSpec(Record):
    """One estimate: an estimator applied to selected segments. The estimator has additional keys."""

    estimator: str = key(Text(NAME, "an estimator's name"), "Estimator to use.", "flexure_gyro_static")
    segments: tuple[str, ...] | Detection = key(
        SelectionKind(),
        "Labels of the segments to use, or patterns with the wildcards * and ?; or {detect: still}.",
        "P*",
        default=("*",),
    )
    uses: tuple[str, ...] = key(
        ListOf(Text(NAME, "an estimate's name"), single=True),
        "Earlier estimates that this estimate uses.",
        "drift",
        default_factory=tuple,
    )
    outliers: str = key(
        Choice(("exclude", "keep", "refuse")),
        "What happens to samples that screening finds to be wrong (spikes, bursts, stuck, clipped and repeated samples): `exclude` leaves "
        "them out and states how the results change; `keep` uses them; `refuse` makes no estimate. "
        "In all three cases, the samples are listed.",
        "keep",
        default="exclude",
    )
    validate: str | MonteCarloSpec | None = optional(
        WordOr(("monte_carlo",), RecordOf(MonteCarloSpec)),
        "Compare the reported intervals with Monte Carlo draws (JCGM 101).",
        "monte_carlo",
    )
    parameters: Record = field(default_factory=Record)


class SymmetricKind:
    """A symmetric bound, `±0.5 deg/h`, kept as written. `dimension`: the dimension that the unit of the bound must have; None if
    any dimension is permitted."""

    def __init__(self, dimension: str | None = None):
        self.dimension = dimension

    _form = Text(SYMMETRIC, "a limit such as ±0.5 deg/h", "write ± and one quantity, or use at_least and at_most")

    def read(self, node: source.Node, log: Findings) -> str | None:
        # The form is compiled where a text needs its words: that takes milliseconds.
        text = node.text if isinstance(node, source.Scalar) and is_symmetric(node.text) else self._form.read(node, log)
        try:
            bound = parse_symmetric(text) if text is not None else None
        except QuantityError as error:
            log.error(error.code, node.mark, str(error), error.hint)
            return None
        if bound is not None and bound.value - bound.unit.offset <= 0:
            log.error(
                "meaning-range",
                node.mark,
                f"'{text}' permits no value: the bound must be positive",
                "change the number",
            )
            return None
        if bound is not None and self.dimension is not None and bound.unit.dimension != DIMENSIONS[self.dimension]:
            message = f"'{text}' is not a bound of the dimension '{self.dimension}'"
            log.error("meaning-dimension", node.mark, message, f"write for example ±{EXAMPLES[self.dimension]}")
            return None
        return text

    def schema(self) -> Schema:
        return self._form.schema()


class Limit(Record):
    """A requirement on one quantity. If it is not met, the exit code is 1."""

    quantity: str = key(
        Text(
            rf"{NAME}\.[^ \x00-\x1f]{{1,60}}",
            "the name of an estimate, a dot and a coefficient",
            "write for example drift.D_X_F",
        ),
        "The coefficient and its estimate.",
        "drift.D_X_F",
    )
    within: str | None = optional(SymmetricKind(), "Limits that are symmetric about zero.", "±0.5 deg/h")
    at_least: Quantity | None = optional(QuantityOf(None), "Lower limit.", 0.99)
    at_most: Quantity | None = optional(QuantityOf(None), "Upper limit.", 1.01)
    rule: Literal["simple", "guarded"] = key(
        Choice(("simple", "guarded")),
        "Decision rule (JCGM 106): with simple, the value must be within the limit. With guarded, it must be within the limit "
        "by at least the guard band.",
        "guarded",
        default="guarded",
    )
    guard_band: float = key(Number(0, 10), "Factor r of the guard band w = r·U of the guarded rule.", 1, default=1.0)
    coverage: float = key(
        Number(0.5, 0.9999),
        "Coverage probability of the expanded uncertainty U that the rule uses.",
        0.99,
        default=0.95,
    )
    prior: Quantity | None = optional(
        QuantityOf(None, uncertain=True),
        "Prior distribution of the quantity among the tested items, as mean ± standard deviation. From it, the global "
        "risks of the rule are computed.",
        "0.1 deg/h ± 0.2 deg/h",
    )


@dataclass(frozen=True, slots=True)
class RunItem:
    """Describes one piece of run information that the plan asks for."""

    required: bool
    mark: Mark


class RunItemKind:
    def read(self, node: source.Node, log: Findings) -> RunItem | None:
        word = Choice(("required", "optional")).read(node, log)
        return None if word is None else RunItem(word == "required", node.mark)

    def schema(self) -> Schema:
        return Choice(("required", "optional")).schema()


ESTIMATE: Kind = Plugged(
    EstimateSpec,
    "estimator",
    lambda: plugins.names(plugins.ESTIMATORS),
    lambda name: plugins.load(plugins.ESTIMATORS, name),
    "form-unknown-estimator",
)


class Plan(Record):
    """A test plan."""

    planrunner: int = key(Number(1, 1, integer=True), "Version of the plan language.", 1, fallback=1)
    title: str = key(
        Text(r"[^\x00-\x1f]{1,200}", "a title"),
        "One line that describes the test.",
        "Eight-position calibration",
        fallback="",
    )
    description: str = key(
        Text(), "Purpose of the test, for reviewers.", "Torquer currents at rest in eight positions.", default=""
    )
    author: tuple[str, ...] = key(
        ListOf(Text(PERSON, "a name in the key ring"), single=True),
        "Who wrote the plan, by the names in the key ring of the laboratory. A bench can require that other persons approve the plan.",
        "carla",
        default_factory=tuple,
    )
    bench: str = key(
        Text(r"[^\x00-\x1f]{1,200}", "a bench's name or file"),
        "Bench to run on: the name of a shipped bench, or a file.",
        "virtual",
        default="virtual",
    )
    sensor: Sensor = key(
        RecordOf(Sensor), "The sensor that the plan is for.", {"kind": "flexure-gyro", "outputs": ["torquer_x"]}
    )
    record: dict[str, RunItem] = key(
        MapOf(RunItemKind(), pattern=NAME),
        "Run information that you give with --set or --info. The run folder contains it.",
        {"device_serial": "required", "operator": "optional"},
        default_factory=dict,
    )
    mounting: dict[str, MountedAxis] = key(
        MapOf(RecordOf(MountedAxis), pattern=NAME),
        "Direction of each input axis in a tilted fixture.",
        {"x": {"angle": "54.7356 deg ± 20 arcsec", "azimuth": "0 deg"}},
        default_factory=dict,
    )
    defaults: State | None = optional(
        RecordOf(State), "The state that every segment starts from.", {"settle": "30 s", "dwell": "2 min"}
    )
    segments: tuple[SegmentSpec, ...] = key(
        ListOf(SegmentKind(), minimum=1),
        "What to do, in order.",
        [{"label": "zero", "orientation": {"x": "up", "y": "north"}}],
    )
    estimates: dict[str, EstimateSpec] = key(
        MapOf(ESTIMATE, pattern=NAME),
        "Results to compute from the recording, by name.",
        {"drift": {"estimator": "flexure_gyro_static", "segments": "P*"}},
        default_factory=dict,
    )
    limits: tuple[Limit, ...] = key(
        ListOf(RecordOf(Limit)),
        "Requirements on the results.",
        [{"quantity": "drift.D_X_F", "within": "±0.5 deg/h"}],
        default_factory=tuple,
    )
    diagnosis: DiagnosisSpec | None = optional(
        RecordOf(DiagnosisSpec),
        "How `planrunner diagnose` analyses a recording of this plan; by default all segments with the full nominal "
        "model.",
        {"nominal": ["accel_bias", "accel_misalignment"]},
    )
    report: tuple[str, ...] = key(
        ListOf(Text(FILE_NAME, "a file name")),
        "Reports to write: names of templates, without their .j2 ending; certificate.zh.html is certificate.html in "
        "Chinese.",
        ["report.html", "summary.md"],
        default=("report.html", "summary.md"),
    )


def read_plan(root: source.Mapping, log: Findings | None = None) -> tuple[Plan | None, Findings]:
    """Reads the plan in a document as far as possible; returns the plan (None if it cannot be read) and its findings. If `log` is
    given, the findings are also added to it.

    A part with an error is omitted, so that all other parts can still be checked. A segment with an error is not omitted, but
    marked as not sound.
    """
    log = Findings() if log is None else log
    if root.get("planrunner") is None and root.get("planrunner_bench") is not None:
        log.error("form-bench", root.mark, "this is a bench file, not a plan", "give it with --bench")
        return None, log
    if root.get("planrunner") is None and root.get("planrunner_suite") is not None:
        hint = "use `planrunner check` and `planrunner night`"
        log.error("form-suite", root.mark, "this is a suite of plans, not a plan", hint)
        return None, log
    return RecordOf(Plan).read(root, log), log


def parse_plan(text: str, shown: str) -> tuple[Plan | None, Findings]:
    """Reads the plan in `text`. Returns the plan (None if it cannot be read) and all its findings. This function raises no
    exception, whatever the text contains. `shown`: the file name that the findings state."""
    log = Findings()
    try:
        root = source.parse(text, shown, log)
    except InputError as error:
        return None, Findings(error.findings)
    return read_plan(root, log)

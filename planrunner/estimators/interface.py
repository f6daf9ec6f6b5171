"""Defines the input and the output of estimators.

An estimator is a class found through the entry-point group `planrunner.estimators`:

    class MyEstimator:
        summary = "one line"
        Parameters = MyParameters                     # a Record: its keys, apart from `estimator`, `segments`, `uses`
        def design(self, request: DesignRequest[MyParameters]) -> Design | None      # before anything moves
        def estimate(self, request: EstimateRequest[MyParameters]) -> Estimate       # from the recording

`planrunner.estimators.method` predicts the coefficients that `estimate` will give, and their uncertainties, with the formula of the
estimator. Values in an `Estimate` are in the units that are usual in the field. The unit is stored with each value.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, field
from typing import Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base import plugins
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.base.said import Said
from planrunner.estimators.tables import Cell as Cell
from planrunner.estimators.tables import Plot as Plot
from planrunner.estimators.tables import Role as Role
from planrunner.estimators.tables import Table as Table
from planrunner.estimators.tables import TableColumn as TableColumn
from planrunner.estimators.unstated_flicker import UnstatedFlicker
from planrunner.instruments.models import SensorModel, TableModel
from planrunner.observation.refusals import EffectAbsentError as EffectAbsentError
from planrunner.observation.refusals import EstimationError as EstimationError
from planrunner.observation.refusals import UnfitDataError as UnfitDataError
from planrunner.physics.earth import Site
from planrunner.plan.kinds import Record
from planrunner.plan.model import EstimateSpec, MountedAxis
from planrunner.plan.schedule import Segment
from planrunner.plan.selection import Detection
from planrunner.uncertainty.decision import CoefficientRole as CoefficientRole
from planrunner.uncertainty.influences import Budget, Influence, Inputs

P = TypeVar("P", covariant=True)
R = TypeVar("R", bound=Record)


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One estimated quantity and its standard uncertainty, both in the unit `unit`. `period`: for a circular quantity, its period
    in `unit`, such as 360 for a heading in deg; values that differ by the period are equivalent. For any other quantity, the period
    is infinite."""

    name: str
    value: float
    unit: str
    standard_uncertainty: float
    degrees_of_freedom: float = math.inf
    description: Said = Said("")
    period: float = math.inf
    role: CoefficientRole = CoefficientRole.LOCATION

    def near(self, place: float) -> float:
        """Returns the value in `unit`. For a circular quantity, returns the equivalent value that is nearest to `place`
        [`unit`]."""
        return place + math.remainder(self.value - place, self.period) if math.isfinite(self.period) else self.value


@dataclass(frozen=True, slots=True)
class Unpredicted:
    """Describes a coefficient that a run will give, or may give, but whose uncertainty cannot be predicted. `why`: the reason why
    it cannot be predicted."""

    name: str
    unit: str
    why: str
    description: Said = Said("")
    role: CoefficientRole = CoefficientRole.LOCATION


@dataclass(frozen=True)
class Estimate:
    """Contains the coefficients that an estimator found, their covariance, and the information that a reader needs to judge them.
    The covariance has the shape (m, m); its elements are in the products of the coefficients' units.

    An estimator computes the covariance due to the data (type A), and the `influences` of inputs whose errors the data do not show.
    The analysis adds the influences to the covariance of the coefficients, and computes the `budgets`.

    `headline`: names of the coefficients that the terminal shows first. `settings`: choices that were made, such as the kind of
    uncertainty. `extra`: plain data for other estimates that use this one. Some coefficients are known at several temperatures, or
    at one temperature that all segments have in common. Such coefficients are in extra["by_temperature"], where `temperature_model`
    reads them. The form is {name: {"temperature_degC": [...], "value": [...], "standard_uncertainty": [...], "unit": "..."}}. These
    standard uncertainties are of type A. The mean times of the data may be added as "time_s": [...].

    `data_covariance`: the part of the covariance that is of type A. The analysis keeps this part unchanged when it adds the
    influences. An estimate that uses this one starts from `data_covariance` and propagates the influences (`Influence.through`). An
    input that acts on both of these estimates is therefore counted only once, with the correct sign. `expected`: True if the
    estimate comes from a schedule instead of a recording. `unstated`: how flicker for which the bench file gives no size affects
    the coefficients; the analysis warns about this flicker.
    """

    name: str
    estimator: str
    coefficients: tuple[Coefficient, ...]
    covariance: Array
    _: KW_ONLY
    headline: tuple[str, ...] = ()
    settings: Mapping[str, Json] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()
    plots: tuple[Plot, ...] = ()
    notes: tuple[Said, ...] = ()
    warnings: tuple[Said, ...] = ()
    segments: tuple[str, ...] = ()
    extra: Mapping[str, Json] = field(default_factory=dict)
    influences: tuple[Influence, ...] = ()
    budgets: tuple[Budget, ...] = ()
    data_covariance: Array | None = None
    expected: bool = False
    unstated: tuple[UnstatedFlicker, ...] = ()

    def __getitem__(self, name: str) -> Coefficient:
        for item in self.coefficients:
            if item.name == name:
                return item
        raise KeyError(name)

    def values(self, *names: str) -> Array:
        return np.array([self[name].value for name in names])


@dataclass(frozen=True, slots=True)
class Setup:
    """Describes the test set-up apart from site and sensor. The set-up consists of the table, the mounting of the sensor, the
    stated uncertainties, the information on this run (name → text), and a flag that is True if the bench plays back a recording."""

    table: TableModel | None = None
    mounting: Mapping[str, MountedAxis] = field(default_factory=dict)
    inputs: Inputs = field(default_factory=Inputs)
    information: Mapping[str, str] = field(default_factory=dict)
    replayed: bool = False


@dataclass(frozen=True, slots=True)
class EstimateRequest(Generic[P]):
    """Contains what an estimator needs to compute an estimate from a recording.

    `name`: name of the requested estimate in the plan. `parameters`: the values of the estimator's keys. `uses`: the estimates that
    this estimate uses, by their names in the plan. `detection`: the settings for detecting spans in the data
    (`planrunner.plan.selection.Detection`); None if the plan does not require this.
    """

    name: str
    segments: tuple[RecordedSegment, ...]
    parameters: P
    site: Site
    sensor: SensorModel
    uses: Mapping[str, Estimate] = field(default_factory=dict)
    detection: Detection | None = None
    setup: Setup = field(default_factory=Setup)


@dataclass(frozen=True, slots=True)
class DesignRequest(Generic[P]):
    """Contains what an estimator needs to check an estimate before anything is recorded. If `detection` is given, the spans are not
    known yet, because they will be detected in the data. `uses`: designs of the estimates that this estimate uses, by their names
    in the plan."""

    name: str
    segments: tuple[Segment, ...]
    parameters: P
    site: Site
    sensor: SensorModel
    uses: Mapping[str, Design] = field(default_factory=dict)
    setup: Setup = field(default_factory=Setup)
    detection: Detection | None = None


@dataclass(frozen=True, slots=True)
class DesignBlock:
    """Describes the linear model of one output at the planned stimulus.

    `matrix`: array of shape (n, p), design matrix, SI. `terms`: the p names of the columns. `magnitudes`: array of shape (p,),
    declared size of each column (Earth rate, g …), by which the column is divided before the rank and the condition of the matrix
    are computed. `sigma`: array of shape (n,), predicted standard uncertainty of each observation, in the output's unit.
    """

    output: str
    terms: tuple[str, ...]
    matrix: Array
    magnitudes: Array
    sigma: Array
    labels: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Remark:
    """Contains an error, a warning or a note of an estimator about planned segments. The command `check` prints it as a finding at
    the key `key` of the estimate.

    `code`: code of the finding, such as `physics-release`; docs/findings.md lists all codes. `error`: True if the plan must not
    run. `note`: True if the remark only informs, so that the plan need not be changed. `conditions`: True if the remark explains
    why the fit is ill-conditioned, so that the general message about this is not printed. `superfluous`: terms of an output, as pairs
    of effect and column, without which the segments determine all other terms of this output. `keeps`: the other terms.
    """

    code: str
    message: str
    hint: str
    key: str = "segments"
    error: bool = False
    conditions: bool = False
    note: bool = False
    superfluous: tuple[tuple[str, str], ...] = ()
    keeps: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Foresight:
    """The prediction of a run.

    `predicted`: coefficients with nominal values and expected uncertainties. `unpredicted`: coefficients whose uncertainties cannot
    be predicted. Both tuples are empty if the coefficients of a run are not known. `expected`: estimates from the expected
    observations, one for each set of assumed values. The predictions of other estimates that use this one are based on these
    estimates. `notes`: remarks about the prediction.
    """

    predicted: tuple[Coefficient, ...] = ()
    unpredicted: tuple[Unpredicted, ...] = ()
    expected: tuple[Estimate, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def known(self) -> bool:
        """Returns True if the prediction states which coefficients a run will give."""
        return bool(self.predicted or self.unpredicted)


@dataclass(frozen=True, slots=True)
class Design:
    """Contains what an estimator states about the planned segments.

    `blocks`: one block per output; empty if the estimator has no linear model. `notes`: notes on the planned segments. `extra`:
    plain data for the designs of other estimates that use this estimate. `foresight`: a function that computes the prediction of a
    run. The prediction takes longer than the rest of a design, so it is computed only when a limit, an estimate that uses this one,
    or a reader needs it.
    """

    blocks: tuple[DesignBlock, ...]
    notes: tuple[str, ...] = ()
    extra: Mapping[str, Json] = field(default_factory=dict)
    remarks: tuple[Remark, ...] = ()
    foresight: Callable[[], Foresight] = Foresight

    @property
    def predicted(self) -> tuple[Coefficient, ...]:
        return self.foresight().predicted

    @property
    def unpredicted(self) -> tuple[Unpredicted, ...]:
        return self.foresight().unpredicted

    @property
    def expected(self) -> tuple[Estimate, ...]:
        return self.foresight().expected

    @property
    def known(self) -> bool:
        return self.foresight().known

    @property
    def foreseen(self) -> Mapping[str, Coefficient | Unpredicted]:
        """Returns the predicted and the unpredicted coefficients of a run, by name; empty if the coefficients are not known."""
        predicted: dict[str, Coefficient | Unpredicted] = {item.name: item for item in self.predicted}
        return predicted | {item.name: item for item in self.unpredicted}

    @property
    def all_notes(self) -> tuple[str, ...]:
        """Returns the notes on the planned segments and the notes on the prediction."""
        return (*self.notes, *self.foresight().notes)


@runtime_checkable
class FindsSpans(Protocol):
    """An estimator that can search the data for spans if a plan requests this with `{detect: …}`. Estimators without `finds_spans`
    use whole segments."""

    finds_spans: bool


class Estimator(Protocol[R]):
    """An estimator plug-in. R: the type of the record that contains the values of its keys."""

    summary: str
    Parameters: type[R]

    def design(self, request: DesignRequest[R]) -> Design | None: ...
    def estimate(self, request: EstimateRequest[R]) -> Estimate: ...


def estimator_of(spec: EstimateSpec) -> Estimator[Record]:
    """Finds the plug-in that an estimate in a plan names. Raises `InputError` if the plug-in is not installed or cannot be
    loaded."""
    estimator: Estimator[Record] = plugins.load(plugins.ESTIMATORS, spec.estimator)()
    return estimator

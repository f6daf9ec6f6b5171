"""Describes the rows of the index: runs, their coefficients and verdicts, and folders that could not be read. All times are in UTC,
in the format ISO 8601."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from enum import Enum
from typing import Literal

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import JsonObject
from planrunner.estimators.interface import CoefficientRole
from planrunner.estimators.limits import VerdictKind

RunState = Literal["sealed", "open"]
IndexedVerdict = VerdictKind | Literal["not analysed"]


class CircumstanceKind(Enum):
    """Kinds of circumstances that may differ between runs and may cause results to change."""

    BENCH = "bench"
    LABORATORY = "laboratory"
    OPERATOR = "operator"
    FIRMWARE = "firmware"
    INSTRUMENT = "instrument"
    MOUNTING = "mounting"
    PLAN = "plan"
    SOFTWARE = "software"


@dataclass(frozen=True, slots=True)
class Circumstance:
    """One circumstance of a run. `name`: name that distinguishes circumstances of this kind, such as `table.serial`; empty if there
    is only one."""

    kind: CircumstanceKind
    name: str
    value: str

    @property
    def words(self) -> str:
        return f"{self.kind.value} {self.name}".strip()


@dataclass(frozen=True, slots=True)
class RunRow:
    """A run in the index.

    `folder`: path relative to the archive, with slashes. `device`: serial number of the device; empty if it is not stated.
    `analysis`: number of the newest analysis; 0 if there is no analysis. The verdict and the coefficients come from this analysis.
    `warnings`: number of warnings of the run and of its estimates.
    """

    folder: str
    run: str
    created: str
    plan: str
    title: str
    device: str
    bench: str
    laboratory: str
    operator: str
    origin: str
    state: RunState
    verdict: IndexedVerdict
    analysis: int
    warnings: int
    circumstances: tuple[Circumstance, ...] = ()
    info: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> JsonObject:
        """Returns one entry of `runs` in schemas/runs.schema.json."""
        return {
            "folder": self.folder,
            "run": self.run,
            "created": self.created,
            "plan": self.plan,
            "title": self.title,
            "device": self.device,
            "bench": self.bench,
            "laboratory": self.laboratory,
            "operator": self.operator,
            "origin": self.origin,
            "state": self.state,
            "verdict": self.verdict,
            "analysis": self.analysis,
            "warnings": self.warnings,
        }


@dataclass(frozen=True, slots=True)
class CoefficientRow:
    """Contains a coefficient of the newest analysis of a run. `quantity`: name of the coefficient in the form
    `estimate.coefficient`. `value`, `standard_uncertainty`: value and standard uncertainty in `unit`. `period`: period of a
    circular quantity in `unit`; inf for any other quantity. Numbers that could not be computed are nan."""

    quantity: str
    value: float
    unit: str
    standard_uncertainty: float
    degrees_of_freedom: float
    role: CoefficientRole = CoefficientRole.LOCATION
    period: float = math.inf


@dataclass(frozen=True, slots=True)
class LimitRow:
    """Contains a limit of the plan with its verdict. `lower`, `upper`: the limits in `unit`."""

    quantity: str
    requirement: str
    verdict: str
    unit: str
    lower: float
    upper: float
    probability: float


@dataclass(frozen=True, slots=True)
class RecordedAs:
    """Contains the identity of a run, as recorded when it began: the names of its bench and its plan, and its device."""

    bench: str
    plan: str
    device: str


@dataclass(frozen=True, slots=True)
class FaultRow:
    """Describes a folder of the archive that is not in the index, and the reason. `recorded`: the identity of the run, if it can
    still be trusted."""

    folder: str
    message: str
    recorded: RecordedAs | None = None


@dataclass(frozen=True, slots=True)
class IndexedRun:
    """Contains the result of reading a run folder: the run with its coefficients and limits, or the fault.

    `fingerprint`: value that changes whenever planrunner writes to the folder; empty if the folder must be read again next time.
    `recorded`: identity of a run with a fault. `parameters`: values that were given for parameters of the run's plan.
    """

    folder: str
    fingerprint: str
    run: RunRow | None
    coefficients: tuple[CoefficientRow, ...] = ()
    limits: tuple[LimitRow, ...] = ()
    fault: str = ""
    parameters: Mapping[str, str] = field(default_factory=dict)
    recorded: RecordedAs | None = None


@dataclass(frozen=True, slots=True)
class RunFilter:
    """Selects runs by several criteria. An empty criterion matches all runs. A text matches values that are equal to it; a text
    with `*` or `?` is a pattern. `since`, `until`: first and last moment, ISO 8601 in UTC. If `until` is a day, the whole day is
    included."""

    device: str = ""
    plan: str = ""
    bench: str = ""
    operator: str = ""
    verdict: str = ""
    since: str = ""
    until: str = ""
    limit: int | None = None


@dataclass(frozen=True, slots=True)
class HistoryPoint:
    """Contains the value of a coefficient in one run of a device, with the limits in the plan of that run."""

    run: RunRow
    coefficient: CoefficientRow
    limits: tuple[LimitRow, ...] = ()

"""The complete comparison of two plans, benches or runs, for tables, pages and JSON."""

from __future__ import annotations

from typing import Literal

from planrunner.base.dataclass import dataclass
from planrunner.plan.schedule import Schedule
from planrunner.review.consequences import Consequences
from planrunner.review.difference import MeaningDifference
from planrunner.review.meaning import Meaning
from planrunner.review.runs import RunDifference

ComparedKind = Literal["plan", "bench", "run"]


@dataclass(frozen=True, slots=True)
class Fact:
    """Something about two runs that may explain a difference: its name, and its value in each."""

    name: str
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class Compared:
    """Both sides and their difference.

    names: of both sides, as given. meanings: of both sides; for a run, that of its plan on its bench. schedules: of the plans, if
    they could be made. unforeseen: the reason why consequences are missing. facts: facts of runs that differ; conditions: measured
    conditions that differ.
    """

    kind: ComparedKind
    names: tuple[str, str]
    meanings: tuple[Meaning, Meaning]
    meaning: MeaningDifference
    consequences: Consequences | None = None
    schedules: tuple[Schedule | None, Schedule | None] = (None, None)
    titles: tuple[str, str] = ("", "")
    unforeseen: str = ""
    runs: RunDifference | None = None
    facts: tuple[Fact, ...] = ()
    conditions: tuple[Fact, ...] = ()

    @property
    def digests(self) -> tuple[str, str]:
        """SHA-256 of both meanings. Computing it takes longer than the comparison, so it is computed only when it is shown."""
        return self.meanings[0].digest(), self.meanings[1].digest()

    @property
    def different(self) -> bool:
        """Whether the meanings differ. Runs differ if the results or the plans do; two recordings always have differences of noise."""
        if self.runs is not None:
            apart = any(item.difference for item in self.runs.coefficients) or any(self.runs.only)
            return apart or not self.meaning.empty
        return not self.meaning.empty

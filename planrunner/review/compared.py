"""Compares two plans, two benches or two runs completely, for tables, pages and JSON."""

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
    """A fact about two runs that may explain a difference: its name, and its value in each run."""

    name: str
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class Compared:
    """The two sides of a comparison and the difference between them.

    `names`: names of the two sides, as the user gives them. `meanings`: the meaning of each side; for a run, the meaning of its
    plan on its bench. `schedules`: the schedule of each plan; None if it could not be made. `unforeseen`: the reason why the
    consequences of the difference were not predicted. `facts`: facts that differ between two runs. `conditions`: measured
    conditions that differ between two runs.
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
        """Returns the SHA-256 of the meaning of each side. The digests take longer to compute than the comparison, so they are
        computed only when they are shown."""
        return self.meanings[0].digest(), self.meanings[1].digest()

    @property
    def different(self) -> bool:
        """Returns True if the two sides differ. Plans and benches differ if their meanings differ. Runs differ if their
        coefficients or their plans differ; because of noise, two recordings therefore always differ."""
        if self.runs is not None:
            apart = any(item.difference for item in self.runs.coefficients) or any(self.runs.only)
            return apart or not self.meaning.empty
        return not self.meaning.empty

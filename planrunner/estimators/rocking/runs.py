"""Finds the runs of a rocking test: determines which segments are static and dynamic runs, and which four runs form a quadruple."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.estimators.interface import EstimationError
from planrunner.estimators.rocking.attitude import LevelState, level_state
from planrunner.plan.schedule import Cycle, Rest, Rock, Segment, Spin

CAGED = "caged"
PATTERN = (False, True, True, False)  # dynamic?
WORDS = {False: "static", True: "dynamic"}


@dataclass(frozen=True, slots=True)
class Run:
    """Describes one run of the element in navigation. `place`: index of the run among the chosen segments. `caged_before`: True if
    the element was caged before the run, None if the segments do not show this."""

    segment: Segment
    place: int
    state: LevelState
    caged_before: bool | None

    @property
    def label(self) -> str:
        return self.segment.label

    @property
    def dynamic(self) -> bool:
        return isinstance(self.segment.motion, Rock)

    @property
    def planned_lead(self) -> float:
        """Returns the planned time [s] from the release to the start of the record. This time consists of the settling time and of
        the unrecorded part of the rocking's fade-in."""
        motion = self.segment.motion
        return self.segment.settle + (motion.lead_in if isinstance(motion, Rock) else 0.0)

    @property
    def rest_before(self) -> float:
        """Returns the time [s] from the start of the record until the base begins to rock; 0 if the base rocks from the start, or
        does not rock."""
        motion = self.segment.motion
        return motion.delay if isinstance(motion, Rock) else 0.0

    @property
    def rocking_ends(self) -> float:
        """Returns the time [s] from the start of the record until the rings are at rest, including the fade-out; 0 for a run at
        rest."""
        motion = self.segment.motion
        return motion.over if isinstance(motion, Rock) else 0.0


@dataclass(frozen=True, slots=True)
class Quadruple:
    """Four successive runs: static, dynamic, dynamic, static. A change that is linear over the four runs cancels in the rocking
    drift."""

    runs: tuple[Run, Run, Run, Run]

    @property
    def name(self) -> str:
        """Returns the part that the labels of the four runs have in common."""
        parts = [run.label.split("/") for run in self.runs]
        common = [words[0] for words in zip(*parts, strict=False) if len(set(words)) == 1]
        return "/".join(common) or f"{self.runs[0].label} …"


def find_runs(segments: Sequence[Segment], order: str) -> list[Run]:
    """Finds the runs among the chosen segments. Raises `EstimationError` for a segment that is not a run of a rocking test."""
    runs = []
    before: Segment | None = None
    for place, segment in enumerate(segments):
        if segment.mode != CAGED:
            runs.append(_run(segment, place, before, order))
        before = segment
    if not runs:
        raise EstimationError("none of the chosen segments is a run in navigation: choose static and dynamic runs")
    return runs


def _run(segment: Segment, place: int, before: Segment | None, order: str) -> Run:
    if isinstance(segment.motion, Spin | Cycle):
        raise EstimationError(f"'{segment.label}' spins or indexes, but a run must be static or rock")
    if segment.attitude is None:
        raise EstimationError(
            f"the orientation of '{segment.label}' is unknown: give the directions of the platform's axes"
        )
    state = level_state(np.asarray(segment.attitude, dtype=float), order)
    if state is None:
        raise EstimationError(
            f"'{segment.label}' has no axis along the vertical ({segment.orientation}): two axes must be level so that "
            "their tilts can be measured"
        )
    if not isinstance(segment.motion, Rest | Rock):
        raise EstimationError(f"'{segment.label}' is neither at rest nor rocking")
    caged: bool | None = before is not None and before.mode == CAGED
    if not caged and segment.index > 0 and (before is None or before.index != segment.index - 1):
        caged = None
    return Run(segment, place, state, caged)


def quadruples(runs: Sequence[Run]) -> list[Quadruple]:
    """Divides the runs into groups of four successive runs: static, dynamic, dynamic, static, all in one orientation. Raises
    `EstimationError` if runs are not in this order; the message names the first such run."""
    found = []
    for first in range(0, len(runs), 4):
        four = tuple(runs[first : first + 4])
        pattern = tuple(run.dynamic for run in four)
        if pattern != PATTERN:
            is_now = ", ".join(WORDS[dynamic] for dynamic in pattern)
            raise EstimationError(
                f"the runs from '{four[0].label}' on are {is_now}; a quadruple is static, dynamic, dynamic, static"
            )
        a, b, c, d = four
        if any(not np.allclose(run.state.nominal, a.state.nominal, atol=1e-9) for run in four):
            raise EstimationError(
                f"the orientation changes within the four runs from '{a.label}' on; the four runs of a "
                "quadruple must have the same orientation"
            )
        found.append(Quadruple((a, b, c, d)))
    return found


def by_state(found: Sequence[Quadruple]) -> list[list[Quadruple]]:
    """Groups the quadruples by orientation, in the order in which the orientations were recorded."""
    groups: list[list[Quadruple]] = []
    for quadruple in found:
        nominal = quadruple.runs[0].state.nominal
        group = next((g for g in groups if np.allclose(g[0].runs[0].state.nominal, nominal, atol=1e-9)), None)
        if group is None:
            groups.append([quadruple])
        else:
            group.append(quadruple)
    return groups

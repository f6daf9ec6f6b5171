"""Reads the navigations that `modulation_residual` compares: their errors over the common time, and the rotation of each
navigation."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.estimators.interface import Estimate, EstimateRequest, EstimationError
from planrunner.estimators.strapdown.navigation_errors import CEP_SHARE, HOUR, NAUTICAL_MILE
from planrunner.instruments.models import TableModel
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.plan.schedule import Cycle, Motion, Spin

COURSE = ("time_s", "east_m", "north_m", "velocity_east", "velocity_north")
_NO_NAVIGATION = "'{}' is not a navigation: `uses` names strapdown_navigation estimates"
_NO_REFERENCE = (
    "{} of the estimates used {} without rotation: `uses` needs exactly one navigation without rotation, and one or more with "
    "rotation"
)


@dataclass(frozen=True, slots=True)
class Navigation:
    """Contains the errors of one navigation over the time that all navigations cover.

    `course`: array of shape (5, n), with the rows time [s], east and north position error [m], east and north velocity error [m/s].
    `cycle`: the cycle during navigation, None at rest. `aligned`: the cycle during the alignment, None at rest. `highest`: the
    order of the highest harmonic of interest. `spread`: relative standard uncertainty of the slope of the radial error over time.
    """

    name: str
    attitude: Array | None
    cycle: RotationCycle | None
    aligned: RotationCycle | None
    highest: int
    course: Array
    spread: float

    @property
    def seconds(self) -> float:
        return float(self.course[0, -1])

    @property
    def radial(self) -> Array:
        distance: Array = np.hypot(self.course[1], self.course[2])
        return distance

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.radial**2)))

    @property
    def cep_rate(self) -> float:
        """Returns the CEP rate [nmi/h]: √(ln 2) times the slope of the radial error over time. The slope is computed from a fitted
        line through the origin."""
        time = self.course[0]
        return CEP_SHARE * float(time @ self.radial / (time @ time)) * HOUR / NAUTICAL_MILE


def rotation(motion: Motion, table: TableModel | None) -> RotationCycle | None:
    """Returns the rotation cycle of a motion, including the table's ramps; None for a motion that is neither a cycle nor a spin. A
    constant rate counts as a cycle of one turn."""
    if isinstance(motion, Cycle):
        return RotationCycle.of(motion, table.axes[0].max_acceleration if table else math.inf)
    if isinstance(motion, Spin):
        return RotationCycle((math.copysign(2 * math.pi, motion.rate),), 0.0, abs(motion.rate))
    return None


def compared(request: EstimateRequest[object]) -> list[Navigation]:
    """Reads the navigations of `uses`, in their order, over the time that all of them cover. Raises `EstimationError` if the
    navigations cannot be compared."""
    segments = {recorded.label: recorded.segment for recorded in request.segments}
    table = request.setup.table
    courses = {name: _course(name, used) for name, used in request.uses.items()}
    last = min((float(course[0, -1]) for course in courses.values()), default=0.0)
    found = []
    for name, used in request.uses.items():
        own = [segments.get(label) for label in used.segments]
        if not own or own[-1] is None:
            raise EstimationError(
                f"`segments` lacks the segment of the navigation '{name}': name the segments of every navigation in `uses`"
            )
        navigated, before = own[-1], own[-2] if len(own) > 1 else None
        course = courses[name][:, courses[name][0] <= last + 1e-6]
        if course.shape[1] < 3:
            raise EstimationError(
                f"'{name}' has fewer than three points within the {last:.0f} s that all navigations have"
            )
        moves = len(navigated.motion.moves) if isinstance(navigated.motion, Cycle) else 1
        aligned = rotation(before.motion, table) if before is not None else None
        cycle = rotation(navigated.motion, table)
        found.append(Navigation(name, navigated.attitude, cycle, aligned, 2 * moves, course, _spread(used)))
    still = sum(item.cycle is None for item in found)
    if still != 1 or len(found) < 2:
        count = {0: "none", 1: "one"}.get(still, f"{still}")
        raise EstimationError(_NO_REFERENCE.format(count, "is" if still < 2 else "are"))
    return found


def _course(name: str, used: Estimate) -> Array:
    extra: Mapping[str, Json] = used.extra
    if not all(key in extra for key in COURSE):
        raise EstimationError(_NO_NAVIGATION.format(name))
    return np.array([extra[key] for key in COURSE], dtype=float)


def _spread(used: Estimate) -> float:
    for item in used.coefficients:
        if item.name == "radial_error_rate" and item.value:
            return abs(item.standard_uncertainty / item.value)
    return 0.0

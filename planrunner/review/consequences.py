"""Determines the consequences of a change of a plan before anything runs. The consequences are changes of the planned time, of
predicted uncertainties, of the terms that can be determined, of the demands on the bench, of limits, and of findings.

All data come from two checks, one for each plan on its bench. Nothing is estimated again in this module.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Finding
from planrunner.design.identifiability import Identifiability
from planrunner.estimators.interface import Design
from planrunner.instruments.models import ChamberModel, TableModel
from planrunner.plan.schedule import Cycle, Rock, Schedule, Spin


@dataclass(frozen=True, slots=True)
class Forecast:
    """Contains the result of checking one plan on its bench. `findings`: the findings to be shown. `schedule`: None if the plan has
    errors."""

    schedule: Schedule | None = None
    designs: Mapping[str, Design] = field(default_factory=dict)
    judged: Mapping[str, Sequence[Identifiability]] = field(default_factory=dict)
    table: TableModel | None = None
    chamber: ChamberModel | None = None
    findings: Sequence[Finding] = ()


@dataclass(frozen=True, slots=True)
class PredictedChange:
    """Contains the predicted standard uncertainty of one coefficient, in `unit`, before and after a change; None if the plan does
    not predict it."""

    estimate: str
    coefficient: str
    unit: str
    before: float | None
    after: float | None


@dataclass(frozen=True, slots=True)
class Undetermined:
    """Names the terms that the planned segments cannot determine, for one output of an estimate."""

    estimate: str
    output: str
    terms: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Demand:
    """Describes one demand that two plans make on their benches, for example the largest rate.

    `before`, `after`: the extreme value that the first and the second plan command. `limits`: the limits of the benches of the two
    plans. All values are in `unit`. A value is None if the plan or the bench does not have it. `lowest`: True if the limits are
    lower limits.
    """

    name: str
    unit: str
    before: float | None
    after: float | None
    limits: tuple[float | None, float | None]
    lowest: bool = False

    @property
    def newly_reached(self) -> bool:
        """Returns True if the second plan reaches the limit of its bench although the first plan does not."""
        return self._reached(self.after, self.limits[1]) and not self._reached(self.before, self.limits[0])

    def _reached(self, value: float | None, limit: float | None) -> bool:
        if value is None or limit is None:
            return False
        beyond = limit - value if self.lowest else value - limit
        return beyond >= -1e-9 * max(1.0, abs(limit))


@dataclass(frozen=True, slots=True)
class Consequences:
    """Describes the consequences of a change of a plan.

    `total`: planned times before and after the change, s; None without a schedule. `predicted`: coefficients whose predicted
    uncertainty differs. `lost`: terms that can no longer be determined. `won`: terms that can be determined only after the change.
    `demands`: demands on the bench that differ. `new`, `gone`: findings that appear or disappear because of the change. Findings
    are compared without their positions in the files.
    """

    total: tuple[float | None, float | None]
    predicted: tuple[PredictedChange, ...]
    lost: tuple[Undetermined, ...]
    won: tuple[Undetermined, ...]
    demands: tuple[Demand, ...]
    new: tuple[Finding, ...]
    gone: tuple[Finding, ...]


def consequences(before: Forecast, after: Forecast) -> Consequences:
    new, gone = _findings(before.findings, after.findings)
    lost = tuple(_undetermined(after, known=_sound_terms(before)))
    won = tuple(_undetermined(before, known=_sound_terms(after)))
    totals = tuple(None if one.schedule is None else one.schedule.total for one in (before, after))
    demands = tuple(
        demand for demand in _demands(before, after) if demand.before != demand.after or demand.newly_reached
    )
    return Consequences((totals[0], totals[1]), tuple(_predicted(before, after)), lost, won, demands, new, gone)


SAME = 1e-6
"""Relative difference below which two predictions are the same."""


def _predicted(before: Forecast, after: Forecast) -> Iterator[PredictedChange]:
    old, new = _uncertainties(before), _uncertainties(after)
    for key in dict.fromkeys([*old, *new]):
        u, v = old.get(key), new.get(key)
        if u is None or v is None or not math.isclose(u, v, rel_tol=SAME):
            yield PredictedChange(*key, u, v)


def _uncertainties(forecast: Forecast) -> dict[tuple[str, str, str], float]:
    return {
        (name, item.name, item.unit): item.standard_uncertainty
        for name, design in forecast.designs.items()
        for item in design.predicted
        if math.isfinite(item.standard_uncertainty)
    }


def _sound_terms(forecast: Forecast) -> dict[tuple[str, str], frozenset[str]]:
    """Maps (estimate, output) to the terms that the planned segments cannot determine."""
    return {
        (name, one.output): frozenset(one.unidentifiable) for name, judged in forecast.judged.items() for one in judged
    }


def _undetermined(forecast: Forecast, known: Mapping[tuple[str, str], frozenset[str]]) -> Iterator[Undetermined]:
    """Yields the terms that this plan cannot determine, although the other plan determines them for the same outputs."""
    for name, judged in forecast.judged.items():
        for one in judged:
            other = known.get((name, one.output))
            terms = () if other is None else tuple(term for term in one.unidentifiable if term not in other)
            if terms:
                yield Undetermined(name, one.output, terms)


def _demands(before: Forecast, after: Forecast) -> Iterator[Demand]:
    def both(of: str) -> tuple[float | None, float | None]:
        return _EXTREMES[of](before.schedule), _EXTREMES[of](after.schedule)

    rate = both("rate")
    if rate != (None, None):
        fastest = tuple(_fastest(one.table) for one in (before, after))
        yield Demand("highest rate", "rad/s", *rate, (fastest[0], fastest[1]))
    chambers = before.chamber, after.chamber
    hot, cold = both("hottest"), both("coldest")
    if hot != (None, None):
        highest = tuple(None if one is None else one.highest for one in chambers)
        lowest = tuple(None if one is None else one.lowest for one in chambers)
        yield Demand("highest temperature", "K", *hot, (highest[0], highest[1]))
        yield Demand("lowest temperature", "K", *cold, (lowest[0], lowest[1]), lowest=True)


def _fastest(table: TableModel | None) -> float | None:
    return None if table is None else max((axis.max_rate for axis in table.axes), default=None)


def _rate(schedule: Schedule | None) -> float | None:
    found = []
    for segment in schedule.segments if schedule else ():
        match segment.motion:
            case Spin(rate=rate):
                found.append(abs(rate))
            case Cycle(rate=rate):
                found.append(rate)
            case Rock(amplitude=amplitude, frequency=frequency):
                found.append(2 * math.pi * frequency * amplitude)
    return max(found, default=None)


def _temperatures(schedule: Schedule | None) -> list[float]:
    segments = schedule.segments if schedule else ()
    return [kelvin for item in segments for kelvin in (item.temperature, item.ramp_to) if kelvin is not None]


def _hottest(schedule: Schedule | None) -> float | None:
    return max(_temperatures(schedule), default=None)


def _coldest(schedule: Schedule | None) -> float | None:
    return min(_temperatures(schedule), default=None)


_EXTREMES = {"rate": _rate, "hottest": _hottest, "coldest": _coldest}


def _findings(before: Sequence[Finding], after: Sequence[Finding]) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """Returns the findings that are only in `after`, and the findings that are only in `before`. Findings are compared by severity,
    code and message. Positions are ignored, because an edit elsewhere in a file moves them."""
    old, new = (
        Counter[tuple[str, str, str]]((one.severity, one.code, one.message) for one in findings)
        for findings in (before, after)
    )
    return tuple(_only(after, new - old)), tuple(_only(before, old - new))


def _only(findings: Sequence[Finding], more: Counter[tuple[str, str, str]]) -> Iterator[Finding]:
    left = Counter(more)
    for one in findings:
        key = (one.severity, one.code, one.message)
        if left[key] > 0:
            left[key] -= 1
            yield one

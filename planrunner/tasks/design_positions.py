"""Designs the positions of a plan on its bench. Compares the information from the planned positions with the information from the
best set found, and with an upper bound."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.findings import Findings, InputError
from planrunner.base.workers import ALONE, Workers
from planrunner.bench.scheduling import build_schedule
from planrunner.design import continuous, direction_cosines, exchange, optimal, worst_variance
from planrunner.design import places as positions
from planrunner.design.efficiency import Merit, efficiency, merit, region_moment
from planrunner.design.places import Place, Sight
from planrunner.design.study import Asked, Bounds, FoundPositions, PositionSet, SearchProgress
from planrunner.estimators import rank
from planrunner.estimators.foresight import design_of
from planrunner.estimators.interface import Design, EstimationError
from planrunner.physics.kinematics import TableAxis, Unreachable, joint_angles
from planrunner.plan import source
from planrunner.plan.expand import expand
from planrunner.plan.orientation import Orientation, in_words
from planrunner.plan.rewriting import (
    DECIMALS,
    RewriteError,
    as_written,
    cardinal_orientations,
    orientation_text,
    with_dwells,
    with_orientations,
)
from planrunner.plan.schedule import Schedule
from planrunner.plan.selection import Detection
from planrunner.tasks.check import Checked

_Mark = tuple[int, int]  # (line, column) of what is changed in the plan

SPREAD = 2000  # attitudes over which exchange looks, and over which predictions are judged
_REPAIRED = ("physics-rank", "physics-condition")  # findings that other positions may resolve
_WITH_BOUND = ("D", "A", "I")  # criteria whose continuous optimum is solved for; that of G is that of D


def design_positions(
    checked: Checked, asked: Asked, progress: SearchProgress | None = None, workers: Workers = ALONE
) -> FoundPositions:
    """Designs the positions of a plan. `workers`: processes that share the search over arbitrary orientations. Raises `InputError`
    with the findings about the plan, and `EstimationError` if there is nothing to design."""
    if any(finding.code not in _REPAIRED for finding in checked.findings.errors) or checked.schedule is None:
        raise InputError(checked.findings)
    if asked.restarts < 1 or asked.seed < 0:
        raise EstimationError("--restarts must be at least 1 and --seed at least 0")
    return _Designer(checked, asked, progress or (lambda stage, fraction: None), workers).study()


def _rows_of(rows: direction_cosines.RowsAt, axes: tuple[TableAxis, ...], azimuth: float, settings: Array) -> Array:
    """Returns the design rows for m settings of the table's k axes. `settings`: angles of the axes, shape (m, k)."""
    return rows(positions.attitudes(axes, settings, azimuth))


class _Designer:
    def __init__(self, checked: Checked, asked: Asked, progress: SearchProgress, workers: Workers):
        assert checked.plan and checked.models and checked.schedule and checked.models.sensor
        self.checked, self.asked, self.progress, self.workers = checked, asked, progress, workers
        self.plan, self.models, self.schedule = checked.plan, checked.models, checked.schedule
        if self.models.table is None or self.models.replays:
            raise EstimationError(
                "this bench has no table that can take other positions; choose another bench with --bench"
            )
        self.axes: tuple[TableAxis, ...] = self.models.table.axes
        self.azimuth = self.models.site.azimuth
        self.places, self.sight = self._find()
        # Without this object, so that workers can be given it.
        self._rows_of = partial(_rows_of, direction_cosines.quick(self.sight.rows), self.axes, self.azimuth)
        self.count = len(self.places)
        self.terms = len(self.sight.terms)
        self.fixed = self.sight.fixed.T @ self.sight.fixed if len(self.sight.fixed) else None
        if self.fixed is None and self.count < self.terms:
            raise EstimationError(
                f"'{self.sight.name}' has {self.terms} terms but only {self.count} positions: add positions to "
                "the plan first"
            )

    def _find(self) -> tuple[tuple[Place, ...], Sight]:
        names = list(self.plan.estimates)
        if self.asked.estimate is not None and self.asked.estimate not in names:
            raise EstimationError(f"the plan has no estimate '{self.asked.estimate}'; it has {', '.join(names)}")
        problems = []
        for name in [self.asked.estimate] if self.asked.estimate else names:
            spec = self.plan.estimates[name]
            patterns = spec.segments.within if isinstance(spec.segments, Detection) else spec.segments
            uses = {used: self.checked.designs[used] for used in spec.uses if used in self.checked.designs}
            try:
                found, spins = positions.places(self.schedule.segments, patterns)
                sensor = self.models.sensor
                assert sensor is not None
                return found, positions.sight(
                    name, spec, found, self.models.site, sensor, uses, self.checked.setup, spins, self.asked.output
                )
            except EstimationError as error:
                problems.append(f"{name}: {error}")
        raise EstimationError("; ".join(problems) or "the plan has no estimates, so there is nothing to design for")

    def study(self) -> FoundPositions:
        rows_of = self._rows_of
        kept, cardinal_settings = positions.reachable(self.axes, cardinal_orientations(), self.azimuth)
        bounds = [(axis.lowest, axis.highest) for axis in self.axes]
        spread = optimal.spread(bounds, SPREAD, self.asked.seed)
        region = optimal.region(rows_of, np.concatenate([cardinal_settings, spread]), bounds)
        self.region_rows, cardinal_rows = region.rows, region.rows[: len(kept)]
        self._require_rank()
        self._require_time()
        planned = [place.attitude for place in self.places]
        weighting = self._weighting(self.asked.criterion)
        found: dict[str, list[Array]] = {"planned": planned}
        how = []
        if len(kept) and self._merit(cardinal_rows).sound:
            chosen = self._cardinal(cardinal_rows, weighting)
            indices = self._flattened(cardinal_rows, chosen.indices)
            found["cardinal"] = self._ordered([kept[index] for index in indices])
            tried = f"all {chosen.tried} choices" if chosen.exhaustive else f"exchange from {chosen.tried} starts"
            how.append(f"cardinal: {tried} of {self.count} out of {len(kept)} orientations")
        elif self.asked.orientations == "cardinal":
            raise EstimationError(
                f"no set of {self.count} cardinal orientations separates "
                f"all terms (rank {np.linalg.matrix_rank(cardinal_rows)} of {self.terms} with all of them): use --set free"
            )
        starts = [self._settings(planned)]
        free = optimal.search(
            region, self.count, weighting, restarts=self.asked.restarts, seed=self.asked.seed, starts=starts,
            fixed=self.fixed, progress=lambda part: self.progress("free orientations", part),
            workers=self.workers,
        )  # fmt: skip
        settings = free.settings
        if self.asked.criterion == "G":
            settings = worst_variance.refine(region, settings, region.rows, self.fixed)
        attitudes = positions.attitudes(self.axes, self._rounded(settings), self.azimuth)
        found["free"] = self._ordered([as_written(attitude, self._decimals) for attitude in attitudes])
        how.append(f"free: {free.starts} local searches, {free.agreeing} of which found the best value")
        best, limits = self._references(region, cardinal_rows, settings, found)
        sets = {name: self._set(name, attitudes, best, limits) for name, attitudes in found.items()}
        dwells, gain = self._dwells(sets[self.asked.orientations])
        text = self._text(sets[self.asked.orientations], dwells)
        return FoundPositions(
            self.sight, self.places, self.asked, sets, best, limits, "; ".join(how), dwells, gain, text
        )

    def _require_rank(self) -> None:
        """Raises `EstimationError` if no set of orientations that the table can reach separates the terms."""
        seen = rank.look(np.concatenate([self.region_rows, self.sight.fixed]))
        if seen.rank < self.terms:
            blind = ", ".join(rank.unidentifiable(seen.null, self.sight.terms))
            raise EstimationError(
                f"no positions within this table's reach separate {blind} (rank {seen.rank} of {self.terms} over "
                f"the whole reach): {rank.explain(seen.null, self.sight.terms)}; use a table with more axes or leave terms out"
            )

    def _require_time(self) -> None:
        """Raises `EstimationError` if the parts of the plan that do not depend on the positions already take longer than the time
        budget. The time is checked before the search."""
        if self.asked.time is None:
            return
        recorded = [segment for place in self.places for segment in place.segments]
        if any(segment.dwell is None for segment in recorded):
            raise EstimationError(
                "the positions dwell for the length of their recording, so dwell times cannot be distributed"
            )
        designed = {segment.index for segment in recorded}
        others = sum(segment.dwell or 0.0 for segment in self.schedule.segments if segment.index not in designed)
        self._left(others, "the other segments take")

    def _left(self, spent: float, what: str) -> float:
        """Returns the time [s] that the budget leaves for the recordings at all positions together, if each position is recorded
        once. Raises `EstimationError` if this time is too short."""
        assert self.asked.time is not None
        left = (self.asked.time - spent) / len(self.places[0].segments)
        if left < 10 * self.count:
            raise EstimationError(f"{what} {spent:.0f} s, which leaves too little of {self.asked.time:.0f} s")
        return left

    # -- searching ---------------------------------------------------------------------------------------------------

    @property
    def _decimals(self) -> int:
        """Returns the number of decimals for angles [deg] in the orientations that are written to the plan. The number is two if
        the table can reach any attitude. It is larger if axes are missing or limited, because the table might then be unable to
        reach a rounded orientation."""
        anywhere = len(self.axes) == 3 and all(axis.continuous for axis in self.axes)
        return DECIMALS if anywhere else 7

    def _rounded(self, settings: Array) -> Array:
        """Returns the angles of the table's axes, rounded to hundredths of a degree, as an operator would set them. The rounded
        angles stay within the limits of the axes."""
        step = math.radians(10.0**-DECIMALS)
        low, high = np.array([(axis.lowest, axis.highest) for axis in self.axes]).T
        return np.clip(np.round(settings / step) * step, low, high)

    def _settings(self, attitudes: Sequence[Array]) -> Array:
        return np.array([joint_angles(self.axes, one, np.zeros(len(self.axes)), self.azimuth) for one in attitudes])

    def _weighting(self, criterion: str) -> Array | None:
        """Returns the matrix of the linear criterion for the search; None for the criteria D and G. For G, the set that was found
        for criterion D is improved afterwards."""
        if criterion in "DG":
            return None
        return np.eye(self.terms) if criterion == "A" else region_moment(self.region_rows)

    def _cardinal(self, rows: Array, weighting: Array | None) -> exchange.Chosen:
        def tell(part: float) -> None:
            self.progress("cardinal orientations", part)

        if self.count > len(rows):
            return exchange.exchange(
                rows, self.count, weighting, seed=self.asked.seed, repeats=True, fixed=self.fixed, progress=tell
            )[0]
        return exchange.choose(rows, self.count, weighting, seed=self.asked.seed, fixed=self.fixed, progress=tell)

    def _flattened(self, rows: Array, indices: exchange.Indices) -> exchange.Indices:
        """Returns the indices of the chosen rows. For criterion G, rows are first replaced by other rows to reduce the largest
        variance."""
        if self.asked.criterion != "G":
            return indices
        return worst_variance.exchange(
            rows, indices, self.region_rows, repeats=self.count > len(rows), fixed=self.fixed
        )

    def _ordered(self, attitudes: Sequence[Array]) -> list[Array]:
        try:
            return [attitudes[index] for index in positions.quick_order(self.axes, attitudes, self.azimuth)]
        except Unreachable as error:
            raise EstimationError(f"a position is outside the table's reach after rounding: {error}") from None

    def _merit(self, rows: Array) -> Merit:
        return merit(rows, self.region_rows, fixed=self.sight.fixed)

    def _references(
        self, region: optimal.Region, cardinal_rows: Array, free: Array, found: Mapping[str, Sequence[Array]]
    ) -> tuple[dict[str, Merit], dict[str, Bounds]]:
        """Returns the best sets found and the upper bounds, for cardinal orientations and for all orientations that the table can
        reach. Each criterion has a separate search."""
        merits = [self._merit(self.sight.rows(np.array(attitudes))) for attitudes in found.values()]
        continuous_ones = {}
        for number, criterion in enumerate(_WITH_BOUND):
            self.progress("bounds", number / len(_WITH_BOUND))
            weighting = self._weighting(criterion)
            settings = free
            if criterion != self.asked.criterion:
                settings = optimal.search(
                    region,
                    self.count,
                    weighting,
                    restarts=3,
                    seed=self.asked.seed,
                    starts=[free],
                    fixed=self.fixed,
                    workers=self.workers,
                ).settings
                merits.append(self._merit(region.rows_of(settings)))
            continuous_ones[criterion] = optimal.bound(region, settings, weighting, fixed=self._per_observation())
        merits.append(self._merit(region.rows_of(worst_variance.refine(region, free, region.rows, self.fixed))))
        best = {"free": _best([one for one in merits if one.sound])}
        limits = {"free": self._bounds(continuous_ones)}
        if "cardinal" in found:
            sets = [
                exchange.exchange(
                    cardinal_rows, self.count, self._weighting(name), seed=self.asked.seed,
                    repeats=self.count > len(cardinal_rows), fixed=self.fixed,
                )[0]
                for name in _WITH_BOUND
            ]  # fmt: skip
            flattened = worst_variance.exchange(
                cardinal_rows,
                sets[0].indices,
                self.region_rows,
                repeats=self.count > len(cardinal_rows),
                fixed=self.fixed,
            )
            own = [self._merit(cardinal_rows[chosen]) for chosen in (*(one.indices for one in sets), flattened)]
            best["cardinal"] = _best([self._merit(self.sight.rows(np.array(found["cardinal"]))), *own])
            limits["cardinal"] = self._bounds(
                {
                    name: continuous.solve(cardinal_rows, self._weighting(name), fixed=self._per_observation())
                    for name in _WITH_BOUND
                }
            )
        self.progress("bounds", 1.0)
        return best, limits

    def _per_observation(self) -> Array | None:
        return None if self.fixed is None else self.fixed / self.count

    def _bounds(self, designs: Mapping[str, continuous.Continuous]) -> Bounds:
        n, p = self.count, self.terms
        # The bound of G is that of D's equivalence theorem, which holds where nothing is fixed.
        least = p / n if self.fixed is None else math.nan
        limit = Merit(
            n, p, p, designs["D"].determinant_bound(n), designs["A"].trace_bound(n), least, designs["I"].trace_bound(n)
        )
        return Bounds(limit, designs["D"].largest_variance)

    # -- what a set would be -----------------------------------------------------------------------------------------

    def _set(
        self, name: str, attitudes: Sequence[Array], best: Mapping[str, Merit], limits: Mapping[str, Bounds]
    ) -> PositionSet:
        own = self._merit(self.sight.rows(np.array(attitudes)))
        words = all(np.allclose(np.abs(one).max(axis=1), 1.0, atol=1e-12) for one in attitudes)
        texts = tuple(
            place.segments[0].orientation if name == "planned" else orientation_text(one, self._decimals)
            for place, one in zip(self.places, attitudes, strict=True)
        )
        schedule, designs = (
            (self.schedule, self.checked.designs)
            if name == "planned"
            else _moved(self.checked, dict(zip((place.mark for place in self.places), attitudes, strict=True)))
        )
        return PositionSet(
            tuple(attitudes), texts, own, efficiency(own, best["free"]), efficiency(own, limits["free"].merit),
            efficiency(own, best["cardinal"]) if words and "cardinal" in best else None, schedule, designs,
        )  # fmt: skip

    def _dwells(self, chosen: PositionSet) -> tuple[tuple[float, ...], float]:
        """Returns the dwell at each position within the time budget, and the D-efficiency of equal dwells relative to these
        dwells."""
        if self.asked.time is None:
            return (), 1.0
        used = [chosen.schedule.segments[segment.index] for place in self.places for segment in place.segments]
        spent = chosen.schedule.total - sum(segment.dwell or 0.0 for segment in used)
        available = self._left(spent, "moving, settling and the other segments take")
        rows = self.sight.rows(np.array(chosen.attitudes))
        if not chosen.merit.sound:
            raise EstimationError("longer dwells cannot help if the positions do not separate all terms")
        shares = optimal.allocate(rows, self._weighting(self.asked.criterion), fixed=self._per_observation())
        equal = self._merit(rows)
        allotted = merit(rows, self.region_rows, shares * self.count, self.sight.fixed)
        gain = getattr(efficiency(equal, allotted), self.asked.criterion)
        return tuple(float(math.floor(available * share)) for share in shares), float(gain)

    def _text(self, chosen: PositionSet, dwells: Sequence[float]) -> str:
        marks = [place.mark for place in self.places]
        texts = {} if self.asked.orientations == "planned" else dict(zip(marks, chosen.texts, strict=True))
        return _with_positions(self.checked, texts, dict(zip(marks, dwells, strict=True)) if dwells else {})


def _moved(checked: Checked, attitudes: Mapping[_Mark, NDArray[np.float64]]) -> tuple[Schedule, dict[str, Design]]:
    """Replaces orientations of the plan. Returns the schedule of the new plan, with the real transition times, and the designs of
    its estimates. `attitudes`: maps the position of each orientation in the plan's text to the new attitude (3, 3). Raises
    `EstimationError` if the bench cannot execute this plan."""
    assert checked.plan is not None and checked.models is not None and checked.models.sensor is not None
    new = {
        place: Orientation(in_words(attitude), tuple(map(tuple, attitude.tolist())))
        for place, attitude in attitudes.items()
    }
    stated = []
    for item in expand(checked.plan, Findings()):
        mark = item.marks.get("orientation")
        changed = new.get((mark.line, mark.column)) if mark else None
        stated.append(replace(item, state=replace(item.state, orientation=changed)) if changed else item)
    log = Findings()
    schedule = build_schedule(stated, checked.models, log, checked.plan.mounting)
    if log.errors:
        raise EstimationError(f"the bench cannot do it: {log.errors[0].message}")
    designs: dict[str, Design] = {}
    for name, spec in checked.plan.estimates.items():
        with contextlib.suppress(EstimationError):  # an estimate that is not designed for may make no sense here
            design = design_of(
                name, spec, schedule.segments, checked.models.site, checked.models.sensor, designs, checked.setup
            )
            if design is not None:
                designs[name] = design
    return schedule, designs


def _with_positions(checked: Checked, orientations: Mapping[_Mark, str], dwells: Mapping[_Mark, float]) -> str:
    """Returns the text of the plan with other orientations and, if they are given, with other dwells [s]. Raises `EstimationError`
    if an orientation cannot be written to the plan."""
    text = source.decode(checked.plan_bytes, checked.file)
    try:
        if dwells:
            return with_dwells(text, {place: f"{dwell:g} s" for place, dwell in dwells.items()}, orientations)
        return with_orientations(text, orientations) if orientations else text
    except RewriteError as error:
        raise EstimationError(f"{checked.file}: {error}") from None


def _best(merits: Sequence[Merit]) -> Merit:
    """Returns the best value of each criterion among the sets."""
    one = merits[0]
    return Merit(
        one.observations, one.terms, one.terms, max(m.determinant for m in merits), min(m.trace for m in merits),
        min(m.worst for m in merits), min(m.mean for m in merits),
    )  # fmt: skip

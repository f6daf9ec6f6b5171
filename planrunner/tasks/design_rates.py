"""Designs the rates of a plan within a time budget. Finds the pairs of rates that give the most information about a scale factor,
and determines how long to record at each pair.

The estimator determines the information that each rate gives. The design changes only one sweep of the plan. With the terms of a
straight line alone, the design would contain only the largest rates. By default, the columns |rate| and rate³ are therefore added
to the estimator's terms. These columns describe asymmetry and nonlinearity, which a scale-factor test also reports.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.findings import Findings, InputError
from planrunner.base.workers import ALONE, Workers
from planrunner.design import bundles
from planrunner.design.study import Asked, FoundRates, RateSet
from planrunner.estimators.interface import DesignBlock, DesignRequest, EstimationError, estimator_of
from planrunner.physics.kinematics import TableAxis, Unreachable, joint_angles, spin_axis, spin_up_time
from planrunner.plan import source
from planrunner.plan.expand import expand
from planrunner.plan.rewriting import RewriteError, with_rates
from planrunner.plan.schedule import Segment, Spin
from planrunner.plan.segments import Turns
from planrunner.plan.selection import Detection, select
from planrunner.tasks.check import Checked, Document, check_plan

STEPS = 12  # parts of the largest rate: an operator can distinguish such rates, and they are round numbers if the largest is round
TERMS_BESIDE = ("|rate|", "rate^3")
LEAST_SHARE = 0.25  # of an equal share of the time, which every rate keeps, so that none is lost for checking the line
_COPY = "designed rate "


def has_rates_alone(checked: Checked, estimate: str | None = None) -> bool:
    """Returns True if a plan is suitable only for a design of its rates. This is the case if the plan's first estimate over
    several rates fits a straight line. The rates may form one sweep or several. `design_rates` can design only one sweep; it
    raises an error with a hint if there are several."""
    if checked.schedule is None or checked.plan is None:
        return False
    for name in [estimate] if estimate is not None else checked.plan.estimates:
        design = checked.designs.get(name)
        if design is not None and design.blocks and name in checked.plan.estimates:
            rates = {abs(one.motion.rate) for one in _used(checked, name) if isinstance(one.motion, Spin)}
            if len(rates) > 1:
                return len(design.blocks[0].terms) == 2
    return False


def _used(checked: Checked, name: str) -> tuple[Segment, ...]:
    """Returns the segments from which an estimate is made."""
    assert checked.plan is not None and checked.schedule is not None
    chosen = checked.plan.estimates[name].segments
    patterns = chosen.within if isinstance(chosen, Detection) else chosen
    segments = checked.schedule.segments
    return tuple(segments[index] for index in select([one.label for one in segments], patterns))


def design_rates(checked: Checked, asked: Asked, bench: str | None = None, workers: Workers = ALONE) -> FoundRates:
    """Designs the rates of a plan. Raises `InputError` with the findings about the plan, and `EstimationError` if there are no
    rates to design. `bench`: as for `check_plan`. `workers`: processes that share the starting points of the search."""
    if checked.findings.errors or checked.schedule is None:
        raise InputError(checked.findings)
    if asked.criterion not in ("D", "A"):
        raise EstimationError(f"rates can be designed by D or A, not by {asked.criterion}")
    return _RateDesigner(checked, asked, bench).study(workers)


@dataclass(frozen=True, slots=True)
class _Sweep:
    """Describes a sweep over rates: its segments, and all segments that the estimate uses. `mark`: line and column in the plan's
    text at which the rates begin."""

    name: str
    mark: tuple[int, int]
    moved: tuple[Segment, ...]
    used: tuple[Segment, ...]


_ONE_SWEEP = (
    "only one sweep can be designed at a time: copy the plan with a single sweep over both signs, such as `rate: "
    "'±400, ±200, ±100 deg/s'`, "
    "design that plan, and copy the rates found to the sweeps of this plan"
)


def _sweep(checked: Checked, wanted: str | None) -> _Sweep:
    assert checked.plan is not None and checked.schedule is not None
    problems = []
    swept = False
    for name in checked.plan.estimates:
        if wanted not in (None, name):
            continue
        design = checked.designs.get(name)
        if design is None or not design.blocks:
            problems.append(f"'{name}' has no design matrix")
            continue
        used = _used(checked, name)
        sweeps: dict[tuple[int, int], list[Segment]] = {}
        for segment in used:
            if isinstance(segment.motion, Spin) and "rate" in segment.marks:
                mark = segment.marks["rate"]
                sweeps.setdefault((mark.line, mark.column), []).append(segment)
        several = {mark: found for mark, found in sweeps.items() if len({abs(one.rate) for one in found}) > 1}
        if len(several) == 1:
            ((place, moved),) = several.items()
            return _Sweep(name, place, tuple(moved), used)
        if not several:
            problems.append(f"the segments of '{name}' do not come from a sweep over rates")
            continue
        lines = ", ".join(str(line) for line, _ in sorted(several))
        problems.append(f"the segments of '{name}' come from {len(several)} sweeps over rates (lines {lines})")
        swept = True
    if wanted is not None and wanted not in checked.plan.estimates:
        problems.append(f"the plan has no estimate '{wanted}'; it has {', '.join(checked.plan.estimates)}")
    if swept:
        problems.append(_ONE_SWEEP)
    raise EstimationError("; ".join(problems) or "the plan has no estimates, so there is nothing to design for")


class _RateDesigner:
    def __init__(self, checked: Checked, asked: Asked, bench: str | None):
        assert checked.plan and checked.models and checked.schedule and checked.models.sensor
        self.checked, self.asked, self.bench = checked, asked, bench
        if checked.models.table is None or checked.models.replays:
            raise EstimationError(
                "this bench has no table that can turn at other rates; choose another bench with --bench"
            )
        self.sweep = _sweep(checked, asked.estimate)
        self.spec = checked.plan.estimates[self.sweep.name]
        self.planned = tuple(sorted({abs(one.rate) for one in self.sweep.moved}, reverse=True))
        self.largest = self.planned[0]
        self.pattern = [one for one in self.sweep.moved if abs(one.rate) == self.largest]
        for rate in self.planned:
            signs = sorted(math.copysign(1, one.rate) for one in self.sweep.moved if abs(one.rate) == rate)
            if signs != sorted(math.copysign(1, one.rate) for one in self.pattern):
                raise EstimationError(
                    "the rates differ in their signs or in their number of repeats: write them as one sweep with ±"
                )
        self.stated = {item.label: item.state for item in expand(checked.plan, Findings())}
        self.axis = self._axis()
        planned_block = self._blocks(self.sweep.used)[0]
        self.output, self.scale = planned_block.output, np.asarray(planned_block.magnitudes, dtype=float)
        beside = () if asked.line_only or len(planned_block.terms) > 2 else TERMS_BESIDE
        self.terms = (*planned_block.terms, *beside)
        self.unit_sigma = float(np.min(planned_block.sigma)) or 1.0
        others = {one.label for one in self.sweep.moved}
        self.fixed = self._information(planned_block, [label not in others for label in planned_block.labels], 0.0)

    def _axis(self) -> TableAxis:
        models, segment = self.checked.models, self.pattern[0]
        assert models is not None and models.table is not None and isinstance(segment.motion, Spin)
        axes, azimuth = models.table.axes, models.site.azimuth
        try:
            joints = (
                np.zeros(len(axes))
                if segment.attitude is None
                else joint_angles(axes, segment.attitude, np.zeros(len(axes)), azimuth)
            )
            return axes[spin_axis(axes, joints, segment.motion.about, azimuth)]
        except Unreachable as error:
            raise EstimationError(str(error)) from None

    # -- information from a rate ---------------------------------------------------------------------------------------

    def _block(self, segments: Sequence[Segment]) -> DesignBlock:
        """Returns the block of design rows for the output that is studied."""
        return next(one for one in self._blocks(segments) if one.output == self.output)

    def _blocks(self, segments: Sequence[Segment]) -> Sequence[DesignBlock]:
        checked = self.checked
        assert checked.models is not None and checked.models.sensor is not None
        uses = {used: checked.designs[used] for used in self.spec.uses if used in checked.designs}
        request = DesignRequest(
            self.sweep.name,
            tuple(segments),
            self.spec.parameters,
            checked.models.site,
            checked.models.sensor,
            uses,
            checked.setup,
        )
        design = estimator_of(self.spec).design(request)
        assert design is not None
        return design.blocks

    def _information(self, block: DesignBlock, kept: Sequence[bool], rate: float) -> Array:
        """Returns the information matrix (p, p) of p terms from the rows of the block that `kept` selects, weighted with the noise
        of each row. The unit is the information of one observation at the largest rate."""
        mask = np.array(kept, dtype=bool)
        rows = np.asarray(block.matrix)[mask] / self.scale
        if len(self.terms) > rows.shape[1]:
            x = rate / self.largest * np.sign(rows[:, 1]) if rate else np.zeros(len(rows))
            rows = np.column_stack([rows, np.abs(x), x**3])
        weighted = rows * (self.unit_sigma / np.asarray(block.sigma)[mask])[:, None]
        return np.asarray(weighted.T @ weighted)

    def _bundles(self, rates: Sequence[float], dwells: Sequence[float] | None = None) -> Array:
        """Returns the information matrix (p, p) of p terms at each of n rates, shape (n, p, p). Each matrix contains the
        information from all repeats of the pair of segments with that rate. The segments are copies of the planned pair at the
        largest rate, with the rate changed."""
        copies = []
        for number, rate in enumerate(rates):
            seconds = self._dwell(rate) if dwells is None else dwells[number]
            for one in self.pattern:
                assert isinstance(one.motion, Spin)
                motion = replace(one.motion, rate=math.copysign(rate, one.rate))
                copies.append(replace(one, label=f"{_COPY}{number}", motion=motion, dwell=seconds))
        others = {one.index for one in self.sweep.moved}
        block = self._block([*(one for one in self.sweep.used if one.index not in others), *copies])
        return np.array(
            [
                self._information(block, [label == f"{_COPY}{number}" for label in block.labels], rate)
                for number, rate in enumerate(rates)
            ]
        )

    def _dwell(self, rate: float) -> float:
        """Returns the dwell [s] at a rate, computed from the dwell that the plan states for its largest rate."""
        stated = self.stated[self.pattern[0].label].dwell
        if isinstance(stated, Turns):
            period = 2 * math.pi / rate
            least = 0 if stated.at_least is None else math.ceil(stated.at_least.value / period - 1e-9)
            return max(stated.turns or 1, least) * period
        if self.pattern[0].dwell is None:
            raise EstimationError("the rates dwell for the length of their recording, so they cannot be designed")
        return self.pattern[0].dwell

    def _overhead(self, rate: float) -> float:
        """Returns the time [s] that one segment at a rate takes in addition to its dwell."""
        return 2 * spin_up_time(self.axis, rate) + self.pattern[0].settle

    # -- the study -----------------------------------------------------------------------------------------------------

    def study(self, workers: Workers) -> FoundRates:
        grid = sorted({*self.planned, *(self.largest * k / STEPS for k in range(1, STEPS + 1))}, reverse=True)
        added = self._bundles(grid)
        kept = [grid.index(self.planned[-1])] if self.asked.keep_lowest else []
        try:
            chosen = bundles.choose(added, self.fixed, len(self.planned), self.asked.criterion, kept, workers=workers)
            costs = np.array([self._dwell(rate) + self._overhead(rate) for rate in grid])
            own = sum(self._dwell(rate) + self._overhead(rate) for rate in self.planned)
            part, excess = bundles.shares(added * (own / costs)[:, None, None], self.fixed, self.asked.criterion)
        except ValueError as error:
            raise EstimationError(f"no suitable rates up to the largest of the plan: {error}") from None
        bound = bundles.loss(self.fixed + np.tensordot(part * own / costs, added, 1), self.asked.criterion)
        best = tuple(grid[index] for index in chosen)
        least = bundles.loss(self.fixed + added[list(chosen)].sum(axis=0), self.asked.criterion)
        dwells = self._allotted(best)
        text = self._text(best, dwells)
        sets = {
            "planned": self._set(self.planned, None, least, bound, own, self.checked),
            "best": self._set(best, dwells, least, bound, own, self._with(text)),
        }
        return FoundRates(
            self.sweep.name, self.output, self.terms, self.asked, sets, self._course(), excess,
            len(self.pattern) // len({one.rate for one in self.pattern}), text,
        )  # fmt: skip

    def _course(self) -> Array:
        return np.linspace(-self.largest, self.largest, 201)

    def _set(
        self,
        rates: Sequence[float],
        dwells: Sequence[float] | None,
        least: float,
        bound: float,
        own: float,
        checked: Checked,
    ) -> RateSet:
        matrix = self.fixed + self._bundles(rates).sum(axis=0)
        loss = bundles.loss(matrix, self.asked.criterion)
        times = dwells or [self._dwell(rate) for rate in rates]
        spent = sum(times) + sum(map(self._overhead, rates))
        timed = bundles.loss(self.fixed + self._bundles(rates, times).sum(axis=0), self.asked.criterion)
        x = self._course() / self.largest
        columns = np.column_stack([np.ones_like(x), x * self.largest / self.scale[1], np.abs(x), x**3])[
            :, : len(self.terms)
        ]
        variance = (
            np.einsum("ij,jk,ik->i", columns, np.linalg.inv(matrix), columns)
            if math.isfinite(loss) and len(self.terms) in (2, 4)
            else np.array([])
        )
        assert checked.schedule is not None
        return RateSet(
            tuple(rates), tuple(times), loss, self._share(least, loss),
            self._share(bound, timed) * own / spent, variance, checked.designs[self.sweep.name].predicted, checked.schedule.total,
        )  # fmt: skip

    def _share(self, reference: float, loss: float) -> float:
        if math.isinf(loss):
            return 0.0
        return math.exp((reference - loss) / len(self.terms)) if self.asked.criterion == "D" else reference / loss

    def _allotted(self, rates: Sequence[float]) -> tuple[float, ...] | None:
        """Returns the dwell [s] at each rate within the time budget, as a whole number of turns; None without a budget. `rates`:
        sorted, the largest first."""
        if self.asked.time is None:
            return None
        assert self.checked.schedule is not None
        runs = len(self.pattern)
        spent = self.checked.schedule.total - sum(one.dwell or 0.0 for one in self.sweep.moved)
        spent += runs * (sum(map(self._overhead, rates)) - sum(map(self._overhead, self.planned)))
        available = (self.asked.time - spent) / runs
        turn = [2 * math.pi / rate for rate in rates]
        if available < sum(turn):
            needed = self.asked.time + (sum(turn) - available) * runs
            raise EstimationError(
                f"one turn at every rate takes a total of {needed:.0f} s, more than {self.asked.time:.0f} s"
            )
        least = [one * max(1, math.floor(LEAST_SHARE * available / len(rates) / one)) for one in turn]
        left = max(0.0, available - sum(least))
        added = self._bundles(rates, [available] * len(rates))
        always = self.fixed + np.tensordot(np.array(least) / available, added, 1)
        part, _ = bundles.shares(added * (left / available), always, self.asked.criterion)
        return tuple(
            held + one * math.floor(left * share / one) for held, one, share in zip(least, turn, part, strict=True)
        )

    # -- the plan ------------------------------------------------------------------------------------------------------

    def _text(self, rates: Sequence[float], dwells: Sequence[float] | None) -> str:
        text = source.decode(self.checked.plan_bytes, self.checked.file)
        both = {math.copysign(1, one.rate) for one in self.pattern} == {1.0, -1.0}
        sign = "±" if both else ("-" if self.pattern[0].rate < 0 else "")
        shown = [f"{sign}{round(math.degrees(rate), 6):g} deg/s" for rate in rates]
        turns = (
            None
            if dwells is None
            else [round(one * rate / (2 * math.pi)) for one, rate in zip(dwells, rates, strict=True)]
        )
        try:
            return with_rates(text, self.sweep.mark, shown, turns)
        except RewriteError as error:
            raise EstimationError(f"{self.checked.file}: {error}") from None

    def _with(self, text: str) -> Checked:
        """Returns the plan with other rates, checked on its bench."""
        checked = check_plan(Document(text.encode(), self.checked.file), self.bench)
        if checked.schedule is None or self.sweep.name not in checked.designs:
            raise InputError(checked.findings)
        return checked

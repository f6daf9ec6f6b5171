"""Finds changes in the level of a coefficient, and other circumstances that changed at the same time.

The model is x_i ~ N(μ, σ_i²), where σ_i is known and the mean μ is constant between two changes. The likelihood ratio T_k for a
change between the values k and k + 1 compares the means m₁ before and m₂ after the change:

    T_k = (m₂ − m₁)² / (1/W₁ + 1/W₂),    W = Σ 1/σ_i²,  m = Σ x_i/σ_i² / W

The most likely position of a change has the largest T_k (Hawkins, Journal of the American Statistical Association 72, 1977). The
p-value of this position is bounded by the sum over all positions (Bonferroni), p ≤ (n − 1)·P(χ²₁ > T). The test is therefore
conservative. The values on each side of the change are then searched in the same way (binary segmentation; Scott and Knott,
Biometrics 30, 1974).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.night.history.rows import Circumstance, CircumstanceKind

LEVEL = 0.01
"""Largest p-value of a change that is reported."""


@dataclass(frozen=True, slots=True)
class CauseCandidate:
    """A circumstance that changed when the level changed. `before`, `after`: the circumstance in the last run before the change and
    in the first run after it. `shared`: the fraction of runs that agree with the change. A run before the change agrees if it has
    the circumstance `before`; a run after the change agrees if it has the circumstance `after`. A fraction of 1 means that the
    circumstance distinguishes the two groups of runs completely."""

    kind: CircumstanceKind
    name: str
    before: str
    after: str
    shared: float

    @property
    def words(self) -> str:
        return f"{self.kind.value} {self.name}".strip()


@dataclass(frozen=True, slots=True)
class ChangePoint:
    """Describes a change in the level of a coefficient.

    `index`: index of the first value after the change. `step`, `standard_uncertainty`: size of the change and its standard
    uncertainty, in the unit of the values. `p`: p-value of the change. `begin`, `end`: the change separates the values with the
    indices [begin, index) from those with the indices [index, end).
    """

    index: int
    step: float
    standard_uncertainty: float
    p: float
    begin: int
    end: int
    causes: tuple[CauseCandidate, ...] = ()


def change_points(values: Array, sigma: Array) -> tuple[ChangePoint, ...]:
    """Returns all changes of the level in chronological order. `values`: array of shape (n,), the values in chronological order.
    `sigma`: array of shape (n,), positive standard deviations of the values."""
    found = sorted(_search(values, sigma, 0, len(values)))
    edges = [0, *found, len(values)]
    points = []
    for before, index, end in zip(edges, edges[1:], edges[2:], strict=False):
        step, u = _step(values, sigma, before, index, end)
        points.append(ChangePoint(index, step, u, _p(step / u, end - before), before, end))
    return tuple(points)


def _search(values: Array, sigma: Array, begin: int, end: int) -> Iterator[int]:
    n = end - begin
    if n < 2:
        return
    weight = 1 / sigma[begin:end] ** 2
    sums, weights = np.cumsum(weight * values[begin:end]), np.cumsum(weight)
    before, after = weights[:-1], weights[-1] - weights[:-1]
    steps = (sums[-1] - sums[:-1]) / after - sums[:-1] / before
    T = steps**2 / (1 / before + 1 / after)
    k = int(np.argmax(T))
    if _p(math.sqrt(T[k]), n) > LEVEL:
        return
    index = begin + k + 1
    yield index
    yield from _search(values, sigma, begin, index)
    yield from _search(values, sigma, index, end)


def _step(values: Array, sigma: Array, begin: int, index: int, end: int) -> tuple[float, float]:
    sides = []
    for part in (slice(begin, index), slice(index, end)):
        weight = 1 / sigma[part] ** 2
        sides.append((float(np.average(values[part], weights=weight)), 1 / float(weight.sum())))
    (first, v1), (second, v2) = sides
    return second - first, math.sqrt(v1 + v2)


def _p(z: float, n: int) -> float:
    return min(1.0, (n - 1) * math.erfc(abs(z) / math.sqrt(2)))


def steps_fit_better(values: Array, sigma: Array, days: Array, changes: Sequence[ChangePoint]) -> bool:
    """Returns True if levels with these changes describe the values better than one straight line over time, by the Bayesian
    information criterion χ² + p·log n (Schwarz, Annals of Statistics 6, 1978). All arrays have the shape (n,). This comparison is
    necessary because a steady drift resembles a series of changes, although no circumstance changed."""
    n, w = len(values), 1 / sigma**2
    edges = [0, *(one.index for one in changes), n]
    steps = sum(_misfit(values[a:b], w[a:b], np.ones((b - a, 1))) for a, b in pairwise(edges))
    line = _misfit(values, w, np.column_stack([np.ones(n), days - days.mean()]))
    return steps + (2 * len(changes) + 1) * math.log(n) < line + 2 * math.log(n)


def _misfit(values: Array, weight: Array, design: Array) -> float:
    """Returns the χ² of the weighted least-squares fit of a design to the values."""
    root = np.sqrt(weight)
    fit = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
    return float((weight * (values - design @ fit) ** 2).sum())


def causes(point: ChangePoint, circumstances: Sequence[Sequence[Circumstance]]) -> tuple[CauseCandidate, ...]:
    """Returns the circumstances that changed when the level changed. The result is sorted: the first circumstance best
    distinguishes the runs before the change from the runs after it. `circumstances`: the circumstances of every run, in the order
    of the values."""
    known = [{(one.kind, one.name): one.value for one in run} for run in circumstances[point.begin : point.end]]
    split = point.index - point.begin
    before, after = known[split - 1], known[split]
    bench = (CircumstanceKind.BENCH, "")
    moved = before.get(bench) != after.get(bench)
    found = []
    for kind, name in sorted({*before, *after}, key=lambda key: (key[0].value, key[1])):
        old, new = before.get((kind, name), ""), after.get((kind, name), "")
        if old == new or (kind is CircumstanceKind.BENCH and name and moved):  # another bench has another file
            continue
        held = sum(one.get((kind, name), "") == (old if k < split else new) for k, one in enumerate(known))
        found.append(CauseCandidate(kind, name, old, new, held / len(known)))
    return tuple(sorted(found, key=lambda one: -one.shared))

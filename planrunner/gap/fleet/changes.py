"""Finds changes of an amplitude in a fleet: when the amplitude changed, and in which device or on which bench.

The estimates of one amplitude in n runs, in chronological order, are the sum of a part for each device, a part for each bench, and
possibly changes:

    y_r = d[device of r] + b[bench of r] + Σ_j x_j·h_j(r) + e_r,    e_r ~ N(0, c²·s_r²)

For a step of a device, of a bench or of all runs, h is 1 in the runs of this source from a certain run on, and 0 in all other runs.
For a drift, h is the number of days since the first run of its source. The parts are fitted without priors (analysis of
covariance), so a constant difference between devices or between benches does not count as a change. The change with the smallest
p-value is added to the model if its p-value, multiplied by the number of changes that were tried (Bonferroni), is at most `LEVEL`.
This selection is repeated until no further change qualifies. The method is a forward selection (for the place of a step, see
Hawkins, Journal of the American Statistical Association 72, 1977). The p-value of a change comes from Student's t test of its size
x_j. The factor c² is the χ²/ν of the fit with the change, but at least 1. Changes therefore become less significant if the runs
scatter more than their uncertainties s_r allow. A drift is preferred to a step only if it has the smaller p-value.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from enum import Enum

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.gap.fleet.attribution import ALL_RUNS, COVERAGE, Estimates, Source

LEVEL = 0.01
"""Largest p-value of a reported change. The p-value is corrected for the number of changes that were tried."""
LEAST = 2
"""Smallest number of runs before a step, and after it. A single run may be an outlier."""
_MOST = 5
_FIT = 1e-9
"""Tolerance of the fit. A column must keep at least this fraction of its energy when the other columns are projected out. Two
columns count as equal if their correlation differs from 1 by at most this value."""
_LIKELY = 3.84
"""Quantile 0.95 of χ² with one degree of freedom. A place of a step is possible if its χ² exceeds the smallest χ² by at most this
value."""


class ChangeKind(Enum):
    STEP = "step"
    DRIFT = "drift"


@dataclass(frozen=True, slots=True)
class FleetChange:
    """A change of an amplitude: a step or a drift.

    `sources`: the sources to which the change belongs, each with its label. There are several sources if the runs cannot
    distinguish them. `runs`: indices of the runs that belong to the first of these sources. `before`: for a step, the number of
    runs in `runs` before the step. `earliest`, `latest`: for a step, indices into `runs`. With 95 % confidence, the step occurred
    after the run `earliest` and not after the run `latest`. `size`: size of a step, or of a drift per day. `degrees_of_freedom`: ν
    of the standard uncertainty of `size`. `p`: p-value, corrected for the number of changes that were tried.
    """

    kind: ChangeKind
    sources: tuple[tuple[Source, str], ...]
    runs: tuple[int, ...]
    before: int
    earliest: int
    latest: int
    size: float
    standard_uncertainty: float
    degrees_of_freedom: int
    p: float

    @property
    def expanded(self) -> float:
        """Returns the half-width of an interval about the size that has the probability `COVERAGE` according to Student's t
        distribution."""
        from scipy.stats import t as student

        return self.standard_uncertainty * float(student.ppf((1 + COVERAGE) / 2, self.degrees_of_freedom))


@dataclass(frozen=True)
class _Candidate:
    kind: ChangeKind
    source: Source
    label: str
    runs: tuple[int, ...]
    place: int
    column: Array


@dataclass(frozen=True)
class _Tried:
    """The result of fitting one candidate change.

    `size`, `u`, `freedom`, `p`: estimated size, standard uncertainty, degrees of freedom and p-value. `chi2`: χ² of the fit with
    this change. `factor`: c², by which the variances are multiplied. `direction`: the column of the change, made orthogonal to the
    other columns and scaled to length 1.
    """

    candidate: _Candidate
    size: float
    u: float
    freedom: int
    p: float
    chi2: float
    factor: float
    direction: Array


def changes(given: Estimates, days: Sequence[float], amplitudes: int = 1) -> tuple[FleetChange, ...]:
    """Finds the changes of an amplitude, the most significant first.

    `given`: estimates of the amplitude in chronological order, with groups for device and bench. `days`: time of every run, in days.
    `amplitudes`: number of amplitudes that are examined; p-values are corrected for this number of tests.
    """
    time = np.asarray(days, dtype=float)
    listed = list(_candidates(given, time))
    root = 1 / given.standard_uncertainties
    design = [root[:, None] * _dummies(given.groups[source]) for source in (Source.DEVICE, Source.BENCH)]
    found: list[FleetChange] = []
    while len(found) < _MOST:
        tried = list(_tried(np.hstack(design), given.values * root, [(one, one.column * root) for one in listed]))
        if not tried:
            break
        best = min(tried, key=lambda one: one.p)
        p = min(1.0, best.p * len(tried) * amplitudes)
        if p > LEVEL:
            break
        found.append(_change(best, tried, p))
        design.append((best.candidate.column * root)[:, None])
    return tuple(found)


def since_steps(found: Sequence[FleetChange], moments: Sequence[str]) -> dict[Source, list[str]]:
    """Returns the moments of steps in the form of `Estimates.since`: for each run, the moment of the latest step of its device or
    bench at or before this run. `moments`: moment of every run, in chronological order. If several sources may have caused a step, the
    step is attributed to the first of them. A step that all runs have in common does not begin new groups."""
    since = {source: [""] * len(moments) for source in (Source.DEVICE, Source.BENCH)}
    for change in sorted(found, key=lambda one: one.before):
        source, _ = change.sources[0]
        if change.kind is ChangeKind.STEP and source in since:
            after = change.runs[change.before :]
            for k in after:
                since[source][k] = moments[after[0]]
    return since


def _dummies(labels: Sequence[str]) -> Array:
    names = sorted(set(labels))
    return np.array([[float(label == name) for name in names] for label in labels])


def _candidates(given: Estimates, time: Array) -> Iterator[_Candidate]:
    n = len(time)
    groups = {**given.groups, Source.COMMON: [ALL_RUNS] * n}
    for source in (Source.BENCH, Source.DEVICE, Source.COMMON):
        labels = groups[source]
        for label in dict.fromkeys(labels):
            runs = tuple(k for k in range(n) if labels[k] == label)
            for place in range(LEAST, len(runs) - LEAST + 1):
                if time[runs[place]] > time[runs[place - 1]]:
                    column = np.zeros(n)
                    column[list(runs[place:])] = 1.0
                    yield _Candidate(ChangeKind.STEP, source, label, runs, place, column)
            if len({time[k] for k in runs}) > LEAST:
                column = np.zeros(n)
                column[list(runs)] = time[list(runs)] - time[runs[0]]
                yield _Candidate(ChangeKind.DRIFT, source, label, runs, 0, column)


def _tried(design: Array, y: Array, listed: Sequence[tuple[_Candidate, Array]]) -> Iterator[_Tried]:
    """Fits every candidate change that is not already a combination of the columns of the design. `design` (n, m) and `y` (n,) are
    weighted with 1/s, where s is the standard uncertainty of the run. `listed`: the candidates, each with its column (n,), weighted
    in the same way."""
    from scipy.stats import t as student

    left, values, _ = np.linalg.svd(design, full_matrices=False)
    basis = left[:, values > 1e-10 * values.max()]
    rest = y - basis @ (basis.T @ y)
    chi2, freedom = float(rest @ rest), len(y) - basis.shape[1] - 1
    if freedom < 1:
        return
    for candidate, column in listed:
        beside = column - basis @ (basis.T @ column)
        length = float(np.linalg.norm(beside))
        if length <= math.sqrt(_FIT) * float(np.linalg.norm(column)):
            continue
        size = float(beside @ rest) / length**2
        left_over = max(0.0, chi2 - (size * length) ** 2)
        factor = max(1.0, left_over / freedom)
        u = math.sqrt(factor) / length
        p = 2 * float(student.sf(abs(size) / u, freedom))
        yield _Tried(candidate, size, u, freedom, p, left_over, factor, beside / length)


def _change(best: _Tried, tried: Sequence[_Tried], p: float) -> FleetChange:
    one = best.candidate
    alike = [
        (other.candidate.source, other.candidate.label)
        for other in tried
        if other is not best
        and abs(abs(float(other.direction @ best.direction)) - 1) < _FIT
        and other.candidate.kind is one.kind
    ]
    places = [
        other.candidate.place
        for other in tried
        if (other.candidate.kind, other.candidate.source, other.candidate.label) == (one.kind, one.source, one.label)
        and other.chi2 <= best.chi2 + _LIKELY * best.factor
    ]
    return FleetChange(
        one.kind,
        tuple(dict.fromkeys([(one.source, one.label), *alike])),
        one.runs,
        one.place,
        max(0, min(places) - 1),
        max(places),
        best.size,
        best.u,
        best.freedom,
        p,
    )

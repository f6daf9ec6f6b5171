"""Computes the deviations of one phase record at chosen averaging times, each with its noise type, degrees of freedom and
confidence interval."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from planrunner.base.arrays import Array, Integers
from planrunner.base.dataclass import dataclass
from planrunner.estimators.allan.confidence import freedom_of_runs, interval, noise_exponent
from planrunner.estimators.allan.phase import Phase

KINDS = ("overlapping", "modified", "hadamard")


@dataclass(frozen=True, slots=True)
class Deviation:
    """The deviation at one averaging time.

    `kind`: one of `KINDS`. `factor`: averaging factor m. `tau`: averaging time, s. `terms`: number of terms in the sum. `value`:
    the deviation, in the output's unit. `freedom`: its equivalent degrees of freedom. `alpha`: noise exponent for which the degrees
    of freedom were computed. `carried`: True if alpha was adopted from a shorter averaging time. `low`, `high`: limits of the
    confidence interval.
    """

    kind: str
    factor: int
    tau: float
    terms: int
    value: float
    alpha: int
    carried: bool
    freedom: float
    low: float
    high: float


def octave_factors(lengths: Integers) -> Integers:
    """Returns the averaging factors 1, 2, 4 and so on, as long as the longest run gives at least four averages. The factor 1 is
    always included. `lengths`: number of phase points of each run."""
    longest = int(lengths.max()) - 1
    last = max(1, longest // 4)
    return 2 ** np.arange(int(math.log2(last)) + 1, dtype=np.int64)


def deviations(phase: Phase, kind: str, factors: Integers, probability: float) -> list[Deviation]:
    """Computes the deviations of one kind, in the output's unit. `probability`: confidence level of the intervals. Averaging
    factors for which the record is too short are left out."""
    order = 3 if kind == "hadamard" else 2
    span = 3 if kind in ("hadamard", "modified") else 2
    lengths = phase.lengths
    wanted = factors[span * factors + (0 if kind == "modified" else 1) <= lengths.max()]
    if not wanted.size:
        return []
    sums = _sum_over_runs(phase.runs, kind, wanted)
    extra = 1 if kind == "modified" else 0
    found = []
    alpha: int | None = None
    for total, factor in zip(sums, wanted.tolist(), strict=True):
        terms = int(np.clip(lengths - span * factor + extra, 0, None).sum())
        own = noise_exponent(phase.runs, factor, alpha)
        carried = own is None
        alpha = own if own is not None else alpha if alpha is not None else 0
        freedom = freedom_of_runs(alpha, order, factor, lengths, kind == "modified")
        scale = {"overlapping": 2.0, "modified": 2.0 * factor**2, "hadamard": 6.0}[kind] * float(factor) ** 2
        value = math.sqrt(total / (scale * terms))
        low, high = interval(value, freedom, probability)
        found.append(Deviation(kind, factor, factor * phase.interval, terms, value, alpha, carried, freedom, low, high))
    return found


def _sum_over_runs(runs: Sequence[Array], kind: str, factors: Integers) -> Array:
    from planrunner.estimators.allan import kernel as allan_kernel

    kernel: Callable[[Array, Integers], Array] = {
        "overlapping": allan_kernel.second_differences,
        "modified": allan_kernel.averaged_second_differences,
        "hadamard": allan_kernel.third_differences,
    }[kind]
    total = np.zeros(factors.size)
    for run in runs:
        total += kernel(run, factors)
    return total

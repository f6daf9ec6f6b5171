"""Computes continuous designs: the fraction of the observations that each candidate gets, and a bound that no set of observations
can exceed.

By the equivalence theorem (Kiefer & Wolfowitz, Canad. J. Math. 12, 1960) a design is D-optimal if and only if the variance d(x) =
xᵀM⁻¹x is not larger than p for any candidate x. The multiplicative algorithm (Titterington 1976; Yu, Ann. Statist. 38, 2010)
changes the fractions by w_i ← w_i·d_i/p, which increases |M| in every step. The search is completed by steps of Fedorov and Wynn
(Todd & Yıldırım 2007): towards the candidate with the largest d, and away from the candidate with the smallest d. The excess of max
d over p is a certificate for the design ξ that was found: by the inequality of arithmetic and geometric means, |M(η)| ≤ |M(ξ)|·(max
d/p)^p for every other design η. A linear criterion is tr(W·M⁻¹); if W is the identity matrix, it is criterion A. In the formulas
for a linear criterion, xᵀM⁻¹WM⁻¹x replaces d, tr(W·M⁻¹) replaces p, and the step is w_i ← w_i·√(d_i/p).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planrunner.base.arrays import Array
from planrunner.design.efficiency import information

MOST_ROUNDS = 6  # largest number of rounds of climbing
NEGLIGIBLE = 1e-8  # fractions below this value are removed from a solution


@dataclass(frozen=True, slots=True)
class Continuous:
    """An optimal continuous design: the fraction of the observations for each candidate, not rounded to whole numbers of
    observations.

    `shares`: array of shape (N,), the fractions, which add up to 1. `matrix`: array of shape (p, p), the information matrix M per
    observation. `excess`: the ratio of the largest derivative of the criterion to `mean`, minus 1. A value of 1e-6 means that no
    design is better by more than one part in a million. `value`: |M| (criterion D) or tr(W·M⁻¹). `mean`: mean of the derivative
    over the candidates, weighted by `shares`. Without fixed information, this mean is p (criterion D) or `value` (linear
    criterion); with fixed information, it is smaller.
    """

    shares: Array
    matrix: Array
    excess: float
    value: float
    weighting: Array | None
    mean: float

    @property
    def largest_variance(self) -> float:
        """Returns the certificate of a D-optimal design: max d(x) over the candidates. At the optimum, max d(x) is p, or `mean` if
        there is fixed information."""
        return self.mean * (1.0 + self.excess)

    def determinant_bound(self, observations: int) -> float:
        """Returns an upper bound of |M| for any set with this number of observations (criterion D)."""
        # ln|M| is concave. For any other design, it is larger by at most the largest derivative minus the mean derivative.
        return float(observations ** len(self.matrix) * self.value * np.exp(self.mean * self.excess))

    def trace_bound(self, observations: int) -> float:
        """Returns a lower bound of tr(W·M⁻¹) for any set with this number of observations (linear criteria)."""
        # tr(W·M⁻¹) is convex; the bound follows in the same way.
        return (self.value - self.mean * self.excess) / observations


def derivative(rows: Array, matrix: Array, weighting: Array | None) -> Array:
    """Returns the derivative of the criterion for each row x of `rows` (N, p), shape (N,). The derivative is xᵀM⁻¹x for criterion
    D, and xᵀM⁻¹WM⁻¹x for a linear criterion. `matrix`: the information matrix M (p, p). `weighting`: the matrix W (p, p), None for
    criterion D."""
    inverse = np.linalg.inv(matrix)
    middle = inverse if weighting is None else inverse @ weighting @ inverse
    return np.asarray(np.einsum("ij,ij->i", rows @ middle, rows))


def solve(
    rows: Array,
    weighting: Array | None = None,
    *,
    least: float = 0.0,
    tolerance: float = 1e-6,
    most_steps: int = 20_000,
    start: Array | None = None,
    fixed: Array | None = None,
) -> Continuous:
    """Returns the optimal fractions of the observations for the candidates `rows`, shape (N, p), which must have rank p.

    `weighting`: the matrix W (p, p) of the criterion tr(W·M⁻¹), or None for criterion D. `least`: smallest fraction that any
    candidate may have. `start`: fractions with which the iteration starts. `fixed`: array of shape (p, p), information per
    observation that does not depend on the fractions. The iteration ends when the excess (see `Continuous`) is at most `tolerance`,
    or after `most_steps`. The result contains the remaining excess. The bounds that `determinant_bound` and `trace_bound` return
    take this excess into account. Raises ValueError if the candidates cannot determine all terms.
    """
    rows = np.asarray(rows, dtype=float)
    count, p = rows.shape
    always = np.zeros((p, p)) if fixed is None else fixed
    plain = least == 0.0 and fixed is None
    if np.linalg.matrix_rank(information(rows) + always) < p:
        raise ValueError("the candidates cannot separate all terms")
    if not 0.0 <= least * count < 1.0:
        raise ValueError("the minimum shares must not be negative, and their sum must be less than 1")
    free = np.full(count, 1.0 / count) if start is None else np.maximum(start, 1e-6 / count)
    free /= free.sum()
    held, loose = least * information(rows) + always, 1.0 - least * count
    alive = np.arange(count)
    for step in range(most_steps):
        kept = rows[alive]
        gain = derivative(kept, held + loose * information(kept, free), weighting)
        mean = float(free @ gain)
        excess = float(gain.max()) / mean - 1.0
        if excess <= tolerance:
            break
        if weighting is None and plain and step >= 30:
            free = _step(free, gain, p)
        else:
            free = free * (gain / mean) ** (1.0 if weighting is None else 0.5)
            free /= free.sum()
        if weighting is None and plain and step % 20 == 19:
            keep = _needed(gain, p, excess)
            alive, free = alive[keep], free[keep] / free[keep].sum()
    shares = np.zeros(count)
    shares[alive] = np.where(free > NEGLIGIBLE, free, 0.0)
    shares = least + loose * shares / shares.sum()
    return judged(rows, shares, weighting, least, fixed)


def judged(
    rows: Array, shares: Array, weighting: Array | None = None, least: float = 0.0, fixed: Array | None = None
) -> Continuous:
    """Returns the design with the fractions `shares` (N,), with its certificate over the candidates `rows` (N, p). `weighting`,
    `least`, `fixed`: the same as in `solve`."""
    matrix = information(rows, shares) + (0.0 if fixed is None else fixed)
    gain = derivative(rows, matrix, weighting)
    free = shares - least
    mean = float(free @ gain / free.sum())
    excess = max(0.0, float(gain.max()) / mean - 1.0)
    value = np.linalg.det(matrix) if weighting is None else np.trace(weighting @ np.linalg.inv(matrix))
    return Continuous(shares, matrix, excess, float(value), weighting, mean)


def _step(shares: Array, gain: Array, p: int) -> Array:
    """Makes one step of the fractions, and returns the new fractions. There are two possible steps: towards the candidate with the
    largest variance d, or away from the candidate with the smallest d among those with a fraction above zero. The step is made for
    the candidate whose d differs more from p. The length of the step maximises |M|."""
    up = int(np.argmax(gain))
    held = np.flatnonzero(shares > 0.0)
    down = int(held[np.argmin(gain[held])])
    if gain[up] - p >= p - gain[down]:
        length = (gain[up] / p - 1.0) / (gain[up] - 1.0)
        result = (1.0 - length) * shares
        result[up] += length
        return np.asarray(result)
    whole = shares[down] / (1.0 - shares[down])  # the step removes at most the whole fraction
    back = (1.0 - gain[down] / p) / (gain[down] - 1.0) if gain[down] > 1.0 else np.inf
    length = min(float(back), float(whole))
    result = (1.0 + length) * shares
    result[down] = max(0.0, result[down] - length)
    return np.asarray(result / result.sum())


def _needed(gain: Array, p: int, excess: float) -> Array:
    """Returns the candidates that may have a fraction above zero in a D-optimal design (Harman & Pronzato, Statist. Probab. Lett.
    77, 2007)."""
    e = p * excess
    bound = p * (1.0 + e / 2 - np.sqrt(e * (4.0 + e - 4.0 / p)) / 2)
    return np.asarray(gain >= bound)


Climb = Callable[[Array, Array | None], tuple[Array, Array]]


def solve_with_climbing(
    rows: Array,
    climb: Climb,
    weighting: Array | None = None,
    *,
    tolerance: float = 2e-4,
    fixed: Array | None = None,
) -> Continuous:
    """Returns the best fractions of the observations for points of a continuous region. The search starts with the candidates
    `rows`. Then the search finds better points by climbing, and adds them to the candidates, until climbing finds no better point.

    `climb`: a function of (M, W) that returns the rows of points at local maxima of the derivative over the region, and the
    derivatives there. The excess of the result refers to the whole region, provided that climbing finds the maxima.
    """
    known = np.asarray(rows, dtype=float)
    shares: Array | None = None
    best: Continuous | None = None
    for _ in range(MOST_ROUNDS):
        found = solve(known, weighting, tolerance=tolerance / 3, most_steps=1000, start=shares, fixed=fixed)
        tops, gains = climb(found.matrix, weighting)
        mean = found.mean
        excess = max(found.excess, float(gains.max()) / mean - 1.0)
        if best is None or excess < best.excess:
            best = Continuous(found.shares, found.matrix, excess, found.value, weighting, mean)
        if excess <= tolerance:
            break
        kept = found.shares > 0
        known = np.vstack([known[kept], tops[gains > mean]])
        shares = np.concatenate([found.shares[kept], np.full(len(known) - int(kept.sum()), 1e-4)])
    assert best is not None
    return best

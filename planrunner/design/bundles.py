"""Chooses among bundles. A bundle is a candidate that adds several observations at once, such as a pair of equal and opposite
rates.

A bundle i adds the information matrix B_i (p, p). Fixed parts of the plan, such as rest segments, add the matrix F. Criterion D
maximises |F + Σ B_i|, criterion A minimises the trace of the inverse of F + Σ B_i. As there are few bundles and p is small, the
whole matrix is computed again for each exchange.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.workers import ALONE, Workers, results_in_order

_STARTS = 20  # number of random choices from which the exchange starts
_MOST_STEPS = 20_000  # of the multiplicative search for shares


def loss(matrix: Array, criterion: str) -> float:
    """Returns the loss of an information matrix M (p, p). The loss is −ln|M| for criterion D, and tr M⁻¹ for criterion A. The loss
    is infinite if M is singular."""
    sign, logarithm = np.linalg.slogdet(matrix)
    size = float(np.trace(matrix)) / len(matrix)
    if sign <= 0 or size <= 0 or logarithm - len(matrix) * math.log(size) < 2 * math.log(1e-9):
        return math.inf
    return -float(logarithm) if criterion == "D" else float(np.trace(np.linalg.inv(matrix)))


def choose(
    bundles: Array,
    fixed: Array,
    count: int,
    criterion: str = "D",
    kept: Sequence[int] = (),
    workers: Workers = ALONE,
) -> tuple[int, ...]:
    """Returns the best `count` different bundles of `bundles` (N, p, p), as ascending indices (count,), found by exchange from
    seeded starts. The bundles in `kept` are always included. `fixed`: array of shape (p, p), information that does not depend on
    the choice. `workers`: processes that share the starts; the result does not depend on the number of workers.

    Raises ValueError if there are fewer bundles than requested, if more bundles are kept than requested, or if no choice determines
    all terms.
    """
    if count > len(bundles) or len(kept) > count:
        raise ValueError(f"{count} different choices are not possible from {len(bundles)}")
    random = np.random.default_rng(0)
    others = np.setdiff1d(np.arange(len(bundles)), kept)
    best, least = None, math.inf
    starts = [random.choice(others, count - len(kept), replace=False) for _ in range(_STARTS)]
    settle = partial(_settle, bundles, fixed + bundles[list(kept)].sum(axis=0), others, criterion)
    for found, reached in results_in_order(settle, starts, workers):
        if reached < least:
            best, least = found, reached
    if best is None:
        raise ValueError("no choice separates all terms")
    return tuple(sorted((*kept, *best)))


def _settle(bundles: Array, fixed: Array, others: Array, criterion: str, start: Array) -> tuple[list[int], float]:
    chosen = [int(index) for index in start]
    ridge = 1e-9 * float(np.trace(bundles.sum(axis=0))) / len(bundles) * np.eye(bundles.shape[1])
    least = loss(fixed + ridge + bundles[chosen].sum(axis=0), criterion)
    improved = True
    while improved:
        improved = False
        for place in range(len(chosen)):
            rest = fixed + ridge + bundles[chosen[:place] + chosen[place + 1 :]].sum(axis=0)
            for candidate in others:
                if candidate in chosen:
                    continue
                reached = loss(rest + bundles[candidate], criterion)
                if reached < least - 1e-12 * abs(least):
                    chosen[place], least, improved = int(candidate), reached, True
    return chosen, loss(fixed + bundles[chosen].sum(axis=0), criterion)


def shares(bundles: Array, fixed: Array, criterion: str = "D", tolerance: float = 1e-6) -> tuple[Array, float]:
    """Computes the fractions of a resource, such as the time, that N bundles should get. Returns the fractions, shape (N,), which
    add up to 1, and the remaining excess. `bundles`: array of shape (N, p, p), the information of each bundle if it gets the whole
    resource. The excess is the ratio of the largest derivative of the criterion to the mean derivative, minus 1. The excess is 0 at
    the optimum (Kiefer and Wolfowitz; multiplicative steps as in `continuous`).

    `fixed`: array of shape (p, p), information that does not depend on the fractions. Raises ValueError if the bundles cannot
    determine all terms.
    """
    count = len(bundles)
    part = np.full(count, 1.0 / count)
    if not math.isfinite(loss(fixed + np.tensordot(part, bundles, 1), criterion)):
        raise ValueError("the candidates cannot separate all terms")
    excess = math.inf
    for _ in range(_MOST_STEPS):
        inverse = np.linalg.inv(fixed + np.tensordot(part, bundles, 1))
        middle = inverse if criterion == "D" else inverse @ inverse
        gain = np.einsum("ij,nji->n", middle, bundles)
        mean = float(part @ gain)
        excess = float(gain.max()) / mean - 1.0
        if excess <= tolerance:
            break
        part = part * (gain / mean) ** (1.0 if criterion == "D" else 0.5)
        part /= part.sum()
    return part, excess

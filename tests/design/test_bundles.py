"""Bundles: brute force written apart, and designs that can be worked by hand."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from planrunner.design import bundles


def pairs(rates: np.ndarray, terms: int) -> np.ndarray:
    """Information of +x and −x for [1, x, |x|, x³] cut to `terms`."""
    found = []
    for x in rates:
        rows = np.array([[1, s * x, x, s * x**3][:terms] for s in (1, -1)])
        found.append(rows.T @ rows)
    return np.array(found)


def test_a_straight_line_wants_the_largest_rates() -> None:
    part, excess = bundles.shares(pairs(np.linspace(0.1, 1, 10), 2), np.zeros((2, 2)))
    assert part[-1] == pytest.approx(1.0, abs=1e-4)
    assert excess < 1e-6


@pytest.mark.parametrize("criterion", ["D", "A"])
def test_exchange_finds_the_best_of_all_choices(criterion: str) -> None:
    candidates, fixed = pairs(np.linspace(0.05, 1, 12), 4), np.diag([2.0, 0, 0, 0])

    def judge(choice: tuple[int, ...]) -> float:
        values = np.linalg.eigvalsh(fixed + sum(candidates[k] for k in choice))
        return -float(np.sum(np.log(values))) if criterion == "D" else float(np.sum(1 / values))

    best = min(itertools.combinations(range(12), 4), key=judge)
    assert bundles.choose(candidates, fixed, 4, criterion) == best
    kept = min((c for c in itertools.combinations(range(12), 4) if 0 in c), key=judge)
    assert bundles.choose(candidates, fixed, 4, criterion, kept=(0,)) == kept


def test_nothing_passes_the_best_shares() -> None:
    candidates = pairs(np.linspace(0.02, 1, 50), 4)
    part, excess = bundles.shares(candidates, np.zeros((4, 4)), tolerance=1e-5)
    bound = bundles.loss(4 * np.tensordot(part, candidates, 1), "D") - 4 * math.log(1 + excess)
    for choice in itertools.combinations(range(0, 50, 7), 4):
        assert bundles.loss(candidates[list(choice)].sum(axis=0), "D") >= bound


def test_too_little_is_refused() -> None:
    candidates = pairs(np.array([0.5, 1.0]), 4)
    with pytest.raises(ValueError, match="choices are not possible"):
        bundles.choose(candidates, np.zeros((4, 4)), 3)
    with pytest.raises(ValueError, match="separate all terms"):
        bundles.shares(candidates[:1], np.zeros((4, 4)))
    with pytest.raises(ValueError, match="no choice"):
        bundles.choose(candidates, np.zeros((4, 4)), 1)

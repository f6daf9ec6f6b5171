"""G-optimal sets: brute force written apart, and the bound of the equivalence theorem."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from planrunner.design import optimal, worst_variance


def parabola(x: np.ndarray) -> np.ndarray:
    return np.column_stack([np.ones(len(x)), x, x**2])


def worst_by_hand(points: np.ndarray, region: np.ndarray) -> float:
    rows = parabola(points)
    inverse = np.linalg.inv(rows.T @ rows)
    return max(float(row @ inverse @ row) for row in parabola(region))


def test_local_search_reaches_the_best_of_a_fine_grid() -> None:
    """Four observations of a parabola: two at the ends and two within (by symmetry at ±a, found on a grid)."""
    line = np.linspace(-1, 1, 201)
    grid = min(worst_by_hand(np.array([-1, -a, a, 1.0]), line) for a in np.linspace(0.05, 0.95, 181))
    bounds = [(-1.0, 1.0)]
    over = optimal.region(lambda settings: parabola(settings[:, 0]), line[:, None], bounds)
    d_optimal = np.array([[-1.0], [0.02], [-0.02], [1.0]])
    settings = worst_variance.refine(over, d_optimal, parabola(line))
    reached = worst_by_hand(settings[:, 0], line)
    assert reached <= grid * 1.002
    assert reached < worst_by_hand(d_optimal[:, 0], line)
    assert reached >= 3 / 4  # p/n, which no set passes (Kiefer and Wolfowitz)


@pytest.mark.parametrize("seed", range(4))
def test_exchange_reaches_the_best_of_all_choices(seed: int) -> None:
    random = np.random.default_rng(seed)
    rows, region = random.normal(size=(9, 3)), random.normal(size=(30, 3))

    def worst(choice: tuple[int, ...]) -> float:
        inverse = np.linalg.inv(sum(np.outer(rows[k], rows[k]) for k in choice))
        return max(float(row @ inverse @ row) for row in region)

    least = min(worst(choice) for choice in itertools.combinations(range(9), 4))
    starts = [random.choice(9, 4, replace=False) for _ in range(12)]
    found = [worst_variance.exchange(rows, start, region) for start in starts]
    assert min(worst(tuple(one)) for one in found) == pytest.approx(least, rel=1e-9)
    assert all(len(set(one)) == 4 for one in found)


def test_a_set_that_cannot_give_all_terms_has_no_finite_worst_variance() -> None:
    assert math.isinf(worst_variance.worst(np.ones((4, 2)), np.eye(2)))
    assert math.isinf(worst_variance.worst(np.eye(3)[:2], np.eye(3)))

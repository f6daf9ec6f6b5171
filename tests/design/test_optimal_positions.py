"""Optimal designs: the method's own figures, brute force written apart, and the equivalence theorem."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from planrunner.design import continuous, exchange, optimal
from planrunner.design.direction_cosines import quick
from planrunner.design.efficiency import efficiency, merit
from planrunner.design.places import attitudes
from planrunner.physics.kinematics import TableAxis, attitude

LATITUDE = math.radians(39.98)
EARTH = np.array([0.0, math.cos(LATITUDE), math.sin(LATITUDE)])
AXES = (
    TableAxis("outer", (0.0, 0.0, 1.0), 1.0, 1.0),
    TableAxis("middle", (1.0, 0.0, 0.0), 1.0, 1.0),
    TableAxis("inner", (0.0, 1.0, 0.0), 1.0, 1.0),
)
UNBOUNDED = [(-math.inf, math.inf)] * 3


def rows_at(given: np.ndarray, products: bool = False) -> np.ndarray:
    """[1, ω_Y, ω_X, a_X, a_Y, a_Z] in Earth rates and g, written from the source's model."""
    rate, up = given @ EARTH, given[:, :, 2]
    columns = [np.ones(len(given)), rate[:, 1], rate[:, 0], up[:, 0], up[:, 1], up[:, 2]]
    if products:
        columns += [up[:, 0] * up[:, 2], up[:, 1] * up[:, 2]]
    return np.column_stack(columns)


def signed_permutations() -> np.ndarray:
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0:
                found.append(matrix)
    return np.array(found)


CARDINAL = rows_at(signed_permutations())


def region(products: bool = False) -> optimal.Region:
    return optimal.region(
        lambda settings: rows_at(attitudes(AXES, settings, 0.0), products),
        optimal.spread(UNBOUNDED, 1000, 3),
        UNBOUNDED,
    )


def test_all_choices_of_eight_give_the_published_determinant() -> None:
    best = exchange.exhaust(CARDINAL, 8)
    assert best.tried == 735_471
    assert math.exp(-best.loss) == pytest.approx(706.081, abs=5e-4)
    chosen = CARDINAL[best.indices]
    assert np.trace(np.linalg.inv(chosen.T @ chosen)) == pytest.approx(2.57809, abs=5e-6)


def test_exchange_finds_the_same_by_either_criterion() -> None:
    assert math.exp(-exchange.exchange(CARDINAL, 8)[0].loss) == pytest.approx(706.081, abs=5e-4)
    assert exchange.exchange(CARDINAL, 8, np.eye(6))[0].loss == pytest.approx(2.57809, abs=5e-6)


@pytest.mark.parametrize("seed", range(5))
def test_exhaustive_and_exchange_agree_with_brute_force(seed: int) -> None:
    rows = np.random.default_rng(seed).normal(size=(9, 3))
    moment = rows.T @ rows / 9
    for weighting in (None, np.eye(3), moment):
        losses = {}
        for choice in itertools.combinations(range(9), 4):
            matrix = sum(np.outer(rows[k], rows[k]) for k in choice)
            inverse = np.linalg.inv(matrix)
            losses[choice] = -math.log(np.linalg.det(matrix)) if weighting is None else np.trace(weighting @ inverse)
        best = min(losses, key=losses.__getitem__)
        for found in (exchange.exhaust(rows, 4, weighting), exchange.exchange(rows, 4, weighting)[0]):
            assert tuple(found.indices) == best
            assert found.loss == pytest.approx(losses[best], rel=1e-9)


def test_too_few_or_blind_candidates_are_never_called_sound() -> None:
    blind = np.column_stack([CARDINAL, np.zeros(24)])
    assert math.isinf(exchange.exhaust(blind[:10], 8).loss)
    assert math.isinf(exchange.exchange(blind, 8)[0].loss)
    assert merit(blind[:8], blind).rank < 7
    with pytest.raises(ValueError, match="separate all terms"):
        continuous.solve(blind)


def test_the_bound_is_certified_and_nothing_found_passes_it() -> None:
    found = continuous.solve(CARDINAL)
    inverse = np.linalg.inv(CARDINAL.T @ (found.shares[:, None] * CARDINAL))
    largest = max(float(row @ inverse @ row) for row in CARDINAL)
    assert found.shares.sum() == pytest.approx(1.0)
    assert largest == pytest.approx(6.0, rel=2e-6)
    assert found.largest_variance == pytest.approx(largest, rel=1e-9)
    for count in (6, 8, 12, 24):
        chosen = exchange.exchange(CARDINAL, count, repeats=True)[0]
        assert math.exp(-chosen.loss) <= found.determinant_bound(count)
    assert found.determinant_bound(8) == pytest.approx(836.837, abs=0.01)


def test_shares_of_a_hand_worked_design() -> None:
    """A parabola on [-1, 1]: a third each at −1, 0 and 1 (Atkinson, Donev & Tobias); A-optimal: a quarter, a half, a quarter."""
    x = np.linspace(-1, 1, 21)
    rows = np.column_stack([np.ones(21), x, x**2])
    shares = continuous.solve(rows, tolerance=1e-9).shares
    assert shares[[0, 10, 20]] == pytest.approx([1 / 3] * 3, abs=1e-4)
    shares = continuous.solve(rows, np.eye(3), tolerance=1e-8, most_steps=200_000).shares
    assert shares[[0, 10, 20]] == pytest.approx([0.25, 0.5, 0.25], abs=1e-3)


def test_free_orientations_reach_the_published_determinant_and_the_bound() -> None:
    over = region()
    found = optimal.search(over, 8, restarts=4, seed=1)
    determinant = np.linalg.det(np.linalg.multi_dot([over.rows_of(found.settings).T, over.rows_of(found.settings)]))
    assert determinant >= 836.83
    bound = optimal.bound(over, found.settings)
    assert determinant <= bound.determinant_bound(8) < determinant * 1.001
    dense = rows_at(attitudes(AXES, optimal.spread(UNBOUNDED, 20_000, 99), 0.0))
    inverse = np.linalg.inv(bound.matrix)
    assert np.einsum("ij,ij->i", dense @ inverse, dense).max() <= bound.largest_variance * (1 + 1e-6)


def test_products_are_seen_by_free_positions_only() -> None:
    assert np.linalg.matrix_rank(rows_at(signed_permutations(), True)) == 6
    over = region(True)
    found = optimal.search(over, 8, restarts=3)
    rows = over.rows_of(found.settings)
    assert np.linalg.matrix_rank(rows) == 8
    assert np.linalg.det(rows.T @ rows) > 400
    assert np.linalg.matrix_rank(rows[:, [0, 3, 4, 5, 6, 7]]) == 6


def test_the_same_seed_gives_the_same_positions() -> None:
    first, second = (optimal.search(region(), 8, restarts=1, seed=5).settings for _ in range(2))
    assert np.array_equal(first, second)


def test_efficiencies_are_shares_of_observations() -> None:
    once, twice = merit(CARDINAL, CARDINAL), merit(np.vstack([CARDINAL, CARDINAL]), CARDINAL)
    for share in (efficiency(once, twice), efficiency(twice, once)):
        assert pytest.approx((1, 1, 1, 1)) == (share.D, share.A, share.G, share.I)
    worse = merit(CARDINAL, CARDINAL)
    against = efficiency(worse, merit(CARDINAL * math.sqrt(2), CARDINAL))
    assert pytest.approx((0.5, 0.5, 0.5, 0.5)) == (against.D, against.A, against.G, against.I)


def test_dwells_follow_the_information_of_the_positions() -> None:
    """Two repeats of one observation and one of another: the lone one gets half of the time."""
    shares = optimal.allocate(np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    assert shares == pytest.approx([0.25, 0.25, 0.5], abs=1e-6)
    idle = optimal.allocate(np.array([[1.0, 0.0], [0.0, 1.0], [0.1, 0.1]]))
    assert idle[2] == pytest.approx(0.25 / 3)


def test_many_attitudes_at_once_are_those_of_the_table() -> None:
    settings = optimal.spread(UNBOUNDED, 20, 8)
    for row, found in zip(settings, attitudes(AXES, settings, 0.3), strict=True):
        assert np.allclose(found, attitude(AXES, row, 0.3), atol=1e-14)


def test_polynomials_stand_in_only_where_they_are_exact() -> None:
    given = attitudes(AXES, optimal.spread(UNBOUNDED, 50, 1), 0.0)
    stand_in = quick(lambda a: rows_at(a, True))
    assert np.allclose(stand_in(given), rows_at(given, True), atol=1e-12)

    def angles(a: np.ndarray) -> np.ndarray:
        return np.arccos(np.clip(a[:, :, 2], -1, 1))

    assert quick(angles) is angles

"""Monte Carlo: the additive examples of JCGM 101:2008 (9.2), distributions, the adaptive rule, and validation of k·u."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from planrunner.base.workers import Workers
from planrunner.uncertainty.influences import Influence, InputQuantity
from planrunner.uncertainty.monte_carlo import (
    Draws,
    influence_draws,
    numerical_tolerance,
    propagate,
    square_root,
    t_draws,
    validate,
)


def additive(shape: str, *widths: float) -> Draws:
    """Y = X₁ + X₂ + …, each about zero with the given standard uncertainty."""
    inputs = [
        Influence(InputQuantity(f"X{k}", 0.0, "1", u, distribution=shape), np.ones((1, 1)))
        for k, u in enumerate(widths)
    ]
    return influence_draws(inputs, 1)


@pytest.mark.parametrize(
    ("shape", "widths", "u", "end", "gum", "delta", "valid"),
    [
        ("normal", (1, 1, 1, 1), 2.0, 3.92, 3.92, 0.05, True),  # 9.2.2
        ("rectangular", (1, 1, 1, 1), 2.0, 3.88, 3.92, 0.05, True),  # 9.2.3
        ("rectangular", (1, 1, 1, 10), 10.15, 17.0, 19.9, 0.5, False),  # 9.2.4
    ],
)
def test_additive_examples(
    shape: str, widths: tuple, u: float, end: float, gum: float, delta: float, valid: bool
) -> None:
    tolerance = numerical_tolerance(u, 2)
    assert tolerance == pytest.approx(delta)
    found = propagate(additive(shape, *widths), [tolerance / 5], seed=2, most=2_000_000)
    (interval,) = found.intervals
    assert found.stabilised
    assert interval.standard_deviation == pytest.approx(u, abs=2 * delta / 5)
    assert (interval.low, interval.high) == pytest.approx((-end, end), abs=2 * delta / 5)
    expanded = 1.959964 * math.hypot(*widths)
    assert expanded == pytest.approx(gum, abs=0.05)
    assert validate(0.0, expanded, interval, tolerance).validated is valid


def test_four_rectangles_have_the_quantile_of_irwin_and_hall() -> None:
    """P(S > s) = (4 − s)⁴/24 for s ≥ 3 of four uniform numbers: s = 4 − 0.6^(1/4), scaled by √12."""
    end = (2 - 0.6**0.25) * math.sqrt(12)
    (interval,) = propagate(additive("rectangular", 1, 1, 1, 1), [0.0], seed=5, most=1_000_000).intervals
    assert interval.high == pytest.approx(end, abs=0.01)


@pytest.mark.parametrize(
    ("shape", "kurtosis", "end"),
    [
        ("normal", 3.0, 1.959964),
        ("rectangular", 1.8, 0.95 * math.sqrt(3)),
        ("triangular", 2.4, math.sqrt(6) * (1 - math.sqrt(0.05))),
        ("u-shaped", 1.5, math.sqrt(2) * math.sin(0.475 * math.pi)),
    ],
)
def test_distributions_have_their_standard_uncertainty_shape_and_quantiles(
    shape: str, kurtosis: float, end: float
) -> None:
    values = additive(shape, 3.0)(np.random.default_rng(1), 400_000)[0] / 3
    assert np.std(values) == pytest.approx(1, abs=0.01)
    assert np.mean(values**4) == pytest.approx(kurtosis, abs=0.05)
    assert np.quantile(values, 0.975) == pytest.approx(end, abs=0.015)


def test_few_degrees_of_freedom_widen_the_interval_as_student_says() -> None:
    """t of 4 and of 9 degrees of freedom: 2.776 and 2.262 times u at 95 %."""
    values = t_draws(np.diag([4.0, 1.0]), [4, 9])(np.random.default_rng(3), 600_000)
    assert np.quantile(values[0], 0.975) == pytest.approx(2 * 2.7764, rel=0.01)
    assert np.quantile(values[1], 0.975) == pytest.approx(2.2622, rel=0.01)
    stated = Influence(InputQuantity("a", 0.0, "1", 2.0, 4, "t"), np.ones((1, 1)))
    assert np.quantile(influence_draws([stated], 1)(np.random.default_rng(4), 600_000), 0.975) == pytest.approx(
        2 * 2.7764, rel=0.01
    )


def test_shortest_interval_of_a_skewed_quantity() -> None:
    """Exponential of mean 1: symmetric [−ln 0.975, −ln 0.025], shortest [0, −ln 0.05]."""
    draws = propagate(lambda rng, n: rng.exponential(1.0, (1, n)), [0.0], seed=1, most=400_000)
    (interval,) = draws.intervals
    assert interval.low == pytest.approx(-math.log(0.975), abs=0.002)
    assert interval.high == pytest.approx(-math.log(0.025), abs=0.04)
    assert interval.shortest[0] == pytest.approx(0, abs=0.01)
    assert interval.shortest[1] == pytest.approx(-math.log(0.05), abs=0.04)


def test_draws_go_on_until_the_results_are_stable_and_repeat_by_seed() -> None:
    normal = additive("normal", 1.0)
    coarse, fine = (propagate(normal, [tolerance], seed=7) for tolerance in (0.1, 0.01))
    assert coarse.stabilised
    assert fine.stabilised
    assert 20_000 <= coarse.draws < fine.draws < 1_000_000
    assert fine.spread[0] <= 0.01 * stats.t.ppf(0.975, fine.draws / 10_000 - 1) / 2
    assert propagate(normal, [0.1], seed=7) == coarse
    assert propagate(normal, [0.1], seed=8).intervals != coarse.intervals
    short = propagate(normal, [1e-6], seed=7, most=30_000)
    assert (short.draws, short.stabilised) == (30_000, False)


def test_workers_share_the_blocks_without_any_effect_on_the_digits() -> None:
    """Each block has its own numbers: those of the spawned seeds of NumPy, so that the blocks can also be drawn by hand."""
    draw = additive("rectangular", 1, 2)
    alone = propagate(draw, [0.0], seed=7, most=60_000)
    assert alone == propagate(draw, [0.0], seed=7, most=60_000, workers=Workers(2))
    by_hand = [draw(np.random.default_rng(one), 10_000) for one in np.random.SeedSequence(7).spawn(6)]
    assert alone.intervals[0].mean == pytest.approx(np.mean(by_hand), rel=1e-12)


def test_heavy_tails_are_left_out_of_the_rule_for_the_standard_deviation_alone() -> None:
    heavy = t_draws(np.eye(1), [2.5])
    with_it, without = (propagate(heavy, [0.06], seed=1, most=300_000, heavy=[flag]) for flag in (False, True))
    assert not with_it.stabilised
    assert without.stabilised
    assert without.draws < with_it.draws


@pytest.mark.parametrize(
    ("u", "digits", "delta"),
    [(0.00035, 2, 0.000005), (0.00035, 1, 0.00005), (2.0, 1, 0.5), (0.0996, 2, 0.005), (0.0, 1, 0.0)],
)
def test_numerical_tolerance(u: float, digits: int, delta: float) -> None:
    """The first two are the example of JCGM 101:2008, 7.9.2.1."""
    assert numerical_tolerance(u, digits) == pytest.approx(delta)


def test_root_of_a_covariance_in_mixed_units() -> None:
    rng = np.random.default_rng(0)
    factors = np.array([1e-9, 1.0, 1e6, 1e-3])
    root = rng.normal(size=(4, 3)) * factors[:, None]  # rank three of four
    covariance = root @ root.T
    assert square_root(covariance) @ square_root(covariance).T / np.outer(factors, factors) == pytest.approx(
        covariance / np.outer(factors, factors), abs=1e-12
    )

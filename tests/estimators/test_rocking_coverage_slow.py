"""The stated 95 % intervals of rocking drifts hold the truth about as often as they say; docs/platform-rocking.md has long campaigns."""

from __future__ import annotations

import math

import numpy as np
import pytest
import rocking_coverage
import rocking_window_coverage

from planrunner.uncertainty.decision import coverage_factor


def share_of_welch(draws: int = 200_000) -> float:
    """How often x̄ ± t·u holds the truth where u² is the sum of two equal variances known by two degrees of freedom each and t goes by
    Welch and Satterthwaite: what is right for z, which both states measure with three repeats."""
    draw = np.random.default_rng(3)
    parts = draw.chisquare(2, (2, draws)) / 2
    freedom = parts.sum(axis=0) ** 2 / (parts**2 / 2).sum(axis=0)
    grid = np.linspace(2.0, 4.0, 201)
    factor = np.interp(freedom, grid, [coverage_factor(one) for one in grid])
    return float(np.mean(np.abs(draw.standard_normal(draws)) * math.sqrt(2) <= factor * np.sqrt(parts.sum(axis=0))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("campaign", "count"), [(rocking_coverage.campaign, 120), (rocking_window_coverage.campaign, 800)]
)
def test_intervals_of_rocking_drifts_hold_the_truth(campaign, count) -> None:
    """From whole records, and from what the filter leaves of them in the windows; three standard errors of a binomial share."""
    held = campaign(count, seed=11)
    assert len(held) == 6
    welch = share_of_welch()
    for name, (inside, of) in held.items():
        assert of == count
        right = welch if name.endswith("z") else 0.95
        assert abs(inside / of - right) < 3 * math.sqrt(right * (1 - right) / count), name


def test_welch_is_cautious_with_two_variances_of_two_degrees_of_freedom() -> None:
    assert 0.96 < share_of_welch() < 0.97

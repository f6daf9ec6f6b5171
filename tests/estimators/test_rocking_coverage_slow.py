"""The stated 95 % intervals of rocking drifts hold the truth about as often as they say; docs/platform-rocking.md has long campaigns."""

from __future__ import annotations

import math

import pytest
import rocking_coverage
import rocking_window_coverage

CAUTION = 0.02  # by which Welch's formula with two states of two degrees of freedom each may hold the truth more often


@pytest.mark.slow
@pytest.mark.parametrize(
    ("campaign", "count"), [(rocking_coverage.campaign, 120), (rocking_window_coverage.campaign, 1500)]
)
def test_intervals_of_rocking_drifts_hold_the_truth(campaign, count) -> None:
    """From whole records, and from what the filter leaves of them in the windows; three standard errors of a binomial share."""
    held = campaign(count, seed=11)
    assert len(held) == 6
    tolerance = 3 * math.sqrt(0.95 * 0.05 / count)
    for name, (inside, of) in held.items():
        assert of == count
        caution = CAUTION if name.endswith("z") else 0.0
        assert -tolerance < inside / of - 0.95 < tolerance + caution, name

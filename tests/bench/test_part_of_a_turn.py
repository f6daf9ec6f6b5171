"""What a part of a turn leaves in a mean, by averaging the Earth rate in a turning frame step by step."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.bench.motion_checks import mean_left


@pytest.mark.parametrize("turns", [0.25, 0.5, 1.25, 1.5, 2.7, 10.5])
def test_the_largest_mean_over_a_part_of_a_turn(turns: float) -> None:
    """About the vertical at 40° latitude, x of the table: the worst of all angles at which recording may begin."""
    latitude, earth = np.radians(40.0), 15.041067
    north = earth * np.cos(latitude)
    turned = 2 * np.pi * turns * (np.arange(200_000) + 0.5) / 200_000
    begins = np.linspace(0, 2 * np.pi, 3601)
    c, s = np.cos(turned).mean(), np.sin(turned).mean()
    means = north * (np.cos(begins) * c - np.sin(begins) * s)  # mean of cos(begin + turned)
    assert np.abs(means).max() == pytest.approx(north * mean_left(turns), rel=1e-5)
    assert np.abs(means).max() <= north / (np.pi * turns) * (1 + 1e-6)


@pytest.mark.parametrize("turns", [1.0, 2.0, 37.0])
def test_whole_turns_leave_nothing(turns: float) -> None:
    assert mean_left(turns) < 1e-14

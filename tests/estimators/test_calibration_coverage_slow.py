"""Coverage of the intervals of IMU calibrations and of curves over temperature."""

from __future__ import annotations

import math

import pytest
from calibration_coverage import curve_coverage, imu_coverage

RUNS = 1000
SCATTER = math.sqrt(0.95 * 0.05 / RUNS)


@pytest.mark.slow
@pytest.mark.parametrize("basis", ["residual", "within_segment"])
@pytest.mark.parametrize("tilt", [0.0, 5.0])
def test_intervals_of_an_imu(basis: str, tilt: float) -> None:
    """33 coefficients, each within four standard deviations of the binomial; stated tilts, which are counted generously, cover more."""
    found = imu_coverage(RUNS, 50, basis, tilt, tilt)
    assert min(found.values()) > 0.95 - 4 * SCATTER, min(found, key=found.get)  # type: ignore[arg-type]
    if not tilt:
        assert max(found.values()) < 0.95 + 4 * SCATTER, max(found, key=found.get)  # type: ignore[arg-type]


@pytest.mark.slow
def test_tilts_that_nobody_states_are_not_covered() -> None:
    assert min(imu_coverage(200, 51, "within_segment", tilt=5.0).values()) < 0.7


@pytest.mark.slow
@pytest.mark.parametrize("temperatures", [6, 11, 21])
def test_intervals_of_curves_of_a_given_order(temperatures: int) -> None:
    low, high = curve_coverage(4 * RUNS, 52, temperatures, (3.0, 0.05, -1e-3), 2)
    assert low > 0.95 - 2 * SCATTER and high < 0.95 + 2 * SCATTER

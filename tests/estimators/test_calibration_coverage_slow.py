"""Coverage of the intervals of IMU calibrations and of curves over temperature."""

from __future__ import annotations

import math

import pytest
from calibration_coverage import CURVES, IMU, curve_coverage, imu_coverage
from scipy.stats import binom

RUNS = 400
SCATTER = math.sqrt(0.95 * 0.05 / RUNS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["white noise", "tilts of 5 arcsec, stated", "flicker, declared", "flicker and tilts of 5 arcsec, both stated"],
)
def test_intervals_of_an_imu(name: str) -> None:
    """33 coefficients on two bases in four experiments, each within the binomial range that all keep jointly at 1 % (Šidák) if every
    interval covers 95 %."""
    each = 1 - 0.99 ** (1 / (33 * 2 * 4))
    low, high = binom.ppf(each / 2, RUNS, 0.95) / RUNS, binom.ppf(1 - each / 2, RUNS, 0.95) / RUNS
    for basis, found in imu_coverage(RUNS, 50, **IMU[name]).items():
        for coefficient, share in found.items():
            assert low <= share <= high, (basis, coefficient, share)


@pytest.mark.slow
def test_what_nobody_states_is_not_covered() -> None:
    assert min(imu_coverage(200, 51, tilt=5.0)["within_segment"].values()) < 0.7
    assert min(imu_coverage(200, 52, flicker=1.0)["within_segment"].values()) < 0.7


@pytest.mark.slow
@pytest.mark.parametrize("temperatures", [6, 11, 21])
def test_intervals_of_curves_of_a_given_order(temperatures: int) -> None:
    low, high = curve_coverage(2 * RUNS, 52, temperatures, (3.0, 0.05, -1e-3), 2)
    assert low > 0.95 - 3 * SCATTER and high < 0.95 + 3 * SCATTER


@pytest.mark.slow
@pytest.mark.parametrize("truth", CURVES)
def test_intervals_of_curves_of_a_chosen_order_hold_the_truth_at_least(truth: tuple[float, ...]) -> None:
    low, _ = curve_coverage(RUNS, 53, 11, truth, None)
    assert low >= 0.95 - 3 * SCATTER

"""Coverage of the 95 % intervals of tilted scale factors, temperature coefficients and fixture angles: a reduced sample of the campaign."""

from __future__ import annotations

import pytest
from tilted_coverage import SCENARIOS, fixture_coverage, flicker_means, scale_factor_coverage

RUNS = 500


def joint_tolerance(intervals: int) -> tuple[int, int]:
    """The range that each of so many binomial counts may take, jointly at 1 % (Šidák), if every interval covers 95 %."""
    from scipy.stats import binom

    each = 1 - 0.99 ** (1 / intervals)
    return int(binom.ppf(each / 2, RUNS, 0.95)), int(binom.ppf(1 - each / 2, RUNS, 0.95))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_intervals_of_scale_factors_hold_the_truth(name: str) -> None:
    shares = scale_factor_coverage(RUNS, 41, **SCENARIOS[name])  # type: ignore[arg-type]
    low, high = joint_tolerance(3 * len(SCENARIOS))
    for what, share in shares.items():
        print(f"{name}: {what} {share:.4f}")
        assert low <= round(share * RUNS) <= high, (name, what, share)


@pytest.mark.slow
@pytest.mark.parametrize(("basis", "skew", "rate"), [("residual", 0.0, 0.0), ("within_segment", 0.0, 0.0)])
def test_intervals_of_fixture_angles_hold_the_truth(basis: str, skew: float, rate: float) -> None:
    shares = fixture_coverage(RUNS, 42, basis, skew, rate)
    low, high = joint_tolerance(2 * len(shares))
    for what, share in shares.items():
        print(f"{basis}: {what} {share:.4f}")
        assert low <= round(share * RUNS) <= high, (basis, what, share)


@pytest.mark.slow
def test_intervals_of_fixture_angles_with_skewed_positions_and_table_rates_hold_the_truth_at_least() -> None:
    """The rates' errors are in the scatter about the model as well as in the budget, so intervals may only be too wide."""
    shares = fixture_coverage(RUNS, 43, "residual", 3.0, 10e-6)
    low, _ = joint_tolerance(len(shares))
    assert min(shares.values()) * RUNS >= low, shares


def test_flicker_of_the_campaign_has_the_floor_of_its_definition() -> None:
    """Allan deviation √(2·ln 2/π)·B = 0.664·B where 1/f rules (IEEE 952)."""
    import numpy as np

    rng = np.random.default_rng(0)
    series = np.array([flicker_means(rng, 64, 1.0) for _ in range(400)])
    for size in (2, 4, 8):
        means = series.reshape(400, -1, size).mean(axis=-1)
        assert np.sqrt(np.mean(np.diff(means, axis=-1) ** 2) / 2) == pytest.approx(0.664, abs=0.03)

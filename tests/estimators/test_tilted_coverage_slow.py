"""Coverage of the 95 % intervals of tilted scale factors, temperature coefficients and fixture angles: a reduced sample of the campaign."""

from __future__ import annotations

import pytest
from tilted_coverage import BASES, FIXTURE, SCENARIOS, fixture_coverage, flicker_means, scale_factor_coverage

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
@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("name", FIXTURE)
def test_intervals_of_fixture_angles_hold_the_truth(name: str, basis: str) -> None:
    """White noise, declared flicker, skewed positions and rates, and all of them, on both bases."""
    shares = fixture_coverage(RUNS, 42, basis, **FIXTURE[name])
    low, high = joint_tolerance(len(BASES) * len(FIXTURE) * len(shares))
    for what, share in shares.items():
        print(f"{basis}: {what} {share:.4f}")
        assert low <= round(share * RUNS) <= high, (name, basis, what, share)


@pytest.mark.slow
def test_within_segments_flicker_is_not_seen_by_scale_factors() -> None:
    """Of which a warning tells; with white noise alone the same basis holds."""
    low, high = joint_tolerance(3)
    white = scale_factor_coverage(RUNS, 44, basis="within_segment", spread=0.0)
    assert all(low <= round(share * RUNS) <= high for share in white.values()), white
    assert scale_factor_coverage(100, 45, basis="within_segment", spread=0.0, flicker=1.0)["K_x"] < 0.9


def test_flicker_of_the_campaign_has_the_floor_of_its_definition() -> None:
    """Allan deviation √(2·ln 2/π)·B = 0.664·B where 1/f rules (IEEE 952)."""
    import numpy as np

    rng = np.random.default_rng(0)
    series = np.array([flicker_means(rng, 64, 1.0) for _ in range(400)])
    for size in (2, 4, 8):
        means = series.reshape(400, -1, size).mean(axis=-1)
        assert np.sqrt(np.mean(np.diff(means, axis=-1) ** 2) / 2) == pytest.approx(0.664, abs=0.03)

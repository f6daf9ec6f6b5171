"""Coverage of the 95 % intervals of tilted scale factors, temperature coefficients and fixture angles: a reduced sample of the campaign."""

from __future__ import annotations

from typing import Any

import pytest
from tilted_coverage import (
    BASES,
    FIXTURE,
    OTHER_BASES,
    SCENARIOS,
    fixture_coverage,
    scale_factor_coverage,
)

RUNS = 120


def joint_tolerance(intervals: int) -> tuple[int, int]:
    """The range that each of so many binomial counts may take, jointly at 1 % (Šidák), if every interval covers 95 %."""
    from scipy.stats import binom

    each = 1 - 0.99 ** (1 / intervals)
    return int(binom.ppf(each / 2, RUNS, 0.95)), int(binom.ppf(1 - each / 2, RUNS, 0.95))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_intervals_of_scale_factors_hold_the_truth(name: str) -> None:
    shares = scale_factor_coverage(RUNS, 41, **SCENARIOS[name])
    low, high = joint_tolerance(len(SCENARIOS) * len(shares))
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
@pytest.mark.parametrize(("basis", "keys"), OTHER_BASES)
def test_intervals_on_the_other_bases_hold_the_truth(basis: str, keys: dict[str, Any]) -> None:
    """White noise and declared flicker."""
    shares = scale_factor_coverage(RUNS, 44, basis=basis, **keys)
    low, high = joint_tolerance(len(OTHER_BASES) * len(shares))
    for what, share in shares.items():
        print(f"{basis}, {keys}: {what} {share:.4f}")
        assert low <= round(share * RUNS) <= high, (basis, keys, what, share)

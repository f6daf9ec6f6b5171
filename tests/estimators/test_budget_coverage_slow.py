"""Coverage of intervals that combine the data with stated inputs, on a reduced sample; docs/uncertainty-budgets.md has the full one."""

from __future__ import annotations

import pytest
from budget_coverage import LOUD, RATE, STATIC, rate_coverage, static_coverage
from scipy.stats import binom

RUNS = 1_000


def joint_range(share: float, intervals: int) -> tuple[float, float]:
    """The range of each of several binomial shares, jointly at 1 % (Šidák), if every interval covers `share`."""
    each = 1 - 0.99 ** (1 / intervals)
    return binom.ppf(each / 2, RUNS, share) / RUNS, binom.ppf(1 - each / 2, RUNS, share) / RUNS


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["stated inputs large, noise ten times less", "stated inputs large, noise ten times less, noise within"]
)
def test_data_and_stated_inputs_together_cover_95_percent(name: str) -> None:
    """Table position, latitude, azimuth and gravity are most of what is uncertain, and none of it is in the noise within the positions."""
    found = static_coverage(STATIC[name], RUNS, 31)
    low, high = joint_range(0.95, len(found))
    print(found)
    assert low <= min(found.values())
    assert max(found.values()) <= high


@pytest.mark.slow
def test_without_the_stated_inputs_the_same_intervals_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    import budget_coverage

    monkeypatch.setattr(budget_coverage, "combined", lambda estimate: estimate)
    found = static_coverage(STATIC["stated inputs large, noise ten times less, noise within"], 500, 31)
    assert LOUD["position"] == 30.0
    assert min(found.values()) < 0.85


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "noise and rate errors alike",
        "noise and rate errors alike, noise within",
        "rate errors alone matter",
        "rate errors alone matter, noise within",
    ],
)
def test_scale_factor_with_errors_of_each_rate_and_of_all(name: str) -> None:
    found = rate_coverage(RATE[name], RUNS, 32)
    low, high = joint_range(0.95, len(found))
    print(found)
    assert low <= min(found.values())
    assert max(found.values()) <= high

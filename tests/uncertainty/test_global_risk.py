"""Global risks of a decision rule: against the bivariate normal distribution, against counting, and at the edges."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from planrunner.uncertainty.global_risk import Prior, global_risk

CASES = [
    # prior, u, tolerance, guard band
    (Prior(0.0, 0.12), 0.04, (-0.2, 0.2), 0.0),
    (Prior(0.05, 0.12), 0.04, (-0.2, 0.2), 0.08),
    (Prior(10.0, 3.0), 1.0, (-math.inf, 12.0), 2.0),
    (Prior(1.0, 0.01), 0.5, (0.9, 1.1), 0.05),  # much narrower than the measurement
    (Prior(0.0, 5.0), 0.01, (-0.2, 0.2), 0.02),  # much wider
]


@pytest.mark.parametrize(("prior", "u", "tolerance", "band"), CASES)
def test_against_the_joint_normal_distribution(prior: Prior, u: float, tolerance: tuple, band: float) -> None:
    """True value and measured value are jointly normal with covariance [[s², s²], [s², s² + u²]]."""
    acceptance = (tolerance[0] + band, tolerance[1] - band)
    s2 = prior.standard_deviation**2
    joint = stats.multivariate_normal([prior.mean] * 2, [[s2, s2], [s2, s2 + u**2]])
    wide = 60 * (prior.standard_deviation + u)

    def clipped(ends: tuple) -> np.ndarray:
        return np.clip(ends, prior.mean - wide, prior.mean + wide)

    def inside(true: tuple, seen: tuple) -> float:
        (a, b), (c, d) = clipped(true), clipped(seen)
        return float(joint.cdf([b, d]) - joint.cdf([a, d]) - joint.cdf([b, c]) + joint.cdf([a, c]))

    both = inside(tolerance, acceptance)
    accepted = stats.norm(prior.mean, math.sqrt(s2 + u**2))
    conforming = stats.norm(prior.mean, prior.standard_deviation)
    found = global_risk(prior, u, math.inf, tolerance, acceptance)
    assert found.consumer == pytest.approx(
        float(accepted.cdf(acceptance[1]) - accepted.cdf(acceptance[0])) - both, abs=2e-5
    )
    assert found.producer == pytest.approx(
        float(conforming.cdf(tolerance[1]) - conforming.cdf(tolerance[0])) - both, abs=2e-5
    )


def test_few_degrees_of_freedom_by_counting() -> None:
    rng = np.random.default_rng(0)
    n = 2_000_000
    true = rng.normal(0.05, 0.12, n)
    seen = true + 0.04 * rng.standard_t(4, n)
    good, passed = np.abs(true) <= 0.2, np.abs(seen) <= 0.15
    found = global_risk(Prior(0.05, 0.12), 0.04, 4, (-0.2, 0.2), (-0.15, 0.15))
    assert found.consumer == pytest.approx(np.mean(~good & passed), abs=1e-4)
    assert found.producer == pytest.approx(np.mean(good & ~passed), abs=1e-3)


def test_a_guard_band_trades_the_consumers_risk_for_the_producers() -> None:
    prior, tolerance = Prior(0.0, 0.12), (-0.2, 0.2)
    simple, guarded = (global_risk(prior, 0.04, math.inf, tolerance, (-0.2 + w, 0.2 - w)) for w in (0.0, 0.08))
    assert guarded.consumer < simple.consumer / 10
    assert guarded.producer > simple.producer


def test_at_the_edges() -> None:
    prior, tolerance = Prior(0.0, 0.1), (-0.2, 0.2)
    bad = 2 * stats.norm.sf(2)
    nothing = global_risk(prior, 0.3, math.inf, tolerance, (0.1, -0.1))  # a guard band wider than the tolerance
    assert nothing.consumer == 0.0 and nothing.producer == pytest.approx(1 - bad)
    perfect = global_risk(prior, 0.0, math.inf, tolerance, tolerance)
    assert (perfect.consumer, perfect.producer) == pytest.approx((0.0, 0.0), abs=1e-12)
    with pytest.raises(ValueError, match="positive standard uncertainty"):
        global_risk(Prior(0.0, 0.0), 0.1, math.inf, tolerance, tolerance)

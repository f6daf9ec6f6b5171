"""Coverage of the Allan intervals and of the fitted coefficients, for every kind of noise that the fit knows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from allan_coverage import MIXTURE, coefficient_coverage, deviation_coverage
from exact_allan_coverage import POWER, distribution, exact_coverage, true_variance
from scipy.stats import binom, chi2

from planrunner.estimators.allan.confidence import degrees_of_freedom

RECORDS, SAMPLES = 2000, 1024
SCATTER = math.sqrt(0.95 * 0.05 / RECORDS)


@pytest.mark.slow
@pytest.mark.parametrize("kind", POWER)
def test_intervals_of_deviations(kind: str) -> None:
    """Nine averaging times of four kinds of noise, with the noise type told and found: jointly at 1 % (Šidák) within the binomial range
    about what a chi-squared interval with these degrees of freedom covers exactly. Where types are found, that is the mean over the types
    as often as each was found, as if this did not depend on the deviation."""
    shares = deviation_coverage(kind, RECORDS, 70, SAMPLES)
    each = 1 - 0.99 ** (1 / (9 * 4 * 2))

    def exact(factor: int, alpha: int) -> float:
        return exact_coverage(kind, factor, SAMPLES, degrees_of_freedom(alpha, 2, factor, SAMPLES + 1))

    for k, factor in enumerate(shares["factor"].tolist()):
        right = exact(factor, POWER[kind])
        found = sum(share * exact(factor, 2 - place) for place, share in enumerate(shares["alphas"][k]) if share)
        for what, expected in (("told", right), ("inside", found)):
            low, high = binom.ppf(each / 2, RECORDS, expected), binom.ppf(1 - each / 2, RECORDS, expected)
            assert low <= round(shares[what][k] * RECORDS) <= high, (factor, what, shares[what][k], expected)


@pytest.mark.slow
@pytest.mark.parametrize("kind", POWER)
def test_degrees_of_freedom_are_those_that_cover(kind: str) -> None:
    """From four samples on, where the sampled noise is a power law, no interval covers less than 95 %, and none more than few degrees of
    freedom make of a sum that is not quite chi-squared."""
    for factor in (4, 8, 32, 64, 128, 256):
        freedom = degrees_of_freedom(POWER[kind], 2, factor, SAMPLES + 1)
        share = exact_coverage(kind, factor, SAMPLES, freedom)
        assert 0.9495 < share < 0.955 + 0.08 / freedom, (factor, share, freedom)


@pytest.mark.parametrize("freedom", [10, 100])
def test_distribution_of_equal_weights_is_chi_squared(freedom: int) -> None:
    at = chi2.ppf([0.025, 0.3, 0.975], freedom) / freedom
    assert distribution(np.full(freedom, 1 / freedom), at) == pytest.approx([0.025, 0.3, 0.975], abs=1e-7)


def test_truth_of_the_spectrum() -> None:
    """Allan variances of sampled white noise, its differences and its sum: 1/m, 3/m², (2·m² + 1)/(6·m)."""
    for m in (1, 4, 32):
        assert true_variance("N", m) == pytest.approx(1 / m, rel=1e-9)
        assert true_variance("Q", m) == pytest.approx(3 / m**2, rel=1e-9)
        assert true_variance("K", m) == pytest.approx((2 * m**2 + 1) / (6 * m), rel=1e-9)
    assert true_variance("B", 64) == pytest.approx(2 * math.log(2) / math.pi, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "noise",
    [MIXTURE, {"N": 1.0, "B": 0.2}, {"N": 1.0, "K": 0.01}, {"B": 1.0}, {"K": 1.0}],
    ids=["QNBK", "NB", "NK", "B", "K"],
)
def test_intervals_of_coefficients(noise: dict[str, float]) -> None:
    """A coefficient that is hardly told from zero has the wider interval of a bound; none covers less."""
    for name, (inside, bias, scatter) in coefficient_coverage(RECORDS, seed=71, **noise).items():
        assert inside > 0.95 - 4 * SCATTER - 0.01, (name, inside)
        assert abs(bias) < 0.5 and 0.5 < scatter < 1.2, (name, bias, scatter)

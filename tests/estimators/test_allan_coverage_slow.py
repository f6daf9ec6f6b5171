"""Coverage of the Allan intervals and of the fitted coefficients, for every kind of noise that the fit knows."""

from __future__ import annotations

import math

import pytest
from allan_coverage import MIXTURE, coefficient_coverage, deviation_coverage

RECORDS = 2000
SCATTER = math.sqrt(0.95 * 0.05 / RECORDS)


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["N", "Q", "B", "K"])
def test_intervals_of_deviations(noise: str) -> None:
    """Within four standard deviations of the binomial; at the two longest averaging times, known by ten degrees and fewer, no less."""
    inside = deviation_coverage(RECORDS, seed=70, **{noise: 1.0})["inside"]
    assert inside.min() > 0.95 - 4 * SCATTER - 0.01, inside
    assert inside[:-2].max() < 0.95 + 4 * SCATTER + 0.015, inside


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

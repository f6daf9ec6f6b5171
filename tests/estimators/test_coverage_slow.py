"""Coverage of the 95 % intervals of all twelve coefficients over simulated experiments, on both bases."""

from __future__ import annotations

import numpy as np
import pytest
from coverage_experiment import NAMES, SCENARIOS, coverage, flicker_in_segments

RUNS = 1_000
DOUBTED = 0.214
"""Fraction of the runs without a drift in which a drift is in doubt (decision 86). Their intervals are wider and may all hold the truth."""


def joint_tolerance() -> tuple[int, int]:
    """The range that each binomial count may take, jointly at 1 % (Šidák) for 12 coefficients on two bases in seven experiments, if every
    interval covers 95 %, or 100 % in the runs in which a drift is in doubt."""
    from scipy.stats import binom

    each = 1 - 0.99 ** (1 / (12 * 2 * 7))
    return int(binom.ppf(each / 2, RUNS, 0.95)), int(binom.ppf(1 - each / 2, RUNS, 0.95 + 0.05 * DOUBTED))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "white noise",
        "white noise, second output four times noisier",
        "flicker 0.025 pulse/s, declared",
        "flicker 0.1 pulse/s, declared",
        "flicker 0.4 pulse/s, declared",
        "position error 30 arcsec, stated, noise ten times less",
        "flicker 0.1 pulse/s and position error 30 arcsec, both stated",
    ],
)
def test_intervals_cover_95_percent(name: str) -> None:
    low, high = joint_tolerance()
    for basis, share in coverage(RUNS, 11, **SCENARIOS[name]).items():
        counts = np.rint(share * RUNS).astype(int)
        print(f"{name}, {basis}: " + ", ".join(f"{one} {s:.4f}" for one, s in zip(NAMES, share, strict=True)))
        assert low <= counts.min(), (basis, NAMES[int(counts.argmin())], counts.min(), low)
        assert counts.max() <= high, (basis, NAMES[int(counts.argmax())], counts.max(), high)


@pytest.mark.slow
def test_what_nobody_states_is_not_covered_within_segments() -> None:
    """With noise ten times less than the shipped bench's, 30″ of position error is most of the scatter; and flicker of 0.1 pulse/s."""
    found = coverage(1_000, seed=12, tilt=30.0, white=0.09)
    assert found["within_segment"].min() < 0.85
    assert found["residual"].min() > 0.85
    assert coverage(500, seed=13, flicker=0.1)["within_segment"].min() < 0.75


def test_flicker_of_the_experiments_has_the_floor_of_its_definition() -> None:
    """Allan deviation √(2·ln 2/π)·B = 0.664·B between the averaging times where 1/f rules (IEEE 952)."""
    rng = np.random.default_rng(0)
    series = flicker_in_segments(rng, (400, 2), 1.0, span=7200.0)  # averages within one dwell are consecutive
    for size in (4, 8, 16):
        means = series.reshape(*series.shape[:3], -1, size).mean(axis=-1)
        deviation = np.sqrt(np.mean(np.diff(means, axis=-1) ** 2) / 2)
        assert deviation == pytest.approx(0.664, abs=0.03)

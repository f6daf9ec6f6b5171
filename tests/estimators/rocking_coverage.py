"""How often the stated 95 % intervals of rocking drifts hold the truth, over recordings of `rocking_recordings`.

python tests/estimators/rocking_coverage.py COUNT SEED STATE …        (three repeats in each state)
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from rocking_recordings import ARCSEC, DEG, GRAVITY, LATITUDE, PER_HOUR, TABLE, World, estimate, recordings

from planrunner.estimators.interface import Estimate, Setup
from planrunner.uncertainty.decision import coverage_factor
from planrunner.uncertainty.influences import InputQuantity, Inputs

MICRO_G = 9.80665e-6
RATE = 1.0  # samples a second: the filter passes 0.05 Hz, and the base rocks at 0.2 Hz
ROCKING = np.array([0.010, -0.014, 0.008]) * PER_HOUR
TRUTH = ROCKING / PER_HOUR * 420 / 538  # rocked from t0 to 480 s, of the 538 s between the windows
REPEATS = 3
STATED = 2 * ARCSEC  # installation angles
SETUP = Setup(
    TABLE,
    inputs=Inputs(
        {
            "latitude": InputQuantity("latitude", LATITUDE, "rad", 20 * ARCSEC),
            "gravity": InputQuantity("gravity", GRAVITY, "m/s^2", 2e-5),
        }
    ),
)


def one(draw: np.random.Generator, states: Sequence[str]) -> Estimate:
    """One rocking test with everything drawn anew: what all its runs share, and what each has of its own."""
    shared: dict[str, Any] = {
        "installation": STATED * draw.standard_normal(6),
        "latitude": LATITUDE + 20 * ARCSEC * draw.standard_normal(),
        "gravity": GRAVITY + 2e-5 * draw.standard_normal(),
        "bias": 50 * MICRO_G * draw.standard_normal(3),
    }

    def run(dynamic: bool) -> World:
        drift = (np.array([0.21, -0.34, 0.15]) + 0.002 * draw.standard_normal(3)) * PER_HOUR
        caged = np.array([1.0, 1.0, 1.0]) * 60 * ARCSEC * draw.uniform(-1, 1, 3)
        return World(
            drift=drift,
            rocking=ROCKING if dynamic else np.zeros(3),
            caged=caged,
            bias_walk=10 * MICRO_G / 60,
            white=5 * MICRO_G,
            angle_walk=0.0004 * DEG / 60,
            count=2.5 / 2**21,
            shaking=0.004 if dynamic else 0.0,
            return_error=15 * ARCSEC,
            release=5.0 if dynamic else 0.0,
            **shared,
        )

    worlds = []
    for _ in range(REPEATS):
        for state in states:
            four = [run(False), run(True), run(True), run(False)]
            worlds.append((state, four))
    recorded = recordings(worlds, RATE, seed=int(draw.integers(2**62)))
    return estimate(recorded, "{accelerometer_stability: 5 ug}", SETUP)


def combined(result: Estimate) -> np.ndarray:
    """Standard uncertainties (m,) with what the influences add to the scatter."""
    added = sum(
        (item.covariance for item in result.influences if not item.in_scatter), np.zeros_like(result.covariance)
    )
    return np.sqrt(np.diag(result.covariance + added))


def campaign(
    count: int, seed: int = 1, states: Sequence[str] = ("vertical", "horizontal"), told_after: int = 0
) -> dict[str, tuple[int, int]]:
    """Coefficient → (intervals that hold the truth, intervals); told after so many tests."""
    draw = np.random.default_rng(seed)
    held: dict[str, tuple[int, int]] = {}
    for number in range(1, count + 1):
        result = one(draw, states)
        for item, spread in zip(result.coefficients, combined(result), strict=True):
            truth = TRUTH["xyz".index(item.name[-1])]
            inside = abs(item.value - truth) <= coverage_factor(item.degrees_of_freedom) * spread
            before = held.get(item.name, (0, 0))
            held[item.name] = before[0] + bool(inside), before[1] + 1
        if told_after and number % told_after == 0:
            tell(held)
    return held


def tell(held: dict[str, tuple[int, int]]) -> None:
    for name, (inside, of) in held.items():
        share = inside / of
        print(f"{name}: {100 * share:.2f} % of {of} (standard error {100 * math.sqrt(share * (1 - share) / of):.2f} %)")
    print(flush=True)


if __name__ == "__main__":
    campaign(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:], told_after=500)

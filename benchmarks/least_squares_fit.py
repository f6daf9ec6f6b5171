"""Compares a fit of twelve parameters to 10⁴ observations (including covariance and rank check) with `numpy.linalg.lstsq` alone."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from planrunner.estimators.least_squares import fit

PARAMETERS = 12


@dataclass(frozen=True, slots=True)
class Size:
    observations: int
    turns: int


FULL, SMALL = Size(10_000, 60), Size(200, 2)


def run(size: Size = FULL) -> dict[str, object]:
    draw = np.random.default_rng(0)
    matrix = draw.standard_normal((size.observations, PARAMETERS)) * np.geomspace(1e-5, 10, PARAMETERS)
    observed = matrix @ np.arange(1.0, PARAMETERS + 1) + 0.1 * draw.standard_normal(size.observations)
    sigma = np.full(size.observations, 0.1)
    magnitudes = np.geomspace(1e-5, 10, PARAMETERS)
    names = tuple(f"c{k}" for k in range(PARAMETERS))
    ours, theirs = [], []
    for _ in range(size.turns):
        began = time.perf_counter()
        found = fit(matrix, observed, sigma, magnitudes, names)
        middle = time.perf_counter()
        plain = np.linalg.lstsq(matrix, observed, rcond=None)[0]
        theirs.append(time.perf_counter() - middle)
        ours.append(middle - began)
    assert np.allclose(found.coefficients, plain, rtol=1e-8)
    return {
        "fit with covariance, residuals and rank [ms]": 1e3 * min(ours),
        "numpy.linalg.lstsq [ms]": 1e3 * min(theirs),
        "ratio (target ≤ 1.5)": min(ours) / min(theirs),
    }

"""Measures a million Monte Carlo draws (JCGM 101) of static coefficients, from the fit and the declared inputs to the intervals."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from planrunner.error_model.flexure_gyro import output_coefficients, static_model
from planrunner.estimators.flexure_gyro.flexure_gyro_static import static_coefficients
from planrunner.estimators.outputs_fit import fit_outputs
from planrunner.observation.observations import Observations
from planrunner.uncertainty.influences import Influence, InputQuantity
from planrunner.uncertainty.monte_carlo import propagate

POSITIONS, TERMS, DWELL = 8, 6, 120.0


@dataclass(frozen=True, slots=True)
class Size:
    draws: int


FULL, SMALL = Size(1_000_000), Size(20_000)


def run(size: Size = FULL) -> dict[str, object]:
    rng = np.random.default_rng(0)
    matrix = np.column_stack([np.ones(POSITIONS), rng.normal(size=(POSITIONS, TERMS - 1))])
    outputs = output_coefficients(np.array([0.2, 0.21, 2e-3, -1e-3, *rng.normal(size=8)]))
    mean = matrix @ outputs.T + 0.01 * rng.normal(size=(POSITIONS, 2))
    start = 150 * np.arange(POSITIONS, dtype=float)
    observations = Observations(
        ("x", "y"),
        ("pulse/s", "pulse/s"),
        tuple(f"P{n}" for n in range(POSITIONS)),
        mean,
        np.full((POSITIONS, 2), 0.01),
        np.full(POSITIONS, 32),
        start,
        start + DWELL,
        np.eye(2),
    )
    names = tuple(f"c{k}" for k in range(TERMS))
    fit = fit_outputs(matrix, observations, np.ones(TERMS), names, "residual", True)
    shapes = ("normal", "rectangular", "normal", "t")
    stated = [
        Influence(
            InputQuantity(f"q{k}", 0.0, "rad", 1e-3, 9.0 if shape == "t" else np.inf, shape),
            rng.normal(size=(12, 1 + 7 * (k == 0))),
        )
        for k, shape in enumerate(shapes)
    ]
    found_by_fit = static_coefficients(fit, observations.units, static_model(), ())
    draw = found_by_fit.draws("residual", [stated])
    began = time.perf_counter()
    for _ in range(size.draws // 10_000):
        draw(rng, 10_000)
    drawn = time.perf_counter() - began
    began = time.perf_counter()
    found = propagate(lambda source, n: draw(source, n)[:12], np.zeros(12), most=size.draws)
    whole = time.perf_counter() - began
    assert found.draws == size.draws
    return {
        "random draws of twelve coefficients and of the outputs [s]": drawn,
        "draws with the adaptive rule, symmetric intervals and shortest intervals [s] (target ≤ 5)": whole,
    }
